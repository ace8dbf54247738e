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
    ROW,
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
    N,
    S,
    V,
    X,
    Y,
)  # fmt: skip

BLOCK = 8  # states that are dealt with at a time, N a multiple of it


@njit(error_model="numpy", forceinline=True)
def _arc(half: float) -> tuple[float, float]:
    """sin(h)/h, and its derivative by 2 h."""
    if abs(half) < 0.05:
        q = half * half
        return 1.0 - q / 6.0 + q * q / 120.0, half * (-1.0 / 6.0 + q / 60.0 - q * q / 1680.0)
    chord = math.sin(half) / half
    return chord, 0.5 * (math.cos(half) - chord) / half


@njit(error_model="numpy", forceinline=True)
def wrap(angle: float) -> float:
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


@njit(error_model="numpy", forceinline=True)
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


@njit(error_model="numpy", forceinline=True)
def _rows_few(P: Any, f: Any) -> None:
    """F times the first columns, of a state without wheels."""
    ux, uy, dx, dy, px, py = f[UX], f[UY], f[DX], f[DY], f[PX], f[PY]
    cd, fv, fb, w_b = f[CD], f[F], f[FB], f[W_B]
    for j in range(BLOCK):
        turn, move = w_b * P[B * N + j], cd * P[V * N + j]
        P[X * N + j] += ux * move - dy * P[TH * N + j] + px * turn
        P[Y * N + j] += uy * move + dx * P[TH * N + j] + py * turn
        P[TH * N + j] += turn
        P[V * N + j] *= fv
        P[B * N + j] *= fb


@njit(error_model="numpy", forceinline=True)
def _rows_gyro(P: Any, o: int, f: Any) -> None:
    """F times columns o to o + BLOCK, of a state with wheels and gyro."""
    ux, uy, dx, dy, px, py = f[UX], f[UY], f[DX], f[DY], f[PX], f[PY]
    kx, ky, cd, hb, cba, fv = f[KX], f[KY], f[CD], f[HB], f[CBA], f[F]
    w_b, w_kg, phi_w, phi_d, phi_ke, phi_kb = f[W_B], f[W_KG], f[PHI_W], f[PHI_D], f[PHI_KE], f[PHI_KB]
    for j in range(o, o + BLOCK):
        turn, move = w_b * P[B * N + j] + w_kg * P[KG * N + j], cd * P[V * N + j] - hb * P[BA * N + j]
        P[X * N + j] += ux * move - dy * P[TH * N + j] + px * turn + kx * P[KD * N + j]
        P[Y * N + j] += uy * move + dx * P[TH * N + j] + py * turn + ky * P[KD * N + j]
        P[TH * N + j] += turn
        P[V * N + j] = fv * P[V * N + j] - cba * P[BA * N + j]
        P[S * N + j] += move
        P[PHI * N + j] += phi_w * turn + phi_d * move + phi_kb * P[KB * N + j] + phi_ke * P[KE * N + j]


@njit(error_model="numpy", forceinline=True)
def _rows_wheels(P: Any, o: int, f: Any) -> None:
    """F times columns o to o + BLOCK, of a state with wheels alone."""
    ux, uy, dx, dy, px, py = f[UX], f[UY], f[DX], f[DY], f[PX], f[PY]
    kx, ky, cd, hb, cba, fv, fb = f[KX], f[KY], f[CD], f[HB], f[CBA], f[F], f[FB]
    w_b, w_d, w_ke, w_kb, phi_w = f[W_B], f[W_D], f[W_KE], f[W_KB], f[PHI_W]
    for j in range(o, o + BLOCK):
        move = cd * P[V * N + j] - hb * P[BA * N + j]
        turn = w_b * P[B * N + j] + w_d * move + w_ke * P[KE * N + j] + w_kb * P[KB * N + j]
        P[X * N + j] += ux * move - dy * P[TH * N + j] + px * turn + kx * P[KD * N + j]
        P[Y * N + j] += uy * move + dx * P[TH * N + j] + py * turn + ky * P[KD * N + j]
        P[TH * N + j] += turn
        P[S * N + j] += move
        P[PHI * N + j] += phi_w * P[B * N + j]
        P[V * N + j] = fv * P[V * N + j] - cba * P[BA * N + j]
        P[B * N + j] *= fb


@njit(error_model="numpy", forceinline=True)
def _mirror(P: Any, moving: int) -> None:
    """Transpose the block of the moving states."""
    for i in range(1, moving):
        for j in range(i):
            P[i * N + j], P[j * N + i] = P[j * N + i], P[i * N + j]


@njit(error_model="numpy", forceinline=True)
def spread(P: Any, n: int, gyro: bool, f: Any) -> None:
    """P = F P F': rows; then, of what has become of the block of moving states, its transpose's rows, as P is
    symmetric. In blocks of a fixed size that the compiler makes vectors of; beyond n all is zero."""
    if n <= S:
        _rows_few(P, f)
        _mirror(P, S)
        _rows_few(P, f)
        return
    if gyro:
        _rows_gyro(P, 0, f)
        _rows_gyro(P, BLOCK, f)
        if n > 2 * BLOCK:
            _rows_gyro(P, 2 * BLOCK, f)
            _rows_gyro(P, 3 * BLOCK, f)
    else:
        _rows_wheels(P, 0, f)
        _rows_wheels(P, BLOCK, f)
        if n > 2 * BLOCK:
            _rows_wheels(P, 2 * BLOCK, f)
            _rows_wheels(P, 3 * BLOCK, f)
    for i in range(MOVING, n):  # columns of the others follow by symmetry
        for j in range(MOVING):
            P[i * N + j] = P[j * N + i]
    _mirror(P, MOVING)
    if gyro:
        _rows_gyro(P, 0, f)
    else:
        _rows_wheels(P, 0, f)
    for j in range(MOVING):  # the block is one wider than what moves
        P[j * N + MOVING] = P[MOVING * N + j]


@njit(error_model="numpy", forceinline=True)
def _wander(dt: float, f: float, tau: float) -> tuple[float, float, float]:
    """Variances, per unit density, of a speed after dt, of speed with distance, and of distance (Van Loan)."""
    if f == 1.0:
        return dt, 0.5 * dt * dt, dt * dt * dt / 3.0
    k = 0.5 * tau
    return k * (1.0 - f * f), k * tau * (1.0 - f) ** 2, k * tau * max(2.0 * dt - tau * (3.0 - 4.0 * f + f * f), 0.0)


@njit(error_model="numpy", forceinline=True)
def add_noise(
    P: Any, n: int, dt: float, along: float, w: float, ux: float, uy: float, kb: float, trusted: bool, resting: bool,
    f: float, c: Any,
) -> None:  # fmt: skip
    """Process noise of one step: speed, turn, slip along and across, slow parameters."""
    q_v, q_dv, q_d = _wander(dt, f, c[TAU])
    q = c[Q_ACCEL] if trusted else c[Q_SPEED]
    P[V * N + V] += q * q_v
    add3(P, X, Y, S, ux, uy, 1.0 if n > S else 0.0, q * q_d)
    for i, e in ((X, ux), (Y, uy), (S, 1.0)):
        if i < n:
            P[i * N + V] += e * q * q_dv
            P[V * N + i] += e * q * q_dv
    add3(P, X, Y, S, -uy, ux, 0.0, c[Q_SIDE] * along)
    add3(P, X, Y, S, ux, uy, 0.0, 0.5 * c[Q_SLIP] * along)  # v is the wheels' speed: it is the body that slips
    if c[Q_SKID] > 0.0:
        q = c[Q_SKID] * w * w / dt
        P[X * N + X] += q
        P[Y * N + Y] += q
    slip_turn = 2.0 * c[Q_SLIP] * c[INVERSE_TRACK] * (along * c[INVERSE_TRACK] + 0.5 * abs(w))
    if c[HAS_GYRO] != 0.0:
        P[B * N + B] += c[Q_BIAS] * dt
        q_turn = 0.0 if resting else c[Q_GYRO] * dt
        if n > S:
            P[PHI * N + PHI] += slip_turn  # the gyro has the body's turn: it is the wheels that slip
            add3(P, TH, PHI, PHI, 1.0, 1.0 + kb, 0.0, q_turn)
        else:
            P[TH * N + TH] += q_turn
    else:
        P[B * N + B] += c[Q_TURN] * q_v
        P[TH * N + TH] += slip_turn
        gain = 1.0 - kb
        for i, e in ((TH, gain), (PHI, 1.0)):
            P[i * N + B] -= e * c[Q_TURN] * q_dv
            P[B * N + i] -= e * c[Q_TURN] * q_dv
        add3(P, TH, PHI, PHI, gain, 1.0, 0.0, c[Q_TURN] * q_d)
    for i in range(KD, min(n, BR + 1)):
        if P[i * N + i] > 0.0:  # a parameter with no variance is frozen
            P[i * N + i] += (c[Q_TILT] if i == BA else c[Q_SCALE]) * dt


@njit(error_model="numpy", forceinline=True)
def add3(P: Any, i: int, j: int, k: int, a: float, b: float, e: float, q: float) -> None:
    """P += q g g' for g with a, b, e at i, j, k; k may equal j where e is 0."""
    P[i * N + i] += q * a * a
    P[j * N + j] += q * b * b
    P[i * N + j] += q * a * b
    P[j * N + i] += q * a * b
    if e != 0.0:
        P[k * N + k] += q * e * e
        P[i * N + k] += q * a * e
        P[k * N + i] += q * a * e
        P[j * N + k] += q * b * e
        P[k * N + j] += q * b * e


@njit(error_model="numpy")
def anchor(P: Any, n: int, k: int, r: float) -> None:
    """Forget what was expected of state k: it is known to r, and related to nothing."""
    for i in range(n):
        P[i * N + k] = 0.0
        P[k * N + i] = 0.0
    P[k * N + k] = r


@njit(error_model="numpy", forceinline=True)
def covariance_with(P: Any, n: int, work: Any, index: Any, row: int, to: int) -> float:
    """work[to] = P h for the sparse row h of a reading: values work[ROW + row] at states index[row]; returns h' P h."""
    k, a = index[row, 0], work[ROW + row, 0]
    few = n <= BLOCK
    if few:
        for i in range(BLOCK):
            work[to, i] = a * P[k * N + i]
    else:
        for i in range(n):
            work[to, i] = a * P[k * N + i]
    for m in range(1, index[row, ROOM]):
        k, a = index[row, m], work[ROW + row, m]
        if few:
            for i in range(BLOCK):
                work[to, i] += a * P[k * N + i]
        else:
            for i in range(n):
                work[to, i] += a * P[k * N + i]
    total = 0.0
    for m in range(index[row, ROOM]):
        total += work[ROW + row, m] * work[to, index[row, m]]
    return total


@njit(error_model="numpy", forceinline=True)
def _correct_few(x: Any, P: Any, work: Any, row: int, nu: float, inverse: float) -> None:
    """The same for a state without wheels, written out: P h in registers, as arrays might overlap."""
    a, b, c, d, e = work[row, 0], work[row, 1], work[row, 2], work[row, 3], work[row, 4]
    for i in range(S):
        gain = work[row, i] * inverse
        o = i * N
        x[i] += gain * nu
        P[o] -= gain * a
        P[o + 1] -= gain * b
        P[o + 2] -= gain * c
        P[o + 3] -= gain * d
        P[o + 4] -= gain * e
        P[o + i] = max(P[o + i], 0.0)


@njit(error_model="numpy", forceinline=True)
def correct(x: Any, P: Any, n: int, work: Any, row: int, nu: float, variance: float) -> None:
    """Update by one scalar reading: work[row] = P h, innovation nu and its variance."""
    inverse = 1.0 / variance
    if n <= S:
        _correct_few(x, P, work, row, nu, inverse)
        return
    for i in range(n):
        gain = work[row, i] * inverse
        x[i] += gain * nu
        for j in range(n):
            P[i * N + j] -= gain * work[row, j]
        P[i * N + i] = max(P[i * N + i], 0.0)


@njit(error_model="numpy", forceinline=True)
def correct_state(x: Any, P: Any, n: int, k: int, nu: float, r: float, work: Any, rec: Any, event: int) -> None:
    """Update by a reading of state k itself; its covariances are computed without a difference that would cancel.
    Recorded, unless event < 0."""
    for i in range(n):
        work[0, i] = P[k * N + i]
    variance = work[0, k] + r
    if event >= 0:
        u = rec.marks[event + 1, 0]
        rec.which[u, 0], rec.which[u, ROOM], rec.corrections[u, VALUES] = k, 1, 1.0
        keep(rec, event, work, 0, n, nu, variance)
    correct(x, P, n, work, 0, nu, variance)
    ratio = r / variance
    for i in range(n):
        P[i * N + k] = work[0, i] * ratio
        P[k * N + i] = P[i * N + k]


@njit(error_model="numpy", forceinline=True)
def keep(rec: Any, event: int, work: Any, row: int, n: int, nu: float, variance: float) -> None:
    """Record a correction whose row is written already."""
    u = rec.marks[event + 1, 0]
    for i in range(n):
        rec.corrections[u, i] = work[row, i]
    rec.corrections[u, NU], rec.corrections[u, VARIANCE] = nu, variance
    rec.marks[event + 1, 0] = u + 1
