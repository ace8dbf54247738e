"""Compiled parts of the filter: how the state moves, and the update by one scalar reading. The state is in `layout`."""

from __future__ import annotations

import math
from typing import Any

from numba import njit

from core.estimation.fusion.layout import (
    BA,
    BR,
    CBA,
    CD,
    DX,
    DY,
    FB,
    HAS_GYRO,
    HB,
    INVERSE_TRACK,
    KB,
    KD,
    KE,
    KG,
    KX,
    KY,
    MOVING,
    NU,
    PHI,
    PHI_D,
    PHI_KB,
    PHI_KE,
    PHI_W,
    PX,
    PY,
    Q_ACCEL,
    Q_BIAS,
    Q_GYRO,
    Q_SCALE,
    Q_SIDE,
    Q_SKID,
    Q_SLIP,
    Q_SPEED,
    Q_TILT,
    Q_TURN,
    ROOM,
    TAU,
    TH,
    UX,
    UY,
    VALUES,
    VARIANCE,
    W_B,
    W_D,
    W_KB,
    W_KE,
    W_KG,
    B,
    F,
    S,
    V,
    X,
    Y,
)  # fmt: skip


@njit(error_model="numpy")
def _arc(half: float) -> tuple[float, float]:
    """sin(h)/h, and its derivative by 2 h."""
    if abs(half) < 0.05:
        q = half * half
        return 1.0 - q / 6.0 + q * q / 120.0, half * (-1.0 / 6.0 + q / 60.0 - q * q / 1680.0)
    chord = math.sin(half) / half
    return chord, 0.5 * (math.cos(half) - chord) / half


@njit(error_model="numpy")
def wrap(angle: float) -> float:
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


@njit(error_model="numpy")
def step(
    x: Any, P: Any, n: int, dt: float, raw: float, dv: float, trusted: bool, resting: bool, fading: bool, c: Any, f: Any
) -> None:
    """Carry the state over dt [s] with the gyro's raw turn [rad] and the accelerometer's dv [m/s] (trusted or not); `f`
    (PARTS,) receives what the Jacobian is made of, and `spread` carries the covariance."""
    f[F], f[CD], f[FB], cb = 1.0, dt, 1.0, dt
    if fading:
        f[F] = math.exp(-dt / c[TAU])
        f[CD] = c[TAU] * (1.0 - f[F])
        if c[HAS_GYRO] == 0.0:
            f[FB], cb = f[F], f[CD]
    f[CBA] = dt if trusted else 0.0
    change = dv - f[CBA] * x[BA] if trusted else 0.0
    d = (x[V] + 0.5 * change) * f[CD]
    f[HB] = 0.5 * f[CBA] * f[CD]
    f[W_D], f[W_KE], f[W_KB], f[W_KG] = 0.0, 0.0, 0.0, 0.0
    if c[HAS_GYRO] != 0.0:
        if resting:
            raw, cb = 0.0, 0.0
        gain = 1.0 - x[KG]
        free = raw - x[B] * cb
        w = free * gain
        f[W_B], f[W_KG] = -cb * gain, -free
        f[PHI_W], f[PHI_D] = 1.0 + x[KB], -x[KE] * c[INVERSE_TRACK]
        f[PHI_KE], f[PHI_KB] = -d * c[INVERSE_TRACK], w
        turned = w * f[PHI_W] + d * f[PHI_D]
    else:
        turned = -x[B] * cb
        gain = 1.0 - x[KB]
        free = turned + x[KE] * d * c[INVERSE_TRACK]
        w = free * gain
        f[W_B], f[W_KB] = -cb * gain, -free
        f[W_D], f[W_KE] = gain * x[KE] * c[INVERSE_TRACK], gain * d * c[INVERSE_TRACK]
        f[PHI_W], f[PHI_D] = -cb, 0.0
    half = 0.5 * w
    chord, bend = _arc(half)
    cos, sin = math.cos(x[TH] + half), math.sin(x[TH] + half)
    scale = 1.0 + x[KD]
    body, ux, uy = d * scale, chord * cos, chord * sin
    f[UX], f[UY], f[KX], f[KY] = ux * scale, uy * scale, ux * d, uy * d
    f[DX], f[DY] = body * ux, body * uy
    f[PX], f[PY] = body * bend * cos - 0.5 * f[DY], body * bend * sin + 0.5 * f[DX]
    x[X] += f[DX]
    x[Y] += f[DY]
    x[TH] += w
    x[V] = x[V] * f[F] + change
    x[B] *= f[FB]
    if n > S:
        x[S] += d
        x[PHI] += turned
    spread(P, n, c[HAS_GYRO] != 0.0, f)
    add_noise(P, n, dt, abs(body), w, ux, uy, x[KB], trusted, resting, f[F], c)


@njit(error_model="numpy")
def spread(P: Any, n: int, gyro: bool, f: Any) -> None:
    """P = F P F', rows first, then columns."""
    ux, uy, dx, dy, px, py = f[UX], f[UY], f[DX], f[DY], f[PX], f[PY]
    kx, ky, cd, hb, cba, fv, fb = f[KX], f[KY], f[CD], f[HB], f[CBA], f[F], f[FB]
    w_b, w_kg, phi_w, phi_d = f[W_B], f[W_KG], f[PHI_W], f[PHI_D]
    if n <= S:
        for j in range(n):
            turn, move = w_b * P[B, j], cd * P[V, j]
            P[X, j] += ux * move - dy * P[TH, j] + px * turn
            P[Y, j] += uy * move + dx * P[TH, j] + py * turn
            P[TH, j] += turn
            P[V, j] *= fv
            P[B, j] *= fb
        for i in range(n):
            turn, move = w_b * P[i, B], cd * P[i, V]
            P[i, X] += ux * move - dy * P[i, TH] + px * turn
            P[i, Y] += uy * move + dx * P[i, TH] + py * turn
            P[i, TH] += turn
            P[i, V] *= fv
            P[i, B] *= fb
        return
    if gyro:
        phi_ke, phi_kb = f[PHI_KE], f[PHI_KB]
        for j in range(n):
            turn, move = w_b * P[B, j] + w_kg * P[KG, j], cd * P[V, j] - hb * P[BA, j]
            P[X, j] += ux * move - dy * P[TH, j] + px * turn + kx * P[KD, j]
            P[Y, j] += uy * move + dx * P[TH, j] + py * turn + ky * P[KD, j]
            P[TH, j] += turn
            P[V, j] = fv * P[V, j] - cba * P[BA, j]
            P[S, j] += move
            P[PHI, j] += phi_w * turn + phi_d * move + phi_kb * P[KB, j] + phi_ke * P[KE, j]
        for i in range(MOVING):
            turn, move = w_b * P[i, B] + w_kg * P[i, KG], cd * P[i, V] - hb * P[i, BA]
            P[i, X] += ux * move - dy * P[i, TH] + px * turn + kx * P[i, KD]
            P[i, Y] += uy * move + dx * P[i, TH] + py * turn + ky * P[i, KD]
            P[i, TH] += turn
            P[i, V] = fv * P[i, V] - cba * P[i, BA]
            P[i, S] += move
            P[i, PHI] += phi_w * turn + phi_d * move + phi_kb * P[i, KB] + phi_ke * P[i, KE]
    else:
        w_d, w_ke, w_kb = f[W_D], f[W_KE], f[W_KB]
        for j in range(n):
            move = cd * P[V, j] - hb * P[BA, j]
            turn = w_b * P[B, j] + w_d * move + w_ke * P[KE, j] + w_kb * P[KB, j]
            P[X, j] += ux * move - dy * P[TH, j] + px * turn + kx * P[KD, j]
            P[Y, j] += uy * move + dx * P[TH, j] + py * turn + ky * P[KD, j]
            P[TH, j] += turn
            P[S, j] += move
            P[PHI, j] += phi_w * P[B, j]
            P[V, j] = fv * P[V, j] - cba * P[BA, j]
            P[B, j] *= fb
        for i in range(MOVING):
            move = cd * P[i, V] - hb * P[i, BA]
            turn = w_b * P[i, B] + w_d * move + w_ke * P[i, KE] + w_kb * P[i, KB]
            P[i, X] += ux * move - dy * P[i, TH] + px * turn + kx * P[i, KD]
            P[i, Y] += uy * move + dx * P[i, TH] + py * turn + ky * P[i, KD]
            P[i, TH] += turn
            P[i, S] += move
            P[i, PHI] += phi_w * P[i, B]
            P[i, V] = fv * P[i, V] - cba * P[i, BA]
            P[i, B] *= fb
    for i in range(MOVING, n):  # the rest by symmetry
        for j in range(MOVING):
            P[i, j] = P[j, i]


@njit(error_model="numpy")
def _wander(dt: float, f: float, tau: float) -> tuple[float, float, float]:
    """Variances, per unit density, of a speed after dt, of speed with distance, and of distance (Van Loan)."""
    if f == 1.0:
        return dt, 0.5 * dt * dt, dt * dt * dt / 3.0
    k = 0.5 * tau
    return k * (1.0 - f * f), k * tau * (1.0 - f) ** 2, k * tau * max(2.0 * dt - tau * (3.0 - 4.0 * f + f * f), 0.0)


@njit(error_model="numpy")
def add_noise(
    P: Any, n: int, dt: float, along: float, w: float, ux: float, uy: float, kb: float, trusted: bool, resting: bool,
    f: float, c: Any,
) -> None:  # fmt: skip
    """Process noise of one step: speed, turn, slip along and across, slow parameters."""
    q_v, q_dv, q_d = _wander(dt, f, c[TAU])
    q = c[Q_ACCEL] if trusted else c[Q_SPEED]
    P[V, V] += q * q_v
    add3(P, X, Y, S, ux, uy, 1.0 if n > S else 0.0, q * q_d)
    for i, e in ((X, ux), (Y, uy), (S, 1.0)):
        if i < n:
            P[i, V] += e * q * q_dv
            P[V, i] += e * q * q_dv
    add3(P, X, Y, S, -uy, ux, 0.0, c[Q_SIDE] * along)
    add3(P, X, Y, S, ux, uy, 0.0, 0.5 * c[Q_SLIP] * along)  # v is the wheels' speed: it is the body that slips
    if c[Q_SKID] > 0.0:
        q = c[Q_SKID] * w * w / dt
        P[X, X] += q
        P[Y, Y] += q
    slip_turn = 2.0 * c[Q_SLIP] * c[INVERSE_TRACK] * (along * c[INVERSE_TRACK] + 0.5 * abs(w))
    if c[HAS_GYRO] != 0.0:
        P[B, B] += c[Q_BIAS] * dt
        q_turn = 0.0 if resting else c[Q_GYRO] * dt
        if n > S:
            P[PHI, PHI] += slip_turn  # the gyro has the body's turn: it is the wheels that slip
            add3(P, TH, PHI, PHI, 1.0, 1.0 + kb, 0.0, q_turn)
        else:
            P[TH, TH] += q_turn
    else:
        P[B, B] += c[Q_TURN] * q_v
        P[TH, TH] += slip_turn
        gain = 1.0 - kb
        for i, e in ((TH, gain), (PHI, 1.0)):
            P[i, B] -= e * c[Q_TURN] * q_dv
            P[B, i] -= e * c[Q_TURN] * q_dv
        add3(P, TH, PHI, PHI, gain, 1.0, 0.0, c[Q_TURN] * q_d)
    for i in range(KD, min(n, BR + 1)):
        if P[i, i] > 0.0:  # a parameter with no variance is frozen
            P[i, i] += (c[Q_TILT] if i == BA else c[Q_SCALE]) * dt


@njit(error_model="numpy")
def add3(P: Any, i: int, j: int, k: int, a: float, b: float, e: float, q: float) -> None:
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
def anchor(P: Any, n: int, k: int, r: float) -> None:
    """Forget what was expected of state k: it is known to r, and related to nothing."""
    for i in range(n):
        P[i, k] = 0.0
        P[k, i] = 0.0
    P[k, k] = r


@njit(error_model="numpy")
def covariance_with(P: Any, n: int, which: Any, value: Any, g: Any) -> float:
    """g (n,) = P h for the sparse row h (value at which[:ROOM], which[ROOM] of them); returns h' P h."""
    for i in range(n):
        g[i] = value[0] * P[which[0], i]
    for m in range(1, which[ROOM]):
        k, a = which[m], value[m]
        for i in range(n):
            g[i] += a * P[k, i]
    total = 0.0
    for m in range(which[ROOM]):
        total += value[m] * g[which[m]]
    return total


@njit(error_model="numpy")
def correct(x: Any, P: Any, n: int, g: Any, nu: float, variance: float) -> None:
    """Update by one scalar reading: g = P h, innovation nu and its variance."""
    inverse = 1.0 / variance
    for i in range(n):
        gain = g[i] * inverse
        x[i] += gain * nu
        for j in range(n):
            P[i, j] -= gain * g[j]
        P[i, i] = max(P[i, i], 0.0)


@njit(error_model="numpy")
def correct_state(x: Any, P: Any, n: int, k: int, nu: float, r: float, g: Any, rec: Any, event: int) -> None:
    """Update by a reading of state k itself; its covariances are computed without a difference that would cancel.
    Recorded, unless event < 0."""
    for i in range(n):
        g[i] = P[k, i]
    variance = g[k] + r
    if event >= 0:
        u = rec.marks[event + 1, 0]
        rec.which[u, 0], rec.which[u, ROOM], rec.corrections[u, VALUES] = k, 1, 1.0
        keep(rec, event, g, n, nu, variance)
    correct(x, P, n, g, nu, variance)
    ratio = r / variance
    for i in range(n):
        P[i, k] = g[i] * ratio
        P[k, i] = P[i, k]


@njit(error_model="numpy")
def keep(rec: Any, event: int, g: Any, n: int, nu: float, variance: float) -> None:
    """Record a correction whose row is written already."""
    u = rec.marks[event + 1, 0]
    for i in range(n):
        rec.corrections[u, i] = g[i]
    rec.corrections[u, NU], rec.corrections[u, VARIANCE] = nu, variance
    rec.marks[event + 1, 0] = u + 1
