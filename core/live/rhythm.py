"""What a run's first second tells of its streams, and what is then taken for a constant of the run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from core.estimation.assumptions import Assumptions
from core.estimation.odometry import longest_hold
from core.estimation.rest import at_rest
from core.run import Run

FIRST = 1.0  # s of IMU and wheels that are looked at


@dataclass(frozen=True)
class Rhythm:
    """gyro_sd [rad/s] of one reading at rest; hold [s] that one is taken to last; patience, readings at rest that may
    be refused in a row; imu, whether there is one."""

    gyro_sd: float
    hold: float
    patience: int
    imu: bool


def rhythm(run: Run, numbers: Assumptions) -> Rhythm | None:
    """None until the run is FIRST seconds long. Offline these are told from the whole run."""
    wheels, imu = run.wheels, run.imu
    if wheels is None or len(wheels) < 5 or wheels.t[-1] - wheels.t[0] < FIRST:
        return None
    if imu is None or len(imu) < 10:
        return Rhythm(1.0, 0.0, 0, False)
    if imu.t[-1] - imu.t[0] < FIRST:
        return None
    step = np.diff(imu.t, prepend=imu.t[0])
    sd = at_rest(run, numbers).gyro_sd
    return Rhythm(sd, longest_hold(step), int(numbers.reaccept * imu.rate / 2), True)
