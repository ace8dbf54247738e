"""Dead reckoning, stepped: `encoders` and `encoders+gyro`. Sums of `core.estimation.odometry` that go on."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from core.estimation.assumptions import Assumptions, encoder_quantum
from core.estimation.odometry import WheelPath, chi2_gate, gyro_turns, reading_noise, start_covariance, start_pose
from core.live import _poses_numba as kernel
from core.live.intake import Taken
from core.live.rhythm import Rhythm
from core.run import Run, RunMeta
from core.sensors import ImuLog
from core.trajectory import Trajectory

Array = npt.NDArray[np.float64]


class Encoders:
    """`encoders`, stepped: the same poses, to rounding. The robot's dimensions are known."""

    def __init__(self, meta: RunMeta, numbers: Assumptions) -> None:
        robot, run, state = meta.robot, Run(meta), np.zeros(kernel.STATE)
        state[:3] = state[kernel.ORIGIN : kernel.SWINGS] = start_pose(run)[0]
        state[kernel.COVARIANCE : kernel.D] = start_covariance(run, numbers).ravel()
        quantum = encoder_quantum(run, numbers) * float(robot.wheel_radius or 0.0)
        self._state = state
        self._limits = np.array((
            float(robot.track_width or np.nan), numbers.slip, quantum, numbers.distance_scale_sd, numbers.inequality_sd,
            numbers.track_scale_sd,
        ))  # fmt: skip

    def step(self, path: WheelPath) -> Trajectory:
        """Poses at the stamps of new rows of the wheels' path."""
        pose, covariance = np.empty((len(path.t), 3)), np.empty((len(path.t), 3, 3))
        kernel.roll(path.d, path.turn, self._state, self._limits, pose, covariance)
        return Trajectory(path.t, pose[:, 0], pose[:, 1], pose[:, 2], covariance)


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
        self._begun = False
        self._waiting: list[Array] = []  # t, rate, rest of readings without a pose, behind the one stepped from
        self._distance = 0.0

    def begin(self, t: float, wheels: Trajectory) -> Array:
        """Set out at the first IMU stamp, from where the wheels' path is by then: (3,) the pose."""
        pose = np.array([np.interp(t, wheels.t, column) for column in (wheels.x, wheels.y, wheels.theta)])
        self._x[:3], self._origin = pose, pose[:2].copy()
        return pose

    @property
    def bias(self) -> tuple[float, float]:
        """Gyro bias and its sd [rad/s]."""
        return float(self._x[3]), float(np.sqrt(self._P[3, 3]))

    def take(self, taken: Taken) -> None:
        """New readings."""
        if len(taken.imu):
            self._waiting.append(np.column_stack((taken.imu[:, :2], taken.inertial[:, 2])))

    def step(self, path: WheelPath, until: float) -> Trajectory | None:
        """Poses at the stamps of readings up to `until`, given the last seconds of the wheels' path; None where there
        are none."""
        from core.estimation._gyro_numba import walk

        numbers = self._numbers
        rows = np.concatenate((np.zeros((0, 3)), *self._waiting))
        end = int(np.searchsorted(rows[:, 0], until, "right"))
        begins = not self._begun
        if end <= (0 if begins else 1):
            self._waiting = [rows]
            return None
        self._begun, self._waiting = True, [rows[end - 1 :]]  # the last one is stepped from
        part = ImuLog(*np.ascontiguousarray(rows[:end, :2].T))
        turns = gyro_turns(part, numbers, self._rhythm.hold)
        along = np.interp(part.t, path.t, path.d)
        if not begins:
            along[0] = self._distance  # what was counted up to there, whatever came since
        distance = np.diff(along, prepend=along[0])
        n = len(part)
        pose, covariance, bias, bias_var = np.empty((n, 3)), np.empty((n, 3, 3)), np.empty(n), np.empty(n)
        walk(
            np.diff(part.t, prepend=part.t[0]), turns.step, distance, part.gz, rows[:end, 2] != 0,
            turns.variance, numbers.slip**2 / 2 * np.abs(distance), numbers.bias_walk**2, self._rhythm.gyro_sd**2,
            chi2_gate(1, numbers), self._rhythm.patience, self._refused, self._x, self._P, pose, covariance, bias,
            bias_var,
        )  # fmt: skip
        quantum = encoder_quantum(Run(self._meta), numbers) * float(self._meta.robot.wheel_radius or 0.0)
        covariance += reading_noise(pose[:, 2], quantum, None)
        scale = np.column_stack((pose[:, :2] - self._origin, np.zeros(n)))
        covariance += numbers.distance_scale_sd**2 * scale[:, :, None] * scale[:, None, :]
        self._distance = float(along[-1])
        new = slice(0 if begins else 1, None)
        return Trajectory(part.t[new], pose[new, 0], pose[new, 1], pose[new, 2], covariance[new])
