"""Compiled: what the wheels' cumulative readings tell, and which of them to believe."""

from __future__ import annotations

import math
from typing import Any

from numba import njit

from core.estimation.fusion._model_numba import add3, anchor, correct_state, keep
from core.estimation.fusion.layout import (
    ACCEPTED, B, CARRIED, JUMP, LEFT, NONE, PHI, REJECTED, RIGHT, S, SLIP_LEFT, SLIP_RIGHT, SLIP_TURN, STARTED, STOPPED,
    T_STRANGE, T_TRUST, T_WHEEL, TH, TURN, V, X, Y,
)  # fmt: skip

SLIP_TIME = 0.5  # s: for how long a wheel that was caught slipping is not asked, as slip fades below the gate
ANYWHERE = 1.0  # m, m^2: how far a slipping wheel may have run
STOOD = 4e-4  # m^2/s^2, of the speed of a body that is said to stand


@njit(error_model="numpy")
def _loose(P: Any, left: bool, right: bool, turn: bool, c: Any) -> None:
    """Doubt what a wheel should read: left is s - phi/(2 ib), right s + phi/(2 ib), of ib one over the track width."""
    ib = c.inverse_track
    if ib == 0.0:
        P[S, S] += ANYWHERE
        return
    if left:
        add3(P, S, PHI, PHI, 0.5, -ib, 0.0, ANYWHERE)
    if right:
        add3(P, S, PHI, PHI, 0.5, ib, 0.0, ANYWHERE)
    if turn and not (left or right):
        P[PHI, PHI] += ANYWHERE * ib * ib


@njit(error_model="numpy")
def _surge(x: Any, P: Any, nu: float, since: float) -> None:
    """A surprise of the distance that is a manoeuvre: the speed is doubted, and what it has brought since."""
    q, cos, sin, rate = nu * nu, math.cos(x[TH]), math.sin(x[TH]), 1.0 / max(since, 1e-3)
    add3(P, X, Y, S, cos, sin, 1.0, q)
    P[V, V] += q * rate * rate
    for i, e in ((X, cos), (Y, sin), (S, 1.0)):
        P[i, V] += q * e * rate
        P[V, i] += q * e * rate


@njit(error_model="numpy")
def _judge(t: float, nu: float, nu_turn: float, x: Any, P: Any, since: float, mem: Any, c: Any) -> None:
    """Both readings together are a surprise beside a gyro: which wheel slips, or is it a manoeuvre?"""
    half = 0.5 / c.inverse_track
    spread, cross = P[S, S] + c.r_distance + half * half * (P[PHI, PHI] + c.r_turn), 2.0 * half * P[S, PHI]
    left, right = nu - half * nu_turn, nu + half * nu_turn
    left_bad = left * left > c.gate1 * max(spread - cross, 1e-18)
    right_bad = right * right > c.gate1 * max(spread + cross, 1e-18)
    turn_bad = nu_turn * nu_turn > c.gate1 * (P[PHI, PHI] + c.r_turn)
    alone = t - mem[T_TRUST] < c.coast  # the accelerometer can carry the speed for a while, not for ever
    if left_bad and not right_bad:
        mem[SLIP_LEFT] = t + SLIP_TIME
    elif right_bad and not left_bad:
        mem[SLIP_RIGHT] = t + SLIP_TIME
    elif c.has_accel != 0.0 and alone and left_bad:
        mem[SLIP_LEFT], mem[SLIP_RIGHT] = t + 0.1, t + 0.1
    else:
        if turn_bad:
            mem[SLIP_TURN] = t + SLIP_TIME
        if nu * nu > c.gate1 * (P[S, S] + c.r_distance):
            _surge(x, P, nu, since)
    mem[T_STRANGE] = t


@njit(error_model="numpy")
def wheels(
    t: float, a: Any, flags: int, x: Any, P: Any, n: int, mem: Any, c: Any, work: Any, nis: Any, status: Any, rec: Any,
    record: bool, k: int,
) -> None:  # fmt: skip
    """Both wheels' readings: gated together, then taken one after the other."""
    since = t - mem[T_WHEEL]
    turning = not math.isnan(a[1])
    forgotten = 0
    if mem[T_WHEEL] < 0.0 or flags & JUMP:
        x[S] = a[0]
        anchor(P, n, S, c.r_distance)
        x[PHI] = a[1] if turning else 0.0
        anchor(P, n, PHI, c.r_turn)
        forgotten = (1 << S) | (1 << PHI)
        if mem[T_WHEEL] < 0.0:
            mem[T_TRUST] = t
        else:
            nis[0], status[0], status[1] = 0.0, REJECTED, REJECTED if turning else NONE
    else:
        _weigh(t, a, flags, turning, since, x, P, mem, c, nis, status)
    mem[T_WHEEL] = t
    if record:
        rec.forgotten[k] |= forgotten
    nu, g = a[0] - x[S], work[0]
    variance = correct_state(x, P, n, S, nu, c.r_distance, g)
    keep(rec, record, S, g, n, nu, variance)
    if turning:
        nu = a[1] - x[PHI]
        variance = correct_state(x, P, n, PHI, nu, c.r_turn, g)
        keep(rec, record, PHI, g, n, nu, variance)
    if flags & STOPPED:
        nu = -x[V]
        variance = correct_state(x, P, n, V, nu, STOOD, g)
        keep(rec, record, V, g, n, nu, variance)


@njit(error_model="numpy")
def _weigh(
    t: float, a: Any, flags: int, turning: bool, since: float, x: Any, P: Any, mem: Any, c: Any, nis: Any, status: Any
) -> None:
    """Test both readings; doubt what is not to be believed before they are taken."""
    nu = a[0] - x[S]
    nis[0] = nu * nu / (P[S, S] + c.r_distance)
    witness = turning and c.has_gyro != 0.0
    if turning:
        nu_turn = a[1] - x[PHI]
        nis[1] = nu_turn * nu_turn / (P[PHI, PHI] + c.r_turn)
    known = flags & (LEFT | RIGHT | TURN | STOPPED | CARRIED)
    if known:
        mem[T_STRANGE] = t
    elif witness:
        s00, s11, s01 = P[S, S] + c.r_distance, P[PHI, PHI] + c.r_turn, P[S, PHI]
        both = (nu * nu * s11 - 2.0 * nu * nu_turn * s01 + nu_turn * nu_turn * s00) / max(s00 * s11 - s01 * s01, 1e-30)
        if both > c.gate2:
            _judge(t, nu, nu_turn, x, P, since, mem, c)
    else:
        if nis[0] > c.gate1:
            _surge(x, P, nu, since)
        if turning and nis[1] > c.gate1:
            add3(P, TH, PHI, B, 1.0, 1.0, -1.0 / max(since, 1e-3), nu_turn * nu_turn)
    stands = flags & (STOPPED | CARRIED) != 0
    left = flags & LEFT != 0 or mem[SLIP_LEFT] > t or stands
    right = flags & RIGHT != 0 or mem[SLIP_RIGHT] > t or stands
    turn = flags & TURN != 0 or mem[SLIP_TURN] > t
    if left or right or turn:
        _loose(P, left, right, turn, c)
    if not (left and right) and not (c.inverse_track == 0.0 and (left or right)):
        mem[T_TRUST] = t
    status[0] = REJECTED if left or right else ACCEPTED
    if turning:
        status[1] = REJECTED if left or right or turn else ACCEPTED
