"""Fig. 7, second half: the Kalman filter with the beacon, and when the beacon is refused, lost, or believed at once.

A fix is abnormal where it fails its chi-square gate; while there is no normal one the path is dead reckoning. After a
shock has ended the position is replaced by the beacon's, as soon as a few fixes agree with each other; one fix alone
may be the one in a hundred that is wild.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt

from core.estimation.assumptions import Assumptions
from core.estimation.odometry import chi2_gate
from core.estimation.published.decisions import Decisions
from core.estimation.published.fixes import Fixes
from core.estimation.published.reckoning import Reckoning, motion
from core.estimation.result import Event, Innovations
from core.geometry import between, compose, wrap_angle

Array = npt.NDArray[np.float64]

CONSISTENT = 3.5  # sigma within which fixes agree
LOST = "beacon by encoders, gyro and accelerometers"


class Filter(Protocol):
    """What the tracker asks of a filter, as `kalman.PoseFilter` documents it."""

    @property
    def pose(self) -> Array: ...

    @property
    def covariance(self) -> Array: ...

    def replace(self, pose: Array, covariance: Array) -> None: ...

    def predict(self, step: Array, covariance: Array) -> None: ...

    def expected(self, rows: int = 3) -> Array: ...

    def distance(self, z: Array, R: Array) -> float: ...

    def scores(self, z: Array, R: Array) -> Array: ...

    def update(self, z: Array, R: Array) -> None: ...


@dataclass(frozen=True)
class Track:
    """After the start and after each fix (M + 1): t, pose (., 3), covariance (., 3, 3); events; innovations."""

    t: Array
    pose: Array
    covariance: Array
    events: tuple[Event, ...]
    innovations: dict[str, Innovations]


@dataclass
class Tracker:
    """One walk over the fixes. `ends`: when each shock ended [s], in order."""

    fixes: Fixes
    path: Reckoning
    ends: list[float]
    tag: Array
    numbers: Assumptions
    choice: Decisions
    events: list[Event] = field(default_factory=list)
    _longest: float = math.inf

    def walk(self, pose: Array, covariance: Array, skip: int = 0) -> Track:
        """From a start pose at the path's first stamp; the first `skip` fixes were spent on it."""
        from core.estimation.published.kalman import PoseFilter  # filterpy brings scipy.stats, which is slow to import

        t = self.fixes.t[skip:]
        self._longest = self.choice.loss + 2 * self._rhythm()
        kf = PoseFilter(pose, covariance, self.tag)
        self.begin(float(self.fixes.t[skip - 1] if skip else self.path.t[0]))
        poses, covariances, judged = self.go_on(kf, t, self.path.at(np.concatenate((self.path.t[:1], t))), skip)
        self._lost_until(float(self.path.t[-1]))
        stamps = np.concatenate((self.path.t[:1], t))
        poses, covariances = [pose, *poses], [covariance, *covariances]
        return Track(stamps, np.array(poses), np.array(covariances), tuple(self.events), _innovations(t, judged))

    def _rhythm(self) -> float:
        return float(np.median(np.diff(self.fixes.t))) if len(self.fixes.t) > 1 else math.inf

    def begin(self, t: float) -> None:
        """Nothing is known yet; it begins at t."""
        self._recent: deque[tuple[Array, Array, Array]] = deque(maxlen=self.choice.fixes_to_replace)
        self._normal, self._refused, self._since = t, 0, math.inf
        self._before: tuple[Array, Array] | None = None

    def go_on(self, kf: Filter, t: Array, rows: Array, skip: int = 0) -> tuple[list[Array], list[Array], Array]:
        """Over the fixes from number `skip` on, at stamps t (M,); rows (M + 1, 12) of the reckoned path, the first
        where the filter stands. Pose and covariance after each, and (M, 5) nis, its degrees of freedom, whether normal,
        both scores."""
        steps, noise = motion(rows[:-1], rows[1:])
        gates = {rows_: chi2_gate(rows_, self.numbers) for rows_ in (2, 3)}
        poses, covariances, judged = [], [], np.full((len(t), 5), np.nan)
        for k, now in enumerate(t.tolist()):
            kf.predict(steps[k], noise[k])
            seen = self.fixes.fix(skip + k, float(kf.pose[2] - rows[k + 1, 2]))
            if seen is not None:
                scores = kf.scores(*seen)
                judged[k] = *self._take(kf, now, rows[k + 1, :3], seen, gates), *scores
            poses.append(kf.pose)
            covariances.append(kf.covariance)
        return poses, covariances, judged

    def _take(
        self, kf: Filter, now: float, row: Array, seen: tuple[Array, Array], gates: dict[int, float]
    ) -> tuple[float, int, bool]:
        """One fix: replaces, corrects, or is refused."""
        z, R = seen
        while self.ends and self.ends[0] <= now:
            self._since = self.ends.pop(0)
            self._recent.clear()
        self._recent.append((z, R, row))
        nis = kf.distance(z, R)
        good = nis <= gates[len(z)]
        if self._since <= now and self._replace(kf, now, f"shock ended at {self._since:.2f} s"):
            self._since, good = math.inf, True
        elif good:
            self._correct(kf, z, R)
        elif now - self._normal > self.choice.patience and self._replace(kf, now, "refused for long, yet they agree"):
            good = True
        if good:
            self._lost_until(now)
            self._normal, self._refused = now, 0
        else:
            self._refused += 1
        return nis, len(z), good

    def _correct(self, kf: Filter, z: Array, R: Array) -> None:
        before = self._before
        if not self.choice.increments:
            kf.update(z, R)
        elif before is not None and len(before[0]) == len(z):
            kf.update(before[1] + z - before[0], 2 * R)
        self._before = (z, kf.expected(len(z)))

    def _replace(self, kf: Filter, now: float, why: str) -> bool:
        """The last few fixes, carried here by dead reckoning, if most of them agree."""
        if len(self._recent) < self.choice.fixes_to_replace:
            return False
        here = np.array([self._carried(z, row, kf.pose) for z, _, row in self._recent])
        sd = np.sqrt([R[0, 0] for _, R, _ in self._recent])
        middle = np.median(here, axis=0)
        near = np.hypot(*(here[:, :2] - middle[:2]).T) <= CONSISTENT * sd
        if near.sum() < self.choice.agreeing:
            return False
        pose, was = here[near].mean(axis=0), kf.pose
        R = np.mean([r for (_, r, _), n in zip(self._recent, near, strict=True) if n], axis=0) / near.sum()
        P = np.diag((0.0, 0.0, kf.covariance[2, 2]))
        P[: len(R), : len(R)] = R
        kf.replace(pose, P)
        self._before = None
        moved = math.hypot(pose[0] - was[0], pose[1] - was[1])
        self.events.append(
            Event(
                "replacement", self._since if self._since <= now else self._normal, now,
                f"{why}: {near.sum()} of {len(near)} fixes agree; moved by {moved:.2g} m, {pose[2] - was[2]:+.2g} rad",
                "position by beacon",
            )
        )  # fmt: skip
        return True

    def _carried(self, z: Array, row: Array, pose: Array) -> Array:
        """The pose now that a fix taken at `row` of the reckoned path tells; its own heading where it has none."""
        moved = between(row, self._recent[-1][2])
        theta = pose[2] + float(wrap_angle(z[2] + moved[2] - pose[2])) if len(z) == 3 else pose[2]
        then = np.array((z[0], z[1], theta - moved[2]))
        return compose(compose(then, np.array((-self.tag[0], -self.tag[1], 0.0))), moved)

    def _lost_until(self, now: float) -> None:
        if now - self._normal > self._longest:
            n = self._refused
            why = f"{n} fixes in between were abnormal" if n else "no fix came"
            self.events.append(Event("beacon_loss", self._normal, now, why, LOST))


def _innovations(t: Array, judged: Array) -> dict[str, Innovations]:
    found = {}
    for name, dof in (("beacon", 3), ("beacon.position", 2)):
        rows = judged[:, 1] == dof
        if rows.any():
            found[name] = Innovations(t[rows], judged[rows, 0], dof, judged[rows, 2] == 1, judged[rows, 3:])
    return found
