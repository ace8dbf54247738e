"""Compiled Kalman filter of `fused`: one time-sorted list of raw readings in, poses and covariances out.

It may be called over the list in pieces: all that it remembers is in `x`, `P`, `mem` and `past`. With records it also
keeps what the smoother needs to walk back.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba import njit

from core.estimation.fusion._beacon_numba import fix, range_to
from core.estimation.fusion._model_numba import add3, correct_state, step
from core.estimation.fusion._wheels_numba import wheels
from core.estimation.fusion.layout import (
    ACCEL,
    AX,
    BA,
    CARRIED,
    CLOCK_VAR,
    COAST,
    FIX,
    GATE1,
    GZ,
    HAS_ACCEL,
    HAS_GYRO,
    HIDDEN,
    HOLD,
    KB,
    LEAP_VAR,
    LOST_SPEED,
    OUT,
    PARTS,
    PATIENCE_REST,
    PHI,
    Q_CARRIED,
    Q_CARRIED_TURN,
    Q_GYRO,
    Q_PAUSE,
    Q_SLIDE,
    R_RATE,
    R_STILL,
    REFUSED_REST,
    REST,
    RESTING,
    SILENCE,
    SLIPPING,
    SPED,
    STARTED,
    STRANGE,
    T_IMU,
    T_LOST,
    T_STRANGE,
    T_TRUST,
    T_WHEEL,
    TH,
    TURNED,
    UNSEEN,
    WASH_IMU,
    WASH_WHEELS,
    WHEEL,
    B,
    N,
    S,
    T,
    V,
    X,
    Y,
)  # fmt: skip
from core.kernels import uncounted

WASH, RECENT = 0.3, 1.0  # s: memory of a change of speed; for how long the largest one is kept
UNTICKED = 0.4  # s for which a robot that is moving off may turn before a wheel's counter shows it


@njit(error_model="numpy", forceinline=True)
def _inertial(t: float, kind: int, a: Any, mem: Any, c: Any) -> tuple[float, float, float]:
    """The gyro's raw turn [rad] and the accelerometer's change of speed [m/s] since the event before, and the seconds
    of them that were not seen. Between two readings the last one holds; when the next one is in, its step is completed
    to the trapezoid. After a pause the turn is unknown."""
    if mem[T_IMU] < 0.0:
        turned, sped, unseen = 0.0, 0.0, t - mem[STARTED]
    else:
        age = t - mem[T_IMU]
        if age > 2.0 * c[HOLD]:
            turned, sped, unseen = mem[GZ] * c[HOLD], mem[AX] * c[HOLD], age - c[HOLD]
        elif kind == OUT:
            turned, sped, unseen = 0.5 * (mem[GZ] + a[0]) * age, 0.5 * (mem[AX] + a[1]) * age, 0.0
        else:
            held = min(age, c[HOLD])
            turned, sped, unseen = mem[GZ] * held, mem[AX] * held, 0.0
    raw, dv, blind = turned - mem[TURNED], sped - mem[SPED], max(unseen - mem[UNSEEN], 0.0)
    mem[TURNED], mem[SPED], mem[UNSEEN] = turned, sped, unseen
    if kind == OUT:
        mem[T_IMU], mem[GZ], mem[AX] = t, a[0], a[1]
        mem[TURNED], mem[SPED], mem[UNSEEN] = 0.0, 0.0, 0.0
    return raw, dv, blind


@njit(error_model="numpy", forceinline=True)
def _at_rest(x: Any, P: Any, gz: float, mem: Any, c: Any) -> bool:
    """Whether the gyro's reading can be its bias; one that stays different for long becomes the bias."""
    nu = gz - x[B]
    if nu * nu > c[GATE1] * (P[B * N + B] + c[R_RATE]):
        mem[REFUSED_REST] += 1.0
        if mem[REFUSED_REST] <= c[PATIENCE_REST]:
            return False
        P[B * N + B] += nu * nu
    mem[REFUSED_REST] = 0.0
    return True


@njit(error_model="numpy", forceinline=True)
def _move_off(x: Any, P: Any, n: int, mem: Any, c: Any) -> None:
    """At the end of rest: what the gyro has read of late, while no counter had ticked yet and the heading was held."""
    k, q = 1.0 + x[KB], 0.5 * UNTICKED * c[Q_GYRO]
    x[TH] += mem[HIDDEN]
    if n > S:
        x[PHI] += mem[HIDDEN] * k
        add3(P, TH, PHI, PHI, 1.0, k, 0.0, q)
    else:
        P[TH * N + TH] += q


@njit(error_model="numpy", forceinline=True)
def _feel(t: float, dt: float, dv: float, mem: Any) -> None:
    """How much speed the body has lost of late and the wheels have not: both changes of speed, washed out over WASH."""
    u = min(0.5 * dt / WASH, 1.0)
    keep = (1.0 - u) / (1.0 + u)  # exp(-dt / WASH), nearly, at a tenth of the price
    mem[WASH_IMU] = (mem[WASH_IMU] + dv) * keep
    mem[WASH_WHEELS] *= keep
    lost = mem[WASH_IMU] - mem[WASH_WHEELS]
    if abs(lost) >= abs(mem[LOST_SPEED]) or t - mem[T_LOST] > RECENT:
        mem[LOST_SPEED], mem[T_LOST] = lost, t


@njit(error_model="numpy", forceinline=True)
def _move(t: float, kind: int, a: Any, flags: int, x: Any, P: Any, n: int, mem: Any, c: Any, f: Any) -> None:
    """Carry the state to t; NaN in the first of the step's parts where no time has passed."""
    raw, dv, blind = 0.0, 0.0, 0.0
    dt = t - mem[T]
    if c[HAS_GYRO] != 0.0:
        raw, dv, blind = _inertial(t, kind, a, mem, c)
    if dt <= 0.0:  # what completes a step that another reading of this stamp has taken goes into the next one
        mem[TURNED] -= raw
        mem[SPED] -= dv
        f[0] = math.nan
        return
    mem[T] = t
    if c[HAS_ACCEL] != 0.0:
        _feel(t, dt, dv - x[BA] * dt, mem)
    trusted = c[HAS_ACCEL] != 0.0 and blind == 0.0 and flags & ACCEL == 0 and mem[T_IMU] >= 0.0
    fading = t - mem[T_WHEEL] > c[SILENCE] or t - mem[T_TRUST] > c[COAST]
    resting = mem[RESTING] != 0.0
    mem[HIDDEN] = (mem[HIDDEN] + raw - x[B] * dt) * max(1.0 - dt / UNTICKED, 0.0) if resting else 0.0
    step(x, P, n, dt, raw, dv, trusted, resting, fading, c, f)
    if blind > 0.0 and not resting:
        q, k = c[Q_PAUSE] * blind, 1.0 + x[KB]
        P[TH * N + TH] += q
        if n > S:
            P[PHI * N + PHI] += q * k * k
            P[TH * N + PHI] += q * k
            P[PHI * N + TH] += q * k
    if flags & SLIPPING:
        P[X * N + X] += c[Q_SLIDE] * dt
        P[Y * N + Y] += c[Q_SLIDE] * dt
    if flags & CARRIED:
        P[X * N + X] += c[Q_CARRIED] * dt
        P[Y * N + Y] += c[Q_CARRIED] * dt
        P[TH * N + TH] += c[Q_CARRIED_TURN] * dt


@njit(error_model="numpy", forceinline=True)
def _write(x: Any, P: Any, n: int, mem: Any, c: Any, row: int, at: int, out: Any, rec: Any) -> None:
    """A row of the path; at >= 0: what the smoother needs of it. A stamp is only as good as its clock: what the body
    moves in that time is added to the claim, as nothing that comes later can tell it."""
    w = (0.0 if mem[RESTING] != 0.0 else mem[GZ] - x[B]) if c[HAS_GYRO] != 0.0 else -x[B]
    drift = (x[V] * math.cos(x[TH]), x[V] * math.sin(x[TH]), w)
    for i in range(3):
        out.rows[row, i] = x[i]
        for j in range(3):
            out.covariance[row, i, j] = P[i * N + j] + c[CLOCK_VAR] * drift[i] * drift[j]
    out.rows[row, 3] = x[B]
    out.rows[row, 4] = P[B * N + B]
    if at >= 0:
        for j in range(n):
            rec.rows[at, 0, j] = P[X * N + j]
            rec.rows[at, 1, j] = P[Y * N + j]
            rec.rows[at, 2, j] = P[TH * N + j]
            rec.rows[at, 3, j] = P[B * N + j]


def _entry_point(digest: int) -> Callable[..., int]:
    """The compiled function that Python calls. numba's cache sees a change of this file and of what it closes over, but
    not of the files that it calls into: so it closes over a digest of those.

    Arrays are not counted (`kernels`), so it makes none: the scratch is the caller's.
    """

    @uncounted(cache=True, nogil=True, error_model="numpy")
    def run_filter(
        begin: int, end: int, row: int, events: Any, x: Any, P: Any, n: int, mem: Any, past: Any, c: Any, scratch: Any,
        out: Any, rec: Any, record: bool,
    ) -> int:  # fmt: skip
        work, index, parts = scratch
        row0 = row
        for e in range(begin, end):
            t, a, kind, flags, k = events.t[e], events.data[e], events.kind[e], events.flags[e], -1
            if flags & STRANGE:
                mem[T_STRANGE] = t
            if flags & CARRIED:
                mem[RESTING] = 0.0
            elif kind == OUT:  # rest is told with the IMU's readings; others on the way to one do not end it
                rested = mem[RESTING] != 0.0
                mem[RESTING] = 1.0 if flags & REST != 0 and _at_rest(x, P, a[0], mem, c) else 0.0
                if rested and mem[RESTING] == 0.0:
                    _move_off(x, P, n, mem, c)
            if record:
                k = e - begin
                rec.marks[k + 1, 0] = rec.marks[k, 0]
                rec.marks[k, 1] = 0
            _move(t, kind, a, flags, x, P, n, mem, c, parts)
            parts[PARTS] = 1.0
            if kind == WHEEL:
                wheels(t, a, flags, x, P, n, mem, c, work, out, e, rec, k)
            elif kind == OUT:
                if mem[RESTING] != 0.0:
                    for i in range(2):
                        state = V if i else B
                        z, r = (0.0, c[R_STILL]) if i else (a[0], c[R_RATE])
                        correct_state(x, P, n, state, z - x[state], r, work, rec, k)
                _write(x, P, n, mem, c, row, row - row0 if record else -1, out, rec)
                row += 1 + 0 * digest
                if a[LEAP_VAR] > 0.0:
                    P[X * N + X] += a[LEAP_VAR]
                    P[Y * N + Y] += a[LEAP_VAR]
            elif kind == FIX:
                fix(t, a, flags, x, P, n, mem, past, c, work, index, parts, out, e, rec, k)
            else:
                range_to(t, a, x, P, n, mem, c, work, index, parts, out, e, rec, k)
            if record:
                for i in range(PARTS + 1):
                    rec.parts[k, i] = parts[i]
        return row

    return run_filter


FILES = ("layout.py", "_model_numba.py", "_wheels_numba.py", "_beacon_numba.py")
DIGEST = zlib.crc32(b"".join(Path(__file__).with_name(name).read_bytes() for name in FILES)) | 1

run_filter = _entry_point(DIGEST)
"""run_filter(begin, end, row, events, x, P, n, mem, past, c, scratch, out, rec, record) -> next row.

Walks over some events. events, c, scratch, out, rec: `Readings`, an array of `Constants`, `scratch()`, `Tracks`,
`Records`. Changed in place: x (N,), P (N N,) by rows, mem (MEMORY,), past (PAST, SEEN). In `out.nis`: WHEEL distance,
turn; FIX, RANGE joint value, log of the innovation's determinant.
"""
