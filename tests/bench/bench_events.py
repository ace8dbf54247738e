"""Hits against false alarms of the event detectors on injected faults, per kind and by size. Run by hand.

Two worlds of tests/plants/faults.py, ordinary flaws in both: missions with faults (hits), and missions without (false
alarms per hour). The knob is `event_false_alarms`. `found`: an event of that kind touches the label; `onset`: it also
begins within 0.2 s of it; `seen`: any kind touches. `elsewhere`: alarms in the faulty missions outside of every fault.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
from collections import defaultdict
from pathlib import Path

import numpy as np

from core.estimation.assumptions import Assumptions, assume
from core.estimation.events import KINDS, Disturbances, detect
from core.estimation.result import Event
from core.formats import read_run
from core.run import Run
from tests.plants.faults import FAULTS, FaultRun, Label, fault_run

ROOT = Path(__file__).resolve().parents[2]
KNOBS = (1e-3, 0.1, 1.0, 10.0, 1e3)
SIZES = {
    "slip": (0.0, 0.01, 0.02, 0.04, 0.08, 0.16, np.inf),
    "collision": (0.2, 0.4, 0.6, 0.8, np.inf),
    "bounce": (2.0, 4.0, 6.0, 9.0, np.inf),
    "pushed": (0.0, 0.05, 0.1, 0.2, np.inf),
    "stuck": (0.0, 1.5, 3.0, np.inf),
    "dead_encoder": (0.0, 1.0, 2.0, 4.0, np.inf),
}
UNITS = {"slip": "m", "collision": "m/s", "bounce": "m/s²", "pushed": "m/s", "stuck": "s", "dead_encoder": "s"}
TOUCH, ONSET = 0.3, 0.2  # s


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Of one label: found by its name, with its onset, seen by any name; onset error and delay of the alarm [s]."""

    label: Label
    found: bool
    onset: bool
    seen: tuple[str, ...]
    error: float
    delay: float


def judge(label: Label, events: tuple[Event, ...], found: Disturbances) -> Outcome:
    """The events that touch a label."""
    near = [e for e in events if e.t0 <= label.t1 + TOUCH and e.t1 >= label.t0 - TOUCH]
    mine = [e for e in near if e.kind == label.kind]
    if not mine:
        return Outcome(label, False, False, tuple(e.kind for e in near), np.nan, np.nan)
    best = min(mine, key=lambda e: abs(e.t0 - label.t0))
    error = best.t0 - label.t0
    alarm = min(d.alarm for d in found.found if d.kind == best.kind and best.t0 <= d.t0 <= best.t1)
    return Outcome(label, True, abs(error) <= ONSET, tuple(e.kind for e in near), error, alarm - label.t0)


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--seeds", type=int, default=12, help="missions with faults, ten minutes each")
    options.add_argument("--clean", type=int, default=12, help="missions without, half an hour each")
    options.add_argument("--first", type=int, default=1000)
    options.add_argument("--faults", default=",".join(FAULTS))
    options.add_argument("--misses", action="store_true", help="list what was not found at knob 1")
    options.add_argument("--real", type=Path, default=ROOT.parent / "shared" / "data" / "real")
    options.add_argument("--worlds", type=int, default=5, help="seeds of each MuJoCo world")
    chosen = options.parse_args()
    seeds = range(chosen.first, chosen.first + chosen.seeds)
    clean_seeds = range(chosen.first + 500, chosen.first + 500 + chosen.clean)
    faulty = [fault_run(seed, 600.0, tuple(chosen.faults.split(","))) for seed in seeds]
    print(f"seeds {seeds} with faults, {clean_seeds} without")
    outcomes: dict[float, list[Outcome]] = defaultdict(list)
    elsewhere: dict[float, dict[str, int]] = {knob: defaultdict(int) for knob in KNOBS}
    wrong: dict[float, dict[str, int]] = {knob: defaultdict(int) for knob in KNOBS}
    hours = 0.0
    for seed in clean_seeds:
        run = fault_run(seed, 1800.0, ()).run
        hours += run.duration / 3600
        for knob in KNOBS:
            for event in detect(run, numbers(run, knob)).events:
                wrong[knob][event.kind] += 1
    for made in faulty:
        for knob in KNOBS:
            found = detect(made.run, numbers(made.run, knob))
            for label in made.labels:
                outcomes[knob].append(judge(label, found.events, found))
            for event in found.events:
                if not any(one.t0 - 0.5 <= event.t1 and event.t0 <= one.over for one in made.labels):
                    elsewhere[knob][event.kind] += 1
    report(outcomes, elsewhere, wrong, hours, sum(m.run.duration for m in faulty) / 3600)
    if chosen.misses:
        misses(outcomes[1.0], faulty)
    other_worlds(chosen.worlds)
    recorded(chosen.real)


def numbers(run: Run, knob: float) -> Assumptions:
    """The run's numbers with the knob set."""
    return dataclasses.replace(assume(run)[0], event_false_alarms=knob)


def report(
    outcomes: dict[float, list[Outcome]],
    elsewhere: dict[float, dict[str, int]],
    wrong: dict[float, dict[str, int]],
    hours: float,
    faulty_hours: float,
) -> None:
    """Curve per kind, then strata by size and by fault at knob 1."""
    print(
        f"\n{'kind':13s} {'knob /h':>8s} {'false /h':>9s} {'elsewhere /h':>13s} {'found':>7s} {'onset':>7s} {'n':>5s}"
    )
    for kind in KINDS:
        for knob in KNOBS:
            mine = [o for o in outcomes[knob] if o.label.kind == kind]
            n = max(len(mine), 1)
            print(
                f"{kind:13s} {knob:8g} {wrong[knob][kind] / max(hours, 1e-9):9.2f} "
                f"{elsewhere[knob][kind] / max(faulty_hours, 1e-9):13.2f} {sum(o.found for o in mine) / n:7.1%} "
                f"{sum(o.onset for o in mine) / n:7.1%} {len(mine):5d}"
            )
    print(f"\n{hours:.1f} h without faults, {faulty_hours:.1f} h with; at knob 1 by size:")
    print(
        f"{'kind':13s} {'size':>16s} {'found':>7s} {'onset':>7s} {'seen':>7s} {'n':>5s}{'onset err, 95 %; alarm':>34s}"
    )
    for kind, edges in SIZES.items():
        for low, high in itertools.pairwise(edges):
            row(
                kind,
                f"{low:g}-{high:g} {UNITS[kind]}",
                [o for o in outcomes[1.0] if o.label.kind == kind and low <= o.label.size < high],
            )
    print("by fault:")
    for fault in FAULTS:
        row(fault, "", [o for o in outcomes[1.0] if o.label.fault == fault])


def row(name: str, size: str, mine: list[Outcome]) -> None:
    if not mine:
        return
    errors = np.abs([o.error for o in mine if o.found])
    delays = [o.delay for o in mine if o.found]
    spread = f"{np.median(errors):.3f} s {np.quantile(errors, 0.95):.3f} s {np.median(delays):.2f} s" if delays else ""
    n = len(mine)
    print(
        f"{name:13s} {size:>16s} {sum(o.found for o in mine) / n:7.1%} {sum(o.onset for o in mine) / n:7.1%} "
        f"{sum(bool(o.seen) for o in mine) / n:7.1%} {n:5d} {spread:>34s}"
    )


def misses(outcomes: list[Outcome], faulty: list[FaultRun]) -> None:
    where = {id(label): made.run.meta.name for made in faulty for label in made.labels}
    for o in outcomes:
        if not o.onset:
            print(f"{where[id(o.label)]}: {o.label} seen as {o.seen}, onset error {o.error:.2f} s")


def other_worlds(seeds: int) -> None:
    """MuJoCo: a bar with one spinning tyre, a wall with both, lifted and carried, and missions without any of it."""
    from tests.plants.mujoco_worlds import world

    print("\nMuJoCo, what was found at knob 1 per world (seeds from 0) and how far from the mark it begins")
    for name, mark in (("obstacle", "spin"), ("wall", "contact"), ("carried", "carried"), ("mission", "")):
        kinds: dict[str, int] = defaultdict(int)
        errors: list[float] = []
        for seed in range(seeds):
            made = world(name, seed)
            events = detect(made.run, numbers(made.run, 1.0)).events
            for kind in {e.kind for e in events}:
                kinds[kind] += 1
            begins = [m.t0 for m in made.marks if m.kind == mark]
            if begins and events:
                errors.append(min(abs(e.t0 - begins[0]) for e in events))
        spread = f"onset error at most {max(errors):.3f} s" if errors else ""
        print(f"{name:10s} {seeds} runs: " + (", ".join(f"{k} in {n}" for k, n in kinds.items()) or "none"), spread)


def recorded(folder: Path) -> None:
    """Events per hour of recorded runs, by set. What is there is not known: skid steering on gravel does slip."""
    if not folder.is_dir():
        return
    hours: dict[str, float] = defaultdict(float)
    counts: dict[str, dict[str, int]] = defaultdict(lambda: defaultdict(int))
    for file in sorted(folder.rglob("run.json")):
        run = read_run(file.parent)
        name = file.relative_to(folder).parts[0]
        hours[name] += run.duration / 3600
        for event in detect(run, numbers(run, 1.0)).events:
            counts[name][event.kind] += 1
    print("\nrecorded runs")
    for name, total in hours.items():
        found = ", ".join(f"{k} {n} ({n / total:.0f}/h)" for k, n in counts[name].items())
        print(f"{name:20s} {total:7.3f} h  {found or 'none'}")


if __name__ == "__main__":
    main()
