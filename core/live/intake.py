"""New rows of a live run, made ready once for every method: cleaned, summed, and as events of the fused filter.

The same numbers as `estimation.cleaning`, `estimation.rest` and `estimation.fusion.events` give over the whole run, as
far as those look back only; the compiled part keeps what it looks back on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.estimation.assumptions import Assumptions
from core.estimation.cleaning import FARTHEST_ANGLE, FASTEST_TURN, HARDEST
from core.estimation.fusion.events import FARTHEST, STANDING, Events
from core.estimation.fusion.layout import BR, KR, OUT, N
from core.estimation.odometry import WheelPath
from core.estimation.rest import LOOSENESS, MIN_WINDOW
from core.live import _intake_numba as kernel
from core.live.rhythm import Rhythm
from core.run import Run, RunMeta
from core.sensors import Log

Array = npt.NDArray[np.float64]
NOTHING = np.zeros((0, 6))


@dataclass(frozen=True)
class Taken:
    """A piece made ready. rolled: the wheels' path at its stamps, from the run's first reading on; imu (I, 4) t, gz,
    ax, ay; inertial (I, 3) rate [rad/s], forward acceleration [m/s^2], whether at rest; fixes (F, 6), the first t, x,
    y, theta or NaN; events of the filter."""

    rolled: WheelPath
    imu: Array
    inertial: Array
    fixes: Array
    events: Events


class Intake:
    """What new rows are held against: the last seconds of wheels, commands and gyro."""

    def __init__(self, meta: RunMeta, numbers: Assumptions) -> None:
        self._meta, self._numbers = meta, numbers
        self._mem = np.zeros(kernel.MEMORY)
        for value in (kernel.LEFT, kernel.RIGHT, kernel.GZ, kernel.AX, kernel.AY):
            self._mem[value] = np.nan
        self._asked = np.zeros((kernel.HISTORY, 3))
        self._turned, self._gyro = np.zeros((kernel.HISTORY, 2)), np.zeros((kernel.HISTORY, 2))
        self._names: list[str] = []
        self._where = np.zeros((0, 3))
        self._limits = self._constants()

    def know(self, rhythm: Rhythm) -> None:
        """What the first second has told."""
        limits = self._limits
        limits[kernel.LOOSE], limits[kernel.BY_IMU] = LOOSENESS * rhythm.gyro_sd**2, rhythm.imu
        limits[kernel.WHEEL_STEP] = rhythm.wheel_step

    def take(self, piece: Run) -> Taken:
        """The piece's rows, newer than those before stream by stream."""
        imu, limits = piece.imu, self._limits
        if imu is not None:
            both = imu.ay is not None or self._meta.robot.imu.yaw == 0.0
            limits[kernel.HAS_AX] = limits[kernel.HAS_AX] or (imu.ax is not None and both)
            limits[kernel.HAS_AY] = limits[kernel.HAS_AY] or imu.ay is not None
        wheels = _table(piece.wheels, "left", "right")
        inertia = _table(imu, "gz", "ax", "ay")
        fixes, ranges = self._fixes(piece), self._ranges(piece)
        outs = len(inertia) if limits[kernel.BY_IMU] else len(wheels)
        size = len(wheels) + len(fixes) + len(ranges) + outs
        rolled, inertial = np.empty((2, len(wheels))), np.zeros((len(inertia), 3))
        t, kind, data, flags = np.empty(size), np.empty(size, np.int64), np.empty((size, 5)), np.empty(size, np.int64)
        kernel.take(
            _table(piece.commands, "v", "w"), wheels, inertia, fixes, ranges, self._mem, self._asked, self._turned,
            self._gyro, limits, rolled, inertial, t, kind, data, flags,
        )  # fmt: skip
        first = KR if not self._names else BR + 1
        events = Events(t, kind, data, flags, t[kind == OUT], first, tuple(self._names))
        return Taken(WheelPath(wheels[:, 0], *rolled), inertia, inertial, fixes, events)

    def _fixes(self, piece: Run) -> Array:
        log = piece.beacon
        if log is None or not len(log):
            return NOTHING
        rows = np.zeros((len(log), 6))
        rows[:, 0], rows[:, 1], rows[:, 2] = log.t, log.x, log.y
        rows[:, 3] = np.nan if log.theta is None else log.theta
        rows[:, 3][~(np.abs(rows[:, 3]) <= FARTHEST)] = np.nan
        offset = (KR if not self._names else BR + 1) + len(self._names)
        rows[:, 4] = offset if self._numbers.lasting_fix > 0 and offset + 1 < N else 0
        kept = (np.abs(rows[:, 1:3]) <= FARTHEST).all(axis=1)
        return rows if kept.all() else rows[kept]

    def _ranges(self, piece: Run) -> Array:
        log = piece.ranges
        if log is None or not len(log):
            return NOTHING
        new = [name for name in log.names if name not in self._names]
        if new:
            self._names += new
            nowhere = (np.nan, np.nan, np.nan)
            self._where = np.array([self._meta.beacons.get(name, nowhere) for name in self._names], np.float64)
        code = np.array([self._names.index(name) for name in log.names])[log.beacon]
        rows = np.empty((len(log), 6))
        rows[:, 0], rows[:, 1:4], rows[:, 4] = log.t, self._where[code], log.range
        first, lasting = BR + 1, self._numbers.lasting_range > 0
        rows[:, 5] = code + first if lasting and first + len(self._names) < N else 0.0
        kept = np.isfinite(rows[:, 1]) & (rows[:, 4] > 0) & (rows[:, 4] <= FARTHEST)
        return rows if kept.all() else rows[kept]

    def _constants(self) -> Array:
        robot, numbers, limits = self._meta.robot, self._numbers, np.zeros(kernel.LIMITS)
        limits[kernel.RADIUS] = robot.wheel_radius or 0.0
        limits[kernel.TRACK] = robot.track_width or np.nan
        limits[kernel.REST_TIME], limits[kernel.STANDING] = numbers.rest_time, STANDING
        limits[kernel.REST_RATE], limits[kernel.WINDOW] = numbers.rest_rate, MIN_WINDOW
        limits[kernel.TOP_SPEED] = numbers.top_speed
        limits[kernel.COS], limits[kernel.SIN] = math.cos(robot.imu.yaw), math.sin(robot.imu.yaw)
        limits[kernel.ARM_X], limits[kernel.ARM_Y] = robot.imu.x, robot.imu.y
        limits[kernel.FARTHEST], limits[kernel.FASTEST], limits[kernel.HARDEST] = FARTHEST_ANGLE, FASTEST_TURN, HARDEST
        return limits


def _table(log: Log | None, *names: str) -> Array:
    """(N, 1 + columns) stamps and columns, copied; NaN where the log has no such column."""
    if log is None:
        return np.zeros((0, 1 + len(names)))
    rows = np.empty((len(log), 1 + len(names)))
    rows[:, 0] = log.t
    for k, name in enumerate(names):
        column = getattr(log, name)
        rows[:, 1 + k] = np.nan if column is None else column
    return rows
