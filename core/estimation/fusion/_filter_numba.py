"""Compiled Kalman filter of `fused`: one time-sorted list of raw readings in, poses and covariances out.

It may be called over the list in pieces: all that it remembers is in `x`, `P`, `mem` and `past`. With records it also
keeps what the smoother needs to walk back.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit

from core.estimation.fusion._beacon_numba import fix, range_to
from core.estimation.fusion._model_numba import correct_state, keep, step
from core.estimation.fusion._wheels_numba import wheels
from core.estimation.fusion.layout import (
    ACCEL, AX, B, CARRIED, FIX, GZ, KB, N, OUT, PHI, REFUSED_REST, REST, RESTING, S, Scratch, SPED, STARTED, T,
    T_IMU, T_TRUST, T_WHEEL, TH, TURNED, UNSEEN, V, WHEEL, X, Y,
)  # fmt: skip


@njit(error_model="numpy")
def _inertial(t: float, kind: int, a: Any, mem: Any, c: Any) -> tuple[float, float, float]:
    """The gyro's raw turn [rad] and the accelerometer's change of speed [m/s] since the event before, and the seconds
    of them that were not seen. Between two readings the last one holds; when the next one is in, its step is completed
    to the trapezoid. After a pause the turn is unknown."""
    if mem[T_IMU] < 0.0:
        turned, sped, unseen = 0.0, 0.0, t - mem[STARTED]
    else:
        age = t - mem[T_IMU]
        if age > 2.0 * c.hold:
            turned, sped, unseen = mem[GZ] * c.hold, mem[AX] * c.hold, age - c.hold
        elif kind == OUT:
            turned, sped, unseen = 0.5 * (mem[GZ] + a[0]) * age, 0.5 * (mem[AX] + a[1]) * age, 0.0
        else:
            held = min(age, c.hold)
            turned, sped, unseen = mem[GZ] * held, mem[AX] * held, 0.0
    raw, dv, blind = turned - mem[TURNED], sped - mem[SPED], max(unseen - mem[UNSEEN], 0.0)
    mem[TURNED], mem[SPED], mem[UNSEEN] = turned, sped, unseen
    if kind == OUT:
        mem[T_IMU], mem[GZ], mem[AX] = t, a[0], a[1]
        mem[TURNED], mem[SPED], mem[UNSEEN] = 0.0, 0.0, 0.0
    return raw, dv, blind


@njit(error_model="numpy")
def _at_rest(x: Any, P: Any, gz: float, mem: Any, c: Any) -> bool:
    """Whether the gyro's reading can be its bias; one that stays different for long becomes the bias."""
    nu = gz - x[B]
    if nu * nu > c.gate1 * (P[B, B] + c.r_rate):
        mem[REFUSED_REST] += 1
        if mem[REFUSED_REST] <= c.patience_rest:
            return False
        P[B, B] += nu * nu
    mem[REFUSED_REST] = 0
    return True


@njit(error_model="numpy")
def _move(t: float, kind: int, a: Any, flags: int, x: Any, P: Any, n: int, mem: Any, c: Any, f: Any) -> bool:
    """Carry the state to t; false where no time has passed."""
    raw, dv, blind = 0.0, 0.0, 0.0
    dt = t - mem[T]
    if c.has_gyro != 0.0:
        raw, dv, blind = _inertial(t, kind, a, mem, c)
    if dt <= 0.0:
        return False
    mem[T] = t
    trusted = c.has_accel != 0.0 and blind == 0.0 and flags & ACCEL == 0 and mem[T_IMU] >= 0.0
    fading = t - mem[T_WHEEL] > c.silence or t - mem[T_TRUST] > c.coast
    resting = mem[RESTING] != 0.0
    step(x, P, n, dt, raw, dv, trusted, resting, fading, c, f)
    if blind > 0.0 and not resting:
        q, k = c.q_pause * blind, 1.0 + x[KB]
        P[TH, TH] += q
        if n > S:
            P[PHI, PHI] += q * k * k
            P[TH, PHI] += q * k
            P[PHI, TH] += q * k
    if flags & CARRIED:
        P[X, X] += c.q_carried * dt
        P[Y, Y] += c.q_carried * dt
        P[TH, TH] += c.q_carried_turn * dt
    return True


@njit(error_model="numpy")
def _row(x: Any, P: Any, n: int, row: int, out: Any) -> None:
    for i in range(3):
        out.pose[row, i] = x[i]
        for j in range(3):
            out.covariance[row, i, j] = P[i, j]
    out.bias[row] = x[B]
    out.bias_var[row] = P[B, B]


def _entry_point(digest: int) -> Callable[..., int]:
    """The compiled function that Python calls. numba's cache sees a change of this file and of what it closes over, but
    not of the files that it calls into: so it closes over a digest of those."""

    @njit(cache=True, nogil=True, error_model="numpy")
    def run_filter(
        begin: int, end: int, row: int, events: Any, x: Any, P: Any, n: int, mem: Any, past: Any, c: Any, out: Any,
        rec: Any, record: bool,
    ) -> int:  # fmt: skip
        work, row0 = np.zeros((1, N)), row
        w = Scratch(
            np.zeros((3, N)), np.zeros(N), np.zeros((3, 7), np.int64), np.zeros((3, 7)), np.zeros(3, np.int64),
            np.zeros(3), np.zeros(3),
        )  # fmt: skip
        for e in range(begin, end):
            t, a, kind, flags, k = events.t[e], events.data[e], events.kind[e], events.flags[e], 0
            if flags & REST == 0 or flags & CARRIED:
                mem[RESTING] = 0.0
            elif kind == OUT:
                mem[RESTING] = 1.0 if _at_rest(x, P, a[0], mem, c) else 0.0
            if record:
                k = e - begin
                rec.first[k] = rec.used[0]
            moved = _move(t, kind, a, flags, x, P, n, mem, c, rec.parts[k])
            if not moved:
                rec.parts[k, 0] = np.nan
            if kind == WHEEL:
                wheels(t, a, flags, x, P, n, mem, c, work, out.nis[e], out.status[e], rec, record, k)
            elif kind == FIX:
                fix(t, a, flags, x, P, n, mem, past, c, w, out.nis[e], out.status[e], rec, record, k)
            elif kind != OUT:
                range_to(t, a, x, P, n, mem, c, w, out.nis[e], out.status[e], rec, record, k)
            else:
                if mem[RESTING] != 0.0:
                    nu = a[0] - x[B]
                    variance = correct_state(x, P, n, B, nu, c.r_rate, work[0])
                    keep(rec, record, B, work[0], n, nu, variance)
                    nu = -x[V]
                    variance = correct_state(x, P, n, V, nu, c.r_still, work[0])
                    keep(rec, record, V, work[0], n, nu, variance)
                _row(x, P, n, row, out)
                if record:
                    for i in range(4):
                        for j in range(n):
                            rec.rows[row - row0, i, j] = P[i if i < 3 else B, j]
                row += 1 + 0 * digest
        if record:
            rec.first[end - begin] = rec.used[0]
        return row

    return run_filter


FILES = ("layout.py", "_model_numba.py", "_wheels_numba.py", "_beacon_numba.py")
DIGEST = zlib.crc32(b"".join(Path(__file__).with_name(name).read_bytes() for name in FILES)) | 1

run_filter = _entry_point(DIGEST)
"""run_filter(begin, end, row, events, x, P, n, mem, past, c, out, rec, record) -> next row: walk over events begin .. end.

events: t, kind, data, flags (E, ...) as `layout` says. Changed in place: x (N,), P (N, N), mem (MEMORY,), past (PAST,
SEEN). Into `out`: nis, status (E, 2) per event (WHEEL distance, turn; FIX, RANGE joint value, log of the innovation's
determinant), pose, covariance, bias, bias_var per OUT event, from `row` on.
"""
