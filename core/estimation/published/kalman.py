"""Equations (4) and (5), run by filterpy: the state is the pose, the measurement a fix, with heading or without."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from filterpy.kalman import ExtendedKalmanFilter

Array = npt.NDArray[np.float64]


ABSURD = 1e9
"""A fix further off than this [m] is none; its square would overflow."""


class PoseFilter:
    """filterpy's extended Kalman filter on x, y, theta; tag (2,) is the beacon receiver in the body."""

    def __init__(self, pose: Array, covariance: Array, tag: Array) -> None:
        self._kf = ExtendedKalmanFilter(dim_x=3, dim_z=3)
        self._kf.B = np.eye(3)
        self._tag = tag
        self.replace(pose, covariance)

    @property
    def pose(self) -> Array:
        """x, y, theta, unwrapped (3,)."""
        return np.asarray(self._kf.x, np.float64)

    @property
    def covariance(self) -> Array:
        """(3, 3)."""
        return np.asarray(self._kf.P, np.float64)

    def replace(self, pose: Array, covariance: Array) -> None:
        """The position data is replaced."""
        self._kf.x, self._kf.P = pose.copy(), covariance.copy()

    def predict(self, step: Array, covariance: Array) -> None:
        """By a motion (3,) in the body's frame, covariance (3, 3) there: eq. (1), eq. (4), eq. (5) lines 1 and 2."""
        kf, theta = self._kf, self.pose[2]
        cos, sin = math.cos(theta), math.sin(theta)
        dx, dy = cos * step[0] - sin * step[1], sin * step[0] + cos * step[1]
        R = np.array(((cos, -sin, 0.0), (sin, cos, 0.0), (0.0, 0.0, 1.0)))
        kf.F = np.array(((1.0, 0.0, -dy), (0.0, 1.0, dx), (0.0, 0.0, 1.0)))
        kf.Q = R @ covariance @ R.T
        # filterpy adds F x, which for this F is x + (-dy theta, dx theta, 0).
        kf.predict(u=np.array((dx + dy * theta, dy - dx * theta, step[2])))

    def expected(self, rows: int = 3) -> Array:
        """The fix that the pose makes expect: tag position, and heading where rows is 3."""
        (x, y, theta), (tx, ty) = self.pose, self._tag
        cos, sin = math.cos(theta), math.sin(theta)
        return np.array((x + cos * tx - sin * ty, y + sin * tx + cos * ty, theta))[:rows]

    def distance(self, z: Array, R: Array) -> float:
        """Squared innovation over its covariance."""
        y = _residual(z, self.expected(len(z)))
        if not np.abs(y).max() < ABSURD:
            return math.inf
        H = self._jacobian(len(z))
        return float(y @ np.linalg.solve(H @ self.covariance @ H.T + R, y))

    def scores(self, z: Array, R: Array) -> Array:
        """(2,) signed innovations of the position, each over its own sd; NaN for a fix that is none."""
        y = _residual(z, self.expected(len(z)))[:2]
        H = self._jacobian(2)
        sd = np.sqrt(np.diag(H @ self.covariance @ H.T + R[:2, :2]))
        return np.where(np.abs(y) < ABSURD, y / sd, np.nan)

    def update(self, z: Array, R: Array) -> None:
        """Eq. (5), lines 3 to 5, with a fix z (3,) or (2,)."""
        rows = len(z)
        self._kf.update(z, lambda _: self._jacobian(rows), lambda _: self.expected(rows), R, residual=_residual)

    def _jacobian(self, rows: int) -> Array:
        theta, (tx, ty) = self.pose[2], self._tag
        cos, sin = math.cos(theta), math.sin(theta)
        H = ((1.0, 0.0, -sin * tx - cos * ty), (0.0, 1.0, cos * tx - sin * ty), (0.0, 0.0, 1.0))
        return np.array(H)[:rows]


def _residual(z: Array, expected: Array) -> Array:
    y = z - expected
    if len(y) == 3:
        y[2] = math.remainder(y[2], math.tau)
    return np.asarray(y, np.float64)
