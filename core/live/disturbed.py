"""What befalls the robot, found as it drives: `core.estimation.events.Detector`, fed once all its streams are there."""

from __future__ import annotations

import numpy as np

from core.estimation.assumptions import Assumptions
from core.estimation.events import Detector, Disturbances
from core.estimation.events.detector import gather
from core.run import Run, RunMeta

SILENT = 1.0  # s after which a stream is not waited for


class Disturbed:
    """The detector, and up to which stamp it has been fed."""

    def __init__(self, meta: RunMeta, numbers: Assumptions) -> None:
        self._meta, self._numbers = meta, numbers
        self._detector: Detector | None = None
        self._fed = -np.inf

    def step(self, recent: Run) -> Disturbances:
        """Disturbances that have come to their end, given the last seconds of the run."""
        until = complete_until(recent)
        if not until > self._fed or (self._detector is None and until - recent.span[0] < SILENT):
            return Disturbances()
        after = float(np.nextafter(self._fed, np.inf))
        used = Run(self._meta, commands=recent.commands, wheels=recent.wheels, imu=recent.imu)
        piece = used.crop(after, until)
        if self._detector is None:
            self._detector = Detector(self._meta, self._numbers, piece)
        self._fed = until
        return gather(self._detector.feed(piece))


def complete_until(recent: Run) -> float:
    """The stamp up to which wheels and IMU are both there; a stream that is silent is not waited for."""
    ends = [float(log.t[-1]) for log in (recent.wheels, recent.imu) if log is not None and len(log)]
    if not ends:
        return -np.inf
    return max(min(ends), max(ends) - SILENT)
