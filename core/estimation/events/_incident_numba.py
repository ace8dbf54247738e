"""Compiled reading of the rows of `_residual_numba`: which story explains that sensors contradict each other.

Wheels flat, nothing asked, IMU moves      pushed
one or both flat, the rest moves           dead encoder
wheels asked to turn, flat, IMU at rest    stuck
wheels turn, IMU at rest, after a blow     stuck (spinning)
anything else                              slip

State lives in one array, so a log may come in pieces.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit

from core.estimation.events._residual_numba import (
    PER_CHANNEL,
    R_ASKED,
    R_BEFORE_L,
    R_BEFORE_R,
    R_BUSY,
    R_CHANNEL,
    R_FLAT_L,
    R_FLAT_R,
    R_GYRO,
    R_H,
    R_KNOWN,
    R_SET_L,
    R_SET_R,
    R_STILL,
    R_T,
    R_UNASKED,
    R_VL,
    R_VR,
)  # fmt: skip

SLIP, COLLISION, BOUNCE, PUSHED, STUCK, DEAD = range(6)  # as KINDS
MIS, BLOCKED, SPIN = 0, 20, 40  # places of the three open incidents in the state
ASK_L, ASK_R, CALM, DEAD_END, LAST_MIS, KEEP, DRIVE = range(60, 67)
STATE = 70
# of an open incident: open, kind, t0, alarm, last sign, left, right, turn, stopped, z, turn, along, side, and the
# first along or the rims' speed
SIZE = 14

FLAT = 0.12  # s without a tick that make a wheel flat
ASKED = 0.7  # s of asking in vain
ASK = 0.05  # m/s, least rim speed that is asked for
SLOW = 0.05  # m/s
RUNS_AWAY = 0.05  # m/s: less is no reason to doubt a second wheel
CREEP = 0.02  # m/s: a wheel that is shaken may tick
RESTS, MOVES = 3.0, 5.0  # variance of the IMU over that at rest: below, above
AFTER = 3.0  # s after a contradiction in which wheels may be found spinning


@njit(error_model="numpy")
def _start(o: Any, kind: Any, t0: float, alarm: float, s: Any) -> None:
    for j in range(SIZE):
        s[o + j] = 0.0
    s[o], s[o + 1], s[o + 2], s[o + 3], s[o + 4] = 1.0, kind, t0, alarm, t0


@njit(error_model="numpy")
def _write(o: Any, t1: float, release: float, s: Any, found: Any, n: Any) -> Any:
    row = found[n]
    for j in range(SIZE):
        row[j] = s[o + j]
    row[4], row[SIZE] = max(t1, s[o + 2]), release
    s[o] = 0.0
    return n + 1


@njit(error_model="numpy")
def _kind(r: Any, onset: float, along: float, track: float, has_accel: bool) -> tuple[int, bool, bool]:
    """What explains a contradiction since `onset`, and which wheels it is about."""
    since, fl, fr = r[R_T] - onset, r[R_FLAT_L], r[R_FLAT_R]
    parked_l = fl > since + 0.1 or (abs(r[R_VL]) < CREEP and abs(r[R_BEFORE_L]) < SLOW)
    parked_r = fr > since + 0.1 or (abs(r[R_VR]) < CREEP and abs(r[R_BEFORE_R]) < SLOW)
    if parked_l and parked_r and r[R_UNASKED] > since + 0.1:
        return PUSHED, True, True
    flat_l, flat_r = fl >= FLAT, fr >= FLAT
    if flat_l and flat_r:
        asked = r[R_ASKED] > 0.3 and max(abs(r[R_SET_L]), abs(r[R_SET_R])) > ASK
        moved = max(abs(r[R_BEFORE_L]), abs(r[R_BEFORE_R])) > SLOW and min(fl, fr) < since + 0.2
        if (asked and (moved or r[R_STILL] > MOVES)) or (moved and min(fl, fr) > 0.5 and r[R_STILL] > MOVES):
            return DEAD, True, True
        return SLIP, False, False
    for side in range(2):
        flat, before, f = (flat_l, r[R_BEFORE_L], fl) if side == 0 else (flat_r, r[R_BEFORE_R], fr)
        if not flat:
            continue
        sign = 1.0 if side == 0 else -1.0
        expected = (r[R_VR] if side == 0 else r[R_VL]) - sign * track * r[R_GYRO]
        moved = abs(before) > SLOW and f < since + 0.2
        lost = abs(expected) > SLOW and (moved if not has_accel else (along * expected < 0.0 or moved))
        if lost and abs(expected) > 0.4 * abs(before):
            return DEAD, side == 0, side == 1
    return SLIP, False, False


@njit(error_model="numpy")
def _mismatch(r: Any, track: float, has_accel: bool, s: Any, found: Any, n: Any) -> Any:
    """Open, follow and close the incident behind the channels."""
    t, known = r[R_T], r[R_KNOWN]
    onset, active, z = math.inf, np.int64(0), 0.0
    for k in range(3):
        a = R_CHANNEL + k * PER_CHANNEL
        old = s[DEAD_END] > 0.0 and r[a + 1] <= s[DEAD_END] + 0.3  # an encoder that came back to life
        if r[a] > 0.0 and not old:
            onset, active, z = min(onset, r[a + 1]), active | (1 << k), max(z, r[a + 3])
    turn, along, side = r[R_CHANNEL + 4], r[R_CHANNEL + PER_CHANNEL + 4], r[R_CHANNEL + 2 * PER_CHANNEL + 4]
    if s[MIS] == 0.0 and active:
        kind, left, right = _kind(r, onset, along, track, has_accel)
        _start(np.int64(MIS), kind, onset, known, s)
        if kind == SLIP:
            left, right = _sides(active, turn / max(t - onset, r[R_H]), along, track, has_accel)
        s[MIS + 13] = along
        s[MIS + 5], s[MIS + 6], s[MIS + 7] = (1.0 if left else 0.0), (1.0 if right else 0.0), float(active & 1)
    if s[MIS] == 0.0:
        return n
    if active:
        if s[MIS + 1] == SLIP:
            kind, left, right = _kind(r, s[MIS + 2], along, track, has_accel)
            if kind == DEAD:  # what was a slip is known by now for what it is
                onset, first = s[MIS + 2], s[MIS + 13]
                n = _write(np.int64(MIS), t, known, s, found, n)
                _start(np.int64(MIS), np.int64(DEAD), onset, known, s)
                s[MIS + 5], s[MIS + 6], s[MIS + 13] = (1.0 if left else 0.0), (1.0 if right else 0.0), first
            else:
                n = _widen(r, active, turn, along, track, has_accel, s, found, n)
        s[MIS + 9] = max(s[MIS + 9], z)
        s[MIS + 7] = max(s[MIS + 7], float(active & 1))
        sums = (turn if active & 1 else 0.0, along if active & 2 else 0.0, side if active & 4 else 0.0)
        for j in range(3):
            if abs(sums[j]) > abs(s[MIS + 10 + j]):
                s[MIS + 10 + j] = sums[j]
        s[MIS + 4] = t
    if s[MIS + 1] == DEAD:
        return _dead(r, active, s, found, n)
    if active == 0:
        return _write(np.int64(MIS), s[MIS + 4] - 3.0 * r[R_H], known, s, found, n)
    return n


@njit(error_model="numpy")
def _widen(
    r: Any, active: Any, turn: float, along: float, track: float, has_accel: bool, s: Any, found: Any, n: Any
) -> Any:
    """A slip that reaches a wheel which was trusted so far goes on as a new one of the same onset, known from now."""
    left, right = _sides(active, turn / max(r[R_T] - s[MIS + 2], r[R_H]), along, track, has_accel)
    if abs(along) < RUNS_AWAY:
        return n
    left, right = left or s[MIS + 5] > 0.0, right or s[MIS + 6] > 0.0
    if left == (s[MIS + 5] > 0.0) and right == (s[MIS + 6] > 0.0):
        return n
    onset, first, turned = s[MIS + 2], s[MIS + 13], s[MIS + 7]
    n = _write(np.int64(MIS), r[R_T], r[R_KNOWN], s, found, n)
    _start(np.int64(MIS), np.int64(SLIP), onset, r[R_KNOWN], s)
    s[MIS + 5], s[MIS + 6] = (1.0 if left else 0.0), (1.0 if right else 0.0)
    s[MIS + 7], s[MIS + 13] = turned, first
    return n


@njit(error_model="numpy")
def _dead(r: Any, active: Any, s: Any, found: Any, n: Any) -> Any:
    """A dead encoder ends with its first tick, or when the whole robot rests."""
    left, right = s[MIS + 5] > 0.0, s[MIS + 6] > 0.0
    ticks = (not left or r[R_FLAT_L] == 0.0) and (not right or r[R_FLAT_R] == 0.0)
    rests = min(r[R_FLAT_L], r[R_FLAT_R]) > 0.3 and r[R_ASKED] == 0.0 and 0.0 <= r[R_STILL] < RESTS and active == 0
    if not (ticks or rests):
        s[MIS + 4] = r[R_T]
        return n
    s[DEAD_END] = r[R_T]
    return _write(np.int64(MIS), r[R_T] - r[R_H], r[R_KNOWN], s, found, n)


@njit(error_model="numpy")
def _sides(active: Any, rate: float, along: float, track: float, has_accel: bool) -> tuple[bool, bool]:
    """Which wheels run away from the ground: from the excess of speed, and of turn rate."""
    if not active & 1:
        return bool(active & 2), bool(active & 2)
    if not has_accel or not active & 2:
        return False, False
    left, right = abs(along - 0.5 * track * rate), abs(along + 0.5 * track * rate)
    least = min(RUNS_AWAY, 0.7 * max(left, right))
    return left > max(0.5 * right, least), right > max(0.5 * left, least)


@njit(error_model="numpy")
def _blocked(r: Any, s: Any, found: Any, n: Any) -> Any:
    """Asked to turn and flat, while nothing says that the robot moves."""
    t, h = r[R_T], r[R_H]
    for j, place, flat in ((R_SET_L, ASK_L, r[R_FLAT_L]), (R_SET_R, ASK_R, r[R_FLAT_R])):
        s[place] = s[place] + h if abs(r[j]) > ASK and flat > 0.0 and r[R_ASKED] > 0.0 else 0.0
    left, right = s[ASK_L] > ASKED, s[ASK_R] > ASKED
    dead = s[MIS] > 0.0 and s[MIS + 1] == DEAD
    moving = (r[R_STILL] > MOVES and left and right) or (s[MIS] > 0.0 and s[MIS + 7] > 0.0)
    now = (left or right) and not dead and not moving
    if s[BLOCKED] == 0.0 and now:
        _start(np.int64(BLOCKED), np.int64(STUCK), t - max(s[ASK_L], s[ASK_R]), r[R_KNOWN], s)
        s[BLOCKED + 8] = 1.0 if left and right else 0.0
    if s[BLOCKED] == 0.0:
        return n
    if now:
        s[BLOCKED + 4] = t
        s[BLOCKED + 13] = max(abs(r[R_SET_L]), abs(r[R_SET_R]))
        return n
    return _write(np.int64(BLOCKED), t - h, r[R_KNOWN], s, found, n)


@njit(error_model="numpy")
def _spinning(r: Any, blow: float, s: Any, found: Any, n: Any) -> Any:
    """Wheels that turn under a body at rest: after something has happened, where driving is known to shake the IMU."""
    t, h = r[R_T], r[R_H]
    rim = max(abs(r[R_VL]), abs(r[R_VR]))
    rests = rim > SLOW and 0.0 <= r[R_STILL] < min(RESTS, 0.1 * s[DRIVE]) and abs(r[R_GYRO]) < 0.05
    s[CALM] = s[CALM] + h if rests else 0.0
    if s[MIS] > 0.0:
        s[LAST_MIS] = t
    recent = t - max(s[LAST_MIS], blow) < AFTER
    if rim > SLOW and not recent and r[R_STILL] >= 0.0:
        s[DRIVE] += min(h / 3.0, 1.0) * (min(r[R_STILL], 100.0) - s[DRIVE])
    if s[SPIN] == 0.0 and s[CALM] > 0.3 and recent:
        _start(np.int64(SPIN), np.int64(STUCK), t - s[CALM] - 0.3, r[R_KNOWN], s)
        s[SPIN + 5], s[SPIN + 6], s[SPIN + 7], s[SPIN + 8] = 1.0, 1.0, 1.0, 1.0
    if s[SPIN] == 0.0:
        return n
    if rests:
        s[SPIN + 13] = max(s[SPIN + 13], rim)
        return n
    return _write(np.int64(SPIN), t - h, r[R_KNOWN], s, found, n)


def _entry_point(digest: int) -> Callable[..., int]:
    """numba's cache sees a change of this file and of what is closed over, not of the file that the columns are of."""

    @njit(error_model="numpy", cache=True, nogil=True)
    def walk(rows: Any, blow: Any, s: Any, found: Any, track: float, has_accel: bool, flush: bool) -> int:
        """Fill found (., SIZE + 1) with incidents that ended here; how many. rows (M, ROW); blow (M,): when the newest
        blow was known; state s (STATE,). Columns: as of an open incident (4: its end), then the release."""
        n: Any = np.int64(0)  # as a literal it would be compiled twice
        for i in range(rows.shape[0] * min(digest, 1)):
            r = rows[i]
            if r[R_BUSY] == 0.0:
                n = _mismatch(r, track, has_accel, s, found, n)
                n = _spinning(r, blow[i], s, found, n)
            n = _blocked(r, s, found, n)
            s[KEEP] = r[R_T]
        if flush:
            for o in (MIS, BLOCKED, SPIN):
                if s[o] > 0.0:
                    n = _write(o, s[KEEP], s[KEEP], s, found, n)
        return n

    return walk


walk = _entry_point(zlib.crc32(Path(__file__).with_name("_residual_numba.py").read_bytes()) | 1)
