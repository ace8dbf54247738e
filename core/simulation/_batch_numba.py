"""Compiled: the whole chain for many parameter sets. Named tuples of plain arrays in and out."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from core.simulation import params as P
from core.simulation._drive_numba import compiled
from core.simulation._rollout_numba import EDGE, STATE, rollout
from core.simulation._sense_numba import path_edges, sense_beacon, sense_imu, sense_pose, sense_ranges, sense_wheels

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]


class Inputs(NamedTuple):
    """What the kernels need of a run.

    times (C,): command stamps; left, right (C, 2): rim set-points [m/s] and slopes. wheels, beacon, ranges, truth:
    stamps [s], empty where the stream is absent. imu (N,): stamps; warmth (N,): temperature - first [K]; grid (G,):
    window edges in the IMU's stamps; lo, hi (N,): each sample's edges. anchor (M,): beacon index of each range;
    anchors (A, 3) [m]. cuts (M,): instants at which every rollout ends a piece. restarts (K, 4): t, x, y, theta at
    which the pose is set anew. begin: until when all is at rest [s].
    """

    times: Array
    left: Array
    right: Array
    cuts: Array
    restarts: Array
    begin: float
    wheels: Array
    imu: Array
    warmth: Array
    grid: Array
    lo: Indices
    hi: Indices
    beacon: Array
    ranges: Array
    anchor: Indices
    anchors: Array
    truth: Array


class Outputs(NamedTuple):
    """Readings without noise, (B, rows) each, row b for parameter set b.

    Encoder angles are not rounded, the gyro is not clipped; fixes and ranges in a beacon's shadow are NaN. `speed` is
    the body's forward speed at each IMU sample [m/s].
    """

    left: Array
    right: Array
    gz: Array
    ax: Array
    ay: Array
    speed: Array
    beacon_x: Array
    beacon_y: Array
    beacon_theta: Array
    range: Array
    x: Array
    y: Array
    theta: Array


@compiled
def sense(par: Array, nodes: Array, n: int, edges: Array, inputs: Inputs, out: Outputs, b: int) -> None:
    """Every sensor's readings of a path, into row b of `out`."""
    sense_wheels(par, nodes, n, inputs.wheels, out.left[b], out.right[b])
    sense_imu(
        par, edges, inputs.lo, inputs.hi, inputs.grid, inputs.imu, inputs.warmth,
        out.gz[b], out.ax[b], out.ay[b], out.speed[b],
    )  # fmt: skip
    sense_beacon(par, nodes, n, inputs.beacon, out.beacon_x[b], out.beacon_y[b], out.beacon_theta[b])
    sense_ranges(par, nodes, n, inputs.ranges, inputs.anchor, inputs.anchors, out.range[b])
    sense_pose(nodes, n, inputs.truth, out.x[b], out.y[b], out.theta[b])


@compiled
def same_path(a: Array, b: Array) -> bool:
    """Whether two parameter sets drive alike and differ in what sensors make of it only."""
    for i in range(P.TILT_X):
        if a[i] != b[i]:
            return False
    return a[P.CLOCK_OFFSET] == b[P.CLOCK_OFFSET] and a[P.CLOCK_RATE] == b[P.CLOCK_RATE]


def _entry_points(
    digest: int,
) -> tuple[Callable[..., None], Callable[..., int], Callable[..., None]]:
    """The compiled functions that Python calls. numba's cache sees a change of this file, and of what they close over,
    but not of the files that they call into: so they close over a digest of those.
    """

    @njit(cache=True, nogil=True, error_model="numpy")
    def simulate_every(
        sets: Array,
        ends: Array,
        inputs: Inputs,
        room: Array,
        out: Outputs,
        status: Indices,
        first: int,
        step: int,
    ) -> None:
        nodes = room[first]
        edges, state = np.empty((inputs.grid.shape[0], EDGE)), np.empty(STATE)
        rolled = -1
        for b in range(first, sets.shape[0], step):
            if rolled >= 0 and same_path(sets[b], sets[rolled]) and ends[b] == ends[rolled]:
                status[b] = status[rolled]
                sense(sets[b], nodes, status[b], edges, inputs, out, b)
                continue
            status[b] = digest and rollout(
                sets[b],
                inputs.times,
                inputs.left,
                inputs.right,
                inputs.cuts,
                inputs.grid,
                inputs.restarts,
                inputs.begin,
                ends[b],
                nodes,
                edges,
                state,
            )
            rolled = b if status[b] >= 0 else -1
            if status[b] >= 0:
                sense(sets[b], nodes, status[b], edges, inputs, out, b)

    @njit(cache=True, nogil=True, error_model="numpy")
    def roll(par: Array, end: float, inputs: Inputs, nodes: Array, edges: Array) -> int:
        return digest and rollout(
            par,
            inputs.times,
            inputs.left,
            inputs.right,
            inputs.cuts,
            inputs.grid,
            inputs.restarts,
            inputs.begin,
            end,
            nodes,
            edges,
            np.empty(STATE),
        )

    @njit(cache=True, nogil=True, error_model="numpy")
    def sense_path(par: Array, nodes: Array, inputs: Inputs, out: Outputs) -> None:
        if digest:
            edges = np.empty((inputs.grid.shape[0], EDGE))
            path_edges(par, nodes, nodes.shape[0], inputs.grid, edges)
            sense(par, nodes, nodes.shape[0], edges, inputs, out, 0)

    return simulate_every, roll, sense_path


def _in_threads(digest: int) -> Callable[..., None]:
    """As above. It calls `simulate_every` by its global name: a compiled function that is closed over has another
    identity in every process, and the cache would never know it again.
    """

    @njit(cache=True, parallel=True, error_model="numpy")
    def simulate_batch(
        sets: Array, ends: Array, inputs: Inputs, room: Array, out: Outputs, status: Indices, workers: int
    ) -> None:
        for k in prange(workers):
            if digest:
                simulate_every(sets, ends, inputs, room, out, status, k, workers)

    return simulate_batch


KERNELS = ("params.py", "_drive_numba.py", "_rollout_numba.py", "_sense_numba.py")
_DIGEST = zlib.crc32(b"".join(Path(__file__).with_name(name).read_bytes() for name in KERNELS)) | 1

simulate_every, roll, sense_path = _entry_points(_DIGEST)
simulate_batch = _in_threads(_DIGEST)
"""simulate_every(sets, ends, inputs, room, out, status, first, step): parameter sets first, first + step, ... of `sets`
(B, SLOTS), each to its end (B,) [s]; room (step or more, capacity, NODE) is worked in; status (B,) gets the number of
nodes, or -1 where there was too little room.
simulate_batch(sets, ends, inputs, room, out, status, workers): the same, all sets, dealt out over threads.
roll(par, end, inputs, nodes, edges): the path alone; returns the number of nodes or -1.
sense_path(par, nodes, inputs, out): the readings of a smooth path given by its nodes, into row 0.
"""
