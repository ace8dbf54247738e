"""Putting a path over the truth before they are compared: not at all (the default), or by a stated rigid motion.

An alignment hides errors: one that turns the whole path hides a wrong start heading. So it is never done unasked, and
each result names it. Source: Umeyama, IEEE PAMI 13(4), 1991, in the plane and without scale.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.errors import NotEnoughDataError, ParameterError
from core.geometry import compose

Array = npt.NDArray[np.float64]

ALIGNMENTS = ("none", "se2", "start")


@dataclass(frozen=True)
class Alignment:
    """What was done: its name, and the motion (x [m], y [m], theta [rad]) that was put before the path."""

    name: str = "none"
    motion: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def apply(self, pose: Array) -> Array:
        """(N, 3) aligned poses."""
        return pose if self.name == "none" else compose(np.array(self.motion), pose)


def umeyama(path_xy: Array, truth_xy: Array) -> tuple[float, float, float]:
    """The rigid motion that brings path points (N, 2) nearest to truth points (N, 2), in least squares."""
    if path_xy.shape[0] < 2:
        raise NotEnoughDataError("an SE(2) alignment needs two matched positions at least", expected=2)
    mean_p, mean_t = path_xy.mean(axis=0), truth_xy.mean(axis=0)
    p, t = path_xy - mean_p, truth_xy - mean_t
    theta = float(np.arctan2(np.sum(p[:, 0] * t[:, 1] - p[:, 1] * t[:, 0]), np.sum(p * t)))
    cos, sin = np.cos(theta), np.sin(theta)
    shift = mean_t - np.array((cos * mean_p[0] - sin * mean_p[1], sin * mean_p[0] + cos * mean_p[1]))
    return float(shift[0]), float(shift[1]), theta


def align(name: str, pose: Array, truth: Array) -> Alignment:
    """The alignment of that name for matched poses (N, 3); `se2` fits positions, `start` makes the first pose equal."""
    if name not in ALIGNMENTS:
        raise ParameterError(f"unknown alignment {name!r}", parameter="alignment", expected=ALIGNMENTS, found=name)
    if name == "none":
        return Alignment()
    both = np.isfinite(pose[:, :2]).all(axis=1) & np.isfinite(truth[:, :2]).all(axis=1)
    if name == "se2":
        return Alignment(name, umeyama(pose[both, :2], truth[both, :2]))
    whole = np.flatnonzero(both & np.isfinite(pose[:, 2]) & np.isfinite(truth[:, 2]))
    if not whole.size:
        raise NotEnoughDataError("aligning the start needs one matched pose with heading", expected=1)
    p, t = pose[whole[0]], truth[whole[0]]
    turn = float(t[2] - p[2])
    cos, sin = np.cos(turn), np.sin(turn)
    return Alignment(name, (float(t[0] - cos * p[0] + sin * p[1]), float(t[1] - sin * p[0] - cos * p[1]), turn))
