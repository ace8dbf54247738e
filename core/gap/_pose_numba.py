"""Compiled: pose errors as a random walk along a predicted path. Plain arrays in and out.

The predicted path is set down anew at restarts, so the true pose is `path + d` with a small `d` (x, y, theta in the
map) that jumps at every restart by what the old stretch's end and the new stretch's start differ. Within a stretch a
heading error swings the way driven. `d` walks with the distance driven; readings of poses see it linearly.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
compiled = njit(cache=True, nogil=True, error_model="numpy")

TURN_WAY = 0.15
"""A turn of one radian lets the pose walk as far as this way driven [m/rad]: half a small robot's track."""
SIDE = 0.3
"""Walk of the position [m] per walk of the heading [rad], where readings do not tell it."""
DAMPED = 0.7
"""Damping of what a smoothed curve through rounded angles is off by: hardly a swing, and nothing that lasts."""


@compiled
def whiten_poses(
    pose: Array,
    rows: Array,
    variance: Array,
    restart: Flags,
    jumps: Array,
    start: Array,
    walk: float,
    side: float,
    readings: Array,
) -> Array:
    """Innovations of a Kalman filter, in place, for many right-hand sides at once.

    pose (E, 3): predicted pose at each event, for a restart the old stretch's end; rows (E, 3): a reading's derivative
    by d, variance (E,): its noise; restart (E,): whether the event is one, then rows holds the new stretch's start.
    jumps (K, 3, M): what d gains at each restart; start (3, 3): covariance of d at first. walk: the heading's, in
    rad per root of m driven; side: the position's, in m per rad of that. readings (E, M): residual and columns of
    Jacobian; becomes innovations over their standard deviation, zero at restarts and where the variance is infinite.
    Returns (E,) log variances (0 there).
    """
    events, sides = readings.shape
    d = np.zeros((3, sides))
    p = start.copy()
    gain, ph = np.empty(3), np.empty(3)
    logs = np.zeros(events)
    x, y, theta = pose[0, 0], pose[0, 1], pose[0, 2]
    k = 0
    for i in range(events):
        dx, dy = pose[i, 0] - x, pose[i, 1] - y
        way = np.sqrt(dx * dx + dy * dy) + TURN_WAY * abs(pose[i, 2] - theta)
        x, y, theta = pose[i, 0], pose[i, 1], pose[i, 2]
        for m in range(sides):
            d[0, m] -= dy * d[2, m]
            d[1, m] += dx * d[2, m]
        c0, c1, c2 = p[0, 2] - dy * p[2, 2], p[1, 2] + dx * p[2, 2], p[2, 2]
        p00 = p[0, 0] - dy * (p[0, 2] + c0)
        p01 = p[0, 1] - dy * p[1, 2] + dx * c0
        p11 = p[1, 1] + dx * (p[1, 2] + c1)
        q = walk * walk * way
        p[0, 0], p[1, 1], p[2, 2] = p00 + side * side * q, p11 + side * side * q, c2 + q
        p[0, 1], p[1, 0], p[0, 2], p[2, 0], p[1, 2], p[2, 1] = p01, p01, c0, c0, c1, c1
        if restart[i]:
            for m in range(sides):
                d[0, m] += jumps[k, 0, m]
                d[1, m] += jumps[k, 1, m]
                d[2, m] += jumps[k, 2, m]
                readings[i, m] = 0.0
            x, y, theta = rows[i, 0], rows[i, 1], rows[i, 2]
            k += 1
            continue
        if not np.isfinite(variance[i]):
            for m in range(sides):
                readings[i, m] = 0.0
            continue
        h0, h1, h2 = rows[i, 0], rows[i, 1], rows[i, 2]
        s = variance[i]
        for a in range(3):
            ph[a] = p[a, 0] * h0 + p[a, 1] * h1 + p[a, 2] * h2
        s += h0 * ph[0] + h1 * ph[1] + h2 * ph[2]
        for a in range(3):
            gain[a] = ph[a] / s
        root = 1.0 / np.sqrt(s)
        logs[i] = np.log(s)
        for m in range(sides):
            e = readings[i, m] - (h0 * d[0, m] + h1 * d[1, m] + h2 * d[2, m])
            d[0, m] += gain[0] * e
            d[1, m] += gain[1] * e
            d[2, m] += gain[2] * e
            readings[i, m] = e * root
        for a in range(3):
            for b in range(3):
                p[a, b] -= gain[a] * ph[b]
    return logs


@compiled
def step(pose: Array, increment: Array) -> Array:
    """A pose, moved by an increment (x, y, theta) in its own frame."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    out = np.empty(3)
    out[0] = pose[0] + c * increment[0] - s * increment[1]
    out[1] = pose[1] + s * increment[0] + c * increment[1]
    out[2] = pose[2] + increment[2]
    return out


@compiled
def predicted(kind: int, pose: Array, tag: Array, anchor: Array) -> tuple[float, float, float, float]:
    """(reading, its derivative by x, y, theta) of a fix's x, y, theta (kind 0, 1, 2) or a range (3)."""
    if kind == 2:
        return pose[2], 0.0, 0.0, 1.0
    c, s = np.cos(pose[2]), np.sin(pose[2])
    tx, ty = c * tag[0] - s * tag[1], s * tag[0] + c * tag[1]
    if kind == 0:
        return pose[0] + tx, 1.0, 0.0, -ty
    if kind == 1:
        return pose[1] + ty, 0.0, 1.0, tx
    dx, dy, dz = pose[0] + tx - anchor[0], pose[1] + ty - anchor[1], tag[2] - anchor[2]
    far = max(np.sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
    return far, dx / far, dy / far, (dy * tx - dx * ty) / far


@compiled
def product(a: Array, b: Array, out: Array) -> None:
    """out = a @ b, all (3, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@compiled
def whiten_offset(t: Array, sigma: Array, density: float, sway: float, pace: float, values: Array) -> float:
    """Innovations of readings (M, N), in place, whose offset walks from 0 at t = 0 and sways; sum of log variances.

    sigma (N,): white noise; density: of the walk, per root of a second. sway: standard deviation of the rate of a
    swing of angular frequency `pace` [rad/s], damped by DAMPED, under white noise: an angle that is known, but for
    rounding. As `whiten_poses`, over standard deviations.
    """
    sides, n = values.shape
    state = np.zeros((3, sides))  # walk, angle, its rate
    p, f, left, gain = np.zeros((3, 3)), np.eye(3), np.zeros((3, 3)), np.empty(3)
    rest0, rest1 = (sway / pace) ** 2 if sway > 0.0 else 0.0, sway * sway
    p[1, 1], p[2, 2] = rest0, rest1
    last, logs = 0.0, 0.0
    fade, turn = DAMPED * pace, pace * np.sqrt(1.0 - DAMPED * DAMPED)
    for k in range(n):
        h = max(t[k] - last, 0.0)
        last = max(t[k], last)
        if sway > 0.0:
            decay, c, s = np.exp(-fade * h), np.cos(turn * h), np.sin(turn * h)
            f[1, 1], f[1, 2] = decay * (c + fade / turn * s), decay * s / turn
            f[2, 1], f[2, 2] = -decay * pace * pace / turn * s, decay * (c - fade / turn * s)
            for m in range(sides):
                angle, rate = state[1, m], state[2, m]
                state[1, m] = f[1, 1] * angle + f[1, 2] * rate
                state[2, m] = f[2, 1] * angle + f[2, 2] * rate
            p[1, 1] -= rest0  # the excess over what is at rest fades, the rest is renewed
            p[2, 2] -= rest1
            product(f, p, left)
            for a in range(3):
                for b in range(3):
                    p[a, b] = left[a, 0] * f[b, 0] + left[a, 1] * f[b, 1] + left[a, 2] * f[b, 2]
            p[1, 1] += rest0
            p[2, 2] += rest1
        p[0, 0] += density * density * h
        spread = p[0, 0] + 2.0 * p[0, 2] + p[2, 2] + sigma[k] * sigma[k]
        for a in range(3):
            gain[a] = (p[a, 0] + p[a, 2]) / spread
        root = 1.0 / np.sqrt(spread)
        logs += np.log(spread)
        for m in range(sides):
            e = values[m, k] - state[0, m] - state[2, m]
            for a in range(3):
                state[a, m] += gain[a] * e
            values[m, k] = e * root
        for a in range(3):
            for b in range(3):
                p[a, b] -= gain[a] * gain[b] * spread
    return logs


@compiled
def inverse(a: Array, out: Array) -> None:
    """out = the inverse of a symmetric (3, 3) matrix, by cofactors."""
    c00, c01 = a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1], a[1, 2] * a[2, 0] - a[1, 0] * a[2, 2]
    c02 = a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0]
    det = a[0, 0] * c00 + a[0, 1] * c01 + a[0, 2] * c02
    out[0, 0], out[0, 1], out[0, 2] = c00 / det, c01 / det, c02 / det
    out[1, 0], out[2, 0] = out[0, 1], out[0, 2]
    out[1, 1] = (a[0, 0] * a[2, 2] - a[0, 2] * a[2, 0]) / det
    out[1, 2] = (a[0, 2] * a[1, 0] - a[0, 0] * a[1, 2]) / det
    out[2, 1] = out[1, 2]
    out[2, 2] = (a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]) / det


@compiled
def carry(p: Array, dx: float, dy: float, out: Array) -> None:
    """out = F p, F the swing of a position by a heading error over (dx, dy)."""
    for j in range(3):
        out[0, j] = p[0, j] - dy * p[2, j]
        out[1, j] = p[1, j] + dx * p[2, j]
        out[2, j] = p[2, j]


@compiled
def smooth_poses(
    increments: Array,
    kinds: npt.NDArray[np.int64],
    values: Array,
    variance: Array,
    tag: Array,
    anchors: Array,
    start: Array,
    start_sd: Array,
    walk: float,
    gate: float,
) -> tuple[Array, Array]:
    """Extended Kalman filter over events, then the fixed-interval smoother: poses (E, 3) and their variances (E, 3).

    increments (E, 3): motion in the body since the event before. kinds, values, variance (E,): the readings (kind -1:
    none); anchors (E, 3): the beacon of a range. A reading off by more than `gate` deviations counts by its square
    root: outliers pull little, a wrong start still comes back.
    """
    events = increments.shape[0]
    post, cov = np.empty((events, 3)), np.empty((events, 3, 3))
    prior, prior_cov = np.empty((events, 3)), np.empty((events, 3, 3))
    swings = np.empty((events, 2))
    pose, p = start.copy(), np.zeros((3, 3))
    left, gain, ph = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for a in range(3):
        p[a, a] = start_sd[a] * start_sd[a]
    for i in range(events):
        moved = step(pose, increments[i])
        dx, dy = moved[0] - pose[0], moved[1] - pose[1]
        way = np.sqrt(dx * dx + dy * dy) + TURN_WAY * abs(increments[i, 2])
        pose = moved
        swings[i, 0], swings[i, 1] = dx, dy
        carry(p, dx, dy, left)
        for a in range(3):
            p[a, 0] = left[a, 0] - dy * left[a, 2]
            p[a, 1] = left[a, 1] + dx * left[a, 2]
            p[a, 2] = left[a, 2]
        q = walk * walk * way + 1e-12
        p[0, 0] += SIDE * SIDE * q
        p[1, 1] += SIDE * SIDE * q
        p[2, 2] += q
        prior[i], prior_cov[i] = pose, p
        if kinds[i] >= 0 and np.isfinite(values[i]):
            far, h0, h1, h2 = predicted(kinds[i], pose, tag, anchors[i])
            e = values[i] - far
            if kinds[i] == 2:
                e = (e + np.pi) % (2.0 * np.pi) - np.pi
            for a in range(3):
                ph[a] = p[a, 0] * h0 + p[a, 1] * h1 + p[a, 2] * h2
            spread = h0 * ph[0] + h1 * ph[1] + h2 * ph[2]
            s = spread + variance[i]
            ratio = abs(e) / np.sqrt(s)
            if ratio > gate:
                s = spread + variance[i] * (ratio / gate) ** 2
            for a in range(3):
                pose[a] += ph[a] / s * e
                for b in range(3):
                    p[a, b] -= ph[a] * ph[b] / s
        post[i], cov[i] = pose, p
    sd = np.empty((events, 3))
    for i in range(events - 1, -1, -1):
        if i < events - 1:
            carry(cov[i], swings[i + 1, 0], swings[i + 1, 1], left)
            inverse(prior_cov[i + 1], p)
            product(p, left, gain)  # transposed
            for a in range(3):
                for b in range(3):
                    post[i, a] += gain[b, a] * (post[i + 1, b] - prior[i + 1, b])
                    p[a, b] = cov[i + 1, a, b] - prior_cov[i + 1, a, b]
            product(p, gain, left)
            for a in range(3):
                for b in range(3):
                    cov[i, a, b] += gain[0, a] * left[0, b] + gain[1, a] * left[1, b] + gain[2, a] * left[2, b]
        for a in range(3):
            sd[i, a] = cov[i, a, a]
    return post, sd
