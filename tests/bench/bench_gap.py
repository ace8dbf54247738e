"""The diagnosis on worlds of other programs, per stratum, beside simple baselines and an oracle.

python -m tests.bench.bench_gap [--cases N] [--first SEED] [--strata single,pair,...] [--shared DIR] [--lines FILE]: one
row per stratum. Worlds: the separately written plant (`gap_plant.py`) with a little of everything wrong, and MuJoCo's
robot (`gap_mujoco.py`). `loudest`: the loudest stream's most usual effect; `alone`: the effect that alone lowers the
deviance most; `together`: the clearest of one joint least-squares fit of all; shrinkage is told as a share of what the
true effects themselves reach.
"""

from __future__ import annotations

import argparse
import itertools
import json
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from core.effects import EFFECTS  # noqa: E402
from core.formats import read_run  # noqa: E402
from core.gap import Diagnosis, diagnose  # noqa: E402
from core.gap.candidates import candidates  # noqa: E402
from core.gap.checks import check_runs  # noqa: E402
from core.gap.conclude import chance_of_none  # noqa: E402
from core.gap.floor import Floor  # noqa: E402
from core.gap.judged import judged  # noqa: E402
from core.gap.leftover import chance_of_unknown  # noqa: E402
from core.gap.linear import Problem, linearise, whitened, with_floor  # noqa: E402
from core.gap.reference import restarts_of  # noqa: E402
from core.gap.screen import gains_of  # noqa: E402
from core.gap.searched import reach_of, searched  # noqa: E402
from core.gap.shrink import NOISES, Scored, figures, show  # noqa: E402
from core.gap.types import Cause, Config, Immaterial, Unexplained  # noqa: E402
from core.gap.world import make_world  # noqa: E402
from core.run import Run  # noqa: E402
from tests.plants.gap_draws import draw, of_poses, plans  # noqa: E402
from tests.plants.gap_plant import Effects, Plan, acting, record  # noqa: E402

PLANT = (
    "null",
    "noise",
    "small",
    "single",
    "pair",
    "open",
    "no truth",
    "no imu",
    "no commands",
    "streams",
    "streams null",
)
STRATA = (*PLANT, "mujoco null", "mujoco single", "mujoco small", "mujoco pair", "mujoco open")
USUAL = {
    "wheels": "motor_lag", "imu.gz": "gyro_bias", "imu.ax": "accel_bias", "imu.ay": "accel_bias",
    "beacon": "beacon_shift", "ranges": "range_bias", "truth": "track_width",
}  # fmt: skip
Row = dict[str, float]
Case = tuple[list[Run], Run, Effects, str, Effects]


def alone(runs: Sequence[Run]) -> str:
    """The effect that alone promises the largest drop over both links."""
    worlds = tuple(make_world(run, restarts_of(run)) for run in runs)
    problem = with_floor(Problem(worlds, Floor({}, {}, {}), runs[0].meta.effects), {})
    tried = candidates(worlds[0].channels, list(runs[0].meta.beacons), reach_of(worlds), runs[0].meta.effects, True)
    total: dict[str, float] = {}
    for scope in ("wheels", "body"):
        gains = gains_of(linearise(problem, {}, tried, scope), 0, tried)
        for effect in {one.effect for one in tried}:
            best = max(g for one, g in zip(tried, gains, strict=True) if one.effect == effect)
            total[effect] = total.get(effect, 0.0) + float(best)
    return max(total, key=lambda name: total[name])


def together(runs: Sequence[Run]) -> str:
    """The effect that stands out most from one linear least-squares fit of all smooth effects at once."""
    worlds = tuple(make_world(run, restarts_of(run)) for run in runs)
    problem = with_floor(Problem(worlds, Floor({}, {}, {}), runs[0].meta.effects), {})
    tried = candidates(worlds[0].channels, list(runs[0].meta.beacons), reach_of(worlds), runs[0].meta.effects, True)
    smooth = [one for one in tried if not one.secant]
    clear: dict[str, float] = {}
    for scope in ("wheels", "body") if worlds[0].wheel_inputs is not None else ("body",):
        _, g, a = linearise(problem, {}, smooth, scope).total
        size = np.sqrt(np.maximum(np.diag(a), 1e-30))
        inverse = np.linalg.pinv(a / np.outer(size, size), rcond=1e-9)
        at, sd = inverse @ (g / size), np.sqrt(np.maximum(np.diag(inverse), 1e-12))
        keys = [one.effect for one in smooth for _ in one.keys]
        for effect, value in zip(keys, np.abs(at) / sd, strict=True):
            clear[effect] = max(clear.get(effect, 0.0), float(value))
    return max(clear, key=lambda name: clear[name])


def oracle(held: Run, answer: Effects, whole: Effects) -> float | None:
    """Shrinkage that the true effects reach on the held-out run. whole: with the little that this robot has anyway."""
    world = make_world(held, restarts_of(held, model=whole))
    problem = with_floor(Problem((world,), Floor({}, {}, {}), held.meta.effects), whole)
    noises = {name: values for name, values in answer.items() if name in NOISES}
    small = {name: values for name, values in whole.items() if name not in answer and name not in NOISES}
    scored = Scored((world,), [show(world, small, answer, problem.floor)], tuple(answer), True)
    return figures(scored, problem.floor, noises, 0)[0].shrink


SEEN = 25.0
"""2 log likelihood ratio from which a run shows an effect, were nothing else wrong with the robot."""


def shown(runs: Sequence[Run], answer: Effects) -> float | None:
    """2 log likelihood ratio of the true effects, by what they change in the readings; None of those that add noise."""
    if not answer or all(EFFECTS[name].noise_only for name in answer):
        return None
    worlds = tuple(make_world(run, restarts_of(run)) for run in runs)
    problem, total = with_floor(Problem(worlds, Floor({}, {}, {}), runs[0].meta.effects), answer), 0.0
    if worlds[0].run.commands is not None:
        problem = replace(problem, worlds=tuple(world.with_drive({}) for world in worlds))
    for scope in ("wheels", "body"):
        apart = [whitened(problem, model, (), scope)[0] for model in ({}, {k: dict(v) for k, v in answer.items()})]
        for without, beside in zip(*apart, strict=True):
            total += sum(float(np.sum((one.residual - beside[name].residual) ** 2)) for name, one in without.items())
    return total


@dataclass(frozen=True)
class Brief:
    """What was identified, without scores and evidence."""

    causes: tuple[Cause, ...]
    probabilities: dict[str, float]
    unexplained: Unexplained | None
    immaterial: tuple[Immaterial, ...]
    verdict: str


def identify(runs: Sequence[Run]) -> Brief:
    """The part of a diagnosis that names causes."""
    config = Config()
    check_runs(runs, ())
    known = runs[0].meta.effects
    one = searched(runs, known, config.window)
    said = judged(one.found, one.reach, known, config)
    causes = tuple(Cause(name, p, 0.0, said.values.get(name, {})) for name, p in said.chances.items())
    causes = tuple(sorted(causes, key=lambda c: -c.probability))
    sure = any(c.probability > 0.5 for c in causes)
    strange = max(chance_of_unknown(one.found), *said.doubt.values(), 0.0)
    chances = {"unknown": strange, "none": 0.0 if sure or said.unexplained else chance_of_none(strange, said.chances)}
    verdict = ("explained" if sure else "none") if said.unexplained is None else "partly" if sure else "unknown"
    small = tuple(Immaterial(name, {}) for name in one.found.trifles)
    return Brief(causes, chances, said.unexplained, small, verdict)


def score(
    runs: Sequence[Run], held: Run, true_effects: tuple[Effects, Effects], outside: bool, baselines: bool, brief: bool
) -> tuple[Row, Diagnosis | Brief]:
    """Figures of one case, and what was found. true_effects: the answer, and with all that is immaterial."""
    answer, whole = true_effects
    began = time.process_time()
    found = identify(runs) if brief else diagnose(runs, held_out=[held])
    row: Row = {"cpu_s": time.process_time() - began, "unknown": found.probabilities.get("unknown", 0.0)}
    ranked = sorted(found.causes, key=lambda one: -one.probability)
    named = {one.effect for one in ranked if one.probability > 0.5}
    true = set(answer)
    row["false"] = float(len(named - true) > 0)
    row["told unknown"] = float(found.unexplained is not None)
    row["exact"] = float(named == true and (found.unexplained is not None) == outside)
    if true:
        order = [one.effect for one in ranked]
        sure = {one.effect for one in ranked if one.probability > 0.8}
        row["honest"] = float(row["exact"] or (bool(true & set(order[:3])) and sure <= true))
        row |= {"top1": float(bool(order) and order[0] in true), "top3": float(bool(true & set(order[:3])))}
        row["p"] = float(np.mean([next((c.probability for c in ranked if c.effect == name), 0.0) for name in true]))
        row["F1"] = 2 * len(named & true) / (len(named) + len(true))
        if baselines:
            row["alone"] = float(alone(runs) in true)
            row["together"] = float(together(runs) in true)
    if isinstance(found, Diagnosis):
        if true:
            stream = found.where[0].stream if found.where else "-"
            row["loudest"] = float(USUAL.get(stream, USUAL.get(stream.split(".")[0], "-")) in true)
            best = oracle(held, answer, whole)
            if best is not None and best > 0.05 and found.gap.shrink is not None:
                row["shrunk"] = found.gap.shrink / best
        row["harm"] = float(found.gap.total.after > 1.002 * found.gap.total.before and bool(named))
    errors = [
        (float(c.parameters[n].value) - float(v)) / (c.parameters[n].std or np.inf)
        for c in found.causes
        if c.effect in answer and c.probability > 0.5
        for n, v in answer[c.effect].items()
        if not isinstance(v, str) and n in c.parameters
    ]
    if errors:
        row["z"] = float(np.mean(np.square(np.clip(errors, -6.0, 6.0))))
        row["in 90 %"] = float(np.mean(np.abs(errors) < 1.645))
    return row, found


def mujoco_cases(kind: str, seeds: range) -> Iterator[Case]:
    """MuJoCo's robots: with one change, two, one of no list, or none."""
    from tests.plants.gap_mujoco import PHYSICAL, UNLISTED, leaning, ride_run

    for seed in seeds:
        rng = np.random.default_rng([seed, 11])
        names: list[str] = []
        effects: dict[str, dict[str, float | str]] = {}
        outside: dict[str, float] = {}
        if kind == "mujoco open":
            names = [sorted(UNLISTED)[seed % len(UNLISTED)]]
            outside = {names[0]: float(rng.uniform(*UNLISTED[names[0]]))}
        elif kind != "mujoco null":
            names = [PHYSICAL[(seed * 11) % len(PHYSICAL)]]
            if kind == "mujoco pair":
                names.append(str(rng.choice([n for n in PHYSICAL if n != names[0]])))
            times = 2.5 if "small" in kind else float(np.exp(rng.uniform(np.log(6.0), np.log(30.0))))
            for name in names:
                effects |= {k: dict(v) for k, v in draw(name, times, rng).items()}
        sensors = "both" if any(of_poses(n) for n in names) else str(rng.choice(["fix", "ranges", "both", "none"]))
        plan = Plan(seed, effects=effects, outside=outside, sensors=sensors, ordinary=True)
        rides = (("mixed", 50.0), ("turns", 40.0), ("stops", 40.0))
        fit, more, held = [ride_run(replace(plan, profile=name, seconds=t)) for name, t in rides]
        answer = leaning(plan)
        yield [fit, more], held, answer, "+".join(names), answer


def cases(stratum: str, seeds: range) -> Iterator[Case]:
    """(fit runs, held-out run, answer, label, all effects) of a stratum."""
    if stratum.startswith("mujoco"):
        yield from mujoco_cases(stratum, seeds)
        return
    for seed in seeds:
        fit, held, answer, label = plans(stratum, seed)
        yield [record(plan) for plan in fit], record(held), answer, label, acting(held)


def told(found: Diagnosis | Brief) -> str:
    """A case's answer in a line."""
    sure = [f"{c.effect} {c.probability:.2f}" for c in found.causes if c.probability > 0.05]
    rest = found.unexplained.description if found.unexplained else ""
    return f"{found.verdict} {', '.join(sure)} {rest}"


def calibration(rows: Sequence[dict[str, Any]]) -> float:
    """Expected calibration error: probabilities of all that was told against how often it was so, in ten classes."""
    pairs = np.array([pair for row in rows for pair in row["pairs"]])
    if len(pairs) == 0:
        return float("nan")
    p, hit = pairs.T
    number = np.minimum((p * 10).astype(int), 9)
    return float(sum(abs((p - hit)[number == k].sum()) for k in range(10)) / len(p))


def pairs(found: Diagnosis | Brief, answer: Effects, outside: bool) -> list[tuple[float, float]]:
    """(probability, truth) of every cause told over 0.01, of "none" and of "unknown"."""
    out = [(c.probability, float(c.effect in answer)) for c in found.causes if c.probability > 0.01]
    listed = {c.effect for c in found.causes}
    out += [(0.0, 1.0) for name in answer if name not in listed]
    out.append((found.probabilities.get("unknown", 0.0), float(outside)))
    out.append((found.probabilities.get("none", 0.0), float(not answer and not outside)))
    return out


COLUMNS = (
    "exact", "honest", "top1", "top3", "F1", "p", "false", "told unknown", "shrunk", "harm", "z", "in 90 %", "loudest",
    "alone", "together", "cpu_s",
)  # fmt: skip


def table(lines: Sequence[dict[str, Any]]) -> None:
    """Means per stratum (z: root mean square; shrunk: median), then what all strata say together."""
    print("| stratum | n | " + " | ".join(COLUMNS) + " | calibration |")
    print("|" + " --- |" * (len(COLUMNS) + 3))
    groups = {
        name: [one for one in lines if one["stratum"] == name] for name in dict.fromkeys(x["stratum"] for x in lines)
    }
    for name, every in list(groups.items()):
        hidden = [one for one in every if one.get("llr2") is not None and one["llr2"] < SEEN]
        if hidden:
            groups |= {f"{name}, shown": [one for one in every if one not in hidden], f"{name}, not shown": hidden}
    for stratum, mine in groups.items():
        cells = []
        for name in COLUMNS:
            values = [line["row"][name] for line in mine if name in line["row"]]
            value = np.median(values) if name == "shrunk" and values else np.mean(values) if values else np.nan
            cells.append("" if not values else f"{np.sqrt(value) if name == 'z' else value:.2f}")
        print(f"| {stratum} | {len(mine)} | " + " | ".join(cells) + f" | {calibration(mine):.3f} |")
    strange = [line["row"]["unknown"] for line in lines if line["outside"]]
    known = np.sort([line["row"]["unknown"] for line in lines if not line["outside"]])
    if strange and len(known):
        auc = np.mean([np.mean(known < s) + 0.5 * np.mean(known == s) for s in strange])
        limit = known[int(np.ceil(0.95 * len(known))) - 1]
        hit = np.mean(np.array(strange) > limit)
        print(f"\nunknown against known: area {auc:.3f}, hits at 5 % false alarms {hit:.2f}")
    print(f"calibration error over everything: {calibration(lines):.3f}")
    for name, mine in (
        ("plant", [line for line in lines if not line["stratum"].startswith(("mujoco", "shared"))]),
        ("MuJoCo", [line for line in lines if line["stratum"].startswith("mujoco")]),
    ):
        reliability(name, mine)


CLASSES = (0.01, 0.1, 0.3, 0.5, 0.7, 0.9, 1.001)


def reliability(name: str, lines: Sequence[dict[str, Any]]) -> None:
    """Per class of probability: how many, their mean, and the share that was so; the calibration error."""
    rows = np.array([pair for line in lines for pair in line["pairs"]]).reshape(-1, 2)
    if not len(rows):
        return
    print(f"\n| {name}: probability | n | mean | was so |\n| --- | --- | --- | --- |")
    for low, high in itertools.pairwise((0.0, *CLASSES)):
        inside = rows[(rows[:, 0] >= low) & (rows[:, 0] < high)]
        if len(inside):
            told, so = inside.mean(axis=0)
            print(f"| {low:.2f} to {min(high, 1.0):.2f} | {len(inside)} | {told:.3f} | {so:.3f} |")
    print(f"calibration error, {name}: {calibration(lines):.3f}")


def main() -> None:
    """All strata asked for."""
    options = argparse.ArgumentParser()
    options.add_argument("--cases", type=int, default=8)
    options.add_argument("--first", type=int, default=0)
    options.add_argument("--strata", default=",".join(STRATA))
    options.add_argument("--shared", type=Path, help="the folder of gap cases with answers")
    options.add_argument("--lines", type=Path, help="a JSON line per case is added here")
    options.add_argument("--brief", action="store_true", help="identification only: no held-out score, no evidence")
    options.add_argument("--bare", action="store_true", help="without the baselines that cost time")
    options.add_argument("--read", type=Path, help="only the table, of lines written before")
    chosen = options.parse_args()
    if chosen.read:
        table([json.loads(line) for line in chosen.read.read_text().splitlines()])
        return
    lines: list[dict[str, Any]] = []

    def add(stratum: str, case: Case, outside: bool) -> None:
        runs, held, answer, label, whole = case
        row, found = score(runs, held, (answer, whole), outside, not chosen.bare, chosen.brief)
        line = {"stratum": stratum, "label": label, "outside": outside, "row": row}
        line |= {"answer": {name: dict(values) for name, values in answer.items()}, "told": told(found)}
        line["pairs"] = pairs(found, answer, outside)
        line["llr2"] = shown(runs, answer) if "small" in stratum else None
        line["immaterial"] = [one.effect for one in found.immaterial]
        lines.append(line)
        print(
            f"{'ok ' if row['exact'] else 'BAD'} {stratum} {label}: {line['told']} [{row['cpu_s']:.1f} s]", flush=True
        )
        if chosen.lines:
            with chosen.lines.open("a") as out:
                out.write(json.dumps(line) + "\n")

    if chosen.shared:
        for folder in sorted((chosen.shared / "cases").iterdir()):
            say = json.loads((chosen.shared / "answers" / f"{folder.name}.json").read_text())
            answer = {one["effect"]: one["parameters"] for one in say["effects"]}
            runs = [read_run(path) for path in sorted((folder / "fit").iterdir())]
            add("shared", (runs, read_run(folder / "heldout"), answer, say["label"], answer), bool(say["outside"]))
    for stratum in chosen.strata.split(",") if chosen.strata else ():
        for case in cases(stratum, range(chosen.first, chosen.first + chosen.cases)):
            add(stratum, case, stratum.endswith("open"))
    table(lines)


if __name__ == "__main__":
    main()
