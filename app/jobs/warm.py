"""A few seconds of an invented drive, estimated by every method: compiles what compiles, before a user waits for it."""

from __future__ import annotations

import time

import numpy as np

from core.estimation.pipeline import METHODS, available, estimate
from core.metrics import evaluate, nees
from core.robot import Pose, RobotParams
from core.run import Run, RunMeta
from core.sensors import BeaconLog, ImuLog, TruthLog, WheelLog


def warm_up() -> float:
    """Run every method once; seconds it took."""
    began = time.perf_counter()
    run = short_drive()
    for method, reason in available(run).items():
        if reason is None and method in METHODS:
            path = estimate(run, method).trajectory
            assert run.truth is not None
            evaluate(path, run.truth)
            nees(path, run.truth)
    return time.perf_counter() - began


def short_drive(seconds: float = 4.0, rate: float = 50.0) -> Run:
    """Rest, then straight on at 0.2 m/s along x: wheels, gyro, fixes and truth without noise, float32 readings."""
    t = np.arange(0.0, seconds, 1 / rate)
    x = 0.2 * np.maximum(t - seconds / 4, 0.0)
    angle = (x / 0.05).astype(np.float32)
    zero = np.zeros(t.shape, np.float32)
    return Run(
        meta=RunMeta(robot=RobotParams(wheel_radius=0.05, track_width=0.3), start=Pose()),
        wheels=WheelLog(t, angle, angle),
        imu=ImuLog(t, zero, ax=zero, ay=zero),
        beacon=BeaconLog(t[::10], x[::10].astype(np.float32), zero[::10]),
        truth=TruthLog(t, x.astype(np.float32), zero, zero),
    )
