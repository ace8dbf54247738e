"""Every method through every experiment: MuJoCo worlds and the product's own simulator. Run by hand: prints figures.

`python tests/bench/bench_experiments.py [--methods published,fused] [--worlds glass,obstacle] [--seeds 5] [--each]`
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from core.errors import DriftscopeError
from core.estimation.pipeline import METHODS, available, estimate
from core.metrics import evaluate, nees
from tests.plants.mujoco_worlds import VARIANTS, WORLDS, Sensors, World, world
from tests.plants.own_worlds import CASES, own_world

RECOVERED = 0.10  # m
SETUPS = {
    "poses": Sensors(),
    "positions": Sensors(headings=False),
    "ranges": Sensors(fixes=False, ranges=True),
}


@dataclass(frozen=True)
class Row:
    """Figures of one method in one world; NaN where there are none."""

    rms_m: float
    max_m: float
    heading_deg: float
    rest_cm: float
    rest_deg: float
    recovery_s: float
    nees: float
    seconds: float


def judge(method: str, made: World) -> Row:
    """One method through one world. Recovery: from the last disturbance's end to the first second under 0.1 m."""
    assert made.run.truth is not None
    t0 = time.perf_counter()
    found = estimate(made.run, method)
    seconds = time.perf_counter() - t0
    errors = evaluate(found.trajectory, made.run.truth)
    claim = nees(found.trajectory, made.run.truth)
    after = max((m.t1 for m in made.marks), default=np.nan)
    recovery = np.nan if np.isnan(after) else _recovery(errors.t, errors.error_xy, after)

    def number(value: float | None, scale: float = 1.0) -> float:
        return np.nan if value is None else value * scale

    degrees = 180 / np.pi
    return Row(
        number(errors.ate_rmse_m), number(errors.max_m), number(errors.heading_rmse_rad, degrees),
        number(errors.final_m, 100.0), number(errors.final_rad, degrees), recovery,
        np.nan if claim is None else claim.mean / claim.dof, seconds,
    )  # fmt: skip


def _recovery(t: np.ndarray, error: np.ndarray, after: float) -> float:
    late = t > after
    bad = np.flatnonzero((error > RECOVERED)[late])
    edges = np.concatenate(([-1], bad, [int(late.sum())]))
    good = np.flatnonzero(np.diff(edges) > 1.0 / float(np.median(np.diff(t))))
    return float(t[late][edges[good[0]] + 1] - after) if good.size else np.inf


COLUMNS = (
    ("rms m", 8),
    ("max m", 8),
    ("head deg", 9),
    ("rest cm", 8),
    ("rest deg", 9),
    ("recov s", 8),
    ("NEES/dof", 9),
)
HEAD = " ".join([" " * 32, *(f"{name:>{width}s}" for name, width in COLUMNS)])


def line(label: str, rows: list[Row]) -> str:
    """Means over seeds; max, rest errors and recovery are the worst."""
    if not rows:
        return f"{label:32s} {'-':>8s}"
    col = {k: np.array([getattr(r, k) for r in rows]) for k in Row.__dataclass_fields__}
    return (
        f"{label:32s} {col['rms_m'].mean():8.3f} {col['max_m'].max():8.3f} {col['heading_deg'].mean():9.2f}"
        f" {col['rest_cm'].max():8.1f} {col['rest_deg'].max():9.2f} {col['recovery_s'].max():8.2f}"
        f" {col['nees'].mean():9.2f}"
    )


def compare(label: str, worlds: list[World], methods: list[str], each: bool) -> None:
    """Prints one world's table."""
    print(f"\n{label}  ({len(worlds)} seeds)\n{HEAD}")
    for method in methods:
        rows = []
        for made in worlds:
            if available(made.run)[method] is not None:
                continue
            try:
                rows.append(judge(method, made))
            except DriftscopeError as error:
                print(f"  {method}: {error}")
                continue
            if each:
                print(line(f"  {made.run.meta.name} {method}"[:32], [rows[-1]]))
        print(line(method, rows), flush=True)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--worlds", default=",".join([*WORLDS, *(f"own-{n}" for n in CASES)]))
    parser.add_argument("--setups", default=",".join(SETUPS))
    parser.add_argument("--seeds", type=int, default=VARIANTS)
    parser.add_argument("--each", action="store_true", help="a line per seed too")
    args = parser.parse_args()
    methods = args.methods.split(",")
    for name in args.worlds.split(","):
        if name.startswith("own-"):
            compare(
                f"own simulator: {name[4:]}", [own_world(name[4:], s) for s in range(args.seeds)], methods, args.each
            )
            continue
        for setup in args.setups.split(","):
            made = [world(name, s, SETUPS[setup]) for s in range(args.seeds)]
            compare(f"MuJoCo: {name}, {setup}", made, methods, args.each)


if __name__ == "__main__":
    main()
