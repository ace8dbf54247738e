"""`Trajectory`: a path of the body through the map, with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.errors import ParameterError

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Trajectory:
    """Body poses over time.

    t (N,) [s] strictly increasing; x, y (N,) [m]; theta (N,) [rad], unwrapped (NaN where the method gives none);
    covariance (N, 3, 3) of (x, y, theta) in the map frame, or None where the method states none.
    """

    t: Array
    x: Array
    y: Array
    theta: Array
    covariance: Array | None = None

    def __post_init__(self) -> None:
        n = self.t.shape[0]
        if any(a.shape != (n,) for a in (self.t, self.x, self.y, self.theta)):
            raise ParameterError("t, x, y and theta of a trajectory must have one shape (N,)")
        if self.covariance is not None and self.covariance.shape != (n, 3, 3):
            raise ParameterError(f"covariance has shape {self.covariance.shape}, expected {(n, 3, 3)}")

    def __len__(self) -> int:
        return int(self.t.shape[0])

    @property
    def pose(self) -> Array:
        """(N, 3) rows of x, y, theta."""
        return np.column_stack((self.x, self.y, self.theta))

    @property
    def sd(self) -> Array | None:
        """(N, 3) standard deviations of x, y, theta, or None."""
        if self.covariance is None:
            return None
        return np.sqrt(np.maximum(np.einsum("nii->ni", self.covariance), 0.0))

    def at(self, t: Array) -> Array:
        """(M, 3) poses at stamps t, linear in x, y and the unwrapped heading; NaN outside the path's span."""
        inside = (t >= self.t[0]) & (t <= self.t[-1]) if len(self) else np.zeros(t.shape, bool)
        if not len(self):
            return np.full((t.shape[0], 3), np.nan)
        columns = (np.interp(t, self.t, column) for column in (self.x, self.y, self.theta))
        return np.where(inside[:, None], np.column_stack(tuple(columns)), np.nan)

    def arc_length(self) -> Array:
        """(N,) distance travelled since the first pose [m]."""
        return np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(self.x), np.diff(self.y)))))[: len(self)]
