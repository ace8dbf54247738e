"""What is kept for a method that begins later, or looks back."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from core.estimation.odometry import WheelPath
from core.estimation.rest import Rest
from core.run import Run
from core.trajectory import Trajectory

if TYPE_CHECKING:
    from core.live.intake import Taken
    from core.live.odometry import EncodersGyro
    from core.live.published import Published

Array = npt.NDArray[np.float64]

LONGEST = 60.0  # s
MOST = 12_000  # pieces


class Rolled:
    """The wheels' path over the last `keep` seconds."""

    def __init__(self, keep: float) -> None:
        self._keep = keep
        self._parts: list[WheelPath] = []

    def append(self, new: WheelPath) -> None:
        """Rows after those that are here."""
        self._parts.append(new)
        if len(self._parts) > 64:
            _ = self.path

    @property
    def path(self) -> WheelPath:
        """All of it."""
        if len(self._parts) != 1:
            t, d, turn = (
                np.concatenate([np.zeros(0), *(getattr(part, k) for part in self._parts)]) for k in ("t", "d", "turn")
            )
            first = int(np.searchsorted(t, self._parts[-1].t[0] - self._keep)) if self._parts else 0
            self._parts = [WheelPath(t[first:], d[first:], turn[first:])]
        return self._parts[0]


class Early:
    """What came before the methods that lean on the gyro have begun, and the path by the wheels meanwhile."""

    def __init__(self) -> None:
        self._paths: list[Trajectory] = []
        self._taken: list[Taken] = []
        self._begun = False

    def by_wheels(self, path: Trajectory) -> None:
        """Poses by the wheels alone."""
        if self._begun:
            return
        self._paths.append(path)
        while self._paths[0].t[-1] < path.t[-1] - LONGEST:
            self._paths.pop(0)

    def keep(self, taken: Taken) -> None:
        """A piece made ready."""
        self._taken.append(taken)
        with_imu = [len(part.imu) > 0 for part in (self._taken[0], taken)]
        if len(self._taken) > MOST or (all(with_imu) and self._taken[0].imu[-1, 0] < taken.imu[-1, 0] - LONGEST):
            self._taken.pop(0)

    def rested(self, rest: Rest, run: Run) -> None:
        """Which readings were at rest, as is known once the noise is."""
        assert run.imu is not None
        for taken in self._taken:
            t = taken.imu[:, 0]
            at = np.minimum(np.searchsorted(run.imu.t, t), len(run.imu) - 1)
            taken.inertial[:, 2] = rest.flags[at] & (run.imu.t[at] == t)

    def hand_over(self, gyro: EncodersGyro, published: Published | None) -> None:
        """All of it to the methods that begin."""
        first = next(float(taken.imu[0, 0]) for taken in self._taken if len(taken.imu))
        pose = gyro.begin(first, joined_paths(self._paths))
        if published is not None:
            published.begin(pose)
        for taken in self._taken:
            gyro.take(taken)
            if published is not None:
                published.take(taken)
        self._paths, self._taken, self._begun = [], [], True


def joined_paths(parts: list[Trajectory]) -> Trajectory:
    """Paths that follow each other as one."""
    if len(parts) == 1:
        return parts[0]
    t, x, y, theta = (np.concatenate([getattr(p, k) for p in parts]) for k in ("t", "x", "y", "theta"))
    given = [p.covariance for p in parts if p.covariance is not None]
    return Trajectory(t, x, y, theta, np.concatenate(given) if len(given) == len(parts) else None)
