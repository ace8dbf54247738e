"""What the diagnosis says of recorded robots: fitted on one half of the runs, scored on the other. Runs by hand.

python -m tests.bench.bench_gap_real [--data DIR] [--only NAME]: one row per group of recordings, then what was told
besides. `harm`: whether what is advised makes the held-out half worse. Times are processor time.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from core.errors import DriftscopeError  # noqa: E402
from core.formats import read_run  # noqa: E402
from core.gap import Diagnosis, diagnose  # noqa: E402
from core.run import Run  # noqa: E402

ODD, EVEN = (1, 3, 5), (2, 4, 6)
STEPS = (0, 2, 28, 37, 42, 44, 1, 3, 32, 40, 43, 45, 60, 66, 68, 74, 78, 82, 61, 67, 73, 75, 81, 85)
Group = tuple[Sequence[str], Sequence[str]]


def _passes(kind: str, numbers: Sequence[int]) -> list[str]:
    return [f"optiodom-{kind}-a/run-0{k}" for k in numbers]


def _steps(first: int, last: int) -> list[str]:
    return [f"husky-steps/step-{k:03d}" for k in STEPS[first:last]]


GROUPS: dict[str, Group] = {
    "OptiOdom squares 1 3 5": (_passes("square", ODD), _passes("square", EVEN)),
    "OptiOdom squares 2 4 6": (_passes("square", EVEN), _passes("square", ODD)),
    "OptiOdom circles 1 3 5": (_passes("circle", ODD), _passes("circle", EVEN)),
    "OptiOdom circles 2 4 6": (_passes("circle", EVEN), _passes("circle", ODD)),
    "OptiOdom squares and circles 1 3 5": (
        _passes("square", ODD) + _passes("circle", ODD),
        _passes("square", EVEN) + _passes("circle", EVEN),
    ),
    "OptiOdom free 1": (_passes("free", (1,)), _passes("free", (2,))),
    "Plaza 1, odometry": (["plaza1/odometry"], []),
    "Plaza 1, distance and gyro": (["plaza1/distance-gyro"], []),
    "Husky, 6 steps": (_steps(0, 6), _steps(6, 12)),
    "Husky, 6 other steps": (_steps(6, 12), _steps(0, 6)),
    "Husky, 12 steps": (_steps(0, 12), _steps(12, 24)),
    "BorealTC, flooring": (["borealtc-a/flooring-01"], []),
    "BorealTC, snow": (["borealtc-a/snow-07"], []),
    "ADIS16405 at rest": (["adis16405-rest-a/run-01"], []),
    "MPU6050 at rest": (["mpu6050-rest/rest-z-up-10min"], []),
}


def row(name: str, out: Diagnosis, seconds: float) -> str:
    """One line of the table."""
    causes = []
    for one in out.causes:
        if one.probability > 0.5:
            sizes = ", ".join(
                f"{value.value:.4g} ± {value.std or 0.0:.1g}"
                for value in one.parameters.values()
                if not isinstance(value.value, str)
            )
            causes.append(f"{one.effect} {sizes} ({one.probability:.2f})")
    total = out.gap.total
    harm = "yes" if total.after > total.before * (1.0 + 1e-6) else "no"
    figures = f"{total.before:.4g} → {total.after:.4g} (floor {total.floor:.3g})"
    return f"| {name} | {out.verdict} | {'; '.join(causes) or '-'} | {figures} | {harm} | {seconds:.0f} |"


def load(data: Path, names: Sequence[str]) -> list[Run]:
    """Runs by their folders."""
    return [read_run(data / name) for name in names]


def main() -> None:
    """Every group, or those whose name holds a word."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared" / "data" / "real")
    parser.add_argument("--only", default="")
    given = parser.parse_args()
    print("| fitted on | verdict | causes (probability) | held-out gap | harm | CPU s |")
    print("| --- | --- | --- | --- | --- | --- |")
    more = []
    for name, (fitted, held) in GROUPS.items():
        if given.only not in name:
            continue
        runs, kept = load(given.data, fitted), load(given.data, held)
        began = time.process_time()
        try:
            out = diagnose(runs, held_out=kept)
        except DriftscopeError as refused:
            print(f"| {name} | refused: {refused} | - | - | no | {time.process_time() - began:.0f} |", flush=True)
            continue
        print(row(name, out, time.process_time() - began), flush=True)
        left = "" if out.unexplained is None else f"{out.unexplained.description}. "
        more.append(f"{name}: {left}{'; '.join(out.notes)}")
    print("", *more, sep="\n")


if __name__ == "__main__":
    main()
