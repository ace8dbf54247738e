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


@njit(error_model="numpy")
def _back(z: Any, rows: int, f: Any, gyro: bool, wheels: bool) -> None:
    """Rows of z times F: the adjoint of `_model_numba.spread`."""
    for i in range(rows):
        _back_row(z[i], f, gyro, wheels)


@njit(error_model="numpy")
def _back_row(z: Any, f: Any, gyro: bool, wheels: bool) -> None:
    x, y, th, s, phi, v, b = z[X], z[Y], z[TH], z[S], z[PHI], z[V], z[B]
    turn = th + f[PX] * x + f[PY] * y
    move = f[UX] * x + f[UY] * y + s
    if wheels:
        if gyro:
            turn += f[PHI_W] * phi
            move += f[PHI_D] * phi
            z[KB] += f[PHI_KB] * phi
            z[KE] += f[PHI_KE] * phi
        else:
            move += f[W_D] * turn
            z[KB] += f[W_KB] * turn
            z[KE] += f[W_KE] * turn
        z[KG] += f[W_KG] * turn
        z[KD] += f[KX] * x + f[KY] * y
        z[BA] -= f[HB] * move + f[CBA] * v
    z[TH] += f[DX] * y - f[DY] * x
    z[V] = f[F] * v + f[CD] * move
    z[B] = f[FB] * b + f[W_B] * turn
    if wheels and not gyro:
        z[B] += f[PHI_W] * phi


@njit(error_model="numpy")
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
            m[i] += L[j, i] * gain
    for i in range(n):
        both += told[i] * m[i]
    both = (both + 1.0) * inverse
    along = (along + told[NU]) * inverse
    for p in range(which[ROOM]):
        k, a = which[p], told[VALUES + p]
        lam[k] -= a * along
        for j in range(n):
            L[k, j] -= a * m[j]
    for p in range(which[ROOM]):
        k, a = which[p], told[VALUES + p]
        for j in range(n):
            L[j, k] -= a * m[j]
        for q in range(which[ROOM]):
            L[k, which[q]] += a * told[VALUES + q] * both


@njit(error_model="numpy")
def _smooth_row(lam: Any, L: Any, n: int, P: Any, row: int, out: Any, work: Any) -> None:
    """Filtered pose, bias and covariances of a row become smoothed ones; P (4, n) of x, y, theta, b."""
    for a in range(4):
        shift = 0.0
        for i in range(n):
            shift += P[a, i] * lam[i]
            work[i] = 0.0
        out.rows[row, a] -= shift
        for j in range(n):
            for i in range(n):
                work[i] += L[j, i] * P[a, j]
        for b in range(a + 1):
            less = 0.0
            for i in range(n):
                less += P[b, i] * work[i]
            if a < 3:
                out.covariance[row, a, b] -= less
                out.covariance[row, b, a] = out.covariance[row, a, b]
            elif b == 3:
                out.rows[row, 4] = max(out.rows[row, 4] - less, 0.0)
        if a < 3:
            out.covariance[row, a, a] = max(out.covariance[row, a, a], 0.0)


@njit(error_model="numpy")
def _forget(lam: Any, L: Any, n: int, bits: int) -> None:
    """An anchored state carries nothing back."""
    for i in range(n):
        if bits & (1 << i):
            lam[i] = 0.0
            for j in range(n):
                L[i, j] = 0.0
                L[j, i] = 0.0


@njit(error_model="numpy")
def _fade(lam: Any, L: Any, n: int, first: int, fade: float) -> None:
    for i in range(first, n):
        lam[i] *= fade
        for j in range(n):
            L[i, j] *= fade
        for j in range(n):
            L[j, i] *= fade


@njit(error_model="numpy")
def _unstep(lam: Any, L: Any, n: int, f: Any, gyro: bool) -> None:
    """Back through a step: F' lambda and F' L F."""
    _back(lam, 1, f, gyro, n > S)
    _back(L, n, f, gyro, n > S)
    for i in range(n):
        for j in range(i):
            L[i, j], L[j, i] = L[j, i], L[i, j]
    _back(L, n, f, gyro, n > S)


def _entry_point(digest: int) -> Callable[..., None]:
    """As in `_filter_numba`."""

    @njit(cache=True, nogil=True, error_model="numpy")
    def walk_back(
        begin: int, end: int, row: int, row0: int, kind: Any, lam: Any, L: Any, n: int, gyro: bool, offsets: int,
        rec: Any, out: Any,
    ) -> None:  # fmt: skip
        work = np.zeros(N)
        for e in range(end - 1, begin - 1, -1):
            k = e - begin
            if kind[e] == OUT:
                row -= 1 + 0 * digest
                _smooth_row(lam[0], L, n, rec.rows[row - row0], row, out, work)
            for u in range(rec.marks[k + 1, 0] - 1, rec.marks[k, 0] - 1, -1):
                _uncorrect(lam[0], L, n, rec.which[u], rec.corrections[u], work)
            if rec.marks[k, 1]:
                _forget(lam[0], L, n, rec.marks[k, 1])
            if rec.parts[k, PARTS] != 1.0:
                _fade(lam[0], L, n, offsets, rec.parts[k, PARTS])
            if not math.isnan(rec.parts[k, 0]):
                _unstep(lam, L, n, rec.parts[k], gyro)

    return walk_back


_DIGEST = zlib.crc32(Path(__file__).with_name("layout.py").read_bytes()) | 1
walk_back = _entry_point(_DIGEST)
"""walk_back(begin, end, row, row0, kind, lam (1, N), L (N, N), n, gyro, offsets, rec, out): from event `end` back to
`begin`; `row` is one past the last row of the stretch, `row0` its first."""
