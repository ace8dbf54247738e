"""Where the filter's fixes come from: the beacon's own, or positions by trilateration from rounds of ranges.

Readings of one round are of different moments: with the dead-reckoned motion in between, each beacon is moved along, so
that all readings are as of the round's end.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from core.errors import NotEnoughDataError
from core.estimation.assumptions import Assumptions, Config
from core.estimation.beacon import MAX_DILUTION, Rounds, gather_rounds, multilaterate
from core.estimation.published.reckoning import Reckoning
from core.geometry import compose
from core.run import Run

Array = npt.NDArray[np.float64]

DISAGREE = 5.0  # rms residual of a round over the sd of a range; more gives no fix


class Fixes(Protocol):
    """t (M,) stamps; `fix(k, turn)` the k-th fix (3,) or (2,) and its covariance, None where it gives none.

    turn [rad]: by how much the map is turned against the dead-reckoned path at that time.
    """

    @property
    def t(self) -> Array: ...

    def fix(self, k: int, turn: float) -> tuple[Array, Array] | None: ...


@dataclass(frozen=True)
class BeaconFixes:
    """The beacon system's own fixes."""

    t: Array
    z: Array
    sd: tuple[float, float]

    def fix(self, k: int, turn: float) -> tuple[Array, Array]:
        """Positions without a heading are (2,)."""
        z = self.z[k]
        if not math.isnan(z[2]):
            return z, self._noise
        return z[:2], self._noise[:2, :2]

    @functools.cached_property
    def _noise(self) -> Array:
        return np.diag(np.square((self.sd[0], self.sd[0], self.sd[1])))


@dataclass(frozen=True)
class RangeFixes:
    """Positions from rounds of ranges; arms (M, K, 2): how far the tag went since each reading, as reckoned."""

    t: Array
    rounds: Rounds
    arms: Array
    tag_z: float
    sd: float

    def fix(self, k: int, turn: float) -> tuple[Array, Array] | None:
        """None where the geometry is poor or the readings contradict each other."""
        one = slice(k, k + 1)
        cos, sin = np.cos(turn), np.sin(turn)
        anchors = self.rounds.anchors[one].copy()
        anchors[..., :2] += self.arms[one] @ np.array(((cos, sin), (-sin, cos)))
        used = self.rounds.used[one]
        moved = Rounds(self.t[one], anchors, self.rounds.ranges[one], used, self.rounds.age[one])
        xy, P, residual = multilaterate(moved, self.tag_z, self.sd)
        spread = float(residual[0]) / self.sd
        if not np.isfinite(xy).all() or np.sqrt(np.trace(P[0])) > MAX_DILUTION * self.sd or spread > DISAGREE:
            return None
        return xy[0], P[0] * max(1.0, spread**2 * used.sum() / max(used.sum() - 2, 1))


def find_fixes(run: Run, numbers: Assumptions, path: Reckoning, config: Config) -> tuple[Fixes, tuple[str, ...]]:
    """The run's fixes, else its ranges; stamps before the path's first are left out. Notes for the user."""
    begin = path.t[0]
    if run.beacon is not None and len(run.beacon):
        log = run.beacon
        theta = np.full(len(log), np.nan) if log.theta is None else np.asarray(log.theta, np.float64)
        z = np.column_stack((np.asarray(log.x, np.float64), np.asarray(log.y, np.float64), theta))
        kept = np.isfinite(z[:, :2]).all(axis=1) & (log.t >= begin)
        if not kept.any():
            raise NotEnoughDataError("no beacon fix within the IMU's time has both x and y", stream="beacon")
        t, z = log.t[kept], z[kept]
        sd = numbers.fix_xy
        notes: tuple[str, ...] = ()
        if run.meta.noise.beacon_xy is None and "fix_xy" not in config:
            sd, notes = _learnt(t, z, path, sd)
        return BeaconFixes(t, z, (sd, numbers.fix_theta)), notes
    assert run.ranges is not None
    rounds, unknown = gather_rounds(run.ranges, dict(run.meta.beacons))
    kept = rounds.t >= begin
    if not kept.any():
        raise NotEnoughDataError(
            "no round of ranges within the IMU's time holds three surveyed beacons", stream="ranges"
        )
    rounds = Rounds(*(column[kept] for column in (rounds.t, rounds.anchors, rounds.ranges, rounds.used, rounds.age)))
    tag = run.meta.robot.tag

    def place(t: Array) -> Array:
        rows = path.at(t)[:, :3]
        return compose(rows, np.broadcast_to(np.array((tag.x, tag.y, 0.0)), rows.shape))[:, :2]

    then = place((rounds.t[:, None] - rounds.age).ravel()).reshape(*rounds.age.shape, 2)
    arms = place(rounds.t)[:, None, :] - then
    note = "Ranges were turned into fixes, one a round, without heading."
    return RangeFixes(rounds.t, rounds, arms, tag.z, numbers.range), (*unknown, note)


def _learnt(t: Array, z: Array, path: Reckoning, sd: float) -> tuple[float, tuple[str, ...]]:
    """Noise of fixes from their increments against those of the path: the median is blind to jumps."""
    if len(t) < 20:
        return sd, ()
    gone = np.hypot(*np.diff(path.at(t)[:, :2], axis=0).T)
    jump = np.hypot(*np.diff(z[:, :2], axis=0).T)
    found = max(0.2 * sd, float(np.median(np.abs(jump - gone))) / 1.4)
    return found, (f"Fix noise {found:.2g} m, by the fixes' increments against the path's.",)
