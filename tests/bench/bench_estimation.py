"""An hour of a robot through every method, and the compiled filter against filterpy. Run by hand: prints figures."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from filterpy.kalman import KalmanFilter

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "core"))

from estimation.world import Flaws, Sensors, simulate

from core.estimation import available, estimate
from core.estimation.assumptions import assume
from core.estimation.fusion import fused
from core.estimation.fusion.events import merge
from core.estimation.fusion.start import Start
from core.estimation.rest import at_rest
from core.metrics import evaluate


def best(job: Callable[[], object], times: int = 3) -> float:
    seconds = []
    for _ in range(times):
        t0 = time.perf_counter()
        job()
        seconds.append(time.perf_counter() - t0)
    return min(seconds)


def filterpy_step(n: int, steps: int = 400) -> float:
    """Seconds of one predict and one scalar update with n states."""
    kf = KalmanFilter(dim_x=n, dim_z=1)
    kf.F = np.eye(n) + 0.01 * np.eye(n, k=1)
    kf.Q, kf.R, kf.H = 1e-6 * np.eye(n), np.array([[0.01]]), np.eye(1, n)

    def walk() -> None:
        for _ in range(steps):
            kf.predict()
            kf.update(0.0)

    return best(walk) / steps


def main() -> None:
    hour = 3600.0
    flaws = Flaws(0.004, 1e-5, 0.003, 0.005, 0.001, 0.01, 0.005, 0.002)
    run = simulate(1, hour, flaws, Sensors(imu=100, wheels=50, fixes=10)).run
    assert run.truth is not None
    for method in available(run):
        estimate(run.crop(0, 5), method)  # compile, or load what was compiled
    total = 0.0
    for method in available(run):
        seconds = best(lambda method=method: estimate(run, method))
        total += seconds
        errors = evaluate(estimate(run, method).trajectory, run.truth)
        print(f"{method:14s} {seconds:6.3f} s   ATE {errors.ate_rmse_m:8.4f} m")
    print(f"all methods    {total:6.3f} s for an hour at 100 Hz IMU, 50 Hz wheels, 10 Hz fixes (aim 2 s)")

    numbers, _ = assume(run)
    rest = at_rest(run, numbers)
    events = merge(run, numbers, rest)
    start = Start(np.zeros(3), 1e-4 * np.eye(3))
    ours = best(lambda: fused._walk(run, events, start, numbers, rest)) / len(events.t)
    print(f"compiled filter {ours * 1e9:7.0f} ns an event ({len(events.t)} events, 13 states)")
    for n in (5, 13):
        theirs = filterpy_step(n)
        print(f"filterpy        {theirs * 1e9:7.0f} ns a step ({n} states): {theirs / ours:.0f} times as long")

    for what, code in (
        ("import core.estimation", "import core.estimation"),
        ("import and load the compiled filter", "import core.estimation.fusion._filter_numba"),
    ):
        seconds = best(lambda code=code: subprocess.run([sys.executable, "-c", code], check=True))
        print(f"{what:36s} {seconds:5.2f} s, new process")


if __name__ == "__main__":
    main()
