"""Compiled: the walk back of the fixed-interval smoother over a stretch that the filter has recorded.

Bryson and Frazier's form as modified by Bierman (1973): an adjoint lambda (n,) and its variance L (n, n) are carried
back through the very steps and corrections of the filter; no covariance is inverted. At a row, smoothed = filtered -
P lambda, covariance P - P L P. What the filter forgot (anchored) carries nothing back.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit

from core.estimation.fusion.layout import (
    BA,
    CBA,
    CD,
    DX,
    DY,
    FB,
    HB,
    KB,
    KD,
    KE,
    KG,
    KX,
    KY,
    NU,
    OUT,
    PARTS,
    PHI,
    PHI_D,
    PHI_KB,
    PHI_KE,
    PHI_W,
    PX,
    PY,
    ROOM,
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


@njit(error_model="numpy", forceinline=True)
def _back(z: Any, stride: int, step: int, count: int, f: Any, gyro: bool, wheels: bool) -> None:
    """z = F' z, the adjoint of `_model_numba.spread`, for `count` columns: state k of column j at k stride + j step."""
    for j in range(count):
        o = j * step
        x, y, th, s = z[X * stride + o], z[Y * stride + o], z[TH * stride + o], z[S * stride + o]
        phi, v, b = z[PHI * stride + o], z[V * stride + o], z[B * stride + o]
        turn = th + f[PX] * x + f[PY] * y
        move = f[UX] * x + f[UY] * y + s
        rate = f[FB] * b
        if wheels:
            if gyro:
                turn += f[PHI_W] * phi
                move += f[PHI_D] * phi
                z[KB * stride + o] += f[PHI_KB] * phi
                z[KE * stride + o] += f[PHI_KE] * phi
                z[KG * stride + o] += f[W_KG] * turn
            else:
                move += f[W_D] * turn
                rate += f[PHI_W] * phi
                z[KB * stride + o] += f[W_KB] * turn
                z[KE * stride + o] += f[W_KE] * turn
            z[KD * stride + o] += f[KX] * x + f[KY] * y
            z[BA * stride + o] -= f[HB] * move + f[CBA] * v
        z[TH * stride + o] = th + f[DX] * y - f[DY] * x
        z[V * stride + o] = f[F] * v + f[CD] * move
        z[B * stride + o] = rate + f[W_B] * turn


@njit(error_model="numpy", forceinline=True)
def _uncorrect(lam: Any, L: Any, n: int, which: Any, told: Any, m: Any) -> None:
    """Back through a correction: with K = gain / variance, (I - K h')' on both sides, and the reading's own word."""
    inverse = 1.0 / told[VARIANCE]
    along, both = 0.0, 0.0
    for i in range(n):
        m[i] = 0.0
    for j in range(n):
        gain = told[j] * inverse
        along += told[j] * lam[j]
        for i in range(n):
            m[i] += L[j * N + i] * gain
    for i in range(n):
        both += told[i] * m[i]
    both = (both + 1.0) * inverse
    along = (along + told[NU]) * inverse
    for p in range(which[ROOM]):
        k, a = which[p], told[VALUES + p]
        lam[k] -= a * along
        for j in range(n):
            L[k * N + j] -= a * m[j]
    for p in range(which[ROOM]):
        k, a = which[p], told[VALUES + p]
        for j in range(n):
            L[j * N + k] -= a * m[j]
        for q in range(which[ROOM]):
            L[k * N + which[q]] += a * told[VALUES + q] * both


@njit(error_model="numpy")
def _smooth_row(lam: Any, L: Any, n: int, P: Any, row: int, out: Any, work: Any) -> None:
    """Filtered pose, bias and covariances of a row become smoothed ones; P (4, n) of x, y, theta, b."""
    for i in range(4 * N):
        work[i] = 0.0
    for j in range(n):
        p0, p1, p2, p3 = P[0, j], P[1, j], P[2, j], P[3, j]
        out.rows[row, 0] -= p0 * lam[j]
        out.rows[row, 1] -= p1 * lam[j]
        out.rows[row, 2] -= p2 * lam[j]
        out.rows[row, 3] -= p3 * lam[j]
        for i in range(n):
            a = L[j * N + i]
            work[i] += a * p0
            work[N + i] += a * p1
            work[2 * N + i] += a * p2
            work[3 * N + i] += a * p3
    for a in range(3):
        for b in range(a + 1):
            less = 0.0
            for i in range(n):
                less += P[b, i] * work[a * N + i]
            out.covariance[row, a, b] -= less
            out.covariance[row, b, a] = out.covariance[row, a, b]
        out.covariance[row, a, a] = max(out.covariance[row, a, a], 0.0)
    less = 0.0
    for i in range(n):
        less += P[3, i] * work[3 * N + i]
    out.rows[row, 4] = max(out.rows[row, 4] - less, 0.0)


@njit(error_model="numpy", forceinline=True)
def _shock(lam: Any, L: Any, row: int, shock: Any) -> None:
    """Was the robot moved just after this row by what no sensor shows? The likeliest leap (x, y), and by how much more
    likely it makes all later readings (chi-square of two): de Jong and Penzer, J. Am. Stat. Assoc. 93, 1998."""
    xx, xy, yy = L[X * N + X], L[X * N + Y], L[Y * N + Y]
    volume = xx * yy - xy * xy
    if volume <= 1e-9 * xx * yy:
        shock[row, 2] = 0.0
        return
    shock[row, 0] = -(yy * lam[X] - xy * lam[Y]) / volume
    shock[row, 1] = -(xx * lam[Y] - xy * lam[X]) / volume
    shock[row, 2] = -(shock[row, 0] * lam[X] + shock[row, 1] * lam[Y])


@njit(error_model="numpy")
def _forget(lam: Any, L: Any, n: int, bits: int) -> None:
    """An anchored state carries nothing back."""
    for i in range(n):
        if bits & (1 << i):
            lam[i] = 0.0
            for j in range(n):
                L[i * N + j] = 0.0
                L[j * N + i] = 0.0


@njit(error_model="numpy")
def _fade(lam: Any, L: Any, n: int, first: int, fade: float) -> None:
    for i in range(first, n):
        lam[i] *= fade
        for j in range(n):
            L[i * N + j] *= fade
        for j in range(n):
            L[j * N + i] *= fade


@njit(error_model="numpy")
def _unstep(lam: Any, L: Any, n: int, f: Any, gyro: bool) -> None:
    """Back through a step: F' lambda and F' L F."""
    _back(lam, 1, 0, 1, f, gyro, n > S)
    _back(L, N, 1, n, f, gyro, n > S)
    for i in (TH, V, B, KD, KE, KB, KG, BA):  # other states' columns are as they were, and follow by symmetry
        if i < n:
            _back(L[i * N : i * N + N], 1, 0, 1, f, gyro, n > S)
    for i in (TH, V, B, KD, KE, KB, KG, BA):
        for j in range(n):
            L[j * N + i] = L[i * N + j]


def _entry_point(digest: int) -> Callable[..., None]:
    """As in `_filter_numba`."""

    @njit(cache=True, nogil=True, error_model="numpy")
    def walk_back(
        begin: int, end: int, row: int, row0: int, kind: Any, lam: Any, square: Any, n: int, gyro: bool, offsets: int,
        rec: Any, out: Any, shock: Any,
    ) -> None:  # fmt: skip
        work, L = np.zeros(4 * N), square.reshape(N * N)
        for e in range(end - 1, begin - 1, -1):
            k = e - begin
            if kind[e] == OUT:
                row -= 1 + 0 * digest
                _shock(lam, L, row, shock)
                _smooth_row(lam, L, n, rec.rows[row - row0], row, out, work)
            for u in range(rec.marks[k + 1, 0] - 1, rec.marks[k, 0] - 1, -1):
                _uncorrect(lam, L, n, rec.which[u], rec.corrections[u], work)
            if rec.marks[k, 1]:
                _forget(lam, L, n, rec.marks[k, 1])
            if rec.parts[k, PARTS] != 1.0:
                _fade(lam, L, n, offsets, rec.parts[k, PARTS])
            if not math.isnan(rec.parts[k, 0]):
                _unstep(lam, L, n, rec.parts[k], gyro)

    return walk_back


_DIGEST = zlib.crc32(Path(__file__).with_name("layout.py").read_bytes()) | 1
walk_back = _entry_point(_DIGEST)
"""walk_back(begin, end, row, row0, kind, lam (N,), L (N, N), n, gyro, offsets, rec, out, shock (M, 3)): from event
`end` back to `begin`; `row` is one past the last row of the stretch, `row0` its first."""
