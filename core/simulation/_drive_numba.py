"""Compiled: one wheel's drive chain over one piece of time, in closed form.

Order: delay (the caller's), dead band, gain and sag, lag, acceleration limit, speed limit; each works on what the one
before it gives. A speed within a piece is (p, q, c) for `p + q*s + c*exp(-s/tau)`, s seconds into the piece.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from core.simulation import params as P

Array = npt.NDArray[np.float64]
Piece = tuple[float, float, float]

EVENT = 1e-9
"""Events nearer than this to a piece's ends [s] are taken as at the ends."""
TOLERANCE = 1e-12
"""Speeds that differ by less [m/s] are the same."""

SNAP = 2e-6
"""A speed nearer than this to what it follows [m/s] has caught up: more than a piece's linear sag can be off."""

OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "_nrt": False}
"""Inner functions allocate nothing, so numba need not count who holds an array: that took 40 % of all time."""
compiled = njit(**OPTIONS)
"""For inner functions: compiled into their callers, kept on disk only as parts of `_batch_numba`'s entry points."""
inlined = njit(**OPTIONS, forceinline=True)
"""The same for what runs in every piece: a call would cost as much as the work (measured: 60 of 190 ns a step)."""


@compiled
def value(piece: Piece, s: float, itau: float) -> float:
    """Speed at `s` seconds into a piece."""
    p, q, c = piece
    return p + q * s + (c * np.exp(-s * itau) if c != 0.0 else 0.0)


@inlined
def halved(h: float, known: float, half: float, itau: float) -> float:
    """exp(-h/2/tau), out of `half` where that is of the same h already: an exponential costs as much as a wheel."""
    if h == known or itau == 0.0:
        return half
    return np.exp(-0.5 * h * itau)


@inlined
def end_of(piece: Piece, h: float, half: float, par: Array) -> tuple[float, float]:
    """Speed at the end and distance over a piece. half: exp(-h/2/tau)."""
    p, q, c = piece
    speed, way = p + q * h, h * (p + 0.5 * q * h)
    if c != 0.0:
        e = half * half
        speed, way = speed + c * e, way + c * par[P.TAU] * (1.0 - e)
    return speed, way


@compiled
def crossing(piece: Piece, line: Piece, h: float, itau: float) -> float:
    """The instant in (0, h) where piece - line changes its sign; it must differ at the ends."""
    lo, hi = 0.0, h
    above = value(piece, h, itau) > value(line, h, itau)
    for _ in range(60):
        mid = 0.5 * (lo + hi)
        if (value(piece, mid, itau) > value(line, mid, itau)) == above:
            hi = mid
        else:
            lo = mid
    return 0.5 * (lo + hi)


@inlined
def command(times: Array, values: Array, j: int, t: float) -> Piece:
    """Set-point at t as a piece, j the last sample at or before it (-1: none yet); held past the ends."""
    if j < 0:
        return values[0, 0], 0.0, 0.0
    return values[j, 0] + values[j, 1] * (t - times[j]), values[j, 1], 0.0


@inlined
def set_point(raw: Piece, h: float, sag: float, fade: float, span: float, par: Array) -> tuple[float, Piece]:
    """Dead band, gain and sag on a set-point: (h cut at the band's edge, what is left of it).

    fade: sag's slope over `span`, which is the same for both wheels, whichever of them cut h.
    """
    c, m, _ = raw
    width = par[P.WIDTH]
    if width > 0.0:
        if m != 0.0:
            for edge in (-width, width):
                at = (edge - c) / m
                if EVENT < at < h - EVENT:
                    h = at
        if abs(c + 0.5 * m * h) < width:
            return h, (0.0, 0.0, 0.0)
    gain = par[P.GAIN]
    if fade == 0.0:
        return h, (gain * sag * c, gain * sag * m, 0.0)
    # taken as linear: within a piece the sag's curvature is below 1e-9 m/s
    return h, (gain * sag * c, gain * (sag * m + fade * (c + m * span)), 0.0)


@inlined
def limit_acceleration(piece: Piece, z: float, a: float, h: float, decay: float, itau: float) -> tuple[float, Piece]:
    """A speed that follows `piece` from z no faster than a: (h cut where it changes between following and lagging)."""
    p, q, c = piece
    ahead = p + c - z
    slope = q - c * itau
    caught = abs(ahead) <= SNAP
    sign = np.sign(slope) if caught else np.sign(ahead)
    if caught and abs(slope) <= a * (1.0 + 1e-12):
        end = q - c * itau * decay
        if c == 0.0 or abs(end) <= a * (1.0 + 1e-9):
            return h, piece
        reached = (q - np.sign(end) * a) / (c * itau)
        cut = -np.log(reached) / itau if 0.0 < reached < 1.0 else 0.0
        if cut > EVENT:
            return min(cut, h), piece
        sign = np.sign(end)  # from here on: the other wheel may have cut the piece before at the same instant
    line = (p + c if caught else z, sign * a, 0.0)
    if sign * (p + q * h + c * decay - line[0] - line[1] * h) < 0.0:
        h = max(crossing(piece, line, h, itau), EVENT)
    return h, line


@inlined
def limit_speed(piece: Piece, top: float, h: float, decay: float, itau: float) -> tuple[float, Piece]:
    """A speed held within +-top: (h cut where it reaches or leaves the limit, what is left of it)."""
    p, q, c = piece
    first, last = p + c, p + q * h + c * decay
    if max(abs(first), abs(last)) + abs(c) < top:  # no bend within the piece is larger than c
        return h, piece
    above0, above1 = abs(first) - top, abs(last) - top
    if above0 * above1 < 0.0 and min(abs(above0), abs(above1)) > TOLERANCE:
        outer = last if above1 > 0.0 else first
        cut = crossing(piece, (np.sign(outer) * top, 0.0, 0.0), h, itau)
        h = cut if EVENT < cut < h else h
    middle = value(piece, 0.5 * h, itau)
    return h, ((np.sign(middle) * top, 0.0, 0.0) if abs(middle) > top else piece)


@inlined
def cut_at_zero(piece: Piece, h: float, decay: float, itau: float) -> float:
    """h cut where the speed changes its sign."""
    first, last = piece[0] + piece[2], piece[0] + piece[1] * h + piece[2] * decay
    if first * last < 0.0 and min(abs(first), abs(last)) > TOLERANCE:
        cut = crossing(piece, (0.0, 0.0, 0.0), h, itau)
        return cut if EVENT < cut < h else h
    return h


@inlined
def wheel(
    raw: Piece, h: float, half: float, sag: float, fade: float, span: float, y: float, z: float, par: Array
) -> tuple[float, float, Piece, Piece, Piece]:
    """One wheel's chain: h cut at its first event, exp(-h/2/tau); its speed after lag, acceleration and speed limit.

    raw: set-point [m/s]; half: as of the given h; sag, fade, span: as `set_point` takes them; y, z: states of the lag
    and of the acceleration limit.
    """
    tau, itau, known = par[P.TAU], par[P.ITAU], h
    h, lagged = set_point(raw, h, sag, fade, span, par)
    half = halved(h, known, half, itau)
    if tau != 0.0:
        u, mu, _ = lagged
        lagged = (u - tau * mu, mu, y - u + tau * mu if itau != 0.0 else 0.0)
    limited = lagged
    if par[P.A_MAX] < np.inf:
        known = h
        h, limited = limit_acceleration(lagged, z, par[P.A_MAX], h, half * half, itau)
        half = halved(h, known, half, itau)
    rim = limited
    if par[P.V_MAX] < np.inf:
        known = h
        h, rim = limit_speed(limited, par[P.V_MAX], h, half * half, itau)
        half = halved(h, known, half, itau)
    if par[P.SLIP_K] != 0.0:
        known = h
        h = cut_at_zero(rim, h, half * half, itau)
        half = halved(h, known, half, itau)
    return h, half, lagged, limited, rim


@inlined
def ground(piece: Piece, h: float, half: float, par: Array) -> tuple[float, float, float, float, float]:
    """One wheel's ground speed at 0, h/2, h and ground distance to h/2, h, with slip k*a*sign(v)."""
    p, q, c = piece
    s = 0.5 * h
    v0, vm, v1 = p, p + q * s, p + q * h
    dm, d1 = s * (p + 0.5 * q * s), h * (p + 0.5 * q * h)
    c0, cm, c1 = c, c * half, c * half * half
    if c != 0.0:
        v0, vm, v1 = v0 + c0, vm + cm, v1 + c1
        dm, d1 = dm + par[P.TAU] * (c0 - cm), d1 + par[P.TAU] * (c0 - c1)
    k, itau = par[P.SLIP_K], par[P.ITAU]
    if k != 0.0:
        s0 = min(max(k * (q - itau * c0), -1.0), 1.0) * abs(v0)
        sm = min(max(k * (q - itau * cm), -1.0), 1.0) * abs(vm)
        s1 = min(max(k * (q - itau * c1), -1.0), 1.0) * abs(v1)
        v0, vm, v1 = v0 - s0, vm - sm, v1 - s1
        dm -= h * (1 / 24) * (5.0 * s0 + 8.0 * sm - s1)
        d1 -= h * (1 / 6) * (s0 + 4.0 * sm + s1)
    return v0, vm, v1, dm, d1
