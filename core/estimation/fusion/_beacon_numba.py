"""Compiled: fixes and ranges, each event's readings gated together; and what many refused ones agree on."""

from __future__ import annotations

import math
from typing import Any

from numba import njit

from core.estimation.fusion._model_numba import anchor, correct, covariance_with, keep, wrap
from core.estimation.fusion.layout import (
    ACCEPTED,
    AGREED,
    BR,
    CARRIED,
    DRIVEN,
    DT,
    FIRST_OFFSET,
    GATE1,
    GATE2,
    GATE3,
    GZ,
    HAS_ACCEL,
    HAS_GYRO,
    INNOVATION,
    KR,
    LEAP,
    LEAPT,
    MEMORY,
    NOISE,
    OFFSET_TAU,
    OFFSET_VAR,
    ONSET,
    PARTS,
    PAST,
    PATIENCE,
    R_FIX,
    R_FIX_THETA,
    R_RANGE,
    RANGE_FROM,
    RANGE_LEAPT,
    RANGE_ONSET,
    REFUSED,
    REFUSED_RANGES,
    REJECTED,
    RELOCATED,
    ROOM,
    ROW,
    STUBBORN,
    T_FIX,
    T_OFFSET,
    T_RANGE,
    T_STRANGE,
    TAG_X,
    TAG_Y,
    TAG_Z,
    TH,
    VALUES,
    VARIANCES,
    N,
    S,
    V,
    X,
    Y,
)  # fmt: skip

SOFT = 0.45  # share of the gate from which on a reading counts less
FAR_ENOUGH = 0.15  # rad: sd of a heading that refused fixes show
SHOCK = 1.0  # s before the first refusal in which a disturbance explains it
TURNED = 0.2  # rad: sd of the heading of a robot that was put elsewhere, beside a gyro
BLIND = 1.8  # rad, without
DOUBT = 0.3  # rad, of the heading when many ranges are refused
DRIVE = 5.0  # m that a robot must drive before fixes that leapt without reason are believed


@njit(error_model="numpy", forceinline=True)
def _fade_offsets(t: float, x: Any, P: Any, n: int, mem: Any, c: Any, parts: Any) -> None:
    """Lasting errors of the beacon system decay (Gauss-Markov); done only where one is asked for."""
    begin = int(c[FIRST_OFFSET])
    if c[OFFSET_VAR] <= 0.0 or n <= begin:
        return
    fade = math.exp(-max(t - mem[T_OFFSET], 0.0) / c[OFFSET_TAU])
    mem[T_OFFSET] = t
    for o in range(begin, n):
        x[o] *= fade
        for j in range(n):
            P[o * N + j] *= fade
        for j in range(n):
            P[j * N + o] *= fade
        P[o * N + o] += c[OFFSET_VAR] * (1.0 - fade * fade)
    parts[PARTS] = fade


@njit(error_model="numpy", forceinline=True)
def _tag_speed(
    x: Any, arm_x: float, arm_y: float, cos: float, sin: float, mem: Any, c: Any
) -> tuple[float, float, float]:
    w = mem[GZ] if c[HAS_GYRO] != 0.0 else 0.0
    return x[V] * cos - w * arm_y, x[V] * sin + w * arm_x, w


@njit(error_model="numpy", forceinline=True)
def _put(work: Any, index: Any, row: int, k: int, a: float) -> None:
    """State k has a in this row."""
    m = index[row, ROOM]
    index[row, m] = k
    work[ROW + row, m] = a
    index[row, ROOM] = m + 1


@njit(error_model="numpy", forceinline=True)
def _fix_rows(a: Any, x: Any, P: Any, mem: Any, c: Any, work: Any, index: Any) -> int:
    """Rows of x, y and, where there is one, heading, with innovations and variances; how many."""
    cos, sin = math.cos(x[TH]), math.sin(x[TH])
    arm_x, arm_y = cos * c[TAG_X] - sin * c[TAG_Y], sin * c[TAG_X] + cos * c[TAG_Y]
    late, lag = P[DT * N + DT] > 0.0, x[DT]
    vx, vy, rate = _tag_speed(x, arm_x, arm_y, cos, sin, mem, c)
    o = int(a[3])
    for row in range(2):
        index[row, ROOM] = 0
        _put(work, index, row, X + row, 1.0)
        _put(work, index, row, TH, arm_x - lag * vx if row else lag * vy - arm_y)
        if late:
            _put(work, index, row, DT, -vy if row else -vx)
            _put(work, index, row, V, -lag * sin if row else -lag * cos)
        if o > 0:
            _put(work, index, row, o + row, 1.0)
    work[INNOVATION, 0] = a[0] - (x[X] + arm_x - lag * vx)
    work[INNOVATION, 1] = a[1] - (x[Y] + arm_y - lag * vy)
    work[NOISE, 0], work[NOISE, 1], work[NOISE, 2] = c[R_FIX], c[R_FIX], c[R_FIX_THETA]
    if o > 0:
        work[INNOVATION, 0] -= x[o]
        work[INNOVATION, 1] -= x[o + 1]
    if math.isnan(a[2]):
        return 2
    index[2, ROOM] = 0
    _put(work, index, 2, TH, 1.0)
    if late:
        _put(work, index, 2, DT, -rate)
    work[INNOVATION, 2] = wrap(a[2] - x[TH] + lag * rate)
    return 3


@njit(error_model="numpy", forceinline=True)
def _range_row(a: Any, x: Any, P: Any, mem: Any, c: Any, work: Any, index: Any) -> None:
    """Row of a range."""
    cos, sin = math.cos(x[TH]), math.sin(x[TH])
    arm_x, arm_y = cos * c[TAG_X] - sin * c[TAG_Y], sin * c[TAG_X] + cos * c[TAG_Y]
    vx, vy, _ = _tag_speed(x, arm_x, arm_y, cos, sin, mem, c)
    lag = x[DT]
    ex, ey, ez = x[X] + arm_x - lag * vx - a[0], x[Y] + arm_y - lag * vy - a[1], c[TAG_Z] - a[2]
    distance = max(math.sqrt(ex * ex + ey * ey + ez * ez), 1e-6)
    scale = (1.0 + x[KR]) / distance
    ux, uy = scale * ex, scale * ey
    index[0, ROOM] = 0
    _put(work, index, 0, X, ux)
    _put(work, index, 0, Y, uy)
    _put(work, index, 0, TH, ux * (lag * vy - arm_y) + uy * (arm_x - lag * vx))
    _put(work, index, 0, KR, distance)
    _put(work, index, 0, BR, 1.0)
    o = int(a[4])
    work[INNOVATION, 0] = a[3] - (1.0 + x[KR]) * distance - x[BR]
    work[NOISE, 0] = c[R_RANGE]
    if P[DT * N + DT] > 0.0:
        _put(work, index, 0, DT, -ux * vx - uy * vy)
        _put(work, index, 0, V, -lag * (ux * cos + uy * sin))
    if o > 0:
        _put(work, index, 0, o, 1.0)
        work[INNOVATION, 0] -= x[o]


@njit(error_model="numpy", forceinline=True)
def _product(row: int, work: Any, index: Any, of: int) -> float:
    """Row h times P h of another row."""
    total = 0.0
    for m in range(index[row, ROOM]):
        total += work[ROW + row, m] * work[of, index[row, m]]
    return total


@njit(error_model="numpy", forceinline=True)
def _joint(P: Any, n: int, rows: int, work: Any, index: Any) -> tuple[float, float]:
    """Joint normalised innovation squared of up to three readings, and the log of the determinant, by L D L' of the
    innovation's covariance, written out."""
    for row in range(rows):
        covariance_with(P, n, work, index, row, row)
    s00 = _product(0, work, index, 0) + work[NOISE, 0]
    work[VARIANCES, 0] = s00
    nis, volume = work[INNOVATION, 0] * work[INNOVATION, 0] / s00, s00
    if rows > 1:
        s10 = _product(1, work, index, 0)
        l10 = s10 / s00
        work[VARIANCES, 1] = _product(1, work, index, 1) + work[NOISE, 1]
        d1, z1 = work[VARIANCES, 1] - l10 * s10, work[INNOVATION, 1] - l10 * work[INNOVATION, 0]
        nis, volume = nis + z1 * z1 / d1, volume * d1
        if rows > 2:
            s20 = _product(2, work, index, 0)
            l20 = s20 / s00
            l21 = (_product(2, work, index, 1) - l20 * s10) / d1
            d2 = _product(2, work, index, 2) + work[NOISE, 2] - l20 * s20 - l21 * l21 * d1
            z2 = work[INNOVATION, 2] - l20 * work[INNOVATION, 0] - l21 * z1
            nis, volume = nis + z2 * z2 / d2, volume * d2
    return nis, math.log(volume)


@njit(error_model="numpy", forceinline=True)
def _take(x: Any, P: Any, n: int, rows: int, ease: float, work: Any, index: Any, rec: Any, k: int) -> None:
    """Update by an event's readings in turn, from the P h of each that `_joint` has left. All are of one prediction:
    what an earlier one moves is taken out of the later ones, linearly. `ease` >= 1 widens a reading near its gate."""
    for row in range(rows):
        variance = work[NOISE, row] * (ease - 1.0)
        variance += work[VARIANCES, 0] if row == 0 else _product(row, work, index, row) + work[NOISE, row]
        nu = work[INNOVATION, row]
        if k >= 0:
            u = rec.marks[k + 1, 0]
            for m in range(ROOM + 1):
                rec.which[u, m] = index[row, m]
            for m in range(ROOM):
                rec.corrections[u, VALUES + m] = work[ROW + row, m]
            keep(rec, k, work, row, n, nu, variance)
        for later in range(row + 1, rows):
            share = _product(later, work, index, row) / variance
            work[INNOVATION, later] -= share * nu
            for i in range(n):
                work[later, i] -= share * work[row, i]
        correct(x, P, n, work, row, nu, variance)


@njit(error_model="numpy", forceinline=True)
def _agree(t: float, mem: Any) -> None:
    """An accepted fix; three in a row end a row of refusals, as one may pass by chance."""
    mem[T_FIX] = t
    mem[AGREED] += 1.0
    if mem[AGREED] >= 3.0:
        mem[REFUSED] = 0.0


@njit(error_model="numpy")
def _first_refused(t: float, far: float, mem: Any, c: Any) -> None:
    """When a row of refusals begins: have the fixes leapt faster than any robot, or without anything having shaken it?
    Then it is they who lie."""
    gap = t - mem[T_FIX] if mem[T_FIX] >= 0.0 else 1e9
    unshaken = c[HAS_ACCEL] != 0.0 and gap < SHOCK and mem[T_STRANGE] < t - gap - SHOCK
    mem[ONSET], mem[DRIVEN] = t, 0.0
    mem[LEAPT] = 1.0 if (far > c[LEAP] * max(gap, 1e-3) or unshaken) else 0.0


@njit(error_model="numpy")
def _refused(
    t: float, a: Any, flags: int, sd: float, x: Any, P: Any, n: int, mem: Any, past: Any, c: Any, work: Any
) -> bool:
    """Keep a refused fix; true where enough of them agree, and the pose has been moved to what they say."""
    if mem[REFUSED] == 0.0:
        _first_refused(t, math.hypot(work[INNOVATION, 0], work[INNOVATION, 1]) - 3.0 * sd, mem, c)
    else:
        last = past[(int(mem[REFUSED]) - 1) % PAST]
        mem[DRIVEN] += math.sqrt((x[X] - last[0]) ** 2 + (x[Y] - last[1]) ** 2)
    if flags & CARRIED:
        mem[LEAPT] = 0.0
    one = past[int(mem[REFUSED]) % PAST]
    one[0], one[1], one[2], one[3], one[4], one[5] = x[X], x[Y], x[TH], a[0], a[1], a[2]
    mem[REFUSED] += 1.0
    mem[AGREED] = 0.0
    if mem[REFUSED] < c[PATIENCE]:
        return False
    if mem[LEAPT] != 0.0 and (t - mem[ONSET] < c[STUBBORN] or mem[DRIVEN] < DRIVE):
        return False
    newest = int(mem[REFUSED])
    if not _relocate(newest, min(newest, PAST), x, P, n, past, c):
        few = max(int(c[PATIENCE]), 3)
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
        lx += p[0] + cos * c[TAG_X] - sin * c[TAG_Y]
        ly += p[1] + sin * c[TAG_X] + cos * c[TAG_Y]
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
        ax, ay = p[0] + cos * c[TAG_X] - sin * c[TAG_Y] - lx, p[1] + sin * c[TAG_X] + cos * c[TAG_Y] - ly
        bx, by = p[3] - fx, p[4] - fy
        same += ax * bx + ay * by
        cross += ax * by - ay * bx
        spread += ax * ax + ay * ay
        far += bx * bx + by * by
    turn, var_turn = 0.0, (TURNED * TURNED if c[HAS_GYRO] != 0.0 else BLIND * BLIND) + P[TH * N + TH]
    if headed > 0:
        turn, var_turn = math.atan2(st, ct), c[R_FIX_THETA] / headed
    elif spread > 0.0 and c[R_FIX] < FAR_ENOUGH * FAR_ENOUGH * spread:
        shown = c[R_FIX] / spread
        turn = math.atan2(cross, same)
        if turn * turn > 9.0 * (var_turn + shown):
            return False
        turn *= var_turn / (var_turn + shown)
        var_turn *= shown / (var_turn + shown)
    cos, sin = math.cos(turn), math.sin(turn)
    miss = (far + spread - 2.0 * (cos * same + sin * cross)) / (2.0 * many)
    if miss > 3.0 * c[R_FIX]:
        return False
    sx, sy = cos * (x[X] - lx) - sin * (x[Y] - ly), sin * (x[X] - lx) + cos * (x[Y] - ly)
    x[X], x[Y], x[TH] = fx + sx, fy + sy, x[TH] + turn
    var = max(c[R_FIX], miss) / many
    anchor(P, n, X, var + var_turn * sy * sy)
    anchor(P, n, Y, var + var_turn * sx * sx)
    anchor(P, n, TH, var_turn)
    P[X * N + Y] = P[Y * N + X] = -var_turn * sx * sy
    P[X * N + TH] = P[TH * N + X] = -var_turn * sy
    P[Y * N + TH] = P[TH * N + Y] = var_turn * sx
    return True


@njit(error_model="numpy", forceinline=True)
def fix(
    t: float, a: Any, flags: int, x: Any, P: Any, n: int, mem: Any, past: Any, c: Any, work: Any, index: Any,
    parts: Any, out: Any, e: int, rec: Any, k: int,
) -> None:  # fmt: skip
    """A fix: taken, refused, or believed with all the other refused ones that it agrees with."""
    _fade_offsets(t, x, P, n, mem, c, parts)
    rows = _fix_rows(a, x, P, mem, c, work, index)
    nis, log = _joint(P, n, rows, work, index)
    out.nis[e, 0], out.nis[e, 1], out.status[e, 0] = nis, log, ACCEPTED
    for row in range(2):
        out.score[e, row] = work[INNOVATION, row] / math.sqrt(work[VARIANCES, row])
    gate = c[GATE2] if rows == 2 else c[GATE3]
    ease = max(nis / (SOFT * gate), 1.0)
    if not nis <= gate:
        sd = math.sqrt(0.5 * (P[X * N + X] + P[Y * N + Y]) + c[R_FIX])
        if not _refused(t, a, flags, sd, x, P, n, mem, past, c, work):
            out.status[e, 0] = REJECTED
            return
        if k >= 0:
            rec.marks[k, 1] |= (1 << X) | (1 << Y) | (1 << TH)
        out.status[e, 0], ease = RELOCATED, 1.0
        rows = _fix_rows(a, x, P, mem, c, work, index)
        _joint(P, n, rows, work, index)
    _agree(t, mem)
    _take(x, P, n, rows, ease, work, index, rec, k)


@njit(error_model="numpy")
def _ranges_lie(t: float, far: float, x: Any, mem: Any, c: Any) -> bool:
    """Whether refused ranges are not to be believed, however many they are: their row began as that of fixes that lie,
    with a leap faster than any robot, or without anything having shaken it, and neither long nor far ago."""
    if mem[REFUSED_RANGES] == 1.0:
        gap = t - mem[T_RANGE] if mem[T_RANGE] >= 0.0 else 1e9
        unshaken = c[HAS_ACCEL] != 0.0 and gap < SHOCK and mem[T_STRANGE] < t - gap - SHOCK
        mem[RANGE_ONSET], mem[RANGE_FROM] = t, x[S]
        mem[RANGE_LEAPT] = 1.0 if (far > c[LEAP] * max(gap, 1e-3) or unshaken) else 0.0
    if mem[T_STRANGE] > mem[RANGE_ONSET]:
        mem[RANGE_LEAPT] = 0.0
    recent = t - mem[RANGE_ONSET] < c[STUBBORN] or abs(x[S] - mem[RANGE_FROM]) < DRIVE
    return mem[RANGE_LEAPT] != 0.0 and recent


@njit(error_model="numpy")
def _refused_range(t: float, nu: float, sd: float, o: int, x: Any, P: Any, mem: Any, c: Any) -> bool:
    """A refused range; true where there were so many that the filter doubts its own pose, or this beacon."""
    mem[REFUSED_RANGES] += 1.0
    lie = _ranges_lie(t, abs(nu) - 3.0 * sd, x, mem, c)
    if mem[REFUSED_RANGES] > c[PATIENCE] and not lie:
        P[X * N + X] += nu * nu
        P[Y * N + Y] += nu * nu
        P[TH * N + TH] += DOUBT * DOUBT
        return True
    if o <= 0 or c[OFFSET_VAR] <= 0.0:
        return False
    mem[MEMORY - N + o] += 1.0
    if mem[MEMORY - N + o] <= c[PATIENCE]:
        return False
    P[o * N + o] += nu * nu
    return True


@njit(error_model="numpy", forceinline=True)
def range_to(
    t: float, a: Any, x: Any, P: Any, n: int, mem: Any, c: Any, work: Any, index: Any, parts: Any, out: Any, e: int,
    rec: Any, k: int,
) -> None:  # fmt: skip
    """A single range."""
    _fade_offsets(t, x, P, n, mem, c, parts)
    _range_row(a, x, P, mem, c, work, index)
    rows = index[0, ROOM] // index[0, ROOM]
    nis, log = _joint(P, n, rows, work, index)
    out.nis[e, 0], out.nis[e, 1], out.status[e, 0] = nis, log, ACCEPTED
    out.score[e, 0] = math.copysign(math.sqrt(nis), work[INNOVATION, 0])
    ease, o = max(nis / (SOFT * c[GATE1]), 1.0), int(a[4])
    if not nis <= c[GATE1]:
        out.status[e, 0], ease = REJECTED, 1.0
        sd = math.sqrt(work[VARIANCES, 0])
        if not _refused_range(t, work[INNOVATION, 0], sd, o, x, P, mem, c):
            return
        _joint(P, n, rows, work, index)
    mem[REFUSED_RANGES], mem[T_RANGE] = 0.0, t
    if o > 0:
        mem[MEMORY - N + o] = 0.0
    _take(x, P, n, rows, ease, work, index, rec, k)
