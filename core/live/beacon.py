"""`beacon`, stepped: fixes as they come; ranges by rounds, each once its second is over."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from core.errors import NotEnoughDataError
from core.estimation.assumptions import Assumptions
from core.estimation.beacon import MAX_ROUND, ROUND, beacon
from core.estimation.needs import for_beacon
from core.live._poses_numba import fix
from core.run import Run, RunMeta
from core.trajectory import Trajectory

Array = npt.NDArray[np.float64]


class Beacon:
    """Poses by the beacon system alone, from the last seconds of a run."""

    def __init__(self, meta: RunMeta, numbers: Assumptions) -> None:
        self._meta, self._numbers = meta, numbers
        self._heading = np.zeros(1)
        self._last = -np.inf

    def by_fixes(self, fixes: Array) -> Trajectory:
        """Poses by new fixes (N, 6): t, x, y, theta or NaN first."""
        n, tag, numbers = len(fixes), self._meta.robot.tag, self._numbers
        pose, covariance = np.empty((n, 3)), np.empty((n, 3, 3))
        fix(fixes, float(tag.x), float(tag.y), numbers.fix_xy, numbers.fix_theta, self._heading, pose, covariance)
        return Trajectory(fixes[:, 0], pose[:, 0], pose[:, 1], pose[:, 2], covariance)

    def by_ranges(self, recent: Run) -> Trajectory | None:
        """Poses by rounds of ranges that are complete by now; `recent` goes back MAX_ROUND s at least."""
        ranges = recent.ranges
        if ranges is None or not len(ranges):
            return None
        over = np.floor(float(ranges.t[-1]) / ROUND) * ROUND  # rounds that end before it are complete
        before = float(ranges.t[np.searchsorted(ranges.t, over) - 1]) if ranges.t[0] < over else -np.inf
        if before <= self._last:
            return None
        known = Run(recent.meta, ranges=ranges.crop(self._last - MAX_ROUND, before))
        found = self._solved(known) if for_beacon(known) is None else None
        self._last = before
        return found

    def _solved(self, run: Run) -> Trajectory | None:
        try:
            found = beacon(run, {"range": self._numbers.range}).trajectory
        except NotEnoughDataError:
            return None
        new = found.t > self._last
        if not new.any():
            return None
        covariance = found.covariance[new] if found.covariance is not None else None
        self._last = float(found.t[-1])
        return Trajectory(found.t[new], found.x[new], found.y[new], found.theta[new], covariance)
