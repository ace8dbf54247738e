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
    B, BA, CBA, CD, DX, DY, F, FB, HB, KB, KD, KE, KG, KR, KX, KY, MOVING, N, OUT, PHI, PHI_D, PHI_KB, PHI_KE, PHI_W, PX,
    PY, S, TH, UX, UY, V, W_B, W_D, W_KB, W_KE, W_KG, X, Y,
)  # fmt: skip


@njit(error_model="numpy")
def _back(z: Any, i: int, f: Any, gyro: bool, wheels: bool) -> None:
    """Row i of z becomes itself times F: the adjoint of `_model_numba.spread`, for one row."""
    x, y, th, s, phi, v, b = z[i, X], z[i, Y], z[i, TH], z[i, S], z[i, PHI], z[i, V], z[i, B]
    turn = th + f[PX] * x + f[PY] * y
    move = f[UX] * x + f[UY] * y + s
    if wheels:
        if gyro:
            turn += f[PHI_W] * phi
            move += f[PHI_D] * phi
            z[i, KB] += f[PHI_KB] * phi
            z[i, KE] += f[PHI_KE] * phi
        else:
            move += f[W_D] * turn
            z[i, KB] += f[W_KB] * turn
            z[i, KE] += f[W_KE] * turn
        z[i, KG] += f[W_KG] * turn
        z[i, KD] += f[KX] * x + f[KY] * y
        z[i, BA] -= f[HB] * move + f[CBA] * v
    z[i, TH] += f[DX] * y - f[DY] * x
    z[i, V] = f[F] * v + f[CD] * move
    z[i, B] = f[FB] * b + f[W_B] * turn
    if wheels and not gyro:
        z[i, B] += f[PHI_W] * phi


@njit(error_model="numpy")
def _uncorrect(lam: Any, L: Any, n: int, rec: Any, u: int, work: Any) -> None:
    """Back through correction u: with K = gain / variance, (I - K h')' on both sides, and the reading's own word."""
    inverse = 1.0 / rec.variance[u]
    m, along, both = work, 0.0, 0.0
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += L[i, j] * rec.gain[u, j]
        m[i] = total * inverse
        along += rec.gain[u, i] * lam[i]
    for i in range(n):
        both += rec.gain[u, i] * m[i]
    both = (both + 1.0) * inverse
    along = (along + rec.nu[u]) * inverse
    for p in range(rec.count[u]):
        k, a = rec.index[u, p], rec.value[u, p]
        lam[k] -= a * along
        for j in range(n):
            L[k, j] -= a * m[j]
    for p in range(rec.count[u]):
        k, a = rec.index[u, p], rec.value[u, p]
        for j in range(n):
            L[j, k] -= a * m[j]
        for q in range(rec.count[u]):
            L[k, rec.index[u, q]] += a * rec.value[u, q] * both


@njit(error_model="numpy")
def _smooth_row(lam: Any, L: Any, n: int, rows: Any, row: int, out: Any, work: Any) -> None:
    """Filtered pose, bias and covariances of a row become smoothed ones."""
    for a in range(4):
        shift = 0.0
        for i in range(n):
            shift += rows[a, i] * lam[i]
        if a < 3:
            out.pose[row, a] -= shift
        else:
            out.bias[row] -= shift
        for i in range(n):
            total = 0.0
            for j in range(n):
                total += L[i, j] * rows[a, j]
            work[i] = total
        if a == 3:
            less = 0.0
            for i in range(n):
                less += rows[3, i] * work[i]
            out.bias_var[row] = max(out.bias_var[row] - less, 0.0)
        else:
            for b in range(a + 1):
                less = 0.0
                for i in range(n):
                    less += rows[b, i] * work[i]
                out.covariance[row, a, b] -= less
                out.covariance[row, b, a] = out.covariance[row, a, b]
            out.covariance[row, a, a] = max(out.covariance[row, a, a], 0.0)


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
            for u in range(rec.first[k + 1] - 1, rec.first[k] - 1, -1):
                _uncorrect(lam[0], L, n, rec, u, work)
            bits = rec.forgotten[k]
            if bits:
                for i in range(n):
                    if bits & (1 << i):
                        lam[0, i] = 0.0
                        for j in range(n):
                            L[i, j] = 0.0
                            L[j, i] = 0.0
            fade = rec.fade[k]
            if fade != 1.0:
                for i in range(offsets, n):
                    lam[0, i] *= fade
                    for j in range(n):
                        L[i, j] *= fade
                    for j in range(n):
                        L[j, i] *= fade
            f = rec.parts[k]
            if not math.isnan(f[0]):
                wheels = n > S
                _back(lam, 0, f, gyro, wheels)
                for i in range(n):
                    _back(L, i, f, gyro, wheels)
                for i in range(n):
                    for j in range(i):
                        L[i, j], L[j, i] = L[j, i], L[i, j]
                for i in range(n):
                    _back(L, i, f, gyro, wheels)

    return walk_back


_DIGEST = zlib.crc32(Path(__file__).with_name("layout.py").read_bytes()) | 1
walk_back = _entry_point(_DIGEST)
"""walk_back(begin, end, row, row0, kind, lam (1, N), L (N, N), n, gyro, offsets, rec, out): from event `end` back to
`begin`; `row` is one past the last row of the stretch, `row0` its first."""
