"""Errors of every method on recorded runs, and how often its 95 % ellipse holds the reference, a row per set. By hand.

Argument: a folder of sets of run folders (default: the larger recorded sets beside the project, else the examples).
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import numpy as np

from core.estimation.pipeline import METHODS, available, estimate
from core.formats import read_run
from core.metrics import evaluate, nees
from core.run import Run
from tests.bench.bench_consistency import REFERENCE_CLOCK, REFERENCE_SD

ROOT = Path(__file__).resolve().parents[2]


def runs_of(folder: Path) -> dict[str, list[Path]]:
    """Run folders by the set that they belong to."""
    sets: dict[str, list[Path]] = {}
    for file in sorted(folder.rglob("run.json")):
        name = file.parent.relative_to(folder).parts
        key = "/".join(name) if len(name) == 1 or name[0].startswith("plaza") else name[0]
        sets.setdefault(key, []).append(file.parent)
    return sets


def judge(run: Run, method: str, name: str) -> tuple[float, ...]:
    """ATE, largest error, largest heading error, share of stamps inside the 95 % ellipse, NEES over its dimension."""
    assert run.truth is not None
    path = estimate(run, method).trajectory
    errors = evaluate(path, run.truth)
    sd = next((v for k, v in REFERENCE_SD.items() if name.startswith(k)), (0.0, 0.0, 0.0))
    clock = next((v for k, v in REFERENCE_CLOCK.items() if name.startswith(k)), 0.0)
    # Plaza's reference heading is its own gyro's: no judge of a claim.
    truth = dataclasses.replace(run.truth, theta=None) if name.startswith("plaza") else run.truth
    claim = nees(path, truth, truth_sd=sd, truth_clock=clock)
    inside, mean = (claim.inside, claim.mean / claim.dof) if claim else (np.nan, np.nan)
    return tuple(
        np.nan if v is None else v for v in (errors.ate_rmse_m, errors.max_m, errors.heading_max_rad, inside, mean)
    )


def main() -> None:
    shared = ROOT.parent / "shared" / "data" / "real"
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else shared if shared.is_dir() else ROOT / "app" / "examples"
    heads = f"{'set':24s} {'runs':>4s} {'method':14s} {'mean ATE':>9s} {'largest':>9s} {'largest heading':>15s}"
    print(f"{heads} {'inside':>7s} {'NEES/dof':>8s}")
    for name, paths in runs_of(folder).items():
        for method in METHODS:
            found = []
            for path in paths:
                run = read_run(path)
                if run.truth is None or available(run)[method] is not None:
                    continue
                found.append(judge(run, method, name))
            if found:
                ate, largest, heading, inside, mean = (np.array(column, float) for column in zip(*found, strict=True))
                heading_text = f"{np.degrees(heading.max()):13.1f} °" if np.isfinite(heading).all() else f"{'–':>15s}"
                print(
                    f"{name:24s} {len(found):4d} {method:14s} {ate.mean():7.3f} m {largest.max():7.3f} m {heading_text}"
                    f" {inside.mean():7.1%} {mean.mean():8.2f}"
                )


if __name__ == "__main__":
    main()
