"""Where the filter begins. A filter that is started with a guessed heading is lost without knowing it, so:

1. the start pose of run.json, where it is given;
2. else the first fixes with a heading (the median of a few, since one may be wrong);
3. else a batch: the dead-reckoned path of the first stretch, as a rigid body, is fitted to its fixes or ranges, over a
   stretch that grows until the heading is known; ranges are tried from many poses, as their fit has wrong minima.
Readings spent on the start are not used again. If the stretch ends before the heading is known, its sd says so.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.estimation.assumptions import Assumptions
from core.estimation.fusion.events import Events
from core.estimation.fusion.layout import FIX, RANGE
from core.estimation.fusion.range_start import fit_ranges
from core.geometry import compose, inverse, wrap_angle
from core.run import Run
from core.trajectory import Trajectory

Array = npt.NDArray[np.float64]
Reckon = Callable[[], Trajectory]
"""The path from x = y = 0, heading 0 at the first event, by wheels and gyro alone."""

UNKNOWN_HEADING = float(np.pi / np.sqrt(3.0))  # rad: sd of a heading that may be anything
HEADING_KNOWN = 0.05  # rad: sd at which a fit to fixes ends
FIRST_FIXES = 5  # with heading
LONGEST = 30.0  # m: after it dead reckoning is no rigid body


@dataclass(frozen=True)
class Start:
    """pose (3,) and covariance (3, 3) at the first event; `used` (K,) event rows spent on it; notes."""

    pose: Array
    covariance: Array
    used: npt.NDArray[np.intp] = dataclasses.field(default_factory=lambda: np.zeros(0, np.intp))
    notes: tuple[str, ...] = ()

    def without_used(self, events: Events) -> Events:
        """The events without those spent on the start."""
        if not self.used.size:
            return events
        left = np.ones(len(events.t), bool)
        left[self.used] = False
        return events.kept(left)


def find_start(run: Run, events: Events, numbers: Assumptions, reckon: Reckon) -> Start:
    """The start pose by the first of the three ways that the run allows; the map's origin where it allows none."""
    if run.meta.start is not None:
        s = run.meta.start
        P = np.diag((numbers.start_xy**2, numbers.start_xy**2, numbers.start_theta**2))
        return Start(np.array((s.x, s.y, s.theta), np.float64), P)
    fixes = np.flatnonzero(events.kind == FIX)
    if fixes.size:
        headed = fixes[np.isfinite(events.data[fixes, 2])]
        if headed.size:
            return _from_headed_fixes(run, events, headed[:FIRST_FIXES], numbers, reckon())
        return _from_fixes(run, events, fixes, numbers, reckon())
    ranges = np.flatnonzero(events.kind == RANGE)
    if ranges.size:
        return _from_ranges(run, events, ranges, numbers, reckon())
    note = "Start pose unknown and nothing observes it: the path begins at x = y = 0, heading 0, and is relative."
    return Start(np.zeros(3), np.zeros((3, 3)), notes=(note,))


def _from_headed_fixes(
    run: Run, events: Events, rows: npt.NDArray[np.intp], numbers: Assumptions, path: Trajectory
) -> Start:
    tag = np.array((run.meta.robot.tag.x, run.meta.robot.tag.y, 0.0))
    fix = events.data[rows, :3]
    body = compose(fix, -np.broadcast_to(tag, fix.shape))
    body[:, 2] = fix[:, 2]
    starts = compose(body, inverse(_poses_at(path, events.t[rows])))
    theta = starts[0, 2] + wrap_angle(starts[:, 2] - starts[0, 2])
    arm2 = numbers.fix_theta**2 * float(tag @ tag)
    P = np.diag((numbers.fix_xy**2 + arm2, numbers.fix_xy**2 + arm2, numbers.fix_theta**2))
    pose = np.array((np.median(starts[:, 0]), np.median(starts[:, 1]), np.median(theta)))
    note = f"Start pose from the first {len(rows)} fixes: heading ± {numbers.fix_theta:.2g} rad."
    return Start(pose, P, rows, (note,))


def _from_fixes(run: Run, events: Events, rows: npt.NDArray[np.intp], numbers: Assumptions, path: Trajectory) -> Start:
    tag = np.array((run.meta.robot.tag.x, run.meta.robot.tag.y, 0.0))
    local = compose(_poses_at(path, events.t[rows]), np.broadcast_to(tag, (len(rows), 3)))[:, :2]
    fixes = events.data[rows, :2]
    far = np.searchsorted(np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(local, axis=0).T)))), LONGEST)
    most = int(np.clip(far, min(4, len(rows)), len(rows)))
    count = min(4, most)
    while True:
        pose, P = fit_rigid(local[:count], fixes[:count], numbers.fix_xy)
        if P[2, 2] <= HEADING_KNOWN**2 or count >= most:
            break
        count = min(2 * count, most)
    sd = float(np.sqrt(P[2, 2]))
    took = events.t[rows[count - 1]] - events.t[0]
    note = (
        f"Start pose fitted to the first {count} fixes ({took:.3g} s, placed with hindsight): heading ± {sd:.2g} rad."
    )
    if sd >= 0.5:
        note = f"Heading not observable: the robot hardly moved while fixes came, its sd is {sd:.2g} rad."
    return Start(pose, P, rows[:count], (note,))


def fit_rigid(local: Array, fixes: Array, sd: float) -> tuple[Array, Array]:
    """Pose (3,) that brings local points (N, 2) onto fixes (N, 2), and its covariance; Huber weights tame outliers."""
    weight = np.ones(len(local))
    noise = sd
    for _ in range(8):
        total = weight.sum()
        mean_l, mean_f = weight @ local / total, weight @ fixes / total
        a, b = local - mean_l, fixes - mean_f
        theta = float(np.arctan2(weight @ (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), weight @ np.sum(a * b, axis=1)))
        cos, sin = np.cos(theta), np.sin(theta)
        turned = np.column_stack((cos * a[:, 0] - sin * a[:, 1], sin * a[:, 0] + cos * a[:, 1]))
        miss = np.hypot(*(b - turned).T)
        noise = max(sd, float(np.median(miss)) / 1.18)
        weight = np.minimum(1.0, 2.5 * noise / np.maximum(miss, 1e-12))
    spread = float(weight @ np.sum(a * a, axis=1))
    var_theta = min(noise**2 / max(spread, 1e-12), UNKNOWN_HEADING**2)
    xy = mean_f - np.array((cos * mean_l[0] - sin * mean_l[1], sin * mean_l[0] + cos * mean_l[1]))
    swing = np.array((-(xy[1] - mean_f[1]), xy[0] - mean_f[0], 1.0))
    P = np.outer(swing, swing) * var_theta
    P[0, 0] += noise**2 / total
    P[1, 1] += noise**2 / total
    return np.array((xy[0], xy[1], theta)), P


def _from_ranges(run: Run, events: Events, rows: npt.NDArray[np.intp], numbers: Assumptions, path: Trajectory) -> Start:
    tag = run.meta.robot.tag
    local = compose(_poses_at(path, events.t[rows]), np.broadcast_to(np.array((tag.x, tag.y, 0.0)), (len(rows), 3)))
    far = np.searchsorted(np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(local[:, :2], axis=0).T)))), 3 * LONGEST)
    most = int(np.clip(far, min(16, len(rows)), len(rows)))
    count = min(16, most)
    while True:
        used = events.data[rows[:count]]
        fit = fit_ranges(local[:count, :2], used[:, :3], used[:, 3], tag.z, numbers.range, numbers.range_scale_sd)
        if fit.unique or count >= most:
            break
        count = min(2 * count, most)
    sd = float(np.sqrt(fit.covariance[2, 2]))
    took = events.t[rows[count - 1]] - events.t[0]
    note = (
        f"Start pose fitted to the first {count} ranges ({took:.3g} s, placed with hindsight): heading ± {sd:.2g} rad."
    )
    if not fit.unique:
        note = f"Start pose ambiguous after {count} ranges ({took:.3g} s): the best is taken, heading ± {sd:.2g} rad."
    return Start(fit.pose, fit.covariance, rows[:count], (note,))


def _poses_at(path: Trajectory, t: Array) -> Array:
    """(N, 3) poses at stamps t, those of the ends beyond them."""
    return path.at(np.clip(t, path.t[0], path.t[-1]))
