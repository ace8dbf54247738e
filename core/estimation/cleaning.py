"""Readings that are missing (NaN) or beyond what a sensor can read, dealt with once, by whole columns."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from core.errors import NotEnoughDataError
from core.robot import ImuMount
from core.sensors import ImuLog, WheelLog

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

FASTEST_TURN = 100.0  # rad/s: beyond it a gyro reading is a fault
HARDEST = 200.0  # m/s^2: beyond it an accelerometer's reading is
FARTHEST_ANGLE = 1e9  # rad: beyond it a wheel reading is one


def finite_rows(rows: Array) -> Flags:
    """(N,) rows without NaN or infinity."""
    return np.asarray(np.isfinite(rows).all(axis=1), np.bool_)


def wheel_readings(wheels: WheelLog) -> tuple[Array, Array]:
    """Left and right angles (N,) float64 [rad], missing readings filled linearly from their neighbours."""
    left, right = (np.asarray(c, np.float64) for c in (wheels.left, wheels.right))
    left, right = (np.where(np.abs(c) <= FARTHEST_ANGLE, c, np.nan) for c in (left, right))
    return filled(wheels.t, left, "wheels.left"), filled(wheels.t, right, "wheels.right")


def gyro_readings(imu: ImuLog) -> tuple[Array, Array]:
    """Stamps and gz (N,) float64, missing readings filled linearly from their neighbours."""
    gz = np.asarray(imu.gz, np.float64)
    return imu.t, filled(imu.t, np.where(np.abs(gz) <= FASTEST_TURN, gz, np.nan), "imu.gz")


def filled(t: Array, column: npt.NDArray[np.floating], name: str) -> Array:
    """The column with every gap bridged linearly, held at the ends."""
    values = np.asarray(column, np.float64)
    good = np.isfinite(values)
    if good.all():
        return values
    if not good.any():
        raise NotEnoughDataError(f"{name} has no finite value", column=name, expected=1, found=0)
    return np.interp(t, t[good], values[good])


def forward_acceleration(imu: ImuLog, mount: ImuMount) -> Array | None:
    """(N,) specific force along the body's x axis at the axle [m/s^2], turned out of the IMU's frame and freed of what
    turning does at the IMU's place; None where the IMU has no usable accelerometer."""
    if imu.ax is None or (imu.ay is None and mount.yaw != 0.0):
        return None
    axes = []
    for column in (imu.ax, imu.ay if imu.ay is not None else np.zeros(len(imu.t))):
        values = np.asarray(column, np.float64)
        values = np.where(np.abs(values) <= HARDEST, values, np.nan)
        if not np.isfinite(values).any():
            return None
        axes.append(filled(imu.t, values, "imu.ax"))
    rate = gyro_readings(imu)[1]
    spin = np.diff(rate, prepend=rate[:1]) / np.maximum(np.diff(imu.t, prepend=imu.t[0] - 1.0), 1e-4)
    forward = np.cos(mount.yaw) * axes[0] - np.sin(mount.yaw) * axes[1] + rate**2 * mount.x + spin * mount.y
    return np.asarray(np.clip(forward, -HARDEST, HARDEST))
