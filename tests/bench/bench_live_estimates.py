"""Live estimates beside stored ones: the same run in pieces of 0.1 s, and whole. Prints the table of the guide's page.

Per run and method: rms error of the live path and of the stored one where there is truth, rms distance of the two from
each other at the same stamps, distance of their ends, and from which time on the live path is there.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from core.estimation.pipeline import available, estimate
from core.formats import read_run
from core.live import LiveEstimator
from core.live.estimator import METHODS, _together
from core.live.pieces import pieces
from core.run import Run
from core.simulation import simulate
from core.simulation.scenarios import SCENARIOS
from core.trajectory import Trajectory

EXAMPLES = Path(__file__).parents[2] / "app" / "examples"
PIECE_S = 0.1


def runs() -> dict[str, Run]:
    """Recorded and simulated ones."""
    found = {name: read_run(EXAMPLES / name) for name in ("square-with-disturbance", "lawn-mower-with-uwb")}
    effects = {"track_width": {"scale": 1.03}, "gyro_bias": {"bias": 0.01}}
    return {**found, "mission, simulated": simulate(SCENARIOS["mission"].run(), effects, 1)}


def rms(a: Trajectory, b: tuple[np.ndarray, np.ndarray, np.ndarray]) -> float:
    """Of the distance of a path from another (t, x, y), where both are."""
    inside = (a.t >= b[0][0]) & (a.t <= b[0][-1]) & np.isfinite(a.x)
    dx, dy = (np.interp(a.t[inside], b[0], column) - mine[inside] for column, mine in ((b[1], a.x), (b[2], a.y)))
    return float(np.sqrt(np.mean(dx**2 + dy**2))) if inside.any() else float("nan")


def main() -> None:
    print("| run | method | live rms m | stored rms m | apart rms m | ends apart m | live from s |")
    print("| --- | --- | ---: | ---: | ---: | ---: | ---: |")
    for name, run in runs().items():
        estimator = LiveEstimator(run.meta)
        whole = _together([estimator.feed(piece) for piece in pieces(run, PIECE_S)])
        for method in METHODS:
            if method not in whole.paths or available(run)[method] is not None:
                continue
            live, stored = whole.paths[method], estimate(run, method).trajectory
            known = np.isfinite(stored.x)
            path = stored.t[known], stored.x[known], stored.y[known]
            truth = run.truth
            errors = ["-", "-"]
            if truth is not None and truth.x is not None and truth.y is not None:
                reference = truth.t, np.asarray(truth.x, np.float64), np.asarray(truth.y, np.float64)
                errors = [f"{rms(made, reference):.3f}" for made in (live, stored)]
            ends = float(
                np.hypot(
                    live.x[-1] - np.interp(live.t[-1], *path[:2]), live.y[-1] - np.interp(live.t[-1], path[0], path[2])
                )
            )
            print(
                f"| {name} | `{method}` | {' | '.join(errors)} | {rms(live, path):.3f} | {ends:.3f} | {live.t[0]:.1f} |"
            )


if __name__ == "__main__":
    main()
