"""A run seen from the user's own simulator: what that simulator makes otherwise than ours is taken out of the readings.

Theirs is first diagnosed as if it were a robot: what ours lacks of it becomes what the simulator already models. Then,
of recorded readings r, theirs f and ours o with that, all from the same commands, r - (f - o) lies as far from ours as
r lies from theirs. Of positions the motion in the body's own frame is corrected, step by step, so that no error of
heading piles up; fixes and ranges move with the pose.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from core.errors import ParameterError
from core.gap.explain import Progress, silent
from core.gap.floor import FALLBACK, stated
from core.gap.pace import Pace
from core.gap.reference import WINDOW, restarts_of
from core.gap.searched import searched
from core.robot import EffectSet, Noise
from core.run import Run
from core.sensors import BeaconLog, ImuLog, RangeLog, TruthLog, WheelLog
from core.simulation import simulate
from core.simulation.foreign import Foreign, check_answer
from core.simulation.inputs import beacon_table

Array = npt.NDArray[np.float64]

SHARE = 0.1
"""Of the progress: all before the search."""
STEP = 0.05
"""Spacing of the path that is asked for where the run has no truth [s]."""
REFERENCE = 0.5
"""Spacing of the smoothed path of a run without truth [s]."""
MIDDLE, THIRD = 0.67449, np.sqrt(20.0)


def against(
    runs: Sequence[Run], simulators: Foreign | Sequence[Foreign], seed: int, progress: Progress = silent
) -> tuple[list[Run], EffectSet]:
    """Every run as seen from its simulator (one for all, or one each: recordings), and what that models beyond ours.

    Raises ParameterError where they are not one each, or a run has no commands to drive one by, and what the
    simulator's answer raises (`core.simulation.foreign`).
    """
    each = [simulators] * len(runs) if isinstance(simulators, Foreign) else list(simulators)
    if len(each) != len(runs):
        raise ParameterError(
            f"{len(runs)} runs and {len(each)} simulators: give one for all, or one for each",
            parameter="simulator",
            expected=len(runs),
            found=len(each),
        )
    made = [_made(run, one, seed + k) for k, (run, one) in enumerate(zip(runs, each, strict=True))]
    inner = Pace(lambda share, message: progress(SHARE * share, f"the simulator itself: {message}"))
    known = searched([_noisy(run, seed + k) for k, run in enumerate(made)], {}, WINDOW, inner).found.model
    return [_seen_from(run, one, known) for run, one in zip(runs, made, strict=True)], known


def _made(run: Run, foreign: Foreign, seed: int) -> Run:
    """What a simulator makes of a run, with the path where it tells it."""
    if run.commands is None or not len(run.commands):
        raise ParameterError(
            f"{run.meta.name or 'the run'} has no commands to drive the simulator {foreign.name!r} by",
            parameter="simulator",
            simulator=foreign.name,
        )
    asked = run if run.truth is not None else dataclasses.replace(run, truth=_blank(run))
    own = {name: values for name, values in run.meta.effects.items() if name in foreign.effects}
    made = foreign.simulate(asked, own, seed)
    check_answer(foreign.name, run, made)
    streams = {name: getattr(made, name) for name in ("wheels", "imu", "beacon", "ranges") if getattr(run, name)}
    bare = dataclasses.replace(run.meta, effects={})
    return Run(meta=bare, commands=run.commands, truth=made.truth, **streams)


def _noisy(made: Run, seed: int) -> Run:
    """With the stated noise on its readings, so that a simulator without any is no more than just as good."""
    rng = np.random.default_rng([seed, 5])
    sheet = {**FALLBACK, **stated(made)}
    streams: dict[str, Any] = {}
    for stream, names in (("imu", "gz ax ay"), ("beacon", "x y theta"), ("ranges", "range"), ("truth", "x y theta")):
        log = getattr(made, stream)
        columns = {} if log is None else {name: getattr(log, name) for name in names.split()}
        louder = {
            name: values + sheet.get(f"{stream}.{name}", QUIET) * (QUIET_TRUTH if stream == "truth" else 1.0)
            * rng.standard_normal(len(values))
            for name, values in columns.items()
            if values is not None
        }  # fmt: skip
        if log is not None:
            streams[stream] = dataclasses.replace(log, **louder)
    if made.wheels is not None and made.meta.robot.ticks_per_rev:
        tick = 2.0 * np.pi / made.meta.robot.ticks_per_rev
        left, right = (tick * np.floor(getattr(made.wheels, side) / tick) for side in ("left", "right"))
        streams["wheels"] = dataclasses.replace(made.wheels, left=left, right=right)
    return dataclasses.replace(made, **streams)


QUIET, QUIET_TRUTH = 0.05, 0.3
"""Noise of a fix that states none [m, rad]; share of a reference's stated noise that it shows."""


def _rounded(wheels: WheelLog, ticks: float) -> bool:
    """Whether encoders count whole ticks."""
    count = np.asarray(wheels.left, dtype=np.float64) * ticks / (2.0 * np.pi)
    return bool(np.nanmax(np.abs(count - np.round(count)), initial=0.0) < 1e-3)


def _seen_from(run: Run, made: Run, known: EffectSet) -> Run:
    """The run less what the simulator makes otherwise than ours with what is known of it."""
    meta = dataclasses.replace(run.meta, effects=known)
    asked = dataclasses.replace(run, meta=meta, truth=made.truth or run.truth)
    ours = simulate(asked, {}, 0, noise=False)
    noise, robot = run.meta.noise, run.meta.robot
    wheels, imu, beacon, ranges, truth = run.wheels, run.imu, run.beacon, run.ranges, run.truth
    if wheels is not None and made.wheels is not None and ours.wheels is not None:
        left, right = (
            getattr(wheels, side) - getattr(made.wheels, side) + getattr(ours.wheels, side)
            for side in ("left", "right")
        )
        wheels = WheelLog(t=wheels.t, left=left, right=right)
        if robot.ticks_per_rev and _rounded(made.wheels, robot.ticks_per_rev):  # rounding of both
            robot = dataclasses.replace(robot, ticks_per_rev=robot.ticks_per_rev / float(np.sqrt(2.0)))
    if imu is not None and made.imu is not None and ours.imu is not None:
        imu, noise = _imu(imu, made.imu, ours.imu, noise)
    paths = _paths(run, made, ours)
    if paths is not None:
        truth, beacon, ranges = _poses(run, *paths)
    meta = dataclasses.replace(meta, robot=robot, noise=noise)
    return dataclasses.replace(run, meta=meta, wheels=wheels, imu=imu, beacon=beacon, ranges=ranges, truth=truth)


def _blank(run: Run) -> TruthLog:
    first, last = run.span
    t = np.arange(max(first, 0.0), last, STEP)
    nothing = np.full(len(t), np.nan)
    return TruthLog(t=t, x=nothing, y=nothing, theta=nothing)


def _imu(real: ImuLog, made: ImuLog, ours: ImuLog, noise: Noise) -> tuple[ImuLog, Noise]:
    """Readings, and the stated noise with the simulator's own beside it."""
    columns, sigma = {}, {}
    for name in ("gz", "ax", "ay"):
        values = [getattr(log, name) for log in (real, made, ours)]
        if all(column is not None for column in values):
            far = np.asarray(values[1] - values[2], dtype=np.float64)
            columns[name] = np.asarray(values[0], dtype=np.float64) - far
            sigma[name] = _white(far) / float(np.sqrt(max(real.rate, 1e-6) / 2.0))
    gyro, accel = noise.gyro_density, noise.accel_density
    if gyro and "gz" in sigma:
        gyro = float(np.hypot(gyro, sigma["gz"]))
    if accel and "ax" in sigma:
        accel = float(np.hypot(accel, sigma["ax"]))
    return dataclasses.replace(real, **columns), dataclasses.replace(noise, gyro_density=gyro, accel_density=accel)


def _white(values: Array) -> float:
    """Standard deviation of white noise on a smooth curve."""
    return float(np.median(np.abs(np.diff(values, 3)))) / MIDDLE / float(THIRD) if len(values) > 8 else 0.0


def _paths(run: Run, made: Run, ours: Run) -> tuple[Array, Array, Array] | None:
    """Stamps, the real path (N, 3) and the corrected one; None where the simulator or the run tells no path."""
    theirs = _path_of(made.truth)
    nominal = _path_of(ours.truth)
    real = _path_of(run.truth)
    if real is None:
        marks = restarts_of(run, REFERENCE)
        real = (marks[:, 0], _unwrapped(marks[:, 1:])) if len(marks) > 1 else None
    if theirs is None or nominal is None or real is None:
        return None
    t, path = real
    far = [np.column_stack([np.interp(t, at, column) for column in poses.T]) for at, poses in (theirs, nominal)]
    steps = _steps(path) - (_steps(far[0]) - _steps(far[1]))
    theta = path[0, 2] + np.concatenate(([0.0], np.cumsum(steps[:, 2])))
    middle = 0.5 * (theta[1:] + theta[:-1])
    c, s = np.cos(middle), np.sin(middle)
    x = path[0, 0] + np.concatenate(([0.0], np.cumsum(c * steps[:, 0] - s * steps[:, 1])))
    y = path[0, 1] + np.concatenate(([0.0], np.cumsum(s * steps[:, 0] + c * steps[:, 1])))
    return t, path, np.column_stack((x, y, theta))


def _path_of(log: TruthLog | None) -> tuple[Array, Array] | None:
    if log is None or log.x is None or log.y is None or log.theta is None or len(log) < 2:
        return None
    poses = np.column_stack((log.x, log.y, log.theta)).astype(np.float64)
    known = np.isfinite(poses).all(axis=1)
    return (log.t[known], _unwrapped(poses[known])) if known.sum() > 1 else None


def _unwrapped(poses: Array) -> Array:
    return np.column_stack((poses[:, 0], poses[:, 1], np.unwrap(poses[:, 2])))


def _steps(path: Array) -> Array:
    """(N - 1, 3) motion between poses in the body's own frame, halfway turned."""
    dx, dy, turn = np.diff(path, axis=0).T
    middle = 0.5 * (path[1:, 2] + path[:-1, 2])
    c, s = np.cos(middle), np.sin(middle)
    return np.column_stack((c * dx + s * dy, c * dy - s * dx, turn))


def _poses(run: Run, t: Array, real: Array, moved: Array) -> tuple[TruthLog | None, BeaconLog | None, RangeLog | None]:
    """Truth, fixes and ranges of the corrected path."""

    def at(path: Array, when: Array) -> tuple[Array, Array, Array]:
        x, y, theta = (np.interp(when, t, column) for column in path.T)
        c, s, tag = np.cos(theta), np.sin(theta), run.meta.robot.tag
        return x + c * tag.x - s * tag.y, y + s * tag.x + c * tag.y, theta

    truth, beacon, ranges = run.truth, run.beacon, run.ranges
    if truth is not None:
        columns = [np.interp(truth.t, t, column) for column in moved.T]
        truth = dataclasses.replace(truth, x=columns[0], y=columns[1], theta=columns[2])
    if beacon is not None and len(beacon):
        (x0, y0, a0), (x1, y1, a1) = at(real, beacon.t), at(moved, beacon.t)
        theta = None if beacon.theta is None else beacon.theta + (a1 - a0)
        beacon = dataclasses.replace(beacon, x=beacon.x + x1 - x0, y=beacon.y + y1 - y0, theta=theta)
    if ranges is not None and len(ranges):
        index, places = beacon_table(run)
        far = []
        for path in (real, moved):
            x, y, _ = at(path, ranges.t)
            place = places[index]
            far.append(
                np.sqrt((x - place[:, 0]) ** 2 + (y - place[:, 1]) ** 2 + (run.meta.robot.tag.z - place[:, 2]) ** 2)
            )
        ranges = dataclasses.replace(ranges, range=ranges.range + far[1] - far[0])
    return truth, beacon, ranges
