"""The reference pose at each window's start: truth where there is some, else smoothed fixes and ranges."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

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
HELD = 0.5
"""A reference further from a window's start than this [s] does not count."""


def restarts_of(run: Run, window: float = WINDOW) -> Array:
    """(K, 4) t, x, y, theta at every window's start. Empty where nothing tells the pose."""
    truth = run.truth
    if truth is not None and truth.x is not None and truth.y is not None and truth.theta is not None and len(truth) > 1:
        return _from_truth(truth.t, np.column_stack((truth.x, truth.y, np.unwrap(truth.theta))), window)
    if run.beacon is None and run.ranges is None and (truth is None or truth.x is None):
        return np.empty((0, 4))
    return _smoothed(run, window)


def _from_truth(t: Array, poses: Array, window: float) -> Array:
    known = np.isfinite(poses).all(axis=1)
    t, poses = t[known], poses[known]
    if len(t) < 2:
        return np.empty((0, 4))
    first = np.searchsorted(t, np.arange(t[0], t[-1] - 0.25 * window, window))
    first = np.unique(first[first < len(t)])
    return np.column_stack((t[first], poses[first])).astype(np.float64)


def _smoothed(run: Run, window: float) -> Array:
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
        _increments(run, stamps), kinds.astype(np.int64), values, variance, par_tag, anchors, start, sd, WALK, GATE
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


def _increments(run: Run, stamps: Array) -> Array:
    """(E, 3) motion in the body's own frame since the stamp before, by dead reckoning from the map's origin."""
    effects: EffectSet = {}
    source = dataclasses.replace(run, imu=None, beacon=None, ranges=None, truth=None)
    if run.wheels is not None and len(run.wheels) > 1:
        drive = dataclasses.replace(source, commands=None)
        meta = dataclasses.replace(run.meta, effects={})
    else:
        drive, meta = source, run.meta
    inputs = prepare(drive)._replace(truth=stamps, wheels=np.empty(0))
    out, _ = simulate_sets(inputs, P.pack(meta, effects, start=Pose())[None, :], parallel=False)
    x, y, theta = out.x[0], out.y[0], out.theta[0]
    dx, dy = np.diff(x, prepend=x[:1]), np.diff(y, prepend=y[:1])
    before = np.concatenate((theta[:1], theta[:-1]))
    c, s = np.cos(before), np.sin(before)
    return np.column_stack((c * dx + s * dy, c * dy - s * dx, np.diff(theta, prepend=theta[:1])))
