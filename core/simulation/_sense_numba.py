"""Compiled: a path -> what each sensor reads, without noise. Plain arrays in and out."""

from __future__ import annotations

import numpy as np
from numba import njit

from core.simulation import params as P
from core.simulation._rollout_numba import (
    EDGE_CC,
    EDGE_SS,
    EDGE_TURN,
    EDGE_V,
    EDGE_VY,
    EDGE_W,
    EDGE_WV,
    EDGE_WVY,
    EDGE_WW,
    OPTIONS,
    PL,
    PR,
    SL,
    SR,
    TH,
    TURN,
    XD,
    YD,
    T,
    V,
    W,
    X,
    Y,
)

GRAVITY = 9.80665


@njit(**OPTIONS)
def _find(nodes, n, i, t):
    """The last node at or before t, walking on from node i; the last but one at most."""
    while i + 2 < n and nodes[i + 1, T] <= t:
        i += 1
    while i > 0 and nodes[i, T] > t:
        i -= 1
    return i


@njit(**OPTIONS)
def _between(nodes, i, t, column, rate):
    """Cubic through two nodes' values and rates; held outside them."""
    a, b = nodes[i], nodes[i + 1]
    h = b[T] - a[T]
    if t >= b[T] or h <= 0.0:
        return b[column]
    if t <= a[T]:
        return a[column]
    s = (t - a[T]) / h
    d = b[column] - a[column]
    return a[column] + s * (
        h * a[rate] + s * (3.0 * d - h * (2.0 * a[rate] + b[rate]) + s * (h * (a[rate] + b[rate]) - 2.0 * d))
    )


@njit(**OPTIONS)
def sense_wheels(par, nodes, n, stamps, left, right):
    """Encoder angles [rad] before they are rounded down to ticks."""
    i = 0
    for k in range(stamps.shape[0]):
        i = _find(nodes, n, i, stamps[k])
        left[k] = (1.0 - par[P.MISSED_LEFT]) * (_between(nodes, i, stamps[k], PL, SL) / par[P.RADIUS])
        right[k] = (1.0 - par[P.MISSED_RIGHT]) * (_between(nodes, i, stamps[k], PR, SR) / par[P.RADIUS])


@njit(**OPTIONS)
def sense_pose(nodes, n, stamps, x, y, theta):
    """Body poses at the stamps."""
    i = 0
    for k in range(stamps.shape[0]):
        i = _find(nodes, n, i, stamps[k])
        x[k] = _between(nodes, i, stamps[k], X, XD)
        y[k] = _between(nodes, i, stamps[k], Y, YD)
        theta[k] = _between(nodes, i, stamps[k], TH, W)


@njit(**OPTIONS)
def _tag(par, nodes, i, t):
    """(x, y) of the tag and the body's heading; NaN while the tag is in the shadow."""
    theta = _between(nodes, i, t, TH, W)
    c, s = np.cos(theta), np.sin(theta)
    x = _between(nodes, i, t, X, XD) + c * par[P.TAG_X] - s * par[P.TAG_Y]
    y = _between(nodes, i, t, Y, YD) + s * par[P.TAG_X] + c * par[P.TAG_Y]
    radius = par[P.SHADOW_RADIUS]
    if radius > 0.0 and (x - par[P.SHADOW_X]) ** 2 + (y - par[P.SHADOW_Y]) ** 2 < radius * radius:
        return np.nan, np.nan, np.nan
    return x, y, theta


@njit(**OPTIONS)
def sense_beacon(par, nodes, n, stamps, x, y, theta):
    """Fixes: the tag's pose `delay` ago, rotated, then scaled, then shifted."""
    i = 0
    c, s = np.cos(par[P.FIX_ANGLE]), np.sin(par[P.FIX_ANGLE])
    for k in range(stamps.shape[0]):
        t = stamps[k] - par[P.FIX_DELAY]
        i = _find(nodes, n, i, t)
        tx, ty, heading = _tag(par, nodes, i, t)
        x[k] = par[P.FIX_SCALE] * (c * tx - s * ty) + par[P.FIX_X]
        y[k] = par[P.FIX_SCALE] * (s * tx + c * ty) + par[P.FIX_Y]
        theta[k] = heading + par[P.FIX_ANGLE]


@njit(**OPTIONS)
def sense_ranges(par, nodes, n, stamps, beacon, anchors, out):
    """Distances in 3D from the tag `delay` ago to the beacons, scaled, then biased. anchors (A, 3) [m]."""
    i = 0
    for k in range(stamps.shape[0]):
        t = stamps[k] - par[P.FIX_DELAY]
        i = _find(nodes, n, i, t)
        tx, ty, _ = _tag(par, nodes, i, t)
        dx, dy, dz = anchors[beacon[k], 0] - tx, anchors[beacon[k], 1] - ty, anchors[beacon[k], 2] - par[P.TAG_Z]
        if beacon[k] == par[P.ANCHOR]:
            dx, dy = dx + par[P.ANCHOR_X], dy + par[P.ANCHOR_Y]
        out[k] = par[P.FIX_SCALE] * np.sqrt(dx * dx + dy * dy + dz * dz) + par[P.RANGE_BIAS]


@njit(**OPTIONS)
def _specific_force(par, a, b, span):
    """Mean specific force over a window in the IMU's own axes, from its edges' rows."""
    v, vy, w = (b[EDGE_V] - a[EDGE_V]) / span, (b[EDGE_VY] - a[EDGE_VY]) / span, (b[EDGE_W] - a[EDGE_W]) / span
    wv, wvy = (b[EDGE_WV] - a[EDGE_WV]) / span, (b[EDGE_WVY] - a[EDGE_WVY]) / span
    ww = (b[EDGE_WW] - a[EDGE_WW]) / span
    fx = v - wvy - w * par[P.IMU_Y] - ww * par[P.IMU_X]
    fy = vy + wv + w * par[P.IMU_X] - ww * par[P.IMU_Y]
    if par[P.TILT_X] != 0.0 or par[P.TILT_Y] != 0.0:
        c, s = (b[EDGE_CC] - a[EDGE_CC]) / span, (b[EDGE_SS] - a[EDGE_SS]) / span
        fx += GRAVITY * (par[P.TILT_X] * c + par[P.TILT_Y] * s)
        fy += GRAVITY * (par[P.TILT_Y] * c - par[P.TILT_X] * s)
    c, s = np.cos(par[P.IMU_YAW]), np.sin(par[P.IMU_YAW])
    return c * fx + s * fy, c * fy - s * fx


@njit(**OPTIONS)
def sense_imu(par, edges, lo, hi, grid, stamps, warmth, gz, ax, ay, speed):
    """Means over one sample period: rate, specific force, forward speed. The gyro is not yet clipped.

    edges (G, EDGE): rows at `grid` (G,); lo, hi (N,): each sample's two edges. warmth (N,): temperature - first.
    """
    for k in range(stamps.shape[0]):
        a, b = edges[lo[k]], edges[hi[k]]
        span = (grid[hi[k]] - grid[lo[k]]) / (1.0 + par[P.CLOCK_SKEW])
        fx, fy = _specific_force(par, a, b, span)
        rate = par[P.GYRO_SCALE] * ((b[EDGE_TURN] - a[EDGE_TURN]) / span) + par[P.BIAS]
        if par[P.DRIFT] != 0.0:
            t = max((stamps[k] - par[P.CLOCK_OFFSET]) / (1.0 + par[P.CLOCK_SKEW]), 0.0)
            rate += par[P.DRIFT] * (1.0 - np.exp(-t / par[P.DRIFT_TAU]))
        gz[k] = rate + par[P.TEMPERATURE] * warmth[k] + par[P.G_SENSITIVITY] * fy
        ax[k] = par[P.ACCEL_SCALE_X] * fx + par[P.ACCEL_BIAS_X]
        ay[k] = par[P.ACCEL_SCALE_Y] * fy + par[P.ACCEL_BIAS_Y]
        speed[k] = 0.5 * (a[EDGE_V] + b[EDGE_V])


@njit(**OPTIONS)
def path_edges(nodes, n, grid, offset, skew, edges):
    """Window edges' rows of a path that is given by its nodes (smooth: no two share a stamp); held past its ends."""
    i = 0
    for g in range(grid.shape[0]):
        t = (grid[g] - offset) / (1.0 + skew)
        i = _find(nodes, n, i, t)
        s = (t - nodes[i, T]) / (nodes[i + 1, T] - nodes[i, T])
        for e, column in enumerate((TURN, V, V + 1, W)):
            edges[g, e] = nodes[i, column] + s * (nodes[i + 1, column] - nodes[i, column])
        for e in range(EDGE_WV, EDGE_SS + 1):
            column = TURN + 1 + e - EDGE_WV
            edges[g, e] = nodes[i, column] + s * (nodes[i + 1, column] - nodes[i, column])
