"""Compiled: what the wheels' cumulative readings tell, and which of them to believe."""

from __future__ import annotations

import math
from typing import Any

from numba import njit

from core.estimation.fusion._model_numba import add3, anchor, correct_state
from core.estimation.fusion.layout import (
    ACCEPTED,
    CARRIED,
    COAST,
    DISTANCE,
    GATE1,
    GATE2,
    HAS_ACCEL,
    HAS_GYRO,
    INVERSE_TRACK,
    JUMP,
    LEFT,
    LOST_SPEED,
    NONE,
    PHI,
    R_DISTANCE,
    R_TURN,
    REJECTED,
    RIGHT,
    SLIP_LEFT,
    SLIP_RIGHT,
    SLIP_TURN,
    STOP_OK,
    STOP_SINCE,
    STOPPED,
    T_STRANGE,
    T_TRUST,
    T_WHEEL,
    TH,
    TURN,
    WASH_WHEELS,
    WHEEL_SPEED,
    B,
    N,
    S,
    V,
    X,
    Y,
)  # fmt: skip

SLIP_TIME = 0.5  # s: for how long a wheel that was caught slipping is not asked, as slip fades below the gate
ANYWHERE = 1.0  # m, m^2: how far a slipping wheel may have run
OWN_SLIP, SLIP_MEMORY = 0.5, 0.3  # the slower wheel's own slip, of its speed; s for which it stays alike
STOOD, STOP_TIME = 4e-4, 0.4  # m^2/s^2, of the speed of a body that stands; s in which that must show


@njit(error_model="numpy", forceinline=True)
def _loose(P: Any, left: bool, right: bool, c: Any) -> None:
    """Doubt what a wheel should read: left is s - phi/(2 ib), right s + phi/(2 ib), of ib one over the track width."""
    ib = c[INVERSE_TRACK]
    if ib == 0.0:
        P[S * N + S] += ANYWHERE
        return
    if left:
        add3(P, S, PHI, PHI, 0.5, -ib, 0.0, ANYWHERE)
    if right:
        add3(P, S, PHI, PHI, 0.5, ib, 0.0, ANYWHERE)


@njit(error_model="numpy")
def _surge(x: Any, P: Any, nu: float, since: float) -> None:
    """A surprise of the distance that is a manoeuvre: the speed is doubted, and what it has brought since."""
    q, cos, sin, rate = nu * nu, math.cos(x[TH]), math.sin(x[TH]), 1.0 / max(since, 1e-3)
    add3(P, X, Y, S, cos, sin, 1.0, q)
    P[V * N + V] += q * rate * rate
    for i, e in ((X, cos), (Y, sin), (S, 1.0)):
        P[i * N + V] += q * e * rate
        P[V * N + i] += q * e * rate


@njit(error_model="numpy")
def _judge(t: float, nu: float, nu_turn: float, x: Any, P: Any, since: float, mem: Any, c: Any) -> None:
    """Both readings together are a surprise beside a gyro: which wheel slips, or is it a manoeuvre?"""
    half = 0.5 / c[INVERSE_TRACK]
    spread, cross = (
        P[S * N + S] + c[R_DISTANCE] + half * half * (P[PHI * N + PHI] + c[R_TURN]),
        2.0 * half * P[S * N + PHI],
    )
    left, right = nu - half * nu_turn, nu + half * nu_turn
    left_bad = left * left > c[GATE1] * max(spread - cross, 1e-18)
    right_bad = right * right > c[GATE1] * max(spread + cross, 1e-18)
    alone = t - mem[T_TRUST] < c[COAST]  # the accelerometer can carry the speed for a while, not for ever
    if left_bad and not right_bad:
        mem[SLIP_LEFT] = t + SLIP_TIME
    elif right_bad and not left_bad:
        mem[SLIP_RIGHT] = t + SLIP_TIME
    elif c[HAS_ACCEL] != 0.0 and alone and left_bad:
        mem[SLIP_LEFT], mem[SLIP_RIGHT] = t + 0.1, t + 0.1
    else:
        if nu_turn * nu_turn > c[GATE1] * (P[PHI * N + PHI] + c[R_TURN]):
            mem[SLIP_TURN] = t + SLIP_TIME
        if nu * nu > c[GATE1] * (P[S * N + S] + c[R_DISTANCE]):
            _surge(x, P, nu, since)
    mem[T_STRANGE] = t


@njit(error_model="numpy", forceinline=True)
def _stands(t: float, flags: int, mem: Any, c: Any) -> bool:
    """Whether a body that is said to stand does: steady driving looks like a standstill to an IMU, so the accelerometer
    must have felt how the wheels' speed was lost, at about the time of which it is said."""
    if flags & STOPPED == 0:
        mem[STOP_SINCE], mem[STOP_OK] = -1.0, 0.0
        return False
    if mem[STOP_SINCE] < 0.0:
        mem[STOP_SINCE] = t
    lost = -mem[LOST_SPEED] * math.copysign(1.0, mem[WHEEL_SPEED])
    if t - mem[STOP_SINCE] <= STOP_TIME and (lost > 0.5 * abs(mem[WHEEL_SPEED]) or c[HAS_ACCEL] == 0.0):
        mem[STOP_OK] = 1.0
    return mem[STOP_OK] != 0.0


@njit(error_model="numpy")
def _test(t: float, nu: float, nu_turn: float, turning: bool, x: Any, P: Any, since: float, mem: Any, c: Any) -> None:
    """Are the readings a surprise?"""
    if turning and c[HAS_GYRO] != 0.0:
        s00, s11, s01 = P[S * N + S] + c[R_DISTANCE], P[PHI * N + PHI] + c[R_TURN], P[S * N + PHI]
        both = (nu * nu * s11 - 2.0 * nu * nu_turn * s01 + nu_turn * nu_turn * s00) / max(s00 * s11 - s01 * s01, 1e-30)
        if both > c[GATE2]:
            _judge(t, nu, nu_turn, x, P, since, mem, c)
        return
    if nu * nu > c[GATE1] * (P[S * N + S] + c[R_DISTANCE]):
        _surge(x, P, nu, since)
    if turning and nu_turn * nu_turn > c[GATE1] * (P[PHI * N + PHI] + c[R_TURN]):
        add3(P, TH, PHI, B, 1.0, 1.0, -1.0 / max(since, 1e-3), nu_turn * nu_turn)


@njit(error_model="numpy")
def _slower(
    d: float, nu_turn: float, since: float, x: Any, P: Any, n: int, c: Any, work: Any, rec: Any, k: int
) -> None:
    """Wheels that contradict the gyro's turn, and nobody knows which: a driven wheel that slips runs ahead; the speed
    is near that of the slower one, which may slip as well."""
    more = abs(0.5 / c[INVERSE_TRACK] * nu_turn)
    slow = math.copysign(max(abs(d) - more, 0.0), d) / since
    sd = OWN_SLIP * max(abs(slow), more / since) + 0.02
    correct_state(x, P, n, V, slow - x[V], sd * sd * max(SLIP_MEMORY / since, 1.0), work, rec, k)


@njit(error_model="numpy")
def _begin(t: float, a: Any, turning: bool, x: Any, P: Any, n: int, c: Any) -> None:
    """The first readings, or those after a counter's jump, say nothing but where the counters stand."""
    x[S] = a[0]
    anchor(P, n, S, c[R_DISTANCE])
    x[PHI] = a[1] if turning else 0.0
    anchor(P, n, PHI, c[R_TURN])


@njit(error_model="numpy", forceinline=True)
def wheels(
    t: float,
    a: Any,
    flags: int,
    x: Any,
    P: Any,
    n: int,
    mem: Any,
    c: Any,
    work: Any,
    out: Any,
    e: int,
    rec: Any,
    k: int,
) -> None:
    """Both wheels' readings: tested together, then taken one after the other; what is not to be believed is doubted
    first, so that it says nothing."""
    since, turning, first = t - mem[T_WHEEL], not math.isnan(a[1]), mem[T_WHEEL] < 0.0
    left, right, turn, stands, nu_turn = False, False, False, False, 0.0
    if first or flags & JUMP:
        _begin(t, a, turning, x, P, n, c)
        if k >= 0:
            rec.marks[k, 1] = (1 << S) | (1 << PHI)
        if not first:
            out.nis[e, 0], left, right = 0.0, True, True
        mem[T_TRUST] = t
    else:
        nu = a[0] - x[S]
        out.score[e, 0] = nu / math.sqrt(P[S * N + S] + c[R_DISTANCE])
        out.nis[e, 0] = out.score[e, 0] * out.score[e, 0]
        if turning:
            nu_turn = a[1] - x[PHI]
            out.score[e, 1] = nu_turn / math.sqrt(P[PHI * N + PHI] + c[R_TURN])
            out.nis[e, 1] = out.score[e, 1] * out.score[e, 1]
        stands = _stands(t, flags, mem, c)
        said = flags & (LEFT | RIGHT | TURN) != 0 and (
            stands or flags & STOPPED == 0 or t - mem[STOP_SINCE] < STOP_TIME
        )
        if not said and flags & CARRIED == 0:
            _test(t, nu, nu_turn, turning, x, P, since, mem, c)
        out_of_use = flags & CARRIED != 0 or stands
        left = (said and flags & LEFT != 0) or mem[SLIP_LEFT] > t or out_of_use
        right = (said and flags & RIGHT != 0) or mem[SLIP_RIGHT] > t or out_of_use
        turn = (said and flags & TURN != 0) or mem[SLIP_TURN] > t
        turn = turn and turning and c[HAS_GYRO] != 0.0 and not (left or right)
        if left or right or turn:
            _loose(P, left or turn, right or turn, c)
        if not (left and right) and (c[INVERSE_TRACK] > 0.0 or not (left or right)):
            mem[T_TRUST] = t
    out.status[e, 0] = REJECTED if left or right or turn else (NONE if first else ACCEPTED)
    if turning:
        out.status[e, 1] = out.status[e, 0]
    correct_state(x, P, n, S, a[0] - x[S], c[R_DISTANCE], work, rec, k)
    if turning:
        correct_state(x, P, n, PHI, a[1] - x[PHI], c[R_TURN], work, rec, k)
    if turn:
        _slower(a[0] - mem[DISTANCE], nu_turn, max(since, 1e-3), x, P, n, c, work, rec, k)
    elif stands:
        correct_state(x, P, n, V, -x[V], STOOD, work, rec, k)
    speed = (a[0] - mem[DISTANCE]) / max(since, 1e-3) if not first and flags & JUMP == 0 else mem[WHEEL_SPEED]
    mem[WASH_WHEELS] += speed - mem[WHEEL_SPEED]
    mem[T_WHEEL], mem[DISTANCE], mem[WHEEL_SPEED] = t, a[0], speed
