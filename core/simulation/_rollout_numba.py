"""Compiled: commands -> wheels -> body, piece by piece. Plain arrays in and out; `simulate.py` keeps checks and docs.

Time is cut at every command sample (shifted by the delay), IMU window edge, restart, and event: a wheel enters or
leaves its dead band or a limit, the body crosses the edge of a slip patch. In between, each rim speed is exactly
`p + q*s + c*exp(-s/tau)`, so wheel angles and heading are integrated in closed form and only the small rotation within
a piece (at most MAX_STEP long) is left to Simpson's rule. Speeds may jump between pieces: then two nodes share a stamp.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from core.simulation import params as P

MAX_STEP = 0.01
"""Longest piece [s]."""
EVENT = 1e-9
"""Events nearer than this to a piece's ends [s] are taken as at the ends."""
BUMP_SPAN = 0.3

# Columns of a node. `w` turn rate; the last five are integrals since t = 0 that give means over a window exactly.
(T, X, Y, TH, V, VY, W, XD, YD, PL, PR, SL, SR, TURN, WV, WVY, WW, CC, SS) = range(19)
NODE = 19
# Columns of an IMU window edge: the same quantities at the edge.
EDGE_TURN, EDGE_V, EDGE_VY, EDGE_W, EDGE_WV, EDGE_WVY, EDGE_WW, EDGE_CC, EDGE_SS = range(9)
EDGE = 9

OPTIONS = {"cache": True, "nogil": True, "error_model": "numpy"}


@njit(**OPTIONS)
def _sincos(d):
    """(sin d, cos d); a series for the small turns of one piece (its next term is below 1e-16)."""
    if abs(d) > 0.06:
        return np.sin(d), np.cos(d)
    e = d * d
    return (
        d * (1.0 - e / 6.0 * (1.0 - e / 20.0 * (1.0 - e / 42.0 * (1.0 - e / 72.0)))),
        1.0 - e / 2.0 * (1.0 - e / 12.0 * (1.0 - e / 30.0 * (1.0 - e / 56.0 * (1.0 - e / 90.0)))),
    )


@njit(**OPTIONS)
def _value(piece, s, itau):
    """Speed at `s` of a piece (p, q, c)."""
    p, q, c = piece
    return p + q * s + (c * np.exp(-s * itau) if c != 0.0 else 0.0)


@njit(**OPTIONS)
def _crossing(piece, line, h, itau):
    """The instant in (0, h) where piece - line changes its sign; both are (p, q, c), the sign differs at the ends."""
    lo, hi = 0.0, h
    above = _value(piece, h, itau) > _value(line, h, itau)
    for _ in range(60):
        mid = 0.5 * (lo + hi)
        if (_value(piece, mid, itau) > _value(line, mid, itau)) == above:
            hi = mid
        else:
            lo = mid
    return 0.5 * (lo + hi)


@njit(**OPTIONS)
def _set_point(c, m, h, t, par):
    """Dead band, gain and sag on a set-point c + m*s: (h cut at the band's edge, value, slope)."""
    width = par[P.WIDTH]
    if width > 0.0:
        if m != 0.0:
            for edge in (-width, width):
                at = (edge - c) / m
                if EVENT < at < h - EVENT:
                    h = at
        if abs(c + 0.5 * m * h) < width:
            return h, 0.0, 0.0
    gain, rate = par[P.GAIN], par[P.SAG]
    if rate == 0.0:
        return h, gain * c, gain * m
    start = gain * np.exp(-rate * t) * c  # the sag's curvature within a piece is below 1e-9 m/s
    return h, start, (gain * np.exp(-rate * (t + h)) * (c + m * h) - start) / h


@njit(**OPTIONS)
def _limit_acceleration(piece, z, a, h, itau):
    """A speed that follows `piece` from z no faster than a: (h cut where it changes between following and lagging)."""
    p, q, c = piece
    ahead = p + c - z
    slope = q - c * itau
    if abs(ahead) <= 1e-12 and abs(slope) <= a * (1.0 + 1e-12):
        if c == 0.0:
            return h, piece
        end = q - c * itau * np.exp(-h * itau)
        if abs(end) > a * (1.0 + 1e-9):
            reached = (q - np.sign(end) * a) / (c * itau)
            cut = -np.log(reached) / itau if 0.0 < reached < 1.0 else h
            h = cut if EVENT < cut < h else h
        return h, piece
    sign = np.sign(ahead) if abs(ahead) > 1e-12 else np.sign(slope)
    line = (z, sign * a, 0.0)
    if sign * (_value(piece, h, itau) - _value(line, h, itau)) < 0.0:
        h = max(_crossing(piece, line, h, itau), EVENT)
    return h, line


@njit(**OPTIONS)
def _limit_level(piece, level, h, itau):
    """h cut where |speed| crosses `level`, and whether it is above it within the piece."""
    first, last = _value(piece, 0.0, itau), _value(piece, h, itau)
    if (abs(first) - level) * (abs(last) - level) < 0.0 and min(
        abs(abs(first) - level), abs(abs(last) - level)
    ) > 1e-12:
        outer = last if abs(last) > level else first
        cut = _crossing(piece, (np.sign(outer) * level, 0.0, 0.0), h, itau)
        h = cut if EVENT < cut < h else h
    return h, abs(_value(piece, 0.5 * h, itau)) > level


@njit(**OPTIONS)
def _wheel(c, m, h, t, y, z, par):
    """One wheel's drive chain from `t`: (h cut at its first event, lagged piece, rate-limited piece, rim-speed piece).

    c, m: raw set-point [m/s] and its slope; y, z: states of the lag and of the acceleration limit.
    """
    tau, itau = par[P.TAU], par[P.ITAU]
    h, u, mu = _set_point(c, m, h, t, par)
    lagged = (u, mu, 0.0) if tau == 0.0 else (u - tau * mu, mu, y - u + tau * mu)
    limited = lagged
    if par[P.A_MAX] < np.inf:
        h, limited = _limit_acceleration(lagged, z, par[P.A_MAX], h, itau)
    rim = limited
    if par[P.V_MAX] < np.inf:
        h, above = _limit_level(limited, par[P.V_MAX], h, itau)
        if above:
            rim = (np.sign(_value(limited, 0.5 * h, itau)) * par[P.V_MAX], 0.0, 0.0)
    if par[P.SLIP_K] != 0.0:  # the slip is of the speed's size: cut where it changes its sign
        first, last = _value(rim, 0.0, itau), _value(rim, h, itau)
        if (first > 1e-12 and last < -1e-12) or (first < -1e-12 and last > 1e-12):
            cut = _crossing(rim, (0.0, 0.0, 0.0), h, itau)
            h = cut if EVENT < cut < h else h
    return h, lagged, limited, rim


@njit(**OPTIONS)
def _slip(piece, s, itau, k):
    """Speed lost to slip, clip(k*a, -1, 1)*|v|, `s` into a piece."""
    p, q, c = piece
    e = c * np.exp(-s * itau) if c != 0.0 else 0.0
    return min(max(k * (q - itau * e), -1.0), 1.0) * abs(p + q * s + e)


@njit(**OPTIONS)
def _ground(piece, h, itau, tau, k):
    """Ground speed at 0, h/2, h and ground distance to h/2, h of one wheel; then rim speed and rim distance at h."""
    p, q, c = piece
    half = 0.5 * h
    v0, vm, v1 = p, p + q * half, p + q * h
    dm, d1 = half * (p + 0.25 * q * h), h * (p + 0.5 * q * h)
    if c != 0.0:
        em = np.exp(-half * itau)
        e1 = em * em
        v0, vm, v1 = v0 + c, vm + c * em, v1 + c * e1
        dm, d1 = dm + c * tau * (1.0 - em), d1 + c * tau * (1.0 - e1)
    rim, distance = v1, d1
    if k != 0.0:
        s0, sm, s1 = _slip(piece, 0.0, itau, k), _slip(piece, half, itau, k), _slip(piece, h, itau, k)
        v0, vm, v1 = v0 - s0, vm - sm, v1 - s1
        dm -= h / 24.0 * (5.0 * s0 + 8.0 * sm - s1)
        d1 -= h / 6.0 * (s0 + 4.0 * sm + s1)
    return v0, vm, v1, dm, d1, rim, distance


@njit(**OPTIONS)
def _bump(u):
    """Share of a bump's speed [1/s] and of its way at `u` seconds into it."""
    u = min(max(u, 0.0), BUMP_SPAN)
    a = 2.0 * np.pi * u / BUMP_SPAN
    return (1.0 - np.cos(a)) / BUMP_SPAN, u / BUMP_SPAN - np.sin(a) / (2.0 * np.pi)


@njit(**OPTIONS)
def _body(left, right, h, t, inside, par):
    """The body's motion over h, in its own frame at the start.

    Returns (dx, dy, turn), (v, vy, w) at the start, the same at the end, the five integrals, and rims at the end.
    """
    k, itau, tau = par[P.SLIP_K], par[P.ITAU], par[P.TAU]
    l0, lm, l1, ldm, ld1, rim_l, way_l = _ground(left, h, itau, tau, k)
    r0, rm, r1, rdm, rd1, rim_r, way_r = _ground(right, h, itau, tau, k)
    grip = 1.0 - par[P.PATCH_SLIP] if inside else 1.0
    fl, fr, ib = grip * par[P.SCALE_L], grip * par[P.SCALE_R], par[P.IB]
    v0, vm, v1, d1 = (
        0.5 * (fl * l0 + fr * r0),
        0.5 * (fl * lm + fr * rm),
        0.5 * (fl * l1 + fr * r1),
        0.5 * (fl * ld1 + fr * rd1),
    )
    w0, wm, w1 = ib * (fr * r0 - fl * l0), ib * (fr * rm - fl * lm), ib * (fr * r1 - fl * l1)
    am, a1 = ib * (fr * rdm - fl * ldm), ib * (fr * rd1 - fl * ld1)
    side = par[P.SIDE_K]
    y0, ym, y1 = -side * v0 * w0, -side * vm * wm, -side * v1 * w1
    since = t - par[P.BUMP_TIME]
    if par[P.BUMP] != 0.0 and -h < since < BUMP_SPAN:
        (b0, p0), (bm, pm), (b1, p1) = _bump(since), _bump(since + 0.5 * h), _bump(since + h)
        distance, turn = par[P.BUMP_DISTANCE], par[P.BUMP_TURN]
        v0, vm, v1, d1 = v0 + distance * b0, vm + distance * bm, v1 + distance * b1, d1 + distance * (p1 - p0)
        w0, wm, w1 = w0 + turn * b0, wm + turn * bm, w1 + turn * b1
        am, a1 = am + turn * (pm - p0), a1 + turn * (p1 - p0)
    sm, cm = _sincos(am)
    s1, c1 = _sincos(a1)
    x6 = h / 6.0
    dx = d1 + x6 * (4.0 * (vm * (cm - 1.0) - ym * sm) + v1 * (c1 - 1.0) - y1 * s1)
    dy = x6 * (y0 + 4.0 * (vm * sm + ym * cm) + v1 * s1 + y1 * c1)
    sums = (
        x6 * (w0 * v0 + 4.0 * wm * vm + w1 * v1),
        x6 * (w0 * y0 + 4.0 * wm * ym + w1 * y1),
        x6 * (w0 * w0 + 4.0 * wm * wm + w1 * w1),
        x6 * (1.0 + 4.0 * cm + c1),
        x6 * (4.0 * sm + s1),
    )
    return (dx, dy, a1, s1, c1), (v0, y0, w0), (v1, y1, w1), sums, (rim_l, way_l, rim_r, way_r)


@njit(**OPTIONS)
def _command(times, values, j, t, delay):
    """Set-point and its slope at t, j the last sample at or before it (-1: none yet); held past the ends."""
    if j < 0:
        return values[0], 0.0
    if j >= times.shape[0] - 1:
        return values[times.shape[0] - 1], 0.0
    slope = (values[j + 1] - values[j]) / (times[j + 1] - times[j])
    return values[j] + slope * (t - delay - times[j]), slope


@njit(**OPTIONS)
def _depth(x, y, par):
    """How far inside the slip patch a point lies [m]; negative outside."""
    return par[P.PATCH_RADIUS] - np.sqrt((x - par[P.PATCH_X]) ** 2 + (y - par[P.PATCH_Y]) ** 2)


@njit(**OPTIONS)
def _cut_at_patch(left, right, h, state, inside, par):
    """h cut where the body crosses the patch's edge, and whether it does."""
    s, c = np.sin(state[TH]), np.cos(state[TH])
    sign = -1.0 if inside else 1.0
    (dx, dy, _, _, _), _, _, _, _ = _body(left, right, h, state[T], inside, par)
    if sign * _depth(state[X] + c * dx - s * dy, state[Y] + s * dx + c * dy, par) <= 1e-10:
        return h, False
    lo, hi = 0.0, h
    for _ in range(50):
        mid = 0.5 * (lo + hi)
        (dx, dy, _, _, _), _, _, _, _ = _body(left, right, mid, state[T], inside, par)
        if sign * _depth(state[X] + c * dx - s * dy, state[Y] + s * dx + c * dy, par) > 0.0:
            hi = mid
        else:
            lo = mid
    return max(hi, EVENT), True


@njit(**OPTIONS)
def _put_speeds(state, speeds, c, s):
    """Body speeds (v, vy, w) and the map velocity that they are at heading (c, s)."""
    v, vy, w = speeds
    state[V], state[VY], state[W] = v, vy, w
    state[XD], state[YD] = c * v - s * vy, s * v + c * vy


@njit(**OPTIONS)
def _put_edge(edges, g, state):
    """The window edge's row from the state at its instant."""
    row = edges[g]
    row[EDGE_TURN], row[EDGE_V], row[EDGE_VY], row[EDGE_W] = state[TURN], state[V], state[VY], state[W]
    row[EDGE_WV], row[EDGE_WVY], row[EDGE_WW] = state[WV], state[WVY], state[WW]
    row[EDGE_CC], row[EDGE_SS] = state[CC], state[SS]


@njit(**OPTIONS)
def _at_rest(par, grid, nodes, edges, state):
    """Start pose into `state` and the first two nodes; rows of the window edges before t = 0. Returns how many."""
    state[X], state[Y], state[TH] = par[P.X0], par[P.Y0], par[P.TH0]
    state[T] = -1e6
    nodes[0] = state
    g = 0
    while g < grid.shape[0] and (grid[g] - par[P.CLOCK_OFFSET]) / (1.0 + par[P.CLOCK_SKEW]) <= 0.0:
        t = (grid[g] - par[P.CLOCK_OFFSET]) / (1.0 + par[P.CLOCK_SKEW])
        state[CC], state[SS] = t * np.cos(par[P.TH0]), t * np.sin(par[P.TH0])
        _put_edge(edges, g, state)
        g += 1
    state[T], state[CC], state[SS] = 0.0, 0.0, 0.0
    nodes[1] = state
    return g


@njit(**OPTIONS)
def _advance(state, step, h, c, s):
    """Add one piece's motion to the state; returns the new (cos, sin) of the heading."""
    (dx, dy, turn, sin_turn, cos_turn), _, end, sums, (rim_l, way_l, rim_r, way_r) = step
    state[X] += c * dx - s * dy
    state[Y] += s * dx + c * dy
    state[TH] += turn
    state[TURN] += turn
    state[WV] += sums[0]
    state[WVY] += sums[1]
    state[WW] += sums[2]
    state[CC] += c * sums[3] - s * sums[4]
    state[SS] += s * sums[3] + c * sums[4]
    state[PL] += way_l
    state[PR] += way_r
    state[SL], state[SR] = rim_l, rim_r
    c, s = c * cos_turn - s * sin_turn, s * cos_turn + c * sin_turn
    scale = 1.5 - 0.5 * (c * c + s * s)
    c, s = c * scale, s * scale
    _put_speeds(state, end, c, s)
    return c, s


@njit(**OPTIONS)
def _target(par, t, t_end, times, j, grid, g, restarts, k):
    """The next instant at which the piece that starts at t must end at the latest."""
    to = min(t_end, t + MAX_STEP)
    if j + 1 < times.shape[0]:
        to = min(to, times[j + 1] + par[P.DELAY])
    if g < grid.shape[0]:
        to = min(to, (grid[g] - par[P.CLOCK_OFFSET]) / (1.0 + par[P.CLOCK_SKEW]))
    if k < restarts.shape[0]:
        to = min(to, restarts[k, 0])
    if par[P.BUMP] != 0.0:
        for edge in (par[P.BUMP_TIME], par[P.BUMP_TIME] + BUMP_SPAN):
            if edge > t + EVENT:
                to = min(to, edge)
    return to


@njit(**OPTIONS)
def rollout(par, times, left, right, grid, restarts, t_end, nodes, edges):
    """Drive and body from rest at t = 0 to t_end.

    par: packed parameters. times (C,): command stamps; left, right (C,): rim set-points [m/s]. grid (G,): IMU window
    edges, in the IMU's stamps. restarts (K, 4): t, x, y, theta at which the pose is set anew. Fills nodes (cap, NODE)
    and edges (G, EDGE); returns the number of nodes, or -1 if `nodes` is too short.
    """
    state = np.zeros(NODE)
    g = _at_rest(par, grid, nodes, edges, state)
    n, j, k, t = 2, -1, 0, 0.0
    yl, yr, zl, zr = 0.0, 0.0, 0.0, 0.0
    c, s = np.cos(state[TH]), np.sin(state[TH])
    patch = par[P.PATCH_SLIP] != 0.0
    inside = patch and _depth(state[X], state[Y], par) > 0.0
    while t < t_end - 1e-12:
        if n + 4 > nodes.shape[0]:
            return -1
        while k < restarts.shape[0] and restarts[k, 0] <= t + 1e-12:
            state[X], state[Y], state[TH] = restarts[k, 1], restarts[k, 2], restarts[k, 3]
            c, s = np.cos(state[TH]), np.sin(state[TH])
            inside = patch and _depth(state[X], state[Y], par) > 0.0
            _put_speeds(state, (state[V], state[VY], state[W]), c, s)
            nodes[n] = state
            n, k = n + 1, k + 1
        while j + 1 < times.shape[0] and times[j + 1] + par[P.DELAY] <= t + 1e-12:
            j += 1
        to = _target(par, t, t_end, times, j, grid, g, restarts, k)
        h = to - t
        cl, ml = _command(times, left, j, t, par[P.DELAY])
        cr, mr = _command(times, right, j, t, par[P.DELAY])
        h, lag_l, limited_l, rim_l = _wheel(cl, ml, h, t, yl, zl, par)
        h, lag_r, limited_r, rim_r = _wheel(cr, mr, h, t, yr, zr, par)
        crosses = False
        if patch:
            h, crosses = _cut_at_patch(rim_l, rim_r, h, state, inside, par)
        step = _body(rim_l, rim_r, h, t, inside, par)
        start = step[1]
        rims = rim_l[0] + rim_l[2], rim_r[0] + rim_r[2]
        jump = abs(start[0] - state[V]) + abs(start[2] - state[W]) + abs(rims[0] - state[SL]) + abs(rims[1] - state[SR])
        if jump > 1e-9:
            _put_speeds(state, start, c, s)
            state[SL], state[SR] = rims
            nodes[n] = state
            n += 1
        c, s = _advance(state, step, h, c, s)
        itau = par[P.ITAU]
        yl, yr = _value(lag_l, h, itau), _value(lag_r, h, itau)
        zl, zr = _value(limited_l, h, itau), _value(limited_r, h, itau)
        inside = inside != crosses
        t = to if t + h >= to - 1e-12 else t + h
        state[T] = t
        nodes[n] = state
        n += 1
        while g < grid.shape[0] and (grid[g] - par[P.CLOCK_OFFSET]) / (1.0 + par[P.CLOCK_SKEW]) <= t + 1e-12:
            _put_edge(edges, g, state)
            g += 1
    return n
