"""KITTI trajectory, written only: a line per pose, the rows of its 3x4 matrix (rotation | position), no stamps.

https://www.cvlibs.net/datasets/kitti/eval_odometry.php; our axes (x forward, z up), as the run format has them.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl

from core.errors import NotEnoughDataError
from core.trajectory import Trajectory


def write_kitti(trajectory: Trajectory, path: Path) -> None:
    """Write a trajectory; poses without a position are left out. NotEnoughDataError where the heading is unknown."""
    known = ~(np.isnan(trajectory.x) | np.isnan(trajectory.y))
    if np.isnan(trajectory.theta[known]).any():
        raise NotEnoughDataError("a KITTI line holds an orientation, but this path has no heading; write TUM instead")
    theta = trajectory.theta[known]
    zero, one = np.zeros(theta.size), np.ones(theta.size)
    cos, sin = np.cos(theta), np.sin(theta)
    rows = (cos, -sin, zero, trajectory.x[known], sin, cos, zero, trajectory.y[known], zero, zero, one, zero)
    pl.DataFrame({str(i): row for i, row in enumerate(rows)}).write_csv(path, include_header=False, separator=" ")
