"""Compiled: fixes and ranges, each event's readings gated together; and what many refused ones agree on."""

from __future__ import annotations

import math
from typing import Any

from numba import njit

from core.estimation.fusion._model_numba import anchor, correct, covariance_with, wrap
from core.estimation.fusion.layout import (
    ACCEPTED, AGREED, B, BR, CARRIED, DRIVEN, DT, FIX, GZ, KR, LEFT, MEMORY, N, ONSET, PAST, REFUSED, REFUSED_RANGES,
    REJECTED, RELOCATED, RIGHT, STARTED, STOPPED, T_FIX, T_OFFSET, T_STRANGE, LEAPT, TH, V, X, Y,
)  # fmt: skip

SOFT = 0.45  # share of the gate from which on a reading counts less
FAR_ENOUGH = 0.15  # rad: sd of a heading that refused fixes show
SHOCK = 1.0  # s before the first refusal in which a disturbance explains it
TURNED = 0.2  # rad: sd of the heading of a robot that was put elsewhere, beside a gyro
BLIND = 1.8  # rad, without
DRIVE = 5.0  # m that a robot must drive before fixes that leapt without reason are believed


@njit(error_model="numpy")
def _fade_offsets(t: float, x: Any, P: Any, n: int, mem: Any, c: Any, rec: Any, record: bool, k: int) -> None:
    """Lasting errors of the beacon system decay (Gauss-Markov); done only where one is asked for."""
    begin = int(c.first_offset)
    if c.offset_var <= 0.0 or n <= begin:
        return
    fade = math.exp(-max(t - mem[T_OFFSET], 0.0) / c.offset_tau)
    mem[T_OFFSET] = t
    for o in range(begin, n):
        x[o] *= fade
        for j in range(n):
            P[o, j] *= fade
        for j in range(n):
            P[j, o] *= fade
        P[o, o] += c.offset_var * (1.0 - fade * fade)
    if record:
        rec.fade[k] = fade


@njit(error_model="numpy")
def _tag_speed(x: Any, arm_x: float, arm_y: float, cos: float, sin: float, mem: Any, c: Any) -> tuple[float, float, float]:
    w = mem[GZ] if c.has_gyro != 0.0 else 0.0
    return x[V] * cos - w * arm_y, x[V] * sin + w * arm_x, w


@njit(error_model="numpy")
def _put(index: Any, value: Any, m: int, row: int, k: int, a: float) -> int:
    index[row, m] = k
    value[row, m] = a
    return m + 1


@njit(error_model="numpy")
def _fix_rows(a: Any, x: Any, P: Any, mem: Any, c: Any, w: Any) -> int:
    """Rows of x, y and, where there is one, heading; how many."""
    index, value, count, nu, r = w.index, w.value, w.count, w.nu, w.r
    r[0], r[1], r[2] = c.r_fix, c.r_fix, c.r_fix_theta
    cos, sin = math.cos(x[TH]), math.sin(x[TH])
    arm_x, arm_y = cos * c.tag_x - sin * c.tag_y, sin * c.tag_x + cos * c.tag_y
    late = P[DT, DT] > 0.0
    lag = x[DT]
    vx, vy, rate = _tag_speed(x, arm_x, arm_y, cos, sin, mem, c)
    o = int(a[3])
    for row in range(2):
        m = _put(index, value, 0, row, X + row, 1.0)
        m = _put(index, value, m, row, TH, -arm_y + lag * vy if row == 0 else arm_x - lag * vx)
        if late:
            m = _put(index, value, m, row, DT, -vx if row == 0 else -vy)
            m = _put(index, value, m, row, V, -lag * cos if row == 0 else -lag * sin)
        if o > 0:
            m = _put(index, value, m, row, o + row, 1.0)
        count[row] = m
    nu[0] = a[0] - (x[X] + arm_x - lag * vx)
    nu[1] = a[1] - (x[Y] + arm_y - lag * vy)
    if o > 0:
        nu[0] -= x[o]
        nu[1] -= x[o + 1]
    if math.isnan(a[2]):
        return 2
    m = _put(index, value, 0, 2, TH, 1.0)
    if late:
        m = _put(index, value, m, 2, DT, -rate)
    count[2] = m
    nu[2] = wrap(a[2] - x[TH] + lag * rate)
    return 3


@njit(error_model="numpy")
def _range_row(a: Any, x: Any, P: Any, mem: Any, c: Any, w: Any) -> None:
    index, value, count, nu = w.index, w.value, w.count, w.nu
    w.r[0] = c.r_range
    cos, sin = math.cos(x[TH]), math.sin(x[TH])
    arm_x, arm_y = cos * c.tag_x - sin * c.tag_y, sin * c.tag_x + cos * c.tag_y
    vx, vy, _ = _tag_speed(x, arm_x, arm_y, cos, sin, mem, c)
    lag = x[DT]
    ex, ey, ez = x[X] + arm_x - lag * vx - a[0], x[Y] + arm_y - lag * vy - a[1], c.tag_z - a[2]
    distance = max(math.sqrt(ex * ex + ey * ey + ez * ez), 1e-6)
    scale = (1.0 + x[KR]) / distance
    ux, uy = scale * ex, scale * ey
    m = _put(index, value, 0, 0, X, ux)
    m = _put(index, value, m, 0, Y, uy)
    m = _put(index, value, m, 0, TH, ux * (-arm_y + lag * vy) + uy * (arm_x - lag * vx))
    m = _put(index, value, m, 0, KR, distance)
    m = _put(index, value, m, 0, BR, 1.0)
    o = int(a[4])
    nu[0] = a[3] - (1.0 + x[KR]) * distance - x[BR]
    if P[DT, DT] > 0.0:
        m = _put(index, value, m, 0, DT, -ux * vx - uy * vy)
    if o > 0:
        m = _put(index, value, m, 0, o, 1.0)
        nu[0] -= x[o]
    count[0] = m


@njit(error_model="numpy")
def _joint(P: Any, n: int, rows: int, w: Any) -> tuple[float, float]:
    """Joint normalised innovation squared of up to three readings, and the log of the determinant, by L D L' of the
    innovation's covariance, written out."""
    index, value, count, nu, r, g = w.index, w.value, w.count, w.nu, w.r, w.g
    s00 = covariance_with(P, n, index[0], value[0], count[0], g[0]) + r[0]
    nis, log = nu[0] * nu[0] / s00, math.log(s00)
    if rows > 1:
        s11 = covariance_with(P, n, index[1], value[1], count[1], g[1]) + r[1]
        s10 = 0.0
        for m in range(count[1]):
            s10 += value[1, m] * g[0, index[1, m]]
        l10 = s10 / s00
        d1, z1 = s11 - l10 * s10, nu[1] - l10 * nu[0]
        nis, log = nis + z1 * z1 / d1, log + math.log(d1)
        if rows > 2:
            s22 = covariance_with(P, n, index[2], value[2], count[2], g[2]) + r[2]
            s20, s21 = 0.0, 0.0
            for m in range(count[2]):
                s20 += value[2, m] * g[0, index[2, m]]
                s21 += value[2, m] * g[1, index[2, m]]
            l20 = s20 / s00
            l21 = (s21 - l20 * s10) / d1
            d2, z2 = s22 - l20 * s20 - l21 * l21 * d1, nu[2] - l20 * nu[0] - l21 * z1
            nis, log = nis + z2 * z2 / d2, log + math.log(d2)
    return nis, log


@njit(error_model="numpy")
def _take(
    x: Any, P: Any, n: int, rows: int, w: Any, ease: float, rec: Any, record: bool
) -> None:
    """Update by an event's readings in turn. All are of one prediction: what an earlier one has moved is taken out,
    linearly. `ease` >= 1 widens a reading at the edge of its gate."""
    index, value, count, nu, r, g, x_old = w.index, w.value, w.count, w.nu, w.r, w.g[0], w.old
    for i in range(n):
        x_old[i] = x[i]
    for row in range(rows):
        variance = covariance_with(P, n, index[row], value[row], count[row], g) + r[row] * ease
        moved = 0.0
        for m in range(count[row]):
            k = index[row, m]
            moved += value[row, m] * (x[k] - x_old[k])
        left = nu[row] - moved
        if record:
            u = rec.used[0]
            rec.count[u], rec.nu[u], rec.variance[u] = count[row], left, variance
            for m in range(count[row]):
                rec.index[u, m], rec.value[u, m] = index[row, m], value[row, m]
            for i in range(n):
                rec.gain[u, i] = g[i]
            rec.used[0] = u + 1
        correct(x, P, n, g, left, variance)


@njit(error_model="numpy")
def _agree(t: float, mem: Any) -> None:
    """An accepted fix; three in a row end a row of refusals, as one may pass by chance."""
    mem[T_FIX] = t
    mem[AGREED] += 1.0
    if mem[AGREED] >= 3.0:
        mem[REFUSED] = 0.0


@njit(error_model="numpy")
def _first_refused(t: float, nu: Any, sd: float, mem: Any, c: Any) -> None:
    """When a row of refusals begins: have the fixes leapt faster than any robot, or without anything having shaken it?
    Then it is they who lie."""
    gap = t - mem[T_FIX] if mem[T_FIX] >= 0.0 else 1e9
    far = math.sqrt(nu[0] * nu[0] + nu[1] * nu[1]) - 3.0 * sd
    unshaken = c.has_accel != 0.0 and gap < SHOCK and mem[T_STRANGE] < t - gap - SHOCK
    mem[ONSET], mem[DRIVEN] = t, 0.0
    mem[LEAPT] = 1.0 if (far > c.leap * max(gap, 1e-3) or unshaken) else 0.0


@njit(error_model="numpy")
def _refused(t: float, a: Any, flags: int, sd: float, x: Any, P: Any, n: int, mem: Any, past: Any, c: Any, w: Any) -> bool:
    """Keep a refused fix; true where enough of them agree, and the pose has been moved to what they say."""
    if mem[REFUSED] == 0.0:
        _first_refused(t, w.nu, sd, mem, c)
    else:
        last = past[(int(mem[REFUSED]) - 1) % PAST]
        mem[DRIVEN] += math.sqrt((x[X] - last[0]) ** 2 + (x[Y] - last[1]) ** 2)
    if flags & CARRIED:
        mem[LEAPT] = 0.0
    one = past[int(mem[REFUSED]) % PAST]
    one[0], one[1], one[2], one[3], one[4], one[5] = x[X], x[Y], x[TH], a[0], a[1], a[2]
    mem[REFUSED] += 1.0
    mem[AGREED] = 0.0
    if mem[REFUSED] < c.patience:
        return False
    if mem[LEAPT] != 0.0 and (t - mem[ONSET] < c.stubborn or mem[DRIVEN] < DRIVE):
        return False
    newest = int(mem[REFUSED])
    if not _relocate(newest, min(newest, PAST), x, P, n, past, c):
        few = max(int(c.patience), 3)
        if newest <= few or not _relocate(newest, few, x, P, n, past, c):
            return False
    mem[REFUSED], mem[T_STRANGE] = 0.0, t
    return True


@njit(error_model="numpy")
def _relocate(newest: int, many: int, x: Any, P: Any, n: int, past: Any, c: Any) -> bool:
    """Fit the believed path to the last `many` refused fixes as a rigid body; if it fits, move the pose there."""
    lx, ly, fx, fy, headed, st, ct = 0.0, 0.0, 0.0, 0.0, 0, 0.0, 0.0
    for i in range(newest - many, newest):
        p = past[i % PAST]
        cos, sin = math.cos(p[2]), math.sin(p[2])
        lx += p[0] + cos * c.tag_x - sin * c.tag_y
        ly += p[1] + sin * c.tag_x + cos * c.tag_y
        fx += p[3]
        fy += p[4]
        if not math.isnan(p[5]):
            headed += 1
            st += math.sin(p[5] - p[2])
            ct += math.cos(p[5] - p[2])
    lx, ly, fx, fy = lx / many, ly / many, fx / many, fy / many
    same, cross, spread, far = 0.0, 0.0, 0.0, 0.0
    for i in range(newest - many, newest):
        p = past[i % PAST]
        cos, sin = math.cos(p[2]), math.sin(p[2])
        ax, ay = p[0] + cos * c.tag_x - sin * c.tag_y - lx, p[1] + sin * c.tag_x + cos * c.tag_y - ly
        bx, by = p[3] - fx, p[4] - fy
        same += ax * bx + ay * by
        cross += ax * by - ay * bx
        spread += ax * ax + ay * ay
        far += bx * bx + by * by
    turn, var_turn = 0.0, TURNED * TURNED if c.has_gyro != 0.0 else BLIND * BLIND
    if headed > 0:
        turn, var_turn = math.atan2(st, ct), c.r_fix_theta / headed
    elif spread * FAR_ENOUGH * FAR_ENOUGH > c.r_fix:
        turn, var_turn = math.atan2(cross, same), c.r_fix / spread
    cos, sin = math.cos(turn), math.sin(turn)
    miss = (far + spread - 2.0 * (cos * same + sin * cross)) / (2.0 * many)
    if miss > 3.0 * c.r_fix:
        return False
    sx, sy = cos * (x[X] - lx) - sin * (x[Y] - ly), sin * (x[X] - lx) + cos * (x[Y] - ly)
    x[X], x[Y], x[TH] = fx + sx, fy + sy, x[TH] + turn
    var = max(c.r_fix, miss) / many
    anchor(P, n, X, var + var_turn * sy * sy)
    anchor(P, n, Y, var + var_turn * sx * sx)
    anchor(P, n, TH, var_turn)
    P[X, Y] = P[Y, X] = -var_turn * sx * sy
    P[X, TH] = P[TH, X] = -var_turn * sy
    P[Y, TH] = P[TH, Y] = var_turn * sx
    return True


@njit(error_model="numpy")
def fix(
    t: float, a: Any, flags: int, x: Any, P: Any, n: int, mem: Any, past: Any, c: Any, w: Any, nis: Any, status: Any,
    rec: Any, record: bool, k: int,
) -> None:  # fmt: skip
    """A fix: taken, refused, or believed with all the other refused ones that it agrees with."""
    _fade_offsets(t, x, P, n, mem, c, rec, record, k)
    rows = _fix_rows(a, x, P, mem, c, w)
    nis[0], nis[1] = _joint(P, n, rows, w)
    gate = c.gate2 if rows == 2 else c.gate3
    status[0], ease = ACCEPTED, max(nis[0] / (SOFT * gate), 1.0)
    if not nis[0] <= gate:
        sd = math.sqrt(0.5 * (P[X, X] + P[Y, Y]) + c.r_fix)
        if not _refused(t, a, flags, sd, x, P, n, mem, past, c, w):
            status[0] = REJECTED
            return
        if record:
            rec.forgotten[k] |= (1 << X) | (1 << Y) | (1 << TH)
        status[0], ease = RELOCATED, 1.0
        rows = _fix_rows(a, x, P, mem, c, w)
    _agree(t, mem)
    _take(x, P, n, rows, w, ease, rec, record)


@njit(error_model="numpy")
def _refused_range(nu: float, o: int, x: Any, P: Any, mem: Any, c: Any) -> bool:
    """A refused range; true where there were so many that the filter doubts its own pose, or this beacon."""
    mem[REFUSED_RANGES] += 1.0
    if mem[REFUSED_RANGES] > c.patience:
        P[X, X] += nu * nu
        P[Y, Y] += nu * nu
        P[TH, TH] += 0.09
        return True
    if o <= 0 or c.offset_var <= 0.0:
        return False
    mem[MEMORY - N + o] += 1.0
    if mem[MEMORY - N + o] <= c.patience:
        return False
    P[o, o] += nu * nu
    return True


@njit(error_model="numpy")
def range_to(
    t: float, a: Any, x: Any, P: Any, n: int, mem: Any, c: Any, w: Any, nis: Any, status: Any, rec: Any, record: bool,
    k: int,
) -> None:  # fmt: skip
    """A single range."""
    _fade_offsets(t, x, P, n, mem, c, rec, record, k)
    _range_row(a, x, P, mem, c, w)
    nis[0], nis[1] = _joint(P, n, 1, w)
    status[0], ease, o = ACCEPTED, max(nis[0] / (SOFT * c.gate1), 1.0), int(a[4])
    if not nis[0] <= c.gate1:
        status[0], ease = REJECTED, 1.0
        if not _refused_range(w.nu[0], o, x, P, mem, c):
            return
    mem[REFUSED_RANGES] = 0.0
    if o > 0:
        mem[MEMORY - N + o] = 0.0
    _take(x, P, n, 1, w, ease, rec, record)
