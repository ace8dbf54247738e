"""Equation (1) over all steps at once: the path from the origin, and between any two stamps its covariance.

The filter asks for the motion from fix to fix; poses between fixes hang on the last one. The Jacobian of many steps is
that of eq. (4) with the whole motion in its last column, since their product telescopes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.estimation.odometry import arcs
from core.estimation.published.substitution import Steps
from core.geometry import between, rotation

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Reckoning:
    """t (N,); table (N, 12): pose from the origin, and running sums from which covariances follow."""

    t: Array
    table: Array

    @staticmethod
    def of(t: Array, steps: Steps) -> Reckoning:
        """The path that these steps make."""
        pose = arcs(np.cumsum(steps.distance), np.cumsum(steps.turn))
        middle, qt, qd = (pose[1:] + pose[:-1]) / 2, steps.var_turn[1:], steps.var_distance[1:]
        x, y, cos, sin = middle[:, 0], middle[:, 1], np.cos(middle[:, 2]), np.sin(middle[:, 2])
        grown = (qt, qt * x, qt * y, qt * x * x, qt * y * y, qt * x * y, qd * cos * cos, qd * sin * sin, qd * sin * cos)
        sums = np.zeros((len(t), len(grown)))
        sums[1:] = np.cumsum(np.column_stack(grown), axis=0)
        return Reckoning(t, np.column_stack((pose, sums)))

    def at(self, t: Array) -> Array:
        """Rows (M, 12) of the table at stamps t, linear between IMU stamps, held beyond the ends."""
        return np.column_stack([np.interp(t, self.t, column) for column in self.table.T])


def motion(a: Array, b: Array) -> tuple[Array, Array]:
    """From rows a (M, 12) to rows b: motion (M, 3) in a's body frame and its covariance (M, 3, 3) in a's axes."""
    x, y = b[:, 0], b[:, 1]
    w, wx, wy, wxx, wyy, wxy, cc, ss, sc = (b[:, 3:] - a[:, 3:]).T
    P = np.empty((len(a), 3, 3))
    P[:, 0, 0] = y * y * w - 2 * y * wy + wyy + cc
    P[:, 1, 1] = x * x * w - 2 * x * wx + wxx + ss
    P[:, 0, 1] = P[:, 1, 0] = -(x * y * w - y * wx - x * wy + wxy) + sc
    P[:, 0, 2] = P[:, 2, 0] = wy - y * w
    P[:, 1, 2] = P[:, 2, 1] = x * w - wx
    P[:, 2, 2] = w
    R = rotation(-a[:, 2])
    return between(a[:, :3], b[:, :3]), R @ P @ np.swapaxes(R, -1, -2)
