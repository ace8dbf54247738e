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
        self._tag = (float(tag[0]), float(tag[1]))
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
        self._moved()

    def predict(self, step: Array, covariance: Array) -> None:
        """By a motion (3,) in the body's frame, covariance (3, 3) there: eq. (1), eq. (4), eq. (5) lines 1 and 2."""
        kf, theta, (forward, left, turn) = self._kf, float(self._kf.x[2]), step.tolist()
        cos, sin = math.cos(theta), math.sin(theta)
        dx, dy = cos * forward - sin * left, sin * forward + cos * left
        R = np.array(((cos, -sin, 0.0), (sin, cos, 0.0), (0.0, 0.0, 1.0)))
        kf.F = np.array(((1.0, 0.0, -dy), (0.0, 1.0, dx), (0.0, 0.0, 1.0)))
        kf.Q = R @ covariance @ R.T
        # filterpy adds F x, which for this F is x + (-dy theta, dx theta, 0).
        kf.predict(u=np.array((dx + dy * theta, dy - dx * theta, turn)))
        self._moved()

    def expected(self, rows: int = 3) -> Array:
        """The fix that the pose makes expect: tag position, and heading where rows is 3."""
        return self._look()[0][:rows]

    def distance(self, z: Array, R: Array) -> float:
        """Squared innovation over its covariance."""
        y, S = self._judge(z, R)
        if not max(map(abs, y)) < ABSURD:
            return math.inf
        a, b = S[0][0], S[0][1] / S[0][0]  # by L D L', written out
        d = S[1][1] - b * S[0][1]
        e = y[1] - b * y[0]
        total = y[0] * y[0] / a + e * e / d
        if len(y) == 3:
            c = S[0][2] / a
            f = (S[1][2] - c * S[0][1]) / d
            last = y[2] - c * y[0] - f * e
            total += last * last / (S[2][2] - c * S[0][2] - f * f * d)
        return total

    def scores(self, z: Array, R: Array) -> Array:
        """(2,) signed innovations of the position, each over its own sd; NaN for a fix that is none."""
        y, S = self._judge(z, R)
        return np.array([y[k] / math.sqrt(S[k][k]) if abs(y[k]) < ABSURD else math.nan for k in range(2)])

    def update(self, z: Array, R: Array) -> None:
        """Eq. (5), lines 3 to 5, with a fix z (3,) or (2,)."""
        rows = len(z)
        expected, H = self._look()
        self._kf.update(z, lambda _: H[:rows], lambda _: expected[:rows], R, residual=_residual)
        self._moved()

    def _moved(self) -> None:
        """What was seen from the old pose no longer holds."""
        self._seen: tuple[Array, Array] | None = None
        self._judged: tuple[Array, list[float], list[list[float]]] | None = None

    def _look(self) -> tuple[Array, Array]:
        """The expected fix with heading (3,), and its derivative (3, 3); once per pose."""
        if self._seen is None:
            (x, y, theta), (tx, ty) = self._kf.x.tolist(), self._tag
            cos, sin = math.cos(theta), math.sin(theta)
            ax, ay = cos * tx - sin * ty, sin * tx + cos * ty
            H = np.array(((1.0, 0.0, -ay), (0.0, 1.0, ax), (0.0, 0.0, 1.0)))
            self._seen = np.array((x + ax, y + ay, theta)), H
        return self._seen

    def _judge(self, z: Array, R: Array) -> tuple[list[float], list[list[float]]]:
        """Innovation and its covariance, as plain numbers; once per fix."""
        if self._judged is None or self._judged[0] is not z:
            expected, H = self._look()
            H = H[: len(z)]
            S = H @ self._kf.P @ H.T + R
            self._judged = z, _residual(z, expected[: len(z)]).tolist(), S.tolist()
        return self._judged[1:]


def _residual(z: Array, expected: Array) -> Array:
    y = z - expected
    if len(y) == 3:
        y[2] = math.remainder(y[2], math.tau)
    return np.asarray(y, np.float64)
