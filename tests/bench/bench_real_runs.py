"""Errors of every method on recorded runs, a row per set: the table of the guide. Run by hand.

Argument: a folder of sets of run folders (default: the larger recorded sets beside the project, else the examples).
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from core.estimation.pipeline import METHODS, available, estimate
from core.formats import read_run
from core.metrics import evaluate

ROOT = Path(__file__).resolve().parents[2]


def runs_of(folder: Path) -> dict[str, list[Path]]:
    """Run folders by the set that they belong to."""
    sets: dict[str, list[Path]] = {}
    for file in sorted(folder.rglob("run.json")):
        name = file.parent.relative_to(folder).parts
        key = "/".join(name) if len(name) == 1 or name[0].startswith("plaza") else name[0]
        sets.setdefault(key, []).append(file.parent)
    return sets


def main() -> None:
    shared = ROOT.parent / "shared" / "data" / "real"
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else shared if shared.is_dir() else ROOT / "app" / "examples"
    print(f"{'set':24s} {'runs':>4s} {'method':14s} {'mean ATE':>9s} {'largest':>9s} {'largest heading':>15s}")
    for name, paths in runs_of(folder).items():
        for method in METHODS:
            found = []
            for path in paths:
                run = read_run(path)
                if run.truth is None or available(run)[method] is not None:
                    continue
                errors = evaluate(estimate(run, method).trajectory, run.truth)
                found.append((errors.ate_rmse_m, errors.max_m, errors.heading_max_rad))
            if found:
                ate, largest, heading = (np.array(column, float) for column in zip(*found, strict=True))
                heading_text = f"{np.degrees(heading.max()):13.1f} °" if np.isfinite(heading).all() else f"{'–':>15s}"
                print(
                    f"{name:24s} {len(found):4d} {method:14s} {ate.mean():7.3f} m {largest.max():7.3f} m {heading_text}"
                )


if __name__ == "__main__":
    main()
