"""Is the robot at rest? Wheels, command and gyro are asked together, and only about the past.

At rest: no wheel reading changed for `rest_time`, no motion was asked for, the gyro's variance over that time is that
of its own noise, and its mean is within what a bias can be. Wheels alone are not believed (a dead encoder reads as
parked), nor is a rate threshold alone (a slow steady turn passes it). The still noise is learnt from the run's own
quiet stretches, since idle motors vibrate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.estimation.assumptions import Assumptions
from core.estimation.cleaning import gyro_readings
from core.run import Run
from core.sensors import CommandLog, ImuLog, WheelLog

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

LOOSENESS = 3.0  # window variance over still variance that still counts as rest
MIN_WINDOW = 5  # gyro samples
LOUDEST = 4.0  # times the sheet's noise that idle motors may shake; more is motion


@dataclass(frozen=True)
class Rest:
    """flags (N,) per IMU stamp; gyro_sd [rad/s], noise of one gyro reading at rest."""

    flags: Flags
    gyro_sd: float


def at_rest(run: Run, numbers: Assumptions, gyro_sd: float | None = None) -> Rest:
    """Rest at each IMU stamp. Without wheels nothing counts as rest.

    gyro_sd [rad/s]: noise of one gyro reading at rest, learnt from the run where None.
    """
    imu = run.imu
    assert imu is not None
    sheet_sd = numbers.gyro_density * np.sqrt(max(imu.rate, 1.0) / 2)
    if run.wheels is None or len(run.wheels) < 2 or len(imu) < MIN_WINDOW:
        return Rest(np.zeros(len(imu), bool), float(sheet_sd) if gyro_sd is None else gyro_sd)
    quiet = wheels_still(run.wheels, imu.t, numbers.rest_time) & no_command(run.commands, imu.t, numbers.rest_time)
    mean, variance, full = _window(imu, numbers.rest_time)
    asked = quiet & full
    learnt = float(np.sqrt(np.quantile(variance[asked], 0.25))) if asked.any() else 0.0
    sd = float(np.clip(learnt, sheet_sd, LOUDEST * sheet_sd)) if gyro_sd is None else gyro_sd
    return Rest(asked & (variance <= LOOSENESS * sd**2) & (np.abs(mean) <= numbers.rest_rate), sd)


def wheels_still(wheels: WheelLog, t: Array, rest_time: float) -> Flags:
    """(N,) at stamps t: neither reading changed during the last `rest_time`, and the stream has not paused since."""
    changed = (np.diff(wheels.left) != 0) | (np.diff(wheels.right) != 0)
    last_change = np.maximum.accumulate(np.where(np.concatenate(([True], changed)), wheels.t, -np.inf))
    newest = np.searchsorted(wheels.t, t, "right") - 1
    known = np.maximum(newest, 0)
    fresh = t - wheels.t[known] <= max(rest_time, 3.0 * float(np.median(np.diff(wheels.t))))
    return (newest >= 0) & fresh & (t - last_change[known] >= rest_time)


def no_command(commands: CommandLog | None, t: Array, rest_time: float) -> Flags:
    """(N,) at stamps t: the latest command was zero for the last `rest_time`; true where there are no commands."""
    if commands is None or not len(commands):
        return np.ones(t.shape, bool)
    asks = (commands.v != 0) | (commands.w != 0)
    last_asked = np.maximum.accumulate(np.where(asks, commands.t, -np.inf))
    newest = np.searchsorted(commands.t, t, "right") - 1
    known = np.maximum(newest, 0)
    return (newest < 0) | (~asks[known] & (t - last_asked[known] >= rest_time))


def _window(imu: ImuLog, rest_time: float) -> tuple[Array, Array, Flags]:
    """Mean and variance of gz over the last `rest_time` (MIN_WINDOW samples at least); whether the window is full."""
    gz = gyro_readings(imu)[1]
    centre = float(np.median(gz))
    sums = np.concatenate(([0.0], np.cumsum(gz - centre)))
    squares = np.concatenate(([0.0], np.cumsum((gz - centre) ** 2)))
    end = np.arange(1, len(gz) + 1)
    begin = np.searchsorted(imu.t, imu.t - rest_time, "left")
    begin = np.maximum(np.minimum(begin, end - MIN_WINDOW), 0)
    n = end - begin
    mean = (sums[end] - sums[begin]) / n
    variance = (squares[end] - squares[begin]) / n - mean**2
    return mean + centre, np.maximum(variance, 0.0) * n / np.maximum(n - 1, 1), n >= MIN_WINDOW
