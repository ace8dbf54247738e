"""What a scene shows, as plain typed data: no viser, no store. Metres, seconds and radians in the map frame."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from core.robot import BeaconMap, RobotParams
from core.run import Run
from core.trajectory import Trajectory

Floats = npt.NDArray[np.floating]

DEFAULT_WHEEL_RADIUS = 0.075  # m, where the run doesn't say
DEFAULT_TRACK_WIDTH = 0.32  # m
MAX_FIXES = 20_000
FIXES = "fixes"  # raw beacon fixes are switched like a method


@dataclass(frozen=True)
class Spread:
    """Position uncertainty along a path, each (N,): sd_x, sd_y [m], cov_xy [m^2] in the map."""

    sd_x: Floats
    sd_y: Floats
    cov_xy: Floats | None = None

    def covariance(self, i: npt.NDArray[np.intp] | int) -> Floats:
        """(M, 2, 2) covariances of x, y at rows i."""
        rows = np.atleast_1d(np.asarray(i))
        xx, yy = np.square(self.sd_x[rows], dtype=np.float64), np.square(self.sd_y[rows], dtype=np.float64)
        xy = np.zeros_like(xx) if self.cov_xy is None else np.asarray(self.cov_xy[rows], dtype=np.float64)
        return np.stack((xx, xy, xy, yy), axis=-1).reshape(-1, 2, 2)


@dataclass(frozen=True)
class ScenePath:
    """The path by one method (or "truth"): t, x, y, theta (N,), full length, possibly memory-mapped.

    `theta` may be NaN where the method gives no heading; `spread` is None where it states no uncertainty.
    """

    method: str
    label: str
    t: Floats
    x: Floats
    y: Floats
    theta: Floats
    spread: Spread | None = None

    def row(self, t: float) -> tuple[int, float]:
        """The row at or before t and the fraction of the way to the next; held at both ends."""
        i = int(np.searchsorted(self.t, t, side="right")) - 1
        if i < 0:
            return 0, 0.0
        if i >= len(self.t) - 1:
            return len(self.t) - 1, 0.0
        step = float(self.t[i + 1] - self.t[i])
        return i, (t - float(self.t[i])) / step if step > 0 else 0.0

    def pose_at(self, t: float) -> tuple[float, float, float]:
        """x, y, theta at t: linear between rows, the short way round, held past the ends. Two look-ups."""
        i, fraction = self.row(t)
        x, y, theta = float(self.x[i]), float(self.y[i]), float(self.theta[i])
        if not fraction:
            return x, y, theta
        dx, dy, turn = float(self.x[i + 1]) - x, float(self.y[i + 1]) - y, float(self.theta[i + 1]) - theta
        turn = (turn + math.pi) % (2 * math.pi) - math.pi
        return x + fraction * dx, y + fraction * dy, theta + fraction * turn


@dataclass(frozen=True)
class SceneEvent:
    """Something that happened, as it stands in the scene: kind, onset [s], where the path was then [m]."""

    kind: str
    t0: float
    x: float
    y: float


@dataclass(frozen=True)
class SceneData:
    """One run as the 3D view needs it. `revision` changes whenever what is shown would change."""

    run_id: str
    name: str
    t0: float
    t1: float
    paths: tuple[ScenePath, ...] = ()
    beacons: BeaconMap = field(default_factory=dict)
    fixes: Floats = field(default_factory=lambda: np.zeros((0, 2)))  # (M, 2) raw beacon fixes x, y
    robot: RobotParams = field(default_factory=RobotParams)
    revision: str = ""
    events: tuple[SceneEvent, ...] = ()
    live: bool = False  # it still grows: whoever looks sees its newest moment

    def grown(self, t1: float, paths: tuple[ScenePath, ...]) -> SceneData:
        """The run a moment later."""
        return dataclasses.replace(self, t1=max(t1, self.t1), paths=paths)

    @property
    def methods(self) -> tuple[str, ...]:
        """What can be switched on and off, in drawing order."""
        return tuple(p.method for p in self.paths) + ((FIXES,) if len(self.fixes) else ())


def from_core(
    run: Run, trajectories: Mapping[str, Trajectory], labels: Mapping[str, str] | None = None, run_id: str = "run"
) -> SceneData:
    """A scene straight from a run and the paths that methods gave."""
    names = labels or {}
    paths = [truth] if (truth := truth_path(run)) else []
    for method, trajectory in trajectories.items():
        sd, covariance = trajectory.sd, trajectory.covariance
        spread = None if sd is None or covariance is None else Spread(sd[:, 0], sd[:, 1], covariance[:, 0, 1])
        columns = (trajectory.t, trajectory.x, trajectory.y, trajectory.theta)
        paths.append(ScenePath(method, names.get(method, method), *columns, spread))
    t0, t1 = run.span
    name, beacons = run.meta.name or run_id, dict(run.meta.beacons)
    return SceneData(run_id, name, t0, t1, tuple(paths), beacons, fixes_of(run), run.meta.robot)


def events_on(path: ScenePath, events: Iterable[Mapping[str, Any]]) -> tuple[SceneEvent, ...]:
    """Events ({kind, t0}) where the path was when they began; those at an unknown place are left out."""
    placed = [(str(e["kind"]), float(e["t0"]), *path.pose_at(float(e["t0"]))[:2]) for e in events]
    return tuple(SceneEvent(*row) for row in placed if math.isfinite(row[2]) and math.isfinite(row[3]))


def truth_path(run: Run) -> ScenePath | None:
    """The reference as a path, where it has positions."""
    truth = run.truth
    if truth is None or truth.x is None or truth.y is None or not len(truth):
        return None
    theta = truth.theta if truth.theta is not None else np.broadcast_to(np.nan, len(truth))
    return ScenePath("truth", "Truth", truth.t, truth.x, truth.y, theta)


def fixes_of(run: Run) -> Floats:
    """(M, 2) beacon fixes of a run, every so manieth where there are very many."""
    if run.beacon is None:
        return np.zeros((0, 2))
    step = max(1, len(run.beacon) // MAX_FIXES)
    return np.column_stack((run.beacon.x[::step], run.beacon.y[::step]))
