"""Compiled: the whole chain for many parameter sets. Named tuples of plain arrays in and out."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from core.simulation._drive_numba import compiled
from core.simulation._rollout_numba import EDGE, NODE, rollout
from core.simulation._sense_numba import sense_beacon, sense_imu, sense_pose, sense_ranges, sense_wheels

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]


class Inputs(NamedTuple):
    """What the kernels need of a run.

    times (C,): command stamps; left, right (C, 2): rim set-points [m/s] and slopes. wheels, beacon, ranges, truth:
    stamps [s], empty where the stream is absent. imu (N,): stamps; warmth (N,): temperature - first [K]; grid (G,):
    window edges in the IMU's stamps; lo, hi (N,): each sample's edges. anchor (M,): beacon index of each range;
    anchors (A, 3) [m]. restarts (K, 4): t, x, y, theta at which the pose is set anew.
    """

    times: Array
    left: Array
    right: Array
    restarts: Array
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
def simulate_every(
    sets: Array,
    ends: Array,
    inputs: Inputs,
    capacity: int,
    out: Outputs,
    status: Indices,
    first: int,
    step: int,
) -> None:
    """Parameter sets first, first + step, ... of `sets` (B, SLOTS), each to its end (B,) [s].

    status (B,) gets the number of nodes, or -1 where `capacity` was too small.
    """
    nodes = np.empty((capacity, NODE))
    edges = np.empty((inputs.grid.shape[0], EDGE))
    for b in range(first, sets.shape[0], step):
        par = sets[b]
        n = rollout(par, inputs.times, inputs.left, inputs.right, inputs.grid, inputs.restarts, ends[b], nodes, edges)
        status[b] = n
        if n < 0:
            continue
        sense_wheels(par, nodes, n, inputs.wheels, out.left[b], out.right[b])
        sense_imu(
            par, edges, inputs.lo, inputs.hi, inputs.grid, inputs.imu, inputs.warmth,
            out.gz[b], out.ax[b], out.ay[b], out.speed[b],
        )  # fmt: skip
        sense_beacon(par, nodes, n, inputs.beacon, out.beacon_x[b], out.beacon_y[b], out.beacon_theta[b])
        sense_ranges(par, nodes, n, inputs.ranges, inputs.anchor, inputs.anchors, out.range[b])
        sense_pose(nodes, n, inputs.truth, out.x[b], out.y[b], out.theta[b])


@njit(cache=True, parallel=True, error_model="numpy")
def simulate_batch(
    sets: Array, ends: Array, inputs: Inputs, capacity: int, out: Outputs, status: Indices, workers: int
) -> None:
    """`simulate_every`, the sets dealt out over `workers` threads."""
    for k in prange(workers):
        simulate_every(sets, ends, inputs, capacity, out, status, k, workers)
