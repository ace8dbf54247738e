"""Compiled: a path -> what each sensor reads, without noise. Plain arrays in and out."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from core.simulation import _rollout_numba as R
from core.simulation import params as P
from core.simulation._drive_numba import compiled

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

GRAVITY = 9.80665


@compiled
def find(nodes: Array, n: int, i: int, t: float) -> int:
    """The last node at or before t, walking on from node i; the last but one at most."""
    while i + 2 < n and nodes[i + 1, R.T] <= t:
        i += 1
    while i > 0 and nodes[i, R.T] > t:
        i -= 1
    return i


@compiled
def between(nodes: Array, i: int, t: float, column: int, rate: int) -> float:
    """Cubic through two nodes' values and rates; held outside them."""
    a, b = nodes[i], nodes[i + 1]
    h = b[R.T] - a[R.T]
    if t >= b[R.T] or h <= 0.0:
        return b[column]
    if t <= a[R.T]:
        return a[column]
    s = (t - a[R.T]) / h
    d, ra, rb = b[column] - a[column], h * a[rate], h * b[rate]
    return a[column] + s * (ra + s * (3.0 * d - 2.0 * ra - rb + s * (ra + rb - 2.0 * d)))


@compiled
def sense_wheels(par: Array, nodes: Array, n: int, stamps: Array, left: Array, right: Array) -> None:
    """Encoder angles [rad] before they are rounded down to ticks."""
    i = 0
    share_l, share_r = (1.0 - par[P.MISSED_LEFT]) / par[P.RADIUS], (1.0 - par[P.MISSED_RIGHT]) / par[P.RADIUS]
    for k in range(stamps.shape[0]):
        i = find(nodes, n, i, stamps[k])
        left[k] = share_l * between(nodes, i, stamps[k], R.PL, R.SL)
        right[k] = share_r * between(nodes, i, stamps[k], R.PR, R.SR)


@compiled
def sense_pose(nodes: Array, n: int, stamps: Array, x: Array, y: Array, theta: Array) -> None:
    """Body poses at the stamps."""
    i = 0
    for k in range(stamps.shape[0]):
        i = find(nodes, n, i, stamps[k])
        x[k] = between(nodes, i, stamps[k], R.X, R.XD)
        y[k] = between(nodes, i, stamps[k], R.Y, R.YD)
        theta[k] = between(nodes, i, stamps[k], R.TH, R.W)


@compiled
def tag(par: Array, nodes: Array, i: int, t: float) -> tuple[float, float, float]:
    """(x, y) of the tag and the body's heading; NaN while the tag is in the shadow."""
    theta = between(nodes, i, t, R.TH, R.W)
    x, y = between(nodes, i, t, R.X, R.XD), between(nodes, i, t, R.Y, R.YD)
    if par[P.TAG_X] != 0.0 or par[P.TAG_Y] != 0.0:
        c, s = np.cos(theta), np.sin(theta)
        x += c * par[P.TAG_X] - s * par[P.TAG_Y]
        y += s * par[P.TAG_X] + c * par[P.TAG_Y]
    radius = par[P.SHADOW_RADIUS]
    if radius > 0.0 and (x - par[P.SHADOW_X]) ** 2 + (y - par[P.SHADOW_Y]) ** 2 < radius * radius:
        return np.nan, np.nan, np.nan
    return x, y, theta


@compiled
def sense_beacon(par: Array, nodes: Array, n: int, stamps: Array, x: Array, y: Array, theta: Array) -> None:
    """Fixes: the tag's pose `delay` ago, rotated, then scaled, then shifted."""
    i = 0
    c, s = np.cos(par[P.FIX_ANGLE]), np.sin(par[P.FIX_ANGLE])
    for k in range(stamps.shape[0]):
        t = stamps[k] - par[P.FIX_DELAY]
        i = find(nodes, n, i, t)
        tx, ty, heading = tag(par, nodes, i, t)
        x[k] = par[P.FIX_SCALE] * (c * tx - s * ty) + par[P.FIX_X]
        y[k] = par[P.FIX_SCALE] * (s * tx + c * ty) + par[P.FIX_Y]
        theta[k] = heading + par[P.FIX_ANGLE]


@compiled
def sense_ranges(par: Array, nodes: Array, n: int, stamps: Array, beacon: Indices, anchors: Array, out: Array) -> None:
    """Distances in 3D from the tag `delay` ago to the beacons, scaled, then biased. anchors (A, 3) [m]."""
    i = 0
    for k in range(stamps.shape[0]):
        t = stamps[k] - par[P.FIX_DELAY]
        i = find(nodes, n, i, t)
        tx, ty, _ = tag(par, nodes, i, t)
        dx, dy, dz = anchors[beacon[k], 0] - tx, anchors[beacon[k], 1] - ty, anchors[beacon[k], 2] - par[P.TAG_Z]
        if beacon[k] == par[P.ANCHOR]:
            dx, dy = dx + par[P.ANCHOR_X], dy + par[P.ANCHOR_Y]
        out[k] = par[P.FIX_SCALE] * np.sqrt(dx * dx + dy * dy + dz * dz) + par[P.RANGE_BIAS]


@compiled
def specific_force(par: Array, a: Array, b: Array, rate: float, c: float, s: float) -> tuple[float, float]:
    """Mean specific force over a window, from its edges' rows, in the IMU's own axes turned by (c, s).

    rate: one over the window's length [1/s].
    """
    v, vy, w = b[R.EDGE_V] - a[R.EDGE_V], b[R.EDGE_VY] - a[R.EDGE_VY], b[R.EDGE_W] - a[R.EDGE_W]
    wv, wvy, ww = b[R.EDGE_WV] - a[R.EDGE_WV], b[R.EDGE_WVY] - a[R.EDGE_WVY], b[R.EDGE_WW] - a[R.EDGE_WW]
    fx = rate * (v - wvy - w * par[P.IMU_Y] - ww * par[P.IMU_X])
    fy = rate * (vy + wv + w * par[P.IMU_X] - ww * par[P.IMU_Y])
    if par[P.TILT_X] != 0.0 or par[P.TILT_Y] != 0.0:
        g = GRAVITY * rate
        gc, gs = g * (b[R.EDGE_CC] - a[R.EDGE_CC]), g * (b[R.EDGE_SS] - a[R.EDGE_SS])
        fx += par[P.TILT_X] * gc + par[P.TILT_Y] * gs
        fy += par[P.TILT_Y] * gc - par[P.TILT_X] * gs
    return c * fx + s * fy, c * fy - s * fx


@compiled
def sense_imu(
    par: Array,
    edges: Array,
    lo: Indices,
    hi: Indices,
    grid: Array,
    stamps: Array,
    warmth: Array,
    gz: Array,
    ax: Array,
    ay: Array,
    speed: Array,
) -> None:
    """Means over one sample period: rate, specific force, forward speed. The gyro is not yet clipped.

    edges (G, EDGE): rows at `grid` (G,); lo, hi (N,): each sample's two edges. warmth (N,): temperature - first.
    """
    c, s = np.cos(par[P.IMU_YAW]), np.sin(par[P.IMU_YAW])
    for k in range(stamps.shape[0]):
        a, b = edges[lo[k]], edges[hi[k]]
        rate = 1.0 / ((grid[hi[k]] - grid[lo[k]]) * par[P.CLOCK_RATE])
        fx, fy = specific_force(par, a, b, rate, c, s)
        turn = par[P.GYRO_SCALE] * ((b[R.EDGE_TURN] - a[R.EDGE_TURN]) * rate) + par[P.BIAS]
        if par[P.DRIFT] != 0.0:
            t = max((stamps[k] - par[P.CLOCK_OFFSET]) * par[P.CLOCK_RATE], 0.0)
            turn += par[P.DRIFT] * (1.0 - np.exp(-t / par[P.DRIFT_TAU]))
        gz[k] = turn + par[P.TEMPERATURE] * warmth[k] + par[P.G_SENSITIVITY] * fy
        ax[k] = par[P.ACCEL_SCALE_X] * fx + par[P.ACCEL_BIAS_X]
        ay[k] = par[P.ACCEL_SCALE_Y] * fy + par[P.ACCEL_BIAS_Y]
        speed[k] = 0.5 * (a[R.EDGE_V] + b[R.EDGE_V])


@compiled
def path_edges(par: Array, nodes: Array, n: int, grid: Array, edges: Array) -> None:
    """Window edges' rows of a path that is given by its nodes (smooth: no two share a stamp); held past its ends."""
    i = 0
    for g in range(grid.shape[0]):
        t = (grid[g] - par[P.CLOCK_OFFSET]) * par[P.CLOCK_RATE]
        i = find(nodes, n, i, t)
        s = min(max((t - nodes[i, R.T]) / (nodes[i + 1, R.T] - nodes[i, R.T]), 0.0), 1.0)
        for e, column in enumerate((R.TURN, R.V, R.VY, R.W, R.WV, R.WVY, R.WW, R.CC, R.SS)):
            edges[g, e] = nodes[i, column] + s * (nodes[i + 1, column] - nodes[i, column])
