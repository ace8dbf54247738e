"""Compile every kernel into numba's cache, on two cores: `python -m app.warm`. Run at install, so that no user waits.

Compiled code is found again by later processes as long as its source is unchanged; then this takes seconds.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable


def paths() -> None:
    """Every method of estimation on an invented drive, and its judging."""
    from app.jobs.warm import warm_up

    warm_up()


def inertial() -> None:
    """Allan deviation, gyro bias by every method, simulator."""
    import numpy as np

    from core.imu.allan import allan
    from core.imu.bias import track_bias
    from core.simulation import simulate, warm
    from core.simulation.scenarios import SCENARIOS

    warm()
    run = simulate(SCENARIOS["corridor"].run(), {}, 0)
    assert run.imu is not None and run.imu.gz is not None
    allan(run.imu.t, np.asarray(run.imu.gz, np.float64))
    for method in ("A", "B", "C", "best", "smoothed"):
        track_bias(run, method)


def gap() -> None:
    """The diagnosis, on a short drive with a wider track than simulated."""
    import dataclasses

    import numpy as np

    from app.sandbox.figure import figure
    from app.sandbox.prepared import make_prepared
    from core.gap import diagnose
    from core.gap._pose_numba import whiten_offset
    from core.simulation import simulate
    from core.simulation.scenarios import SCENARIOS

    whiten_offset(np.arange(4.0), np.ones(4), 0.0, 1.0, 9.0, np.ones((1, 4)))  # what runs without commands need more
    run = simulate(SCENARIOS["figure-eight"].run(), {"track_width": {"scale": 1.05}}, 0).crop(0.0, 30.0)
    diagnose([run])
    for one in (run, dataclasses.replace(run, truth=None)):  # the sandbox's first move; without truth, by fixes
        figure(make_prepared(one, one.span, recorded=True, best=None), {})


def live() -> None:
    """A virtual robot driven for a while, and every estimator that steps, on rows as a worker gets them."""
    import numpy as np

    from app.live.worker import as_run
    from core.live import LiveEstimator
    from core.live.virtual import META, VirtualRobot

    robot, estimator = VirtualRobot(), LiveEstimator(META)
    for k in range(1, 301):
        piece = robot.step(0.05 * k, *((0.4, 0.8) if 40 < k < 240 else (0.0, 0.0)))
        streams = {
            name: {c: np.asarray(v, "<i2" if c == "beacon" else "<f8").tobytes() for c, v in log.columns().items()}
            for name, log in piece.logs().items()
        }
        estimator.feed(as_run([{"streams": streams, "names": list(META.beacons)}]))


PARTS: dict[str, tuple[Callable[[], None], ...]] = {"paths": (paths, live), "inertial": (inertial, gap)}


def main() -> int:
    """One process per part; 0 when all compiled."""
    if len(sys.argv) > 1:
        for part in PARTS[sys.argv[1]]:
            part()
        return 0
    running = [subprocess.Popen([sys.executable, "-m", "app.warm", part]) for part in PARTS]
    return max(process.wait() for process in running)


if __name__ == "__main__":
    sys.exit(main())
