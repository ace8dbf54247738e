"""Filters that go on from where they were left: low-pass, offset at rest, and the pose filter of `published`."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

ABSURD = 1e9  # m: a fix further off is none


class LowPass:
    """`published.signals.lowpass`, stepped."""

    def __init__(self, hz: float, cutoff: float) -> None:
        from scipy.signal import butter

        self._used = cutoff < 0.45 * hz
        self._b: Array = np.ones(1)
        self._a: Array = np.ones(1)
        if self._used:
            self._b, self._a = butter(2, cutoff, fs=hz)
        self._z: Array | None = None

    def __call__(self, values: Array) -> Array:
        """Filtered values (N,)."""
        from scipy.signal import lfilter, lfilter_zi

        if not self._used or not len(values):
            return values
        if self._z is None:
            self._z = lfilter_zi(self._b, self._a) * values[0]
        out, self._z = lfilter(self._b, self._a, values, zi=self._z)
        return np.asarray(out, np.float64)


class Offset:
    """`published.signals.offsets`, stepped: keep is the share that a reading at rest keeps at the next one."""

    def __init__(self, keep: float) -> None:
        self._keep = keep
        self._z, self._count, self._latest = np.zeros(1), 0, 0.0

    def __call__(self, values: Array, rest: npt.NDArray[np.bool_]) -> Array:
        """(N,) mean of the values at rest so far."""
        from scipy.signal import lfilter

        seen = np.cumsum(rest)
        if not len(seen) or not seen[-1]:
            return np.full(len(values), self._latest)
        keep = self._keep
        sums, self._z = lfilter([1 - keep], [1, -keep], values[rest], zi=self._z)
        sums = sums / (1 - keep ** np.arange(self._count + 1, self._count + 1 + len(sums)))
        before, self._latest = self._latest, float(sums[-1])
        self._count += len(sums)
        return np.where(seen > 0, sums[np.maximum(seen - 1, 0)], before)


class PoseFilter:
    """`published.kalman.PoseFilter`, without filterpy: the same equations, as a live run has no time to load it."""

    def __init__(self, pose: Array, covariance: Array, tag: Array) -> None:
        self._tag = tag
        self.pose, self.covariance = pose.copy(), covariance.copy()

    def replace(self, pose: Array, covariance: Array) -> None:
        """The position data is replaced."""
        self.pose, self.covariance = pose.copy(), covariance.copy()

    def predict(self, step: Array, covariance: Array) -> None:
        """By a motion (3,) in the body's frame, covariance (3, 3) there."""
        theta = self.pose[2]
        cos, sin = math.cos(theta), math.sin(theta)
        dx, dy = cos * step[0] - sin * step[1], sin * step[0] + cos * step[1]
        R = np.array(((cos, -sin, 0.0), (sin, cos, 0.0), (0.0, 0.0, 1.0)))
        F = np.array(((1.0, 0.0, -dy), (0.0, 1.0, dx), (0.0, 0.0, 1.0)))
        self.pose = self.pose + np.array((dx, dy, step[2]))
        self.covariance = F @ self.covariance @ F.T + R @ covariance @ R.T

    def expected(self, rows: int = 3) -> Array:
        """The fix that the pose makes expect: tag position, and heading where rows is 3."""
        (x, y, theta), (tx, ty) = self.pose, self._tag
        cos, sin = math.cos(theta), math.sin(theta)
        return np.array((x + cos * tx - sin * ty, y + sin * tx + cos * ty, theta))[:rows]

    def distance(self, z: Array, R: Array) -> float:
        """Squared innovation over its covariance."""
        y, H = self._residual(z), self._jacobian(len(z))
        if not np.abs(y).max() < ABSURD:
            return math.inf
        return float(y @ np.linalg.solve(H @ self.covariance @ H.T + R, y))

    def scores(self, z: Array, R: Array) -> Array:
        """Nobody asks for them while live."""
        return np.full(2, np.nan)

    def update(self, z: Array, R: Array) -> None:
        """With a fix z (3,) or (2,)."""
        H, P = self._jacobian(len(z)), self.covariance
        K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
        rest = np.eye(3) - K @ H
        self.pose = self.pose + K @ self._residual(z)
        self.covariance = rest @ P @ rest.T + K @ R @ K.T

    def _residual(self, z: Array) -> Array:
        y = z - self.expected(len(z))
        if len(y) == 3:
            y[2] = math.remainder(y[2], math.tau)
        return np.asarray(y, np.float64)

    def _jacobian(self, rows: int) -> Array:
        theta, (tx, ty) = self.pose[2], self._tag
        cos, sin = math.cos(theta), math.sin(theta)
        return np.array(((1.0, 0.0, -sin * tx - cos * ty), (0.0, 1.0, cos * tx - sin * ty), (0.0, 0.0, 1.0)))[:rows]
