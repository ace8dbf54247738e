"""What the simulator takes from a run: commands as rim set-points, every stream's stamps, IMU windows, beacons."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from core.errors import MissingStreamError
from core.run import Run
from core.sensors import RangeLog, WheelLog
from core.simulation._batch_numba import Inputs

Array = npt.NDArray[np.float64]
NO_STAMPS = np.empty(0)
NO_RESTARTS = np.empty((0, 4))
SAME_EDGE = 1e-9
"""Window edges nearer than this [s] are one."""


def prepare(run: Run, restarts: Array | None = None) -> Inputs:
    """Arrays for the kernels. restarts (K, 4): t, x, y, theta, increasing t, where the pose is set anew.

    A run without commands is driven by its recorded wheels, one at rest stands still. Raises MissingStreamError where
    neither is there, or where the run does not say where a beacon stands.
    """
    times, left, right = set_points(run)
    imu = run.imu.t if run.imu else NO_STAMPS
    grid, lo, hi = windows(imu)
    temperature = run.imu.temperature if run.imu else None
    warmth = np.zeros(imu.shape[0])
    if temperature is not None and len(temperature):
        degrees = temperature.astype(np.float64)
        known = np.flatnonzero(np.isfinite(degrees))
        if len(known):
            warmth = np.nan_to_num(degrees - degrees[known[0]])
    anchor, anchors = beacon_table(run)
    others = [log.t[-1:] for log in (run.wheels, run.beacon, run.ranges, run.truth) if log is not None]
    inputs = Inputs(
        times=times,
        left=_with_slopes(times, left),
        right=_with_slopes(times, right),
        cuts=np.unique(np.concatenate((grid, *others))),
        restarts=NO_RESTARTS if restarts is None else np.ascontiguousarray(restarts, dtype=np.float64),
        begin=begin_of(run),
        wheels=_stamps(run.wheels.t if run.wheels else NO_STAMPS),
        imu=_stamps(imu),
        warmth=warmth,
        grid=grid,
        lo=lo,
        hi=hi,
        beacon=_stamps(run.beacon.t if run.beacon else NO_STAMPS),
        ranges=_stamps(run.ranges.t if run.ranges else NO_STAMPS),
        anchor=anchor,
        anchors=anchors,
        truth=_stamps(run.truth.t if run.truth else NO_STAMPS),
    )
    # a stored run's arrays are read-only, for which the kernels would be compiled once more
    fields: dict[str, Any] = inputs._asdict()
    for name, one in fields.items():
        if isinstance(one, np.ndarray):
            fields[name] = np.require(one, requirements=("C", "W"))
    return Inputs(**fields)


def begin_of(run: Run) -> float:
    """When the drive begins [s]: at 0, where `start` is the pose; a run cropped from another, with its commands."""
    if run.meta.start is not None or run.commands is None or not len(run.commands):
        return 0.0
    return max(float(run.commands.t[0]), 0.0)


def with_drive(inputs: Inputs, times: Array, left: Array, right: Array) -> Inputs:
    """The same with other rim set-points [m/s]."""
    return inputs._replace(times=_stamps(times), left=_with_slopes(times, left), right=_with_slopes(times, right))


def set_points(run: Run) -> tuple[Array, Array, Array]:
    """Stamps and rim set-points of both wheels [m/s] from the commands, with the nominal track width."""
    if run.commands is not None and len(run.commands):
        v, w = run.commands.v.astype(np.float64), run.commands.w.astype(np.float64)
        known = np.isfinite(v) & np.isfinite(w)
        if known.any():
            half = 0.5 * (run.meta.robot.track_width or 0.0)
            v, w = v[known], w[known]
            return run.commands.t[known], v - half * w, v + half * w
    if run.wheels is not None and len(run.wheels) > 1:
        return rim_speeds(run.wheels, run.meta.robot.wheel_radius or 0.0)
    if run.meta.procedure is not None and run.meta.procedure.kind in ("rest", "six_position"):
        return np.zeros(1), np.zeros(1), np.zeros(1)
    raise MissingStreamError(
        "the simulator needs the run's commands, or its wheels to drive by", method="simulate", missing=["commands"]
    )


def rim_speeds(wheels: WheelLog, radius: float) -> tuple[Array, Array, Array]:
    """Recorded wheels as rim set-points: mean speeds between readings, at their midpoints, linear in between.

    Distances are kept over any stretch, single increments up to an eighth of their second difference.
    """
    left, right = wheels.left.astype(np.float64), wheels.right.astype(np.float64)
    known = np.isfinite(left) & np.isfinite(right)
    t, left, right = wheels.t[known], left[known], right[known]
    step = np.diff(t)
    return 0.5 * (t[1:] + t[:-1]), radius * np.diff(left) / step, radius * np.diff(right) / step


def windows(stamps: Array) -> tuple[Array, npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Edges of one sample period around each stamp: (G,) merged edges, (N,) lower and (N,) upper index into them."""
    n = stamps.shape[0]
    if n == 0:
        return NO_STAMPS, np.empty(0, np.int64), np.empty(0, np.int64)
    half = 0.5 * float(np.median(np.diff(stamps))) if n > 1 else 0.5e-3
    edges = np.concatenate((stamps - half, stamps + half))
    order = np.argsort(edges, kind="stable")
    new = np.diff(edges[order], prepend=-np.inf) > SAME_EDGE
    index = np.empty(2 * n, np.int64)
    index[order] = np.cumsum(new) - 1
    return edges[order][new], index[:n], index[n:]


def beacon_table(run: Run) -> tuple[npt.NDArray[np.int64], Array]:
    """(M,) index of each range's beacon into (A, 3) beacon positions [m], in the order of `run.meta.beacons`."""
    anchors = np.array([run.meta.beacons[name] for name in run.meta.beacons], dtype=np.float64).reshape(-1, 3)
    if run.ranges is None or not len(run.ranges):
        return np.empty(0, np.int64), anchors
    return _anchor_index(run.ranges, list(run.meta.beacons)), anchors


def _anchor_index(ranges: RangeLog, names: list[str]) -> npt.NDArray[np.int64]:
    used = [ranges.names[i] for i in np.unique(ranges.beacon)]
    unknown = [name for name in used if name not in names]
    if unknown:
        raise MissingStreamError(
            f"ranges are to {', '.join(unknown)}, whose place run.json does not give",
            method="simulate",
            missing=[f"beacons.{name}" for name in unknown],
        )
    table = np.array([names.index(name) if name in names else -1 for name in ranges.names], dtype=np.int64)
    return table[ranges.beacon]


def _with_slopes(t: Array, values: Array) -> Array:
    """(C, 2) values and their slopes to the next, 0 after the last."""
    slopes = np.append(np.diff(values) / np.diff(t), 0.0)
    return np.column_stack((values, slopes))


def _stamps(t: Array) -> Array:
    return np.ascontiguousarray(t, dtype=np.float64)
