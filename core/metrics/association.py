"""Which pose of the path belongs to which reading of the truth: the path is interpolated at the truth's stamps.

Nothing is dropped in silence: stamps before or after the path, and stamps inside one of its pauses, are counted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.sensors import TruthLog
from core.trajectory import Trajectory

Array = npt.NDArray[np.float64]

PAUSE_FACTOR = 10.0  # a pause is a step of the path this many times its typical one ...
PAUSE_FLOOR = 1.0  # ... and at least this long [s]


@dataclass(frozen=True)
class Match:
    """Matched stamps t (N,) [s], path and truth poses (N, 3) there (NaN where a source has no value), and counts."""

    t: Array
    path: Array
    truth: Array
    index: npt.NDArray[np.intp]  # (N,) rows of the truth log
    outside: int  # truth stamps before or after the path
    in_pauses: int  # truth stamps inside a pause of the path, where an interpolated pose would be invented

    @property
    def unmatched(self) -> int:
        """Truth stamps without a pose of the path."""
        return self.outside + self.in_pauses


def truth_poses(truth: TruthLog) -> Array:
    """(M, 3) reference poses, NaN in what the reference lacks."""
    missing = np.full(len(truth), np.nan)
    columns = (truth.x, truth.y, truth.theta)
    return np.column_stack([missing if c is None else np.asarray(c, np.float64) for c in columns])


def match(trajectory: Trajectory, truth: TruthLog) -> Match:
    """Match every truth stamp to the path, linear between poses, within the path's span and outside its pauses."""
    t, n = truth.t, len(trajectory)
    if n == 0:
        empty = np.zeros((0, 3))
        return Match(np.zeros(0), empty, empty, np.zeros(0, np.intp), len(truth), 0)
    inside = (t >= trajectory.t[0]) & (t <= trajectory.t[-1])
    in_pause = np.zeros(t.shape, bool)
    if n > 1:
        steps = np.diff(trajectory.t)
        pause = steps > max(PAUSE_FLOOR, PAUSE_FACTOR * float(np.median(steps)))
        after = np.clip(np.searchsorted(trajectory.t, t, "left"), 1, n - 1)
        strictly = (t > trajectory.t[after - 1]) & (t < trajectory.t[after])
        in_pause = inside & strictly & pause[after - 1]
    index = np.flatnonzero(inside & ~in_pause)
    return Match(
        t=t[index],
        path=trajectory.at(t[index]),
        truth=truth_poses(truth)[index],
        index=index,
        outside=int(np.sum(~inside)),
        in_pauses=int(np.sum(in_pause)),
    )
