"""The beacon system alone: its fixes as they are, or positions computed from rounds of ranges.

Fixes are of the tag; the body's origin follows where the fix has a heading or the tag sits on the origin. A heading is
given only where the fixes have one: the course between two noisy fixes is no heading at a robot's speed.
Ranges: the position of least squares over each round (Foy, IEEE Trans. AES 12(2), 1976), by Gauss-Newton on all rounds
at once, in 3D with the tag at its known height. A round is a second of readings, or longer until three beacons are in.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.errors import NotEnoughDataError
from core.estimation.assumptions import Assumptions, Config, assume
from core.estimation.result import Estimate
from core.run import Run
from core.sensors import RangeLog
from core.trajectory import Trajectory

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Flags = npt.NDArray[np.bool_]

ROUND = 1.0  # s: readings of one round
MAX_ROUND = 3.0  # s: longer, and the robot has moved on
MAX_IN_ROUND = 16  # readings of a round that are used, the newest
STEPS = 12  # Gauss-Newton steps
MAX_DILUTION = 5.0  # sd of the position over sd of a range; worse geometry gives no fix


def beacon(run: Run, config: Config | None = None) -> Estimate:
    """One pose per fix, or per round of ranges where the run has no fixes."""
    numbers, notes = assume(run, config)
    if run.beacon is not None and len(run.beacon):
        trajectory, more = _by_fixes(run, numbers)
    else:
        trajectory, more = _by_ranges(run, numbers)
    if np.isnan(trajectory.theta).all():
        more = (*more, "The beacon system gives no heading.")
    return Estimate("beacon", trajectory, notes=(*notes, *more))


def _by_fixes(run: Run, numbers: Assumptions) -> tuple[Trajectory, tuple[str, ...]]:
    fixes, tag = run.beacon, run.meta.robot.tag
    assert fixes is not None
    x, y = np.asarray(fixes.x, np.float64), np.asarray(fixes.y, np.float64)
    kept = np.isfinite(x) & np.isfinite(y)
    if not kept.any():
        raise NotEnoughDataError("no beacon fix has both x and y", stream="beacon")
    t, x, y = fixes.t[kept], x[kept], y[kept]
    theta = np.full(len(t), np.nan) if fixes.theta is None else np.asarray(fixes.theta, np.float64)[kept]
    known = np.isfinite(theta)
    theta[known] = np.unwrap(theta[known])
    cos, sin = np.cos(np.where(known, theta, 0.0)), np.sin(np.where(known, theta, 0.0))
    arm_x, arm_y = cos * tag.x - sin * tag.y, sin * tag.x + cos * tag.y
    P = np.zeros((len(t), 3, 3))
    P[:, 0, 0] = P[:, 1, 1] = numbers.fix_xy**2
    P[:, 2, 2] = np.where(known, numbers.fix_theta**2, np.nan)
    swing = np.where(known, numbers.fix_theta, 0.0) ** 2
    P[:, 0, 0] += arm_y**2 * swing
    P[:, 1, 1] += arm_x**2 * swing
    P[:, 0, 1] = P[:, 1, 0] = -arm_x * arm_y * swing
    P[:, 0, 2] = P[:, 2, 0] = arm_y * swing
    P[:, 1, 2] = P[:, 2, 1] = -arm_x * swing
    off = float(np.hypot(tag.x, tag.y))
    note: tuple[str, ...] = ()
    if off and not known.all():
        note = (f"Fixes without heading are of the tag, {off:.2g} m from the body's origin.",)
        P[~known, 0, 0] += off**2 / 2
        P[~known, 1, 1] += off**2 / 2
    return Trajectory(t, x - np.where(known, arm_x, 0.0), y - np.where(known, arm_y, 0.0), theta, P), note


@dataclass(frozen=True)
class Rounds:
    """Rounds of ranges: t (M,) of the newest reading; anchors (M, K, 3), ranges, used, age [s] before t (M, K)."""

    t: Array
    anchors: Array
    ranges: Array
    used: Flags
    age: Array


def _by_ranges(run: Run, numbers: Assumptions) -> tuple[Trajectory, tuple[str, ...]]:
    assert run.ranges is not None
    tag_z = run.meta.robot.tag.z
    rounds, notes = gather_rounds(run.ranges, dict(run.meta.beacons))
    xy, P, residual = multilaterate(rounds, tag_z, numbers.range)
    dilution = np.sqrt(np.trace(P, axis1=1, axis2=2)) / numbers.range
    good = np.isfinite(xy).all(axis=1) & (dilution <= MAX_DILUTION) & (residual <= 5 * numbers.range)
    if not good.any():
        raise NotEnoughDataError(
            "no round of ranges gives a position: too few beacons, poor geometry, or readings that disagree",
            stream="ranges",
        )
    n = int(good.sum())
    covariance = np.full((n, 3, 3), np.nan)
    covariance[:, :2, :2] = P[good]
    lost = len(rounds.t) - n
    if lost:
        notes = (*notes, f"{lost} of {len(rounds.t)} rounds of ranges gave no position (geometry or disagreement).")
    return Trajectory(rounds.t[good], xy[good, 0], xy[good, 1], np.full(n, np.nan), covariance), notes


def gather_rounds(log: RangeLog, beacons: dict[str, tuple[float, float, float]]) -> tuple[Rounds, tuple[str, ...]]:
    """Rounds of at least three beacons; a round ends at each reading that is the last of its ROUND of time."""
    known = np.array([name in beacons for name in log.names], bool)
    where = np.array([beacons.get(name, (np.nan, np.nan, np.nan)) for name in log.names])
    kept = known[log.beacon] & np.isfinite(log.range) & (log.range > 0)
    t, index, ranges = log.t[kept], log.beacon[kept].astype(np.intp), np.asarray(log.range, np.float64)[kept]
    unknown = sorted(name for name in log.names if name not in beacons)
    notes = (unsurveyed_note(unknown),) if unknown else ()
    slot = np.floor(t / ROUND).astype(np.int64)
    last = np.flatnonzero(np.diff(slot, append=slot[-1:] + 1) > 0) if t.size else np.zeros(0, np.intp)
    member = last[:, None] - np.arange(MAX_IN_ROUND)[None, :]
    used = (member >= 0) & (t[last][:, None] - t[np.maximum(member, 0)] <= MAX_ROUND)
    member = np.maximum(member, 0)
    age = t[last][:, None] - t[member]
    used &= _newest_until_three(index[member], age, used)
    full = _first_of_its_beacon(index[member], used).sum(axis=1) >= 3
    return Rounds(t[last][full], where[index[member]][full], ranges[member][full], used[full], age[full]), notes


def unsurveyed_note(names: list[str]) -> str:
    """Said of beacons whose place nobody knows."""
    return f"Ranges to unsurveyed beacons were ignored: {', '.join(names)}."


def _newest_until_three(index: Indices, age: Array, used: Flags) -> Flags:
    """Readings of the last ROUND, and older ones until three beacons are there."""
    new = _first_of_its_beacon(index, used).astype(np.int64)
    return (age <= ROUND) | (np.cumsum(new, axis=1) - new < 3)


def _first_of_its_beacon(index: Indices, used: Flags) -> Flags:
    first = used.copy()
    for back in range(1, index.shape[1]):
        first[:, back] &= ~((index[:, :back] == index[:, back : back + 1]) & used[:, :back]).any(axis=1)
    return first


def multilaterate(rounds: Rounds, tag_z: float, range_sd: float) -> tuple[Array, Array, Array]:
    """Positions (M, 2) of the tag, their covariances (M, 2, 2), and rms residuals (M,) [m]; NaN where it fails."""
    w = rounds.used.astype(np.float64)
    anchors, height = rounds.anchors[..., :2], rounds.anchors[..., 2] - tag_z
    seed = np.sum(anchors * w[..., None], axis=1) / np.maximum(w.sum(axis=1), 1)[:, None]
    xy = _linear_start(rounds, w, height, seed)
    normal = np.tile(np.eye(2), (len(xy), 1, 1))
    for _ in range(STEPS):
        H, distance = _lines_of_sight(xy, anchors, height)
        normal = np.einsum("mk,mki,mkj->mij", w, H, H) + 1e-9 * np.eye(2)
        right = np.einsum("mk,mki,mk->mi", w, H, rounds.ranges - distance)
        step = np.linalg.solve(normal, right[..., None])[..., 0]
        xy = xy + step * np.minimum(1.0, 20.0 / np.maximum(np.linalg.norm(step, axis=1), 1e-9))[:, None]
    _, distance = _lines_of_sight(xy, anchors, height)
    residual = np.sqrt(np.sum(w * (rounds.ranges - distance) ** 2, axis=1) / np.maximum(w.sum(axis=1), 1))
    return xy, np.asarray(np.linalg.inv(normal) * range_sd**2, np.float64), np.asarray(residual, np.float64)


def _lines_of_sight(xy: Array, anchors: Array, height: Array) -> tuple[Array, Array]:
    arm = xy[:, None, :] - anchors
    distance = np.sqrt(np.sum(arm**2, axis=-1) + height**2)
    return arm / np.maximum(distance, 1e-6)[..., None], distance


def _linear_start(rounds: Rounds, w: Array, height: Array, centre: Array) -> Array:
    """Differences of squared ranges are linear in the position; solved by least squares about the centre."""
    arm = rounds.anchors[..., :2] - centre[:, None, :]
    square = np.sum(arm**2, axis=-1) + height**2 - rounds.ranges**2
    count = np.maximum(w.sum(axis=1), 1)[:, None]
    A = 2 * (arm - np.sum(arm * w[..., None], axis=1)[:, None, :] / count[..., None])
    b = square - np.sum(square * w, axis=1)[:, None] / count
    normal = np.einsum("mk,mki,mkj->mij", w, A, A) + 1e-6 * np.eye(2)
    return centre + np.linalg.solve(normal, np.einsum("mk,mki,mk->mi", w, A, b)[..., None])[..., 0]
