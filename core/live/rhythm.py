"""What a run's first second tells of its streams, and what is then taken for a constant of the run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from core.estimation.assumptions import Assumptions
from core.estimation.odometry import longest_hold
from core.estimation.rest import at_rest
from core.run import Run

FIRST = 1.0  # s of IMU and wheels that are looked at
FEWEST = 5  # readings of a gyro that is one


@dataclass(frozen=True)
class Rhythm:
    """gyro_sd [rad/s] of one reading at rest; hold [s] that one is taken to last; patience, readings at rest that may
    be refused in a row; imu, whether there is one; imu_rate [Hz]; wheel_step [s]."""

    gyro_sd: float
    hold: float
    patience: int
    imu: bool
    imu_rate: float
    wheel_step: float


def rhythm(run: Run, numbers: Assumptions) -> Rhythm | None:
    """Told from the first FIRST seconds, however the readings came in; None until they are there. Offline these numbers
    are told from the whole run."""
    wheels, imu = run.wheels, run.imu
    if wheels is None or not len(wheels) or wheels.t[-1] - wheels.t[0] < FIRST:
        return None
    blind = Rhythm(1.0, 0.0, 0, False, 0.0, float(np.median(np.diff(wheels.t))))
    if imu is None or imu.t[0] > wheels.t[0] + FIRST:
        return blind
    end = max(float(wheels.t[0]), float(imu.t[0])) + FIRST
    if imu.t[-1] < end or wheels.t[-1] < end:
        return None
    first = run.crop(-np.inf, end)
    assert first.imu is not None
    if len(first.imu) < FEWEST:
        return blind
    step, hz = np.diff(first.imu.t, prepend=first.imu.t[0]), first.imu.rate
    sd = at_rest(first, numbers).gyro_sd
    return Rhythm(sd, longest_hold(step), int(numbers.reaccept * hz / 2), True, hz, blind.wheel_step)
