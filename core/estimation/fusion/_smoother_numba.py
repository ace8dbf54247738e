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

from numba import njit

from core.estimation.fusion._model_numba import BLOCK
from core.estimation.fusion.layout import (
    BA,
    CBA,
    CD,
    DT,
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
from core.kernels import uncounted

SOURCES = (TH, V, B, KD, KE, KB, KG, BA)  # states on which others depend


@njit(error_model="numpy", forceinline=True)
def _rows_few(z: Any, stride: int, first: int, last: int, f: Any) -> None:
    """F' times columns first to last, of a state without wheels; state k of column j is z[k stride + j]."""
    ux, uy, dx, dy, px, py = f[UX], f[UY], f[DX], f[DY], f[PX], f[PY]
    cd, fv, fb, w_b = f[CD], f[F], f[FB], f[W_B]
    for j in range(first, last):
        x, y, th = z[X * stride + j], z[Y * stride + j], z[TH * stride + j]
        turn, move = th + px * x + py * y, ux * x + uy * y
        z[TH * stride + j] = th + dx * y - dy * x
        z[V * stride + j] = fv * z[V * stride + j] + cd * move
        z[B * stride + j] = fb * z[B * stride + j] + w_b * turn


@njit(error_model="numpy", forceinline=True)
def _rows_gyro(z: Any, stride: int, first: int, last: int, f: Any) -> None:
    """The same of a state with wheels and gyro."""
    ux, uy, dx, dy, px, py = f[UX], f[UY], f[DX], f[DY], f[PX], f[PY]
    kx, ky, cd, hb, cba, fv = f[KX], f[KY], f[CD], f[HB], f[CBA], f[F]
    w_b, w_kg, phi_w, phi_d, phi_ke, phi_kb = f[W_B], f[W_KG], f[PHI_W], f[PHI_D], f[PHI_KE], f[PHI_KB]
    for j in range(first, last):
        x, y, th, v = z[X * stride + j], z[Y * stride + j], z[TH * stride + j], z[V * stride + j]
        phi = z[PHI * stride + j]
        turn = th + px * x + py * y + phi_w * phi
        move = ux * x + uy * y + z[S * stride + j] + phi_d * phi
        z[TH * stride + j] = th + dx * y - dy * x
        z[V * stride + j] = fv * v + cd * move
        z[B * stride + j] += w_b * turn
        z[KD * stride + j] += kx * x + ky * y
        z[KE * stride + j] += phi_ke * phi
        z[KB * stride + j] += phi_kb * phi
        z[KG * stride + j] += w_kg * turn
        z[BA * stride + j] -= hb * move + cba * v


@njit(error_model="numpy", forceinline=True)
def _rows_wheels(z: Any, stride: int, first: int, last: int, f: Any) -> None:
    """The same of a state with wheels alone."""
    ux, uy, dx, dy, px, py = f[UX], f[UY], f[DX], f[DY], f[PX], f[PY]
    kx, ky, cd, hb, cba, fv, fb = f[KX], f[KY], f[CD], f[HB], f[CBA], f[F], f[FB]
    w_b, w_d, w_ke, w_kb, phi_w = f[W_B], f[W_D], f[W_KE], f[W_KB], f[PHI_W]
    for j in range(first, last):
        x, y, th, v = z[X * stride + j], z[Y * stride + j], z[TH * stride + j], z[V * stride + j]
        turn = th + px * x + py * y
        move = ux * x + uy * y + z[S * stride + j] + w_d * turn
        z[TH * stride + j] = th + dx * y - dy * x
        z[V * stride + j] = fv * v + cd * move
        z[B * stride + j] = fb * z[B * stride + j] + phi_w * z[PHI * stride + j] + w_b * turn
        z[KD * stride + j] += kx * x + ky * y
        z[KE * stride + j] += w_ke * turn
        z[KB * stride + j] += w_kb * turn
        z[BA * stride + j] -= hb * move + cba * v


@njit(error_model="numpy", forceinline=True)
def _rows(z: Any, stride: int, first: int, last: int, f: Any, gyro: bool) -> None:
    if gyro:
        _rows_gyro(z, stride, first, last, f)
    else:
        _rows_wheels(z, stride, first, last, f)


@njit(error_model="numpy", forceinline=True)
def _uncorrect(lam: Any, L: Any, n: int, which: Any, told: Any, m: Any) -> None:
    """Back through a correction: with K = gain / variance, (I - K h')' on both sides, and the reading's own word."""
    inverse = 1.0 / told[VARIANCE]
    along, both, w = 0.0, 0.0, (n + 3) & ~3
    for i in range(w):
        m[i] = 0.0
    for j in range(n):
        gain = told[j] * inverse
        along += told[j] * lam[j]
        for i in range(w):
            m[i] += L[j * N + i] * gain
    for i in range(n):
        both += told[i] * m[i]
    both = (both + 1.0) * inverse
    along = (along + told[NU]) * inverse
    for p in range(which[ROOM]):
        k, a = which[p], told[VALUES + p]
        lam[k] -= a * along
        for j in range(w):
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
    w = (n + 3) & ~3
    for i in range(4 * N):
        work[i] = 0.0
    for j in range(n):
        p0, p1, p2, p3 = P[0, j], P[1, j], P[2, j], P[3, j]
        out.rows[row, 0] -= p0 * lam[j]
        out.rows[row, 1] -= p1 * lam[j]
        out.rows[row, 2] -= p2 * lam[j]
        out.rows[row, 3] -= p3 * lam[j]
        for i in range(w):
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


@njit(error_model="numpy", forceinline=True)
def _unstep(lam: Any, L: Any, n: int, f: Any, gyro: bool) -> None:
    """Back through a step: F' lambda and F' L F, the adjoint of `_model_numba.spread`: rows; then, as L is symmetric,
    rows of the transpose, where they concern the states on which others depend. Beyond n all is zero."""
    if n <= S:
        _rows_few(lam, 1, 0, 1, f)
        _rows_few(L, N, 0, BLOCK, f)
        for i in (TH, V, B):
            for j in range(TH):
                L[j * N + i] = L[i * N + j]
            for j in range(TH, i):
                L[i * N + j], L[j * N + i] = L[j * N + i], L[i * N + j]
        _rows_few(L, N, TH, S, f)
        return
    _rows(lam, 1, 0, 1, f, gyro)
    _rows(L, N, 0, BLOCK, f, gyro)
    _rows(L, N, BLOCK, 2 * BLOCK, f, gyro)
    if n > 2 * BLOCK:
        _rows(L, N, 2 * BLOCK, N, f, gyro)
    for i in SOURCES:
        for j in (X, Y, S, PHI):
            L[j * N + i] = L[i * N + j]
        for j in range(DT, n):
            L[j * N + i] = L[i * N + j]
        for j in SOURCES:
            if j < i:
                L[i * N + j], L[j * N + i] = L[j * N + i], L[i * N + j]
    _rows(L, N, TH, TH + BLOCK, f, gyro)
    _rows(L, N, TH + BLOCK, DT, f, gyro)
    for i in SOURCES:
        for j in (S, PHI):
            L[i * N + j] = L[j * N + i]


def _entry_point(digest: int) -> Callable[..., None]:
    """As in `_filter_numba`."""

    @uncounted(cache=True, nogil=True, error_model="numpy")
    def walk_back(
        begin: int, end: int, row: int, row0: int, kind: Any, lam: Any, L: Any, n: int, gyro: bool, offsets: int,
        rec: Any, out: Any, shock: Any, work: Any,
    ) -> None:  # fmt: skip
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


_FILES = ("layout.py", "_model_numba.py")
_DIGEST = zlib.crc32(b"".join(Path(__file__).with_name(name).read_bytes() for name in _FILES)) | 1
walk_back = _entry_point(_DIGEST)
"""walk_back(begin, end, row, row0, kind, lam (N,), L (N N,), n, gyro, offsets, rec, out, shock (M, 3), work (4 N,)):
from event `end` back to `begin`; `row` is one past the last row of the stretch, `row0` its first."""
