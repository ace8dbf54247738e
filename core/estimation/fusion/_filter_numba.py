"""Compiled Kalman filter of `fused`: one time-sorted list of events in, poses and covariances out.

State (13): x, y [m], theta [rad] of the body in the map; s [m], phi [rad], what the wheels should have told by now of
distance and turn; v [m/s]; b [rad/s], gyro bias, or minus the turn rate where there is no gyro; kg gyro scale; kd
distance scale, ke wheel inequality, kb track scale; kr range scale, br [m] range bias. Scales are errors, 0 is perfect.

Between events   the turn is the gyro's, or that of b:  theta' = w = (gyro turn - b dt)(1 - kg)
                 s' = d (1 - kd),  phi' = w (1 + kb) - ke d / track
                 v (and b without gyro) wander freely, and decay towards zero while the wheels are silent
Measurements     are scalars, applied one after another; no matrix is inverted. `s` and `phi` are compared with
                 *cumulative* wheel readings, so the encoder's step is an error of each reading and does not add up.

All in one file on purpose: the cache of compiled code looks at this file alone to see that it is out of date.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

X, Y, TH, S, PHI, V, B, KG, KD, KE, KB, KR, BR = range(13)
N = 13
MOVING = 7  # the first states change between events; the others are constants of the robot

WHEEL, FIX, RANGE, OUT = range(4)  # kinds of event, in the order they are taken at equal stamps
NONE, ACCEPTED, REJECTED = range(3)

SLIP_TIME = 0.5  # s: for how long wheels that disagreed with the gyro are not asked about turning


class Constants(NamedTuple):
    """Numbers of one run, SI; q_ are variances per second or per metre, r_ of one reading."""

    has_gyro: float
    inverse_track: float  # 1/m, 0 where the track width is unknown
    tag_x: float
    tag_y: float
    tag_z: float
    tau: float  # s, memory of speed and turn rate while the wheels are silent
    q_speed: float
    q_turn: float
    q_gyro: float
    q_bias: float
    q_scale: float
    q_slip: float
    q_side: float
    r_distance: float
    r_turn: float
    r_rate: float
    r_still: float
    r_fix: float
    r_fix_theta: float
    r_range: float
    top_speed: float
    gate1: float
    gate2: float
    gate3: float
    patience: float  # rejections in a row
    patience_rest: float


@njit(error_model="numpy")
def _arc(half: float) -> tuple[float, float]:
    """sin(h)/h, and its derivative by 2 h."""
    if abs(half) < 0.05:
        q = half * half
        return 1.0 - q / 6.0 + q * q / 120.0, half * (-1.0 / 6.0 + q / 60.0 - q * q / 1680.0)
    chord = math.sin(half) / half
    return chord, 0.5 * (math.cos(half) - chord) / half


@njit(error_model="numpy")
def _predict(x: Any, P: Any, dt: float, raw: float, q_extra: float, resting: bool, silent: bool, c: Any) -> None:
    """Carry state and covariance over dt [s] with the gyro's raw turn [rad]; F P F' is done row by row."""
    f, cd, fb, cb = 1.0, dt, 1.0, dt
    if silent:
        f = math.exp(-dt / c.tau)
        cd = c.tau * (1.0 - f)
        if c.has_gyro == 0.0:
            fb, cb = f, cd
    if resting:
        raw, cb = 0.0, 0.0
    gain = 1.0 - x[KG]
    free = raw - x[B] * cb
    w = free * gain
    d = x[V] * cd
    half = 0.5 * w
    chord, bend = _arc(half)
    cos, sin = math.cos(x[TH] + half), math.sin(x[TH] + half)
    ux, uy = chord * cos, chord * sin
    dx, dy = d * ux, d * uy
    px, py = d * bend * cos - 0.5 * dy, d * bend * sin + 0.5 * dx
    sd, sk = 1.0 - x[KD], 1.0 + x[KB]
    ke = x[KE] * c.inverse_track
    x[X] += dx
    x[Y] += dy
    x[TH] += w
    x[S] += d * sd
    x[PHI] += w * sk - ke * d
    x[V] *= f
    x[B] *= fb
    for j in range(N):
        turn = -cb * gain * P[B, j] - free * P[KG, j]
        move = cd * P[V, j]
        P[X, j] += ux * move - dy * P[TH, j] + px * turn
        P[Y, j] += uy * move + dx * P[TH, j] + py * turn
        P[S, j] += sd * move - d * P[KD, j]
        P[PHI, j] += sk * turn + w * P[KB, j] - ke * move - d * c.inverse_track * P[KE, j]
        P[TH, j] += turn
        P[V, j] *= f
        P[B, j] *= fb
    for i in range(MOVING):
        turn = -cb * gain * P[i, B] - free * P[i, KG]
        move = cd * P[i, V]
        P[i, X] += ux * move - dy * P[i, TH] + px * turn
        P[i, Y] += uy * move + dx * P[i, TH] + py * turn
        P[i, S] += sd * move - d * P[i, KD]
        P[i, PHI] += sk * turn + w * P[i, KB] - ke * move - d * c.inverse_track * P[i, KE]
        P[i, TH] += turn
        P[i, V] *= f
        P[i, B] *= fb
    for i in range(MOVING, N):  # the rest by symmetry
        for j in range(MOVING):
            P[i, j] = P[j, i]
    _add_noise(x, P, dt, d, w, f, ux, uy, q_extra, resting, c)


@njit(error_model="numpy")
def _wander(dt: float, f: float, tau: float) -> tuple[float, float, float]:
    """Variances, per unit density, of a speed after dt, of speed with distance, and of distance (Van Loan)."""
    if f == 1.0:
        return dt, 0.5 * dt * dt, dt * dt * dt / 3.0
    k = 0.5 * tau
    return k * (1.0 - f * f), k * tau * (1.0 - f) ** 2, k * tau * max(2.0 * dt - tau * (3.0 - 4.0 * f + f * f), 0.0)


@njit(error_model="numpy")
def _add_noise(
    x: Any, P: Any, dt: float, d: float, w: float, f: float, ux: float, uy: float, q_extra: float, resting: bool, c: Any
) -> None:
    """Process noise of one step: speed, turn, slip along and across, slow parameters."""
    q_v, q_dv, q_d = _wander(dt, f, c.tau)
    along = abs(d)
    P[V, V] += c.q_speed * q_v
    _add3(P, X, Y, S, ux, uy, 1.0, c.q_speed * q_d)
    for i, e in ((X, ux), (Y, uy), (S, 1.0)):
        P[i, V] += e * c.q_speed * q_dv
        P[V, i] += e * c.q_speed * q_dv
    _add3(P, X, Y, S, -uy, ux, 0.0, c.q_side * along)
    _add3(P, X, Y, S, ux, uy, 0.0, 0.5 * c.q_slip * along)  # v is the wheels' speed: it is the body that slips
    slip_turn = 2.0 * c.q_slip * c.inverse_track * (along * c.inverse_track + 0.5 * abs(w))
    if c.has_gyro != 0.0:
        P[B, B] += c.q_bias * dt
        P[PHI, PHI] += slip_turn  # the gyro has the body's turn: it is the wheels that slip
        q_turn = 0.0 if resting else c.q_gyro * dt + q_extra
    else:
        P[B, B] += c.q_turn * q_v
        P[TH, TH] += slip_turn
        for i, e in ((TH, 1.0), (PHI, 1.0 + x[KB])):
            P[i, B] -= e * c.q_turn * q_dv
            P[B, i] -= e * c.q_turn * q_dv
        q_turn = c.q_turn * q_d
    _add3(P, TH, PHI, PHI, 1.0, 1.0 + x[KB], 0.0, q_turn)
    for i in (KG, KD, KE, KB, KR, BR):
        if P[i, i] > 0.0:  # a parameter with no variance is frozen
            P[i, i] += c.q_scale * dt


@njit(error_model="numpy")
def _add3(P: Any, i: int, j: int, k: int, a: float, b: float, e: float, q: float) -> None:
    """P += q g g' for g with a, b, e at i, j, k; k may equal j where e is 0."""
    P[i, i] += q * a * a
    P[j, j] += q * b * b
    P[i, j] += q * a * b
    P[j, i] += q * a * b
    if e != 0.0:
        P[k, k] += q * e * e
        P[i, k] += q * a * e
        P[k, i] += q * a * e
        P[j, k] += q * b * e
        P[k, j] += q * b * e


@njit(error_model="numpy")
def _update(x: Any, P: Any, h: Any, nu: float, r: float, keep: Any, single: int, a: int, b: int, work: Any) -> Any:
    """Update by one scalar reading with row h, innovation nu, variance r; returns nu^2 / its variance, and that.

    States with keep = 1 are considered, not corrected (Schmidt), and the gain is that for known states a and b (-1:
    none): wheels alone cannot tell a wrong scale from another speed, nor may they correct, through a scale's long
    memory, what was driven before. `single` is the state read directly, else -1: where subtraction would cancel, its
    covariances are computed without. Covariance by Joseph's form, right for any gain.
    """
    g, gain, second = work[5], work[7], work[8]
    for i in range(N):
        g[i] = 0.0
    for j in range(N):
        if h[j] != 0.0:
            for i in range(N):
                g[i] += P[j, i] * h[j]
    for i in range(N):
        gain[i] = g[i]
        second[i] = P[b, i]
    if a >= 0 and P[a, a] > 0.0:
        for i in range(N):
            gain[i] -= P[a, i] * (g[a] / P[a, a])
            second[i] -= P[a, i] * (P[a, b] / P[a, a])
    if b >= 0 and second[b] > 0.0:
        ratio = gain[b] / second[b]
        for i in range(N):
            gain[i] -= second[i] * ratio
    variance, known = r, r
    for j in range(N):
        variance += h[j] * g[j]
        known += h[j] * gain[j]
    for i in range(N):
        gain[i] *= (1.0 - keep[i]) / known
        x[i] += gain[i] * nu
        second[i] = g[i] - 0.5 * variance * gain[i]
    for i in range(N):
        for j in range(N):
            P[i, j] -= gain[i] * second[j] + second[i] * gain[j]
        if P[i, i] < 0.0:
            P[i, i] = 0.0
    if single >= 0:
        for i in range(N):
            P[i, single] = (g[i] - gain[i] * g[single]) * (r / known) + gain[i] * (r * gain[single])
            P[single, i] = P[i, single]
    else:
        for i in range(N):  # rounding must not add up to an asymmetry
            for j in range(i):
                P[i, j] = P[j, i]
    return nu * nu / variance, variance


@njit(error_model="numpy")
def _anchor(x: Any, P: Any, k: int, value: float, r: float) -> None:
    """Forget what was expected of state k: it is `value`, known to r, and related to nothing."""
    for i in range(N):
        P[i, k] = 0.0
        P[k, i] = 0.0
    x[k] = value
    P[k, k] = r


@njit(error_model="numpy")
def _gate_distance(x: Any, P: Any, z: float, since: float, jump: bool, c: Any) -> tuple[float, int]:
    """The wheels' cumulative distance. A surprise is a manoeuvre (the speed is doubted), a jump is no motion at all."""
    nu = z - x[S]
    nis = nu * nu / (P[S, S] + c.r_distance)
    if jump:
        _anchor(x, P, S, z, c.r_distance)
    elif nis > c.gate1:
        q, cos, sin, rate = nu * nu, math.cos(x[TH]), math.sin(x[TH]), 1.0 / max(since, 1e-3)
        _add3(P, X, Y, S, cos, sin, 1.0, q)
        P[V, V] += q * rate * rate
        for i, e in ((X, cos), (Y, sin), (S, 1.0)):
            P[i, V] += q * e * rate
            P[V, i] += q * e * rate
    return nis, REJECTED if jump or nis > c.gate1 else ACCEPTED


@njit(error_model="numpy")
def _gate_turn(x: Any, P: Any, z: float, since: float, jump: bool, refused: Any, c: Any) -> tuple[float, int]:
    """The wheels' cumulative turn. With a gyro a surprise is slip: that interval and a while after it are dropped, as
    slip fades in and out below the gate. Without one it is a manoeuvre."""
    nu = z - x[PHI]
    nis = nu * nu / (P[PHI, PHI] + c.r_turn)
    slips = nis > c.gate1 and c.has_gyro != 0.0
    refused[WHEEL] = SLIP_TIME if slips else refused[WHEEL] - since
    if jump or refused[WHEEL] > 0.0:
        _anchor(x, P, PHI, z, c.r_turn)
        if not slips and not jump:
            return nis, NONE
    elif nis > c.gate1:
        _add3(P, TH, PHI, B, 1.0, 1.0, -1.0 / max(since, 1e-3), nu * nu)
    return nis, REJECTED if jump or nis > c.gate1 else ACCEPTED


@njit(error_model="numpy")
def _wrap(angle: float) -> float:
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


@njit(error_model="numpy")
def _rows(kind: int, a: Any, x: Any, resting: bool, c: Any, H: Any, nu: Any, r: Any) -> int:
    """Rows H (3, 13), innovations nu (3,) and variances r (3,) of an event's scalar readings; how many there are."""
    for i in range(3):
        for j in range(N):
            H[i, j] = 0.0
    if kind == WHEEL:
        H[0, S], nu[0], r[0] = 1.0, a[0] - x[S], c.r_distance
        if math.isnan(a[1]):
            return 1
        H[1, PHI], nu[1], r[1] = 1.0, a[1] - x[PHI], c.r_turn
        return 2
    if kind == OUT:
        if not resting:
            return 0
        H[0, B], nu[0], r[0] = 1.0, a[0] - x[B], c.r_rate
        H[1, V], nu[1], r[1] = 1.0, -x[V], c.r_still
        return 2
    cos, sin = math.cos(x[TH]), math.sin(x[TH])
    arm_x, arm_y = cos * c.tag_x - sin * c.tag_y, sin * c.tag_x + cos * c.tag_y
    if kind == FIX:
        H[0, X], H[0, TH], nu[0], r[0] = 1.0, -arm_y, a[0] - x[X] - arm_x, c.r_fix
        H[1, Y], H[1, TH], nu[1], r[1] = 1.0, arm_x, a[1] - x[Y] - arm_y, c.r_fix
        if math.isnan(a[2]):
            return 2
        H[2, TH], nu[2], r[2] = 1.0, _wrap(a[2] - x[TH]), c.r_fix_theta
        return 3
    ex, ey, ez = x[X] + arm_x - a[0], x[Y] + arm_y - a[1], c.tag_z - a[2]
    distance = max(math.sqrt(ex * ex + ey * ey + ez * ez), 1e-6)
    scale = (1.0 + x[KR]) / distance
    H[0, X], H[0, Y], H[0, TH] = scale * ex, scale * ey, scale * (ey * arm_x - ex * arm_y)
    H[0, KR], H[0, BR] = distance, 1.0
    nu[0], r[0] = a[3] - (1.0 + x[KR]) * distance - x[BR], c.r_range
    return 1


@njit(error_model="numpy")
def _copy_row(a: Any, b: Any) -> None:
    for i in range(N):  # b[:] = a would compile its error message too, for seconds
        b[i] = a[i]


@njit(error_model="numpy")
def _copy(A: Any, C: Any) -> None:
    for i in range(N):
        for j in range(N):
            C[i, j] = A[i, j]


@njit(error_model="numpy")
def _doubt(P: Any, kind: int, count: int, nu: Any) -> None:
    """After many rejections the filter doubts its own pose: wide enough to take the reading."""
    if kind == FIX:
        heading = 0.7 if count == 2 else nu[2]
        P[X, X] += nu[0] * nu[0]
        P[Y, Y] += nu[1] * nu[1]
    else:
        heading = 0.3
        P[X, X] += nu[0] * nu[0]
        P[Y, Y] += nu[0] * nu[0]
    P[TH, TH] += heading * heading


@njit(error_model="numpy")
def _measure(
    kind: int, a: Any, x: Any, P: Any, resting: bool, refused: Any, c: Any, keep: Any, work: Any, P_old: Any
) -> tuple[float, float, int]:
    """One event's readings, in turn; fixes and ranges go through their joint gate, or are taken back.

    Readings of one event are of one prediction: what an earlier one has already moved is taken out, linearly.
    """
    H, nu, r, x_old = work[0:3], work[3], work[4], work[6]
    first, log_variance, gate, absolute = 0.0, 0.0, c.gate1, kind >= FIX and kind <= RANGE
    for attempt in range(2):
        count = _rows(kind, a, x, resting, c, H, nu, r)
        if absolute:
            _copy(P, P_old)
        _copy_row(x, x_old)
        total, spread = 0.0, 0.0
        for m in range(count):
            moved = 0.0
            for j in range(N):
                moved += H[m, j] * (x[j] - x_old[j])
            single, which, known_a, known_b = -1, 0, -1, -1
            if kind == WHEEL and m == 0:
                single, which, known_a = S, 1, KD
            elif kind == WHEEL:
                single, which = PHI, 2
                if c.has_gyro == 0.0:
                    known_a, known_b = KB, KE
            square, variance = _update(x, P, H[m], nu[m] - moved, r[m], keep[which], single, known_a, known_b, work)
            total += square
            spread += math.log(variance)
        if attempt == 0:
            first, log_variance = total, spread
            gate = c.gate1 if count == 1 else (c.gate2 if count == 2 else c.gate3)
        if not absolute or attempt == 1 or total <= gate:
            break
        _copy_row(x_old, x)
        _copy(P_old, P)
        refused[kind] += 1
        if refused[kind] <= c.patience:
            return first, log_variance, REJECTED
        _doubt(P, kind, count, nu)
    if absolute:
        refused[kind] = 0
    return first, log_variance, ACCEPTED if first <= gate else REJECTED


@njit(error_model="numpy")
def _at_rest(x: Any, P: Any, gz: float, refused: Any, c: Any) -> bool:
    """Whether the gyro's reading can be its bias; one that stays different for long becomes the bias."""
    nu = gz - x[B]
    if nu * nu > c.gate1 * (P[B, B] + c.r_rate):
        refused[OUT] += 1
        if refused[OUT] <= c.patience_rest:
            return False
        P[B, B] += nu * nu
    refused[OUT] = 0
    return True


@njit(error_model="numpy")
def _considered(c: Any) -> Any:
    """(3, 13) states that a reading must leave alone: none; all but the motion along, for the wheels' distance; without
    a gyro all but the turning, for the wheels' turn. Speed and turn rate are free there, so scales cannot be seen."""
    keep = np.zeros((3, N))
    for i in range(N):
        keep[1, i] = 1.0
        keep[2, i] = 0.0 if c.has_gyro != 0.0 else 1.0
    for i in (X, Y, V, S):
        keep[1, i] = 0.0
    for i in (X, Y, TH, B, PHI):
        keep[2, i] = 0.0
    return keep


@njit(cache=True, nogil=True, error_model="numpy")
def run_filter(
    dt: Any, kind: Any, data: Any, raw: Any, q_extra: Any, flags: Any, x: Any, P: Any, c: Any,
    nis: Any, status: Any, pose: Any, covariance: Any, bias: Any, bias_var: Any,
) -> None:  # fmt: skip
    """Walk over E events. In: per event dt [s] since the one before, kind, data (E, 4), the gyro's raw
    turn [rad], extra turn variance, flags (E, 3) of rest, counter jump and silent wheels; x (13,) and P (13, 13),
    changed in place to the last state. Out: nis, status (E, 2); a row of pose (M, 3), covariance (M, 3, 3), bias,
    bias_var (M,) per OUT event. nis: WHEEL distance, turn; FIX, RANGE joint value, log of the innovation's determinant.

    data: WHEEL distance, turn (NaN: unknown), time since the last reading; FIX x, y, theta or NaN; RANGE beacon x, y, z
    and range; OUT gyro reading.
    """
    work, P_old, refused, keep = np.zeros((9, N)), np.zeros((N, N)), np.zeros(4), _considered(c)
    row, started, resting = 0, False, False
    for e in range(dt.shape[0]):
        a = data[e]
        if not flags[e, 0]:
            resting = False
        elif kind[e] == OUT:
            resting = _at_rest(x, P, a[0], refused, c)
        if dt[e] > 0.0:
            _predict(x, P, dt[e], raw[e], q_extra[e], resting, flags[e, 2], c)
        if kind[e] == WHEEL:
            if not started:
                started = True
                _anchor(x, P, S, a[0], c.r_distance)
                _anchor(x, P, PHI, 0.0 if math.isnan(a[1]) else a[1], c.r_turn)
            nis[e, 0], status[e, 0] = _gate_distance(x, P, a[0], a[2], flags[e, 1], c)
            if not math.isnan(a[1]):
                nis[e, 1], status[e, 1] = _gate_turn(x, P, a[1], a[2], flags[e, 1], refused, c)
            _measure(kind[e], a, x, P, resting, refused, c, keep, work, P_old)
        elif kind[e] != OUT:
            nis[e, 0], nis[e, 1], status[e, 0] = _measure(kind[e], a, x, P, resting, refused, c, keep, work, P_old)
        else:
            _measure(kind[e], a, x, P, resting, refused, c, keep, work, P_old)
            for i in range(3):
                pose[row, i] = x[i]
                for j in range(3):
                    covariance[row, i, j] = P[i, j]
            bias[row] = x[B]
            bias_var[row] = P[B, B]
            row += 1
