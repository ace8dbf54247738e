"""`published(run)`: the navigation system of Lee, Shin and Cho, Fig. 7 from top to bottom. The story, one screen.

Given: wheels, gyro and both horizontal accelerometers, and beacon fixes (or ranges). Done: IMU signals are low-passed
(`signals`), IMU data stand in where encoders differ by more than the mean difference (`substitution`), shocks are found
(`shocks`), the path is reckoned (`reckoning`) and corrected or replaced by the beacon (`tracker`, `kalman`).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from core.estimation import needs
from core.estimation.assumptions import Assumptions, Config, assume
from core.estimation.fusion.start import HEADING_KNOWN, fit_rigid
from core.estimation.odometry import arcs, start_pose, wheel_path
from core.estimation.published.decisions import Decisions
from core.estimation.published.fixes import Fixes, find_fixes
from core.estimation.published.reckoning import Reckoning, motion
from core.estimation.published.shocks import shocks
from core.estimation.published.signals import signals
from core.estimation.published.substitution import choose
from core.estimation.published.tracker import Track, Tracker
from core.estimation.result import Estimate
from core.geometry import compose, inverse, rotation, wrap_angle
from core.run import Run
from core.trajectory import Trajectory

Array = npt.NDArray[np.float64]

FIRST_FIXES = 5


def missing(run: Run) -> str | None:
    """None, or what the run lacks for this method."""
    reason = needs.for_encoders(run) or needs.for_encoders_gyro(run)
    if reason is not None:
        return reason
    absent = [f"imu.{name}" for name in ("ax", "ay") if getattr(run.imu, name) is None]
    if absent:
        return f"the IMU has no {' and '.join(absent)}: both horizontal accelerometers are needed"
    return needs.for_beacon(run)


def published(run: Run, config: Config | None = None) -> Estimate:
    """The path by the published system as we read it; one pose per IMU stamp."""
    return navigate(run, config, Decisions())


def navigate(run: Run, config: Config | None, choice: Decisions) -> Estimate:
    """The same with other decisions on what the paper leaves open. Of a run that is sound (`sanity`).

    Raises NotEnoughDataError without usable fixes.
    """
    numbers, notes = assume(run, config)
    s = signals(run, numbers, choice)
    steps, slips = choose(s, numbers, choice)
    hits = shocks(s, choice)
    path = Reckoning.of(s.t, steps)
    fixes, fix_notes = find_fixes(run, numbers, path, config or {})
    pose, P, used, start_notes = _start(run, numbers, path, fixes)
    tag = np.array((run.meta.robot.tag.x, run.meta.robot.tag.y))
    ends = [float(s.t[hit.last]) + choice.quiet for hit in hits]
    track = Tracker(fixes, path, ends, tag, numbers, choice).walk(pose, P, used)
    if not s.rested:
        notes = (*notes, "The robot never rests: offsets of gyro and accelerometers are taken for zero.")
    events = [*slips, *(event for hit in hits for event in hit.events), *track.events]
    return Estimate(
        "published",
        _between_fixes(path, track),
        events=tuple(sorted(events, key=lambda event: event.t0)),
        innovations=track.innovations,
        notes=(*start_notes, *fix_notes, *notes),
    )


def _between_fixes(path: Reckoning, track: Track) -> Trajectory:
    """Poses (N,) at the IMU's stamps: the last fix's, carried on by dead reckoning."""
    last = np.searchsorted(track.t, path.t, "right") - 1
    moved, noise = motion(path.at(track.t)[last], path.table)
    base = track.pose[last]
    pose = compose(base, moved)
    J = np.broadcast_to(np.eye(3), noise.shape).copy()
    J[:, 0, 2], J[:, 1, 2] = -(pose[:, 1] - base[:, 1]), pose[:, 0] - base[:, 0]
    R = rotation(base[:, 2])
    P = J @ track.covariance[last] @ np.swapaxes(J, -1, -2) + R @ noise @ np.swapaxes(R, -1, -2)
    return Trajectory(path.t, pose[:, 0], pose[:, 1], pose[:, 2], P)


def _start(run: Run, numbers: Assumptions, path: Reckoning, fixes: Fixes) -> tuple[Array, Array, int, tuple[str, ...]]:
    """Pose and covariance at the path's first stamp, how many fixes it took, notes."""
    if run.meta.start is not None:
        P = np.diag(np.square((numbers.start_xy, numbers.start_xy, numbers.start_theta)))
        return _at_first_stamp(run, path.t[0]), P, 0, ()
    first = fixes.fix(0, 0.0)
    if first is not None and len(first[0]) == 3:
        return _by_headings(run, path, fixes)
    return _by_positions(run, path, fixes)


def _at_first_stamp(run: Run, t: float) -> Array:
    """The start pose of t = 0, carried to the first IMU stamp by the wheels."""
    wheels, robot = run.wheels, run.meta.robot
    assert wheels is not None and robot.wheel_radius
    rolled = wheel_path(wheels, robot.wheel_radius, robot.track_width)
    poses = arcs(rolled.d, rolled.turn, start_pose(run)[0])
    return np.array([np.interp(t, rolled.t, column) for column in poses.T])


def _by_headings(run: Run, path: Reckoning, fixes: Fixes) -> tuple[Array, Array, int, tuple[str, ...]]:
    count = min(FIRST_FIXES, len(fixes.t))
    seen = [found for k in range(count) if (found := fixes.fix(k, 0.0)) is not None and len(found[0]) == 3]
    z = np.array([found[0] for found in seen])
    tag = np.array((run.meta.robot.tag.x, run.meta.robot.tag.y, 0.0))
    body = compose(z, -np.broadcast_to(tag, z.shape))
    rows = path.at(fixes.t[: len(z)])[:, :3]
    starts = compose(body, inverse(rows))
    starts[:, 2] = starts[0, 2] + wrap_angle(starts[:, 2] - starts[0, 2])
    note = f"Start pose from the first {len(z)} fixes."
    return np.median(starts, axis=0), seen[0][1], len(z), (note,)


def _by_positions(run: Run, path: Reckoning, fixes: Fixes) -> tuple[Array, Array, int, tuple[str, ...]]:
    """The reckoned path, as a rigid body, laid onto the first fixes, until its heading is known."""
    most = min(len(fixes.t), 400)
    found = [(k, fix) for k in range(most) if (fix := fixes.fix(k, 0.0)) is not None]
    rows = path.at(fixes.t[[k for k, _ in found]])[:, :3]
    tag = np.array((run.meta.robot.tag.x, run.meta.robot.tag.y, 0.0))
    local = compose(rows, np.broadcast_to(tag, rows.shape))[:, :2]
    z = np.array([fix[0][:2] for _, fix in found])
    sd = float(np.sqrt(np.median([fix[1][0, 0] for _, fix in found])))
    count = min(4, len(z))
    while True:
        pose, P = fit_rigid(local[:count], z[:count], sd)
        if P[2, 2] <= HEADING_KNOWN**2 or count >= len(z):
            break
        count = min(2 * count, len(z))
    note = f"Start pose fitted to the first {count} fixes, placed with hindsight: heading ± {np.sqrt(P[2, 2]):.2g} rad."
    return pose, P, found[count - 1][0] + 1, (note,)
