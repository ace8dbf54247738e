"""Dead reckoning, stepped: `encoders` and `encoders+gyro`. Sums of `core.estimation.odometry` that go on."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from core.estimation.assumptions import Assumptions, encoder_quantum
from core.estimation.cleaning import gyro_readings
from core.estimation.odometry import (
    WheelPath,
    arcs,
    chi2_gate,
    growth,
    gyro_turns,
    reading_noise,
    start_covariance,
    start_pose,
    step_noise,
)
from core.live.recent import tail
from core.live.rhythm import Rhythm
from core.run import Run, RunMeta
from core.sensors import ImuLog, WheelLog
from core.trajectory import Trajectory

Array = npt.NDArray[np.float64]


class WheelSum:
    """Cumulative distance and turn since the first wheel reading; a missing reading holds the one before it."""

    def __init__(self, meta: RunMeta) -> None:
        self._radius, self._track = float(meta.robot.wheel_radius or 0.0), meta.robot.track_width
        self._first: Array | None = None
        self._last = np.zeros(2)

    def path(self, wheels: WheelLog) -> WheelPath:
        """The path's rows at the wheels' stamps, which go on from those before."""
        angles = np.column_stack((wheels.left, wheels.right)).astype(np.float64)
        if not np.isfinite(angles).all():
            angles = _held(angles, self._last)
        if self._first is None:
            self._first = angles[0].copy()
        self._last = angles[-1].copy()
        left, right = (self._radius * (angles - self._first)).T
        turn = (right - left) / self._track if self._track else np.full(len(wheels), np.nan)
        return WheelPath(wheels.t, (left + right) / 2, turn)


def _held(angles: Array, last: Array) -> Array:
    rows = np.vstack((last, angles))
    place = np.maximum.accumulate(np.where(np.isfinite(rows), np.arange(len(rows))[:, None], 0), axis=0)
    return np.take_along_axis(rows, place, axis=0)[1:]


class Encoders:
    """`encoders`, stepped: the same poses, to rounding."""

    def __init__(self, meta: RunMeta, numbers: Assumptions) -> None:
        run = Run(meta)
        self._numbers, self._meta = numbers, meta
        self._pose = np.array(start_pose(run)[0], np.float64)
        self._P = start_covariance(run, numbers)
        self._origin, self._swings = self._pose.copy(), np.zeros((2, 2))
        self._d = self._turn = 0.0

    def step(self, path: WheelPath) -> Trajectory:
        """Poses at the stamps of new rows of the wheels' path."""
        robot, numbers = self._meta.robot, self._numbers
        assert robot.track_width and robot.wheel_radius
        t = np.concatenate((path.t[:1], path.t))
        d, turn = (np.concatenate(([v], rows)) for v, rows in ((self._d, path.d), (self._turn, path.turn)))
        pose = arcs(d, turn, (self._pose[0], self._pose[1], self._pose[2]))
        P = growth(pose, *step_noise(WheelPath(t, d, turn), robot.track_width, numbers), self._P)
        self._P, self._d, self._turn = P[-1].copy(), float(d[-1]), float(turn[-1])
        covariance = P[1:] + reading_noise(pose[1:, 2], encoder_quantum(Run(self._meta), numbers) * robot.wheel_radius,
                                           robot.track_width)  # fmt: skip
        covariance += self._geometry(pose, d, robot.track_width)
        self._pose = pose[-1].copy()
        return Trajectory(path.t, pose[1:, 0], pose[1:, 1], pose[1:, 2], covariance)

    def _geometry(self, pose: Array, d: Array, track: float) -> Array:
        """As `geometry_error`, of the rows after the first, with sums that go on."""
        numbers = self._numbers
        xy = pose[1:, :2] - self._origin[:2]
        scale = np.column_stack((xy, np.zeros(len(xy))))
        P = numbers.distance_scale_sd**2 * scale[:, :, None] * scale[:, None, :]
        dx, dy = np.diff(pose[:, 0]), np.diff(pose[:, 1])
        turned = (d / track, pose[:, 2] - self._origin[2])
        for k, (by, sd) in enumerate(zip(turned, (numbers.inequality_sd, numbers.track_scale_sd), strict=True)):
            middle = (by[1:] + by[:-1]) / 2
            swing = np.column_stack((self._swings[k, 0] + np.cumsum(-middle * dy),
                                     self._swings[k, 1] + np.cumsum(middle * dx), by[1:]))  # fmt: skip
            self._swings[k] = swing[-1, :2]
            P += sd**2 * swing[:, :, None] * swing[:, None, :]
        return P


class EncodersGyro:
    """`encoders+gyro`, stepped: the same poses, to rounding, where the rest noise is the same. A pose waits for the
    wheel reading after its stamp, as distance is linear between wheel readings."""

    def __init__(self, meta: RunMeta, numbers: Assumptions, rhythm: Rhythm) -> None:
        from core.estimation._gyro_numba import N

        self._meta, self._numbers, self._rhythm = meta, numbers, rhythm
        self._x, self._P, self._refused = np.zeros(N), np.zeros((N, N)), np.zeros(1, np.int64)
        self._P[:3, :3] = start_covariance(Run(meta), numbers)
        self._P[3, 3], self._P[4, 4] = numbers.bias_sd**2, numbers.gyro_scale_sd**2
        self._origin = np.zeros(2)
        self._last = -np.inf  # stamp of the newest pose
        self._distance = 0.0

    def begin(self, t: float, wheels: Trajectory) -> None:
        """Set out at the first IMU stamp, from where the wheels' path is by then."""
        pose = np.array([np.interp(t, wheels.t, column) for column in (wheels.x, wheels.y, wheels.theta)])
        self._x[:3], self._origin = pose, pose[:2].copy()

    @property
    def bias(self) -> tuple[float, float]:
        """Gyro bias and its sd [rad/s]."""
        return float(self._x[3]), float(np.sqrt(self._P[3, 3]))

    def step(self, imu: ImuLog, resting: npt.NDArray[np.bool_], path: WheelPath, until: float) -> Trajectory | None:
        """Poses at new IMU stamps up to `until`, given the last seconds of the IMU, which of it is at rest, and of the
        wheels' path; None where there are none."""
        from core.estimation._gyro_numba import walk

        numbers = self._numbers
        first = int(np.searchsorted(imu.t, self._last, "right"))
        end = int(np.searchsorted(imu.t, until, "right"))
        if end <= first:
            return None
        begins = not np.isfinite(self._last)
        low = first if begins else first - 1  # the row before, to step from
        part: ImuLog = tail(imu, low)
        part = tail_end(part, end - low)
        turns = gyro_turns(part, numbers, self._rhythm.hold)
        along = np.interp(part.t, path.t, path.d)
        if not begins:
            along[0] = self._distance  # what was counted up to there, whatever came since
        distance = np.diff(along, prepend=along[0])
        n = len(part)
        pose, covariance, bias, bias_var = np.empty((n, 3)), np.empty((n, 3, 3)), np.empty(n), np.empty(n)
        walk(
            np.diff(part.t, prepend=part.t[0]), turns.step, distance, gyro_readings(part)[1], resting[low:end],
            turns.variance, numbers.slip**2 / 2 * np.abs(distance), numbers.bias_walk**2, self._rhythm.gyro_sd**2,
            chi2_gate(1, numbers), self._rhythm.patience, self._refused, self._x, self._P, pose, covariance, bias,
            bias_var,
        )  # fmt: skip
        quantum = encoder_quantum(Run(self._meta), numbers) * float(self._meta.robot.wheel_radius or 0.0)
        covariance += reading_noise(pose[:, 2], quantum, None)
        scale = np.column_stack((pose[:, :2] - self._origin, np.zeros(n)))
        covariance += numbers.distance_scale_sd**2 * scale[:, :, None] * scale[:, None, :]
        self._last, self._distance = float(part.t[-1]), float(along[-1])
        new = slice(0 if begins else 1, None)
        return Trajectory(part.t[new], pose[new, 0], pose[new, 1], pose[new, 2], covariance[new])


def tail_end(log: ImuLog, count: int) -> ImuLog:
    """The log's first `count` rows."""
    return dataclasses.replace(log, **{name: column[:count] for name, column in log.columns().items()})  # type: ignore[arg-type]
