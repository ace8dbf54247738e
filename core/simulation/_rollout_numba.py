"""Compiled: commands -> wheels -> body, piece by piece. Plain arrays in and out; `simulate.py` keeps checks and docs.

Time is cut at every command sample (shifted by the delay), at given instants (the IMU windows' edges), at restarts and
at events: a wheel enters or leaves its dead band or a limit, the body crosses the edge of a slip patch. In between,
each rim speed is exactly `p + q*s + c*exp(-s/tau)` (see `_drive_numba`), so wheel angles and heading are integrated in
closed form and only the small rotation within a piece (at most MAX_STEP long) is left to Simpson's rule. Speeds may
jump between pieces: then two nodes share a stamp.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from core.simulation import params as P
from core.simulation._drive_numba import EVENT, Piece, command, compiled, end_of, ground, halved, inlined, wheel

Array = npt.NDArray[np.float64]
Triple = tuple[float, float, float]

MAX_STEP = 0.01
"""Longest piece [s]."""
DWELL = 0.001
"""After crossing a slip patch's edge the body stays on that side this long [s], or slips that turn it could chatter."""
MIN_STEP = 0.001
"""Shortest piece that a lag asks for [s]."""
BUMP_SPAN = 0.3
SAME = 1e-12
"""Instants nearer than this [s] are one."""
SETTLED = 1e-6
"""A lag's transient below this [m/s] has died out."""
JUMP = 1e-9
"""Speeds that differ by less [m/s, rad/s] do not jump."""

# Columns of a node: pose, speeds in the body and the map, rim distances and speeds; the last six are integrals since
# the start (of w, w*v, w*vy, w*w, cos theta, sin theta), whose differences give the means over an IMU window exactly.
(T, X, Y, TH, V, VY, W, XD, YD, PL, PR, SL, SR, TURN, WV, WVY, WW, CC, SS) = range(19)
NODE = 19
# What the rollout carries beside: heading's cosine and sine, lag and limit state of each wheel, inside a slip patch,
# and when its edge was last crossed; the battery's sag and when it was last worked out.
(COS, SIN, YL, YR, ZL, ZR, INSIDE, CROSSED, SAG, SAGGED) = range(19, 29)
STATE = 29
# Columns of an IMU window edge: the same quantities at the edge.
EDGE_TURN, EDGE_V, EDGE_VY, EDGE_W, EDGE_WV, EDGE_WVY, EDGE_WW, EDGE_CC, EDGE_SS = range(9)
EDGE = 9


@inlined
def sincos(d: float) -> tuple[float, float]:
    """(sin d, cos d); a series for the small turns of one piece (its next term is below 1e-16)."""
    if abs(d) > 0.06:
        return np.sin(d), np.cos(d)
    e = d * d
    return (
        d * (1.0 - e * (1 / 6) * (1.0 - e * (1 / 20) * (1.0 - e * (1 / 42) * (1.0 - e * (1 / 72))))),
        1.0 - e * (1 / 2) * (1.0 - e * (1 / 12) * (1.0 - e * (1 / 30) * (1.0 - e * (1 / 56) * (1.0 - e * (1 / 90))))),
    )


@compiled
def bump(u: float) -> tuple[float, float]:
    """Share of a bump's speed [1/s] and of its way at `u` seconds into it."""
    u = min(max(u, 0.0), BUMP_SPAN)
    a = 2.0 * np.pi * u / BUMP_SPAN
    return (1.0 - np.cos(a)) / BUMP_SPAN, u / BUMP_SPAN - np.sin(a) / (2.0 * np.pi)


@inlined
def body(
    left: Piece, right: Piece, h: float, half: float, t: float, inside: bool, par: Array
) -> tuple[tuple[float, float, float, float, float], Triple, Triple, tuple[float, float, float, float, float]]:
    """The body's motion over h, in its own frame at the start. half: exp(-h/2/tau).

    Returns (dx, dy, turn, its sine, its cosine); (v, vy, w) at the start and at the end; the five integrals.
    """
    l0, lm, l1, ldm, ld1 = ground(left, h, half, par)
    r0, rm, r1, rdm, rd1 = ground(right, h, half, par)
    grip = 1.0 - par[P.PATCH_SLIP] if inside else 1.0
    fl, fr, ib = grip * par[P.SCALE_L], grip * par[P.SCALE_R], par[P.IB]
    l0, lm, l1, ldm, ld1 = fl * l0, fl * lm, fl * l1, fl * ldm, fl * ld1
    r0, rm, r1, rdm, rd1 = fr * r0, fr * rm, fr * r1, fr * rdm, fr * rd1
    v0, vm, v1, d1 = 0.5 * (l0 + r0), 0.5 * (lm + rm), 0.5 * (l1 + r1), 0.5 * (ld1 + rd1)
    w0, wm, w1, am, a1 = ib * (r0 - l0), ib * (rm - lm), ib * (r1 - l1), ib * (rdm - ldm), ib * (rd1 - ld1)
    side = par[P.SIDE_K]
    y0, ym, y1 = -side * v0 * w0, -side * vm * wm, -side * v1 * w1
    since = t - par[P.BUMP_TIME]
    if par[P.BUMP] != 0.0 and -h < since < BUMP_SPAN:
        (b0, p0), (bm, pm), (b1, p1) = bump(since), bump(since + 0.5 * h), bump(since + h)
        way, turn = par[P.BUMP_DISTANCE], par[P.BUMP_TURN]
        v0, vm, v1, d1 = v0 + way * b0, vm + way * bm, v1 + way * b1, d1 + way * (p1 - p0)
        w0, wm, w1 = w0 + turn * b0, wm + turn * bm, w1 + turn * b1
        am, a1 = am + turn * (pm - p0), a1 + turn * (p1 - p0)
    sm, cm = sincos(am)
    s1, c1 = sincos(a1)
    x6 = h * (1 / 6)
    dx = d1 + x6 * (4.0 * (vm * (cm - 1.0) - ym * sm) + v1 * (c1 - 1.0) - y1 * s1)
    dy = x6 * (y0 + 4.0 * (vm * sm + ym * cm) + v1 * s1 + y1 * c1)
    sums = (
        x6 * (w0 * v0 + 4.0 * wm * vm + w1 * v1),
        x6 * (w0 * y0 + 4.0 * wm * ym + w1 * y1),
        x6 * (w0 * w0 + 4.0 * wm * wm + w1 * w1),
        x6 * (1.0 + 4.0 * cm + c1),
        x6 * (4.0 * sm + s1),
    )
    return (dx, dy, a1, s1, c1), (v0, y0, w0), (v1, y1, w1), sums


@compiled
def depth(x: float, y: float, par: Array) -> float:
    """How far inside the slip patch a point lies [m]; negative outside."""
    return par[P.PATCH_RADIUS] - np.sqrt((x - par[P.PATCH_X]) ** 2 + (y - par[P.PATCH_Y]) ** 2)


@compiled
def beyond(left: Piece, right: Piece, h: float, state: Array, par: Array) -> float:
    """How far over the slip patch's edge, seen from where it is, the body is after h [m]."""
    half = np.exp(-0.5 * h * par[P.ITAU])
    (dx, dy, _, _, _), _, _, _ = body(left, right, h, half, state[T], state[INSIDE] != 0.0, par)
    c, s = state[COS], state[SIN]
    over = depth(state[X] + c * dx - s * dy, state[Y] + s * dx + c * dy, par)
    return -over if state[INSIDE] != 0.0 else over


@inlined
def reach(left: Piece, right: Piece, h: float, t: float, par: Array) -> float:
    """At least how far the body can get within h [m]: cheaper than to drive there."""
    if par[P.BUMP] != 0.0 and -h < t - par[P.BUMP_TIME] < BUMP_SPAN:
        return np.inf
    rim = abs(left[0]) + h * abs(left[1]) + abs(left[2]) + abs(right[0]) + h * abs(right[1]) + abs(right[2])
    v = 2.0 * max(par[P.SCALE_L], par[P.SCALE_R]) * rim  # each wheel's slip and the patch may double its speed
    return h * v * (1.0 + 2.0 * abs(par[P.SIDE_K]) * par[P.IB] * v)


@compiled
def cut_at_patch(left: Piece, right: Piece, h: float, state: Array, par: Array) -> tuple[float, bool]:
    """h cut where the body crosses the slip patch's edge, and whether it does."""
    if abs(depth(state[X], state[Y], par)) > reach(left, right, h, state[T], par):
        return h, False
    if beyond(left, right, h, state, par) <= 1e-10:
        return h, False
    lo, hi = 0.0, h
    for _ in range(50):
        mid = 0.5 * (lo + hi)
        if beyond(left, right, mid, state, par) > 0.0:
            hi = mid
        else:
            lo = mid
    return max(hi, EVENT), True


@inlined
def put_speeds(state: Array, speeds: Triple) -> None:
    """Body speeds (v, vy, w) and the map velocity that they are."""
    v, vy, w = speeds
    state[V], state[VY], state[W] = v, vy, w
    state[XD], state[YD] = state[COS] * v - state[SIN] * vy, state[SIN] * v + state[COS] * vy


@compiled
def put_pose(state: Array, x: float, y: float, theta: float, par: Array) -> None:
    """Set the body down at a pose; its speeds run on."""
    state[X], state[Y], state[TH] = x, y, theta
    state[COS], state[SIN] = np.cos(theta), np.sin(theta)
    state[INSIDE] = 1.0 if par[P.PATCH_SLIP] != 0.0 and depth(x, y, par) > 0.0 else 0.0
    put_speeds(state, (state[V], state[VY], state[W]))


@inlined
def put_edge(edges: Array, g: int, state: Array) -> None:
    """The window edge's row from the state at its instant."""
    row = edges[g]
    row[EDGE_TURN], row[EDGE_V], row[EDGE_VY], row[EDGE_W] = state[TURN], state[V], state[VY], state[W]
    row[EDGE_WV], row[EDGE_WVY], row[EDGE_WW] = state[WV], state[WVY], state[WW]
    row[EDGE_CC], row[EDGE_SS] = state[CC], state[SS]


@inlined
def put_node(nodes: Array, n: int, state: Array) -> int:
    """Write the state as node n; returns n + 1."""
    row = nodes[n]
    for i in range(NODE):
        row[i] = state[i]
    return n + 1


@inlined
def edge_at(par: Array, grid: Array, g: int) -> float:
    """The instant of a window edge, out of the IMU's stamps."""
    return (grid[g] - par[P.CLOCK_OFFSET]) * par[P.CLOCK_RATE]


@compiled
def at_rest(par: Array, begin: float, grid: Array, nodes: Array, edges: Array, state: Array) -> int:
    """Start pose into `state` and the first two nodes; rows of the window edges before `begin`. Returns how many."""
    put_pose(state, par[P.X0], par[P.Y0], par[P.TH0], par)
    state[T] = begin - 1e6
    put_node(nodes, 0, state)
    g = 0
    while g < grid.shape[0] and edge_at(par, grid, g) <= begin:
        t = edge_at(par, grid, g) - begin
        state[CC], state[SS] = t * state[COS], t * state[SIN]
        put_edge(edges, g, state)
        g += 1
    state[T], state[CC], state[SS] = begin, 0.0, 0.0
    put_node(nodes, 1, state)
    return g


@inlined
def advance(
    state: Array,
    moved: tuple[float, float, float, float, float],
    end: Triple,
    sums: tuple[float, float, float, float, float],
) -> None:
    """Add one piece's motion of the body to the state."""
    dx, dy, turn, sin_turn, cos_turn = moved
    c, s = state[COS], state[SIN]
    state[X] += c * dx - s * dy
    state[Y] += s * dx + c * dy
    state[TH] += turn
    state[TURN] += turn
    state[WV] += sums[0]
    state[WVY] += sums[1]
    state[WW] += sums[2]
    state[CC] += c * sums[3] - s * sums[4]
    state[SS] += s * sums[3] + c * sums[4]
    c, s = c * cos_turn - s * sin_turn, s * cos_turn + c * sin_turn
    scale = 1.5 - 0.5 * (c * c + s * s)  # one Newton step keeps the rotation a rotation
    state[COS], state[SIN] = c * scale, s * scale
    put_speeds(state, end)


@compiled
def edges_within(
    par: Array, state: Array, left: Piece, right: Piece, h: float, grid: Array, g: int, edges: Array
) -> int:
    """Rows of the window edges inside a piece (not at its end), by as many shorter pieces. Returns the next g."""
    c, s = state[COS], state[SIN]
    while g < grid.shape[0] and edge_at(par, grid, g) < state[T] + h - SAME:
        d = edge_at(par, grid, g) - state[T]
        half = np.exp(-0.5 * d * par[P.ITAU]) if par[P.ITAU] != 0.0 else 1.0
        moved, _, end, sums = body(left, right, d, half, state[T], state[INSIDE] != 0.0, par)
        row = edges[g]
        row[EDGE_TURN] = state[TURN] + moved[2]
        row[EDGE_V], row[EDGE_VY], row[EDGE_W] = end
        row[EDGE_WV], row[EDGE_WVY], row[EDGE_WW] = state[WV] + sums[0], state[WVY] + sums[1], state[WW] + sums[2]
        row[EDGE_CC] = state[CC] + (c * sums[3] - s * sums[4])
        row[EDGE_SS] = state[SS] + (s * sums[3] + c * sums[4])
        g += 1
    return g


@inlined
def piece(
    par: Array,
    state: Array,
    nodes: Array,
    n: int,
    to: float,
    left: Piece,
    right: Piece,
    grid: Array,
    g: int,
    edges: Array,
) -> tuple[int, int]:
    """Drive and body from the state's instant to `to` at most; left, right: set-points. Returns the next n and g."""
    t = state[T]
    h = span = to - t
    sag, fade = 1.0, 0.0
    if par[P.SAG] != 0.0:
        sag = state[SAG] if state[SAGGED] == t else np.exp(-par[P.SAG] * t)
        state[SAG], state[SAGGED] = np.exp(-par[P.SAG] * to), to
        fade = (state[SAG] - sag) / h
    half = halved(h, 0.0, 1.0, par[P.ITAU])
    h, half, lag_l, limited_l, rim_l = wheel(left, h, half, sag, fade, span, state[YL], state[ZL], par)
    h, half, lag_r, limited_r, rim_r = wheel(right, h, half, sag, fade, span, state[YR], state[ZR], par)
    known = h
    if abs(lag_l[2]) + abs(lag_r[2]) > SETTLED:  # so that a cubic between nodes follows the exponential
        h = min(h, max(0.5 * par[P.TAU], MIN_STEP))
    crosses = False
    if par[P.PATCH_SLIP] != 0.0:
        if t < state[CROSSED] + DWELL:
            h = min(h, DWELL)
        else:
            h, crosses = cut_at_patch(rim_l, rim_r, h, state, par)
    half = halved(h, known, half, par[P.ITAU])
    moved, start, end, sums = body(rim_l, rim_r, h, half, t, state[INSIDE] != 0.0, par)
    sl, sr = rim_l[0] + rim_l[2], rim_r[0] + rim_r[2]
    if abs(start[0] - state[V]) + abs(start[2] - state[W]) + abs(sl - state[SL]) + abs(sr - state[SR]) > JUMP:
        put_speeds(state, start)
        state[SL], state[SR] = sl, sr
        n = put_node(nodes, n, state)
    g = edges_within(par, state, rim_l, rim_r, h, grid, g, edges)
    advance(state, moved, end, sums)
    state[SL], way_l = end_of(rim_l, h, half, par)
    state[SR], way_r = end_of(rim_r, h, half, par)
    state[PL] += way_l
    state[PR] += way_r
    if par[P.TAU] != 0.0 or par[P.A_MAX] != np.inf:
        state[YL], state[YR] = end_of(lag_l, h, half, par)[0], end_of(lag_r, h, half, par)[0]
        state[ZL], state[ZR] = end_of(limited_l, h, half, par)[0], end_of(limited_r, h, half, par)[0]
    if crosses:
        state[INSIDE], state[CROSSED] = 1.0 - state[INSIDE], t + h
    state[T] = to if t + h >= to - SAME else t + h
    return put_node(nodes, n, state), g


@inlined
def target(
    par: Array, t: float, t_end: float, times: Array, j: int, cuts: Array, m: int, restarts: Array, k: int
) -> float:
    """The next instant at which the piece that starts at t must end at the latest."""
    to = min(t_end, t + MAX_STEP)
    if j + 1 < times.shape[0]:
        to = min(to, times[j + 1] + par[P.DELAY])
    if m < cuts.shape[0]:
        to = min(to, cuts[m])
    if k < restarts.shape[0]:
        to = min(to, restarts[k, 0])
    if par[P.BUMP] != 0.0:
        for edge in (par[P.BUMP_TIME], par[P.BUMP_TIME] + BUMP_SPAN):
            if edge > t + EVENT:
                to = min(to, edge)
    return to


@compiled
def rollout(
    par: Array,
    times: Array,
    left: Array,
    right: Array,
    cuts: Array,
    grid: Array,
    restarts: Array,
    begin: float,
    t_end: float,
    nodes: Array,
    edges: Array,
    state: Array,
) -> int:
    """Drive and body from rest at `begin` to t_end.

    par: packed parameters. times (C,): command stamps; left, right (C, 2): rim set-points [m/s] and their slopes to
    the next. cuts (M,): instants to cut at, whatever the parameters are. grid (G,): IMU window edges, in the IMU's
    stamps. restarts (K, 4): t, x, y, theta at which the pose is set anew. state (STATE,): room to work in.
    Fills nodes (cap, NODE) and edges (G, EDGE); returns the number of nodes, or -1 if `nodes` is too short.
    """
    for i in range(STATE):
        state[i] = 0.0
    state[CROSSED] = state[SAGGED] = -np.inf
    g = at_rest(par, begin, grid, nodes, edges, state)
    n, j, k, m = 2, -1, 0, 0
    while state[T] < t_end - SAME:
        t = state[T]
        while k < restarts.shape[0] and restarts[k, 0] <= t + SAME and n < nodes.shape[0]:
            put_pose(state, restarts[k, 1], restarts[k, 2], restarts[k, 3], par)
            n = put_node(nodes, n, state)
            k += 1
        if n + 2 > nodes.shape[0]:
            return -1
        while j + 1 < times.shape[0] and times[j + 1] + par[P.DELAY] <= t + SAME:
            j += 1
        while m < cuts.shape[0] and cuts[m] <= t + SAME:
            m += 1
        to = target(par, t, t_end, times, j, cuts, m, restarts, k)
        u, v = command(times, left, j, t - par[P.DELAY]), command(times, right, j, t - par[P.DELAY])
        n, g = piece(par, state, nodes, n, to, u, v, grid, g, edges)
        while g < grid.shape[0] and edge_at(par, grid, g) <= state[T] + SAME:
            put_edge(edges, g, state)
            g += 1
    return n
