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

from estimation.test_filter import BASE, PRIOR, events, expected, jacobian, motion, process_noise, ready
from estimation.world import Flaws, Sensors, simulate

from core.estimation import available, estimate
from core.estimation.fusion.events import Events
from core.estimation.fusion.fused import fused_and_smoothed, prepare
from core.estimation.fusion.layout import FIX
from core.estimation.fusion.walk import smooth, walk
from core.metrics import evaluate


def best(job: Callable[[], object], times: int = 3) -> float:
    seconds = []
    for _ in range(times):
        t0 = time.perf_counter()
        job()
        seconds.append(time.perf_counter() - t0)
    return min(seconds)


def five_states(steps: int = 20_000, few: int = 500, rounds: int = 12) -> tuple[float, float, float]:
    """Processor seconds a step of ours and of filterpy on one problem (x, y, theta, v, b; the gyro carries, a fix of x
    and y is taken at each step), least of some rounds in turn, and their largest difference at the end of `few` steps.
    filterpy is given its matrices ready made: what the Jacobians cost is not counted against it.
    """
    log = events(4, steps, (FIX,))
    log.kind[:], log.data[:, 2] = FIX, np.nan
    P0 = PRIOR.copy()
    P0[5:] = 0.0
    p = ready(BASE, P0, 5, float(log.t[0]))
    kf, work = prepared(log.leading(few), P0[:5, :5])
    ours, theirs = [], []
    for _ in range(rounds):
        began = time.process_time()
        walk(p, log)
        ours.append(time.process_time() - began)
        kf.x, kf.P = np.array((0.0, 0.0, 0.0, 0.5, 0.0)), P0[:5, :5].copy()
        began = time.process_time()
        for F, Q, after, z, H in work:
            kf.predict(F=F, Q=Q)
            kf.x = after.copy()
            kf.update(z, H=H)
        theirs.append(time.process_time() - began)
    found = walk(p, log.leading(few))
    apart = max(np.abs(found.x[:5] - kf.x).max(), np.abs(found.P[:5, :5] - kf.P).max())
    return min(ours) / steps, min(theirs) / few, float(apart)


def prepared(log: Events, P0: np.ndarray) -> tuple[KalmanFilter, list[tuple[np.ndarray, ...]]]:
    """filterpy's filter, and per event F, Q, the state carried there by the model itself, and the linearised fix."""
    kf, last, work = KalmanFilter(dim_x=5, dim_z=2), log.t[0], []
    kf.x, kf.P, kf.R = np.array((0.0, 0.0, 0.0, 0.5, 0.0)), P0.copy(), np.diag((BASE.r_fix, BASE.r_fix))
    c = BASE._replace(has_accel=0.0)
    for t, a in zip(log.t, log.data, strict=True):
        x, dt = np.zeros(15), t - last
        x[:5] = kf.x
        after = motion(x, dt, 0.0, 0.0, c)
        F = jacobian(lambda z, dt=dt: motion(z, dt, 0.0, 0.0, c), x)[:5, :5]
        Q = process_noise(x, dt, after[2] - x[2], after[5], c)[:5, :5]
        Q[2, 2] += c.q_pause * dt  # there is no gyro reading at all in this log
        H = jacobian(lambda z, a=a: expected(FIX, a, z, 0.0, c), after)[:, :5]
        z = a[:2] - expected(FIX, a, after, 0.0, c) + H @ after[:5]
        work.append((F, Q, after[:5], z, H))
        kf.predict(F=F, Q=Q)
        kf.x, last = after[:5].copy(), t
        kf.update(z, H=H)
    return kf, work


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

    began = time.process_time()
    seconds = best(lambda: fused_and_smoothed(run))
    cpu = (time.process_time() - began) / 3
    print(f"fused and smoothed together {seconds:6.3f} s, {cpu:.3f} s of CPU on two threads (aim 1 s)")

    made = prepare(run)
    count = len(made.events.t)
    for what, job in (("filter", walk), ("filter and smoother", smooth)):
        seconds = best(lambda job=job: job(made.problem, made.events))
        print(f"compiled {what:20s} {seconds / count * 1e9:7.0f} ns an event ({count} events, {made.problem.n} states)")
    ours, theirs, apart = five_states()
    print(f"5 states: ours {ours * 1e9:.0f} ns a step, filterpy {theirs * 1e9:.0f}: {theirs / ours:.0f} times as long")
    print(f"          largest difference of state and covariance after 500 steps {apart:.1e}")

    for what, code in (
        ("import core.estimation", "import core.estimation"),
        ("import and load the compiled filter", "import core.estimation.fusion._filter_numba"),
    ):
        seconds = best(lambda code=code: subprocess.run([sys.executable, "-c", code], check=True))
        print(f"{what:36s} {seconds:5.2f} s, new process")


if __name__ == "__main__":
    main()
