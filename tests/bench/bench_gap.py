"""The diagnosis on worlds of other programs, per stratum, beside simple baselines.

python -m tests.bench.bench_gap [--cases N] [--strata single,pair,...] [--shared DIR]: one row per stratum. Baselines:
`loudest` (the loudest stream's most usual effect), `one by one` (the effect that alone lowers the deviance most).
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from core.formats import read_run  # noqa: E402
from core.gap import diagnose  # noqa: E402
from core.gap.candidates import candidates  # noqa: E402
from core.gap.diagnose import reach_of  # noqa: E402
from core.gap.floor import Floor  # noqa: E402
from core.gap.linear import Problem, linearise, with_floor  # noqa: E402
from core.gap.reference import restarts_of  # noqa: E402
from core.gap.selection import gains_of  # noqa: E402
from core.gap.world import make_world  # noqa: E402
from core.run import Run  # noqa: E402
from tests.plants.gap_draws import plans  # noqa: E402
from tests.plants.gap_plant import Effects, record  # noqa: E402

STRATA = ("null", "noise", "small", "single", "pair", "truthless", "open")
USUAL = {
    "wheels": "motor_lag", "imu.gz": "gyro_bias", "imu.ax": "accel_bias", "imu.ay": "accel_bias",
    "beacon": "beacon_shift", "ranges": "range_bias", "truth": "track_width",
}  # fmt: skip
Row = dict[str, float]


def one_by_one(runs: list[Run]) -> str:
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


def score(runs: list[Run], held: list[Run], answer: Effects, outside: bool) -> tuple[Row, str]:
    """Figures of one case, and a line that tells it."""
    began = time.process_time()
    found = diagnose(runs, held_out=held)
    seconds = time.process_time() - began
    ranked = sorted(found.causes, key=lambda one: -one.probability)
    named = {one.effect for one in ranked if one.probability > 0.5}
    true = set(answer)
    row: Row = {
        "cpu_s": seconds,
        "false": float(len(named - true) > 0),
        "unknown": float(found.unexplained is not None),
    }
    row["exact"] = float(named == true and (found.unexplained is not None) == outside)
    if true:
        order = [one.effect for one in ranked]
        row |= {"top1": float(bool(order) and order[0] in true), "top3": float(bool(true & set(order[:3])))}
        row["p"] = float(np.mean([next((c.probability for c in ranked if c.effect == name), 0.0) for name in true]))
        hits = len(named & true)
        row["f1"] = 2 * hits / (len(named) + len(true))
        row["one by one"] = float(one_by_one(runs) in true)
        stream = found.where[0].stream if found.where else "-"
        row["loudest"] = float(USUAL.get(stream, USUAL.get(stream.split(".")[0], "-")) in true)
    if found.gap.shrink is not None and true:
        row["shrink"] = found.gap.shrink
    errors = [
        (float(c.parameters[n].value) - float(v)) / (c.parameters[n].std or np.inf)
        for c in found.causes
        if c.effect in answer and c.probability > 0.5
        for n, v in answer[c.effect].items()
        if not isinstance(v, str) and n in c.parameters
    ]
    if errors:
        row["z"] = float(np.sqrt(np.mean(np.square(errors))))
        row["within90"] = float(np.mean(np.abs(errors) < 1.645))
    told = f"{'ok ' if row['exact'] else 'BAD'} {sorted(true)} -> {found.verdict} {sorted(named)}"
    return row, told


def table(rows: dict[str, list[Row]]) -> None:
    """Means per stratum (z: root mean square; shrink: median)."""
    names = (
        "exact",
        "top1",
        "top3",
        "f1",
        "p",
        "false",
        "unknown",
        "shrink",
        "z",
        "within90",
        "loudest",
        "one by one",
        "cpu_s",
    )
    print(f"{'stratum':10s} {'n':>3s} " + " ".join(f"{name:>10s}" for name in names))
    for stratum, cases in rows.items():
        cells = []
        for name in names:
            values = [row[name] for row in cases if name in row]
            middle = np.median if name in ("shrink", "z") else np.mean
            cells.append(f"{middle(values):10.3f}" if values else f"{'-':>10s}")
        print(f"{stratum:10s} {len(cases):3d} " + " ".join(cells))


def main() -> None:
    """All strata asked for."""
    options = argparse.ArgumentParser()
    options.add_argument("--cases", type=int, default=8)
    options.add_argument("--first", type=int, default=0)
    options.add_argument("--strata", default=",".join(STRATA))
    options.add_argument("--shared", type=Path, help="the folder of gap cases with answers")
    chosen = options.parse_args()
    rows: dict[str, list[Row]] = {}
    if chosen.shared:
        for case in sorted((chosen.shared / "cases").iterdir()):
            told = json.loads((chosen.shared / "answers" / f"{case.name}.json").read_text())
            answer = {one["effect"]: one["parameters"] for one in told["effects"]}
            runs = [read_run(path) for path in sorted((case / "fit").iterdir())]
            row, line = score(runs, [read_run(case / "heldout")], answer, bool(told["outside"]))
            print(told["label"], line, flush=True)
            rows.setdefault("shared", []).append(row)
    for stratum in chosen.strata.split(",") if chosen.strata else ():
        for seed in range(chosen.first, chosen.first + chosen.cases):
            fit, held, answer, label = plans(stratum, seed)
            row, line = score([record(plan) for plan in fit], [record(held)], answer, stratum == "open")
            print(stratum, seed, label, line, flush=True)
            rows.setdefault(stratum, []).append(row)
    table(rows)


if __name__ == "__main__":
    main()
