"""Where the gap lies, against answers: loudest stream, regime, time and place, and the time that telling takes.

python -m tests.bench.bench_gap_where [--shared DIR] [--cases N] [--first K] [--strata A,B] [--causes A,B]: the shared
cases, then N drives of the plant with one effect each, some of them in no library, and clean ones. F1 is pooled over
the cases of a stratum.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from core.formats import read_run  # noqa: E402
from core.gap import Diagnosis, diagnose  # noqa: E402
from core.robot import Pose  # noqa: E402
from core.run import Run  # noqa: E402
from tests.plants.gap_draws import draw  # noqa: E402
from tests.plants.gap_plant import OUTSIDE, Plan, drive, record, robot  # noqa: E402

Spans = list[tuple[float, float]]

REGIME = {
    "accelerating": "command_delay motor_lag accel_limit wheel_slip accel_scale imu_yaw imu_clock load_play",
    "moving": "drive_gain wheel_radius unequal_wheels vibration missed_ticks beacon_delay left_motor encoder_wobble "
    "resonance",
    "turning": "track_width gyro_scale imu_offset gyro_sign",
    "early to late": "battery_sag gyro_drift gyro_walk gyro_temperature clock_drift fix_drift fix_clock sag_rest",
    "turning while moving": "side_slip gyro_g_sensitivity gyro_fade",
    "place": "slip_patch beacon_shadow anchor_moved ramp",
    "heading": "floor_tilt tag_offset headwind heading_echo",
    "always": "gyro_bias gyro_noise accel_bias beacon_shift beacon_rotation beacon_scale beacon_noise beacon_outliers "
    "range_bias long_anchor",
    "fast": "speed_limit caster drag",
    "slow": "deadband",
    "fast turning": "gyro_clip gyro_cubic",
    "time": "bump",
}
"""In which regime each cause of the plant shows, by its equation."""
HEADS = ("regime", "time", "place", "false", "CPU s")
STRONG = 0.1
"""A stream with this share of the loudest one's energy counts as loudest too."""


@dataclass
class Tally:
    """Counts of one stratum."""

    loudest: list[float] = field(default_factory=list)
    regime: list[tuple[float, float, float]] = field(default_factory=list)
    when: list[tuple[float, float, float]] = field(default_factory=list)
    place: list[tuple[float, float, float]] = field(default_factory=list)
    false: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)


@dataclass(frozen=True)
class Answer:
    """What is to be found: streams that show it most, regimes, when in the first run, and where (x, y, radius)."""

    strict: frozenset[str]
    regimes: frozenset[str]
    spans: Spans
    place: tuple[float, float, float] | None


def regime_of(cause: str) -> str:
    """By the table."""
    return next(regime for regime, names in REGIME.items() if cause in names.split())


def covered(spans: Sequence[tuple[float, float]], t: np.ndarray) -> np.ndarray:
    """Which instants lie in the intervals."""
    inside = np.zeros(len(t), dtype=bool)
    for a, b in spans:
        inside |= (t >= a) & (t <= b)
    return inside


def score(found: Diagnosis, answer: Answer, end: float, tally: Tally) -> str:
    """Counts of one case, and a line that tells it."""
    if not answer.regimes:
        cells = sum(one.significant for one in found.evidence.cells)
        tally.false.append(float(bool(found.where) or cells > 0))
        return f"clean: {len(found.where)} rows, {cells} cells"
    first = found.where[0].stream if found.where else "-"
    tally.loudest.append(float(first in answer.strict))
    told = {one.regime for one in found.where}
    tally.regime.append((len(told & answer.regimes), len(told - answer.regimes), len(answer.regimes - told)))
    t = np.arange(0.0, end, 0.1)
    ours = covered([span for one in found.where[:1] for span in one.intervals], t)
    theirs = covered(answer.spans, t)
    if ours.any() or theirs.any():
        both, false, missed = (float(part.sum()) / 10 for part in (ours & theirs, ours & ~theirs, theirs & ~ours))
        tally.when.append((both, false, missed))
    places = [one.place for one in found.where if one.place is not None]
    if answer.place is not None:
        x, y, radius = answer.place
        hit = any(np.hypot(p.x - x, p.y - y) < radius and 0.5 < p.radius / radius < 2.0 for p in places)
        tally.place.append((float(hit), 0.0, float(not hit)))
    elif places:
        tally.place.append((0.0, 1.0, 0.0))
    return f"{first} of {sorted(answer.strict)}; {sorted(told)} of {sorted(answer.regimes)}"


def f1(rows: Sequence[tuple[float, float, float]]) -> str:
    """Pooled over cases."""
    if not rows:
        return "     -"
    hit, false, missed = np.sum(rows, axis=0)
    return f"{2 * hit / max(2 * hit + false + missed, 1e-9):6.2f}"


def anchored(run: Run) -> np.ndarray:
    """(N, 3) truth in windows of 2 s, each seen from its own start, less its mean."""
    log = run.truth
    assert log is not None and log.x is not None and log.y is not None and log.theta is not None
    poses = np.column_stack((log.x, log.y, np.unwrap(log.theta)))
    window = (log.t / 2.0).astype(int)
    start = poses[np.searchsorted(window, window)]
    far = poses - start
    c, s = np.cos(start[:, 2]), np.sin(start[:, 2])
    far = np.column_stack((c * far[:, 0] + s * far[:, 1], c * far[:, 1] - s * far[:, 0], far[:, 2]))
    count = np.bincount(window)
    return np.column_stack([column - (np.bincount(window, column) / count)[window] for column in far.T])


def energies(run: Run, bare: Run) -> dict[str, float]:
    """By stream, how far two drives with the same noise differ, in the stated noise, within windows of 2 s."""
    noise, ticks = run.meta.noise, run.meta.robot.ticks_per_rev or 1.0
    root = np.sqrt(50.0)
    sheet = {"wheels": 2 * np.pi / ticks / np.sqrt(6.0), "truth": 1e-3, "ranges": noise.range or 1.0}
    sheet |= {"imu.gz": (noise.gyro_density or 1.0) * root, "imu.ax": (noise.accel_density or 1.0) * root}
    sheet |= {"imu.ay": sheet["imu.ax"], "beacon.theta": noise.beacon_theta or 1.0, "beacon": noise.beacon_xy or 1.0}
    out = {}
    paths = [anchored(one) for one in (run, bare)]
    moved = float(np.abs(paths[0] - paths[1]).max()) > 1e-6
    for name, far in zip(("x", "y", "theta"), (paths[0] - paths[1]).T, strict=True):
        out[f"truth.{name}"] = float(np.sum((far / sheet["truth"]) ** 2))
    for stream, names in (("wheels", "left right"), ("imu", "gz ax ay"), ("beacon", "x y theta")):
        mine, theirs = getattr(run, stream), getattr(bare, stream)
        if mine is None or len(mine) != len(theirs) or (moved and stream == "beacon"):
            continue  # fixes along another path tell the path, not the cause
        for name in names.split():
            far = np.asarray(getattr(mine, name) - getattr(theirs, name), dtype=float)
            if stream == "wheels":
                window = (mine.t / 2.0).astype(int)
                far = far - (np.bincount(window, far) / np.maximum(np.bincount(window), 1))[window]
            key = f"{stream}.{name}"
            out[key] = float(np.sum((far / sheet.get(key, sheet.get(stream, 1.0))) ** 2))
    if not moved and run.ranges is not None and bare.ranges is not None and len(run.ranges) == len(bare.ranges):
        out["ranges.range"] = float(np.sum(((run.ranges.range - bare.ranges.range) / sheet["ranges"]) ** 2))
    return out


def cause_of(kind: str, seed: int) -> str:
    """Which cause a seed draws."""
    causes = [name for names in REGIME.values() for name in names.split() if name not in OUTSIDE]
    return sorted(OUTSIDE)[seed % len(OUTSIDE)] if kind == "outside" else causes[seed % 38]


def planted(kind: str, seed: int) -> tuple[list[Run], Run, Answer, str]:
    """Fit runs, held-out run and answer of one drive of the plant."""
    rng = np.random.default_rng([seed, 23])
    name = cause_of(kind, seed)
    effects = draw(name, float(rng.uniform(8.0, 25.0)), rng) if kind == "listed" else {}
    outside = {name: OUTSIDE[name] * 1.5} if kind == "outside" else {}
    fit = [Plan(seed, "mixed", 100.0, effects, outside), Plan(seed, "turns", 80.0, effects, outside)]
    runs = [record(plan) for plan in fit]
    held = record(Plan(seed, "stops", 90.0, effects, outside))
    if kind == "clean":
        return runs, held, Answer(frozenset(), frozenset(), [], None), "clean"
    sizes = energies(runs[0], record(replace(fit[0], effects={}, outside={})))
    top = max(sizes.values(), default=0.0)
    strict = (
        frozenset(n for n, size in sizes.items() if size >= STRONG * top)
        if top > 0
        else frozenset(("beacon.x", "beacon.y", "ranges.range"))
    )
    spans: Spans = []
    place: tuple[float, float, float] | None = None
    values: Mapping[str, float | str] = effects.get(name, {})
    if name == "bump":
        spans = [(float(values["time"]), float(values["time"]) + 0.3)]
    if name in ("slip_patch", "beacon_shadow"):
        place = (float(values["x"]), float(values["y"]), float(values["radius"]))
        body = drive(fit[0], robot(seed)[0], Pose(2.5, 2.0, 0.3))
        inside = np.hypot(body["x"] - place[0], body["y"] - place[1]) < place[2]
        edges = np.flatnonzero(np.diff(np.concatenate(([0], inside.astype(int), [0]))))
        spans = [(float(body["t"][a]), float(body["t"][b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return runs, held, Answer(strict, frozenset((regime_of(name),)), spans, place), name


def shared(case: Path, told: Mapping[str, Any]) -> tuple[list[Run], Run, Answer]:
    """One of the shared cases."""
    where = told["where"]
    discs = [e["parameters"] for e in told["effects"] if "radius" in e["parameters"]]
    place = (discs[0]["x"], discs[0]["y"], discs[0]["radius"]) if discs else None
    spans = [(a, b) for a, b in where["intervals"].get("fit/run1", [])]
    answer = Answer(frozenset(where["strict"]), frozenset(where["regime"]), spans, place)
    return [read_run(path) for path in sorted((case / "fit").iterdir())], read_run(case / "heldout"), answer


def main() -> None:
    """All strata."""
    options = argparse.ArgumentParser()
    options.add_argument("--shared", type=Path)
    options.add_argument("--cases", type=int, default=8)
    options.add_argument("--first", type=int, default=0)
    options.add_argument("--strata", default="listed,outside,clean")
    options.add_argument("--causes", help="only seeds that draw one of these, as bump,slip_patch")
    chosen = options.parse_args()
    tallies: dict[str, Tally] = {}

    def run_case(stratum: str, label: str, runs: list[Run], held: Run, answer: Answer) -> None:
        began = time.process_time()
        found = diagnose(runs, held_out=[held])
        tally = tallies.setdefault(stratum, Tally())
        tally.seconds.append(time.process_time() - began)
        print(stratum, label, found.verdict, score(found, answer, runs[0].span[1], tally), flush=True)

    if chosen.shared:
        for case in sorted((chosen.shared / "cases").iterdir()):
            told = json.loads((chosen.shared / "answers" / f"{case.name}.json").read_text())
            run_case("shared", told["label"], *shared(case, told))
    for stratum in filter(None, chosen.strata.split(",")):
        wanted = set(filter(None, (chosen.causes or "").split(",")))
        drawn = (k for k in itertools.count(chosen.first) if not wanted or cause_of(stratum, k) in wanted)
        for seed in itertools.islice(drawn, chosen.cases):
            runs, held, answer, label = planted(stratum, seed)
            run_case(stratum, label, runs, held, answer)
    print(f"{'stratum':9s} {'n':>3s} {'loudest':>8s} " + " ".join(f"{n:>6s}" for n in HEADS))
    for stratum, tally in tallies.items():
        loudest = f"{np.mean(tally.loudest):8.2f}" if tally.loudest else f"{'-':>8s}"
        false = f"{np.mean(tally.false):6.2f}" if tally.false else f"{'-':>6s}"
        print(
            f"{stratum:9s} {len(tally.seconds):3d} {loudest} {f1(tally.regime)} {f1(tally.when)} {f1(tally.place)} "
            f"{false} {np.mean(tally.seconds):6.1f}"
        )


if __name__ == "__main__":
    main()
