"""A drive that turns, brakes and reverses, short enough to simulate many times, with every stream on it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from core.robot import ImuMount, Pose, TagMount
from core.run import Run
from core.sensors import CommandLog
from core.simulation.scenarios import ROBOT, SCENARIOS, Rates

KNOTS = 61


def wild_commands(seed: int = 3, span: float = 60.0) -> CommandLog:
    """Knots at uneven times, speeds between reverse and fast, with jumps of slope at each and rests in between."""
    rng = np.random.default_rng(seed)
    t = np.concatenate(([0.0], np.sort(rng.uniform(0.5, span - 1.0, KNOTS - 2)), [span]))
    t += np.linspace(0.0, 0.03, KNOTS)  # no two closer than half a millisecond
    v, w = rng.uniform(-0.3, 0.7, KNOTS), rng.uniform(-1.2, 1.2, KNOTS)
    v[[0, 20, 21, 40, 41, -1]] = 0.0
    w[[0, 20, 21, -1]] = 0.0
    return CommandLog(t=t, v=v, w=w)


@pytest.fixture(scope="session")
def wild() -> Run:
    """60 s with every stream and column, an off-centre turned IMU and an off-centre tag."""
    rates = Rates(commands=50.0, wheels=50.0, imu=100.0, beacon=10.0, ranges=8.0, truth=20.0)
    base = SCENARIOS["standstill"].run(rates)
    robot = dataclasses.replace(ROBOT, imu=ImuMount(x=0.08, y=-0.03, yaw=0.4), tag=TagMount(x=0.1, y=0.05, z=0.4))
    meta = dataclasses.replace(base.meta, robot=robot, start=Pose(4.5, 3.5, 0.3))
    assert base.imu is not None
    warming = 24.0 + 5.0 * (1.0 - np.exp(-base.imu.t / 20.0))
    imu = dataclasses.replace(base.imu, temperature=warming)
    return dataclasses.replace(base, meta=meta, commands=wild_commands(), imu=imu)
