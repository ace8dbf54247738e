"""The reference pose at each window's start: truth where there is some, else smoothed fixes and ranges."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from core.effects import EFFECTS, complete
from core.gap._pose_numba import smooth_poses
from core.robot import EffectSet, Pose
from core.run import Run
from core.simulation import params as P
from core.simulation.inputs import beacon_table, prepare
from core.simulation.simulate import simulate_sets

Array = npt.NDArray[np.float64]

WINDOW = 2.0
"""Length of the windows after which the pose is set anew [s]."""
WALK = 0.03
"""How far a heading is trusted to stray from dead reckoning [rad per root of m]."""
GATE = 3.0
FREE = ("kinematics", "ground")
"""Families that act between wheels and body."""


def restarts_of(run: Run, window: float = WINDOW, model: EffectSet | None = None) -> Array:
    """(K, 4) t, x, y, theta at every window's start. Empty where nothing tells the pose.

    model: effects by which fixes, ranges and dead reckoning are set right first, where there is no truth.
    """
    truth = run.truth
    if truth is not None and truth.x is not None and truth.y is not None and truth.theta is not None and len(truth) > 1:
        return _from_truth(truth.t, np.column_stack((truth.x, truth.y, np.unwrap(truth.theta))), window)
    if run.beacon is None and run.ranges is None and (truth is None or truth.x is None):
        return np.empty((0, 4))
    return _smoothed(corrected(run, model or {}), window, model or {})


def _from_truth(t: Array, poses: Array, window: float) -> Array:
    known = np.isfinite(poses).all(axis=1)
    t, poses = t[known], poses[known]
    if len(t) < 2:
        return np.empty((0, 4))
    first = np.searchsorted(t, np.arange(t[0], t[-1] - 0.25 * window, window))
    first = np.unique(first[first < len(t)])
    return np.column_stack((t[first], poses[first])).astype(np.float64)


def corrected(run: Run, model: EffectSet) -> Run:
    """The run with its fixes and ranges as they would be without the model's beacon effects."""
    values = complete({**run.meta.effects, **model})

    def of(effect: str, name: str) -> float:
        return float(values[effect][name])

    delay, scale, angle = of("beacon_delay", "delay"), of("beacon_scale", "scale"), of("beacon_rotation", "angle")
    robot, places = run.meta.robot, dict(run.meta.beacons)
    tag = dataclasses.replace(robot.tag, x=robot.tag.x + of("tag_offset", "x"), y=robot.tag.y + of("tag_offset", "y"))
    moved = str(values["anchor_moved"]["beacon"])
    if moved in places:
        at = places[moved]
        places[moved] = (at[0] + of("anchor_moved", "x"), at[1] + of("anchor_moved", "y"), at[2])
    meta = dataclasses.replace(run.meta, robot=dataclasses.replace(robot, tag=tag), beacons=places)
    beacon, ranges = run.beacon, run.ranges
    if beacon is not None:
        x, y = (beacon.x - of("beacon_shift", "x")) / scale, (beacon.y - of("beacon_shift", "y")) / scale
        c, s = np.cos(angle), np.sin(angle)
        theta = None if beacon.theta is None else beacon.theta - angle
        beacon = dataclasses.replace(beacon, t=beacon.t - delay, x=c * x + s * y, y=c * y - s * x, theta=theta)
    if ranges is not None:
        ranges = dataclasses.replace(
            ranges, t=ranges.t - delay, range=(ranges.range - of("range_bias", "bias")) / scale
        )
    return dataclasses.replace(run, meta=meta, beacon=beacon, ranges=ranges)


def _smoothed(run: Run, window: float, model: EffectSet) -> Array:
    """Dead reckoning (wheels before commands), drawn to fixes and ranges."""
    kinds, t, values, variance, anchors = _events(run)
    if not len(t):
        return np.empty((0, 4))
    marks = np.arange(max(t[0], 0.0), t[-1], window)
    order = np.argsort(np.concatenate((t, marks)), kind="stable")
    stamps = np.concatenate((t, marks))[order]
    none = np.full(len(marks), np.nan)
    kinds = np.concatenate((kinds, np.full(len(marks), -1.0)))[order]
    values, variance = np.concatenate((values, none))[order], np.concatenate((variance, none))[order]
    anchors = np.concatenate((anchors, np.zeros((len(marks), 3))))[order]
    start, sd = _start(run)
    par_tag = np.array([run.meta.robot.tag.x, run.meta.robot.tag.y, run.meta.robot.tag.z])
    poses, _ = smooth_poses(
        _increments(run, stamps, model),
        kinds.astype(np.int64),
        values,
        variance,
        par_tag,
        anchors,
        start,
        sd,
        WALK,
        GATE,
    )
    chosen = kinds < 0
    return np.column_stack((stamps[chosen], poses[chosen]))


def _events(run: Run) -> tuple[Array, Array, Array, Array, Array]:
    """Kinds, stamps, values, variances and beacons' places of all readings of pose, sorted."""
    parts: list[tuple[npt.NDArray[np.floating], ...]] = []
    noise = run.meta.noise
    for column, kind, sd in (
        ("x", 0, noise.beacon_xy or 0.05),
        ("y", 1, noise.beacon_xy or 0.05),
        ("theta", 2, noise.beacon_theta or 0.05),
    ):
        values = getattr(run.beacon, column) if run.beacon is not None else None
        if run.beacon is not None and values is not None:
            n = len(run.beacon)
            parts.append((np.full(n, float(kind)), run.beacon.t, values, np.full(n, sd**2), np.zeros((n, 3))))
    if run.ranges is not None and len(run.ranges):
        index, anchors = beacon_table(run)
        n = len(run.ranges)
        sd = noise.range or 0.05
        parts.append((np.full(n, 3.0), run.ranges.t, run.ranges.range, np.full(n, sd**2), anchors[index]))
    if not parts:
        empty = np.empty(0)
        return empty, empty, empty, empty, np.empty((0, 3))
    kinds, t, values, variance, places = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.argsort(t, kind="stable")
    return kinds[order], t[order], values[order].astype(np.float64), variance[order], places[order]


def _start(run: Run) -> tuple[Array, Array]:
    """Where the run starts and how well that is known."""
    pose = run.meta.start
    if pose is not None:
        return np.array([pose.x, pose.y, pose.theta]), np.array([0.05, 0.05, 0.05])
    beacon = run.beacon
    if beacon is not None and len(beacon):
        theta = float(beacon.theta[0]) if beacon.theta is not None else 0.0
        return np.array([beacon.x[0], beacon.y[0], theta]), np.array(
            [0.3, 0.3, 0.3 if beacon.theta is not None else 2.0]
        )
    return np.zeros(3), np.array([5.0, 5.0, 2.0])


def _increments(run: Run, stamps: Array, model: EffectSet) -> Array:
    """(E, 3) motion in the body's own frame since the stamp before, by dead reckoning from the map's origin."""
    moving = {name: values for name, values in model.items() if EFFECTS[name].family in FREE}
    source = dataclasses.replace(run, imu=None, beacon=None, ranges=None, truth=None)
    if run.wheels is not None and len(run.wheels) > 1:
        drive = dataclasses.replace(source, commands=None)
        meta = dataclasses.replace(run.meta, effects={})
    else:
        drive, meta, moving = source, run.meta, {k: v for k, v in model.items() if not EFFECTS[k].noise_only}
    inputs = prepare(drive)._replace(truth=stamps, wheels=np.empty(0))
    out, _ = simulate_sets(inputs, P.pack(meta, moving, start=Pose())[None, :], parallel=False)
    x, y, theta = out.x[0], out.y[0], out.theta[0]
    dx, dy = np.diff(x, prepend=x[:1]), np.diff(y, prepend=y[:1])
    before = np.concatenate((theta[:1], theta[:-1]))
    c, s = np.cos(before), np.sin(before)
    return np.column_stack((c * dx + s * dy, c * dy - s * dx, np.diff(theta, prepend=theta[:1])))
