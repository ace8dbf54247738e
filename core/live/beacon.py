"""`beacon`, stepped: fixes as they come; ranges by rounds, each once its second is over."""

from __future__ import annotations

import numpy as np

from core.errors import NotEnoughDataError
from core.estimation.assumptions import Assumptions
from core.estimation.beacon import MAX_ROUND, ROUND, beacon
from core.estimation.needs import for_beacon
from core.run import Run
from core.trajectory import Trajectory


class Beacon:
    """Poses by the beacon system alone, from the last seconds of a run."""

    def __init__(self, numbers: Assumptions) -> None:
        self._config = {f: getattr(numbers, f) for f in ("fix_xy", "fix_theta", "range")}
        self._last, self._theta = -np.inf, 0.0

    def step(self, recent: Run, piece: Run) -> Trajectory | None:
        """New poses, None where there are none; `recent` goes back MAX_ROUND s at least, `piece` is what is new."""
        fixes = piece.beacon
        if fixes is not None and len(fixes):
            return self._solved(Run(recent.meta, beacon=fixes))
        ranges = recent.ranges
        if recent.beacon is not None or ranges is None or not len(ranges):
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
            found = beacon(run, self._config).trajectory
        except NotEnoughDataError:
            return None
        new = found.t > self._last
        if not new.any():
            return None
        theta = self._unwrapped(found.theta[new])
        covariance = found.covariance[new] if found.covariance is not None else None
        self._last = float(found.t[-1])
        return Trajectory(found.t[new], found.x[new], found.y[new], theta, covariance)

    def _unwrapped(self, theta: np.ndarray) -> np.ndarray:
        """Headings that go on from the one before."""
        known = np.isfinite(theta)
        if not known.any():
            return theta
        turns = np.unwrap(np.concatenate(([self._theta], theta[known])))
        self._theta = float(turns[-1])
        theta = theta.copy()
        theta[known] = turns[1:]
        return theta
