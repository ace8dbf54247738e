"""Compiled intake: new rows of a live run become events of the fused filter, with their flags. Plain arrays in and out.

What a row's flags say of the past is looked up in a few seconds of history that is kept here, so that a piece costs
what its own rows cost. The same rules as `estimation.rest` and `estimation.fusion.events`; `intake` documents.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit

from core.estimation.fusion import layout
from core.estimation.fusion.layout import FIX, JUMP, OUT, RANGE, REST, STILL, WHEEL

HISTORY = 4096  # rows of a stream that are kept, half of them at least
W_T, W_CHANGED = range(2)  # columns of the wheels' history: stamp, when a wheel had last turned
C_T, C_ASKS, C_ASKED = range(3)  # of the commands': stamp, whether it asks for motion, when one last did
G_T, G_RATE = range(2)  # of the gyro's

MEMORY = 24
(
    W_ROWS, C_ROWS, G_ROWS, LEFT, LEFT_T, RIGHT, RIGHT_T, GZ, GZ_T, AX, AX_T, AY, AY_T, FIRST_LEFT, FIRST_RIGHT,
    WHEEL_T, LAST_LEFT, LAST_RIGHT, D, TURN, ROLLED, RATE_T, RATE, BEGUN,
) = range(MEMORY)  # fmt: skip
"""What is remembered: rows of each history, last good value of each column and its stamp, sums."""

LIMITS = 19
(
    RADIUS, TRACK, REST_TIME, STANDING, WHEEL_STEP, LOOSE, REST_RATE, WINDOW, TOP_SPEED, COS, SIN, ARM_X, ARM_Y,
    HARDEST, FASTEST, FARTHEST, BY_IMU, HAS_AX, HAS_AY,
) = range(LIMITS)  # fmt: skip
"""Numbers of the robot and the run. LOOSE: largest variance of the gyro at rest; WINDOW: fewest readings for that."""


@njit(cache=True, error_model="numpy")
def _fill(rows: Any, column: int, most: float, mem: Any, value: int) -> None:
    """Missing readings linearly between the last good one, kept in mem[value] with its stamp behind it, and the next;
    held where there is no next."""
    for k in range(rows.shape[0]):
        y = rows[k, column]
        if not abs(y) <= most:
            following = k + 1
            while following < rows.shape[0] and not abs(rows[following, column]) <= most:
                following += 1
            if following < rows.shape[0]:
                t1, y1 = rows[following, 0], rows[following, column]
                if math.isnan(mem[value]):
                    y = y1
                else:
                    y = mem[value] + (y1 - mem[value]) * (rows[k, 0] - mem[value + 1]) / (t1 - mem[value + 1])
            else:
                y = mem[value]
            rows[k, column] = y
        else:
            mem[value], mem[value + 1] = y, rows[k, 0]


@njit(cache=True, error_model="numpy")
def _room(history: Any, rows: int) -> int:
    """Place for one more row: the newer half stays."""
    if rows < history.shape[0]:
        return rows
    half = history.shape[0] // 2
    history[:half] = history[rows - half : rows].copy()
    return half


@njit(cache=True, error_model="numpy")
def _newest(history: Any, rows: int, t: float) -> int:
    """Row of the newest stamp that is not after t; -1 where there is none."""
    k = rows - 1
    while k >= 0 and history[k, 0] > t:
        k -= 1
    return k


@njit(cache=True, error_model="numpy")
def _still(history: Any, rows: int, t: float, time: float, step: float) -> bool:
    k = _newest(history, rows, t)
    return k >= 0 and t - history[k, W_T] <= max(time, 3.0 * step) and t - history[k, W_CHANGED] >= time


@njit(cache=True, error_model="numpy")
def _unasked(history: Any, rows: int, t: float, time: float) -> bool:
    k = _newest(history, rows, t)
    return k < 0 or (history[k, C_ASKS] == 0.0 and t - history[k, C_ASKED] >= time)


@njit(cache=True, error_model="numpy")
def _quiet(history: Any, rows: int, at: int, limits: Any) -> bool:
    """Whether the gyro shows its own noise and no more than a bias over the last rest time, as of row `at`."""
    begin = at
    while begin > 0 and history[begin - 1, G_T] >= history[at, G_T] - limits[REST_TIME]:
        begin -= 1
    begin = max(min(begin, at + 1 - int(limits[WINDOW])), 0)
    n = at + 1 - begin
    if n < limits[WINDOW]:
        return False
    mean = 0.0
    for k in range(begin, at + 1):
        mean += history[k, G_RATE] / n
    square = 0.0
    for k in range(begin, at + 1):
        square += (history[k, G_RATE] - mean) ** 2
    return square / (n - 1) <= limits[LOOSE] and abs(mean) <= limits[REST_RATE]


@njit(cache=True, error_model="numpy")
def _wheels(wheels: Any, mem: Any, history: Any, limits: Any, rolled: Any, jumps: Any) -> None:
    """Distance and turn since the first reading (2, n), and whether the counter jumped."""
    _fill(wheels, 1, limits[FARTHEST], mem, LEFT)
    _fill(wheels, 2, limits[FARTHEST], mem, RIGHT)
    for k in range(wheels.shape[0]):
        t, left, right = wheels[k, 0], wheels[k, 1], wheels[k, 2]
        first = mem[ROLLED] == 0.0
        if first:
            mem[FIRST_LEFT], mem[FIRST_RIGHT], mem[ROLLED] = left, right, 1.0
        by_left, by_right = limits[RADIUS] * (left - mem[FIRST_LEFT]), limits[RADIUS] * (right - mem[FIRST_RIGHT])
        d, turn = (by_left + by_right) / 2, (by_right - by_left) / limits[TRACK]  # NaN without a track width
        rows = int(mem[W_ROWS])
        changed, since = t, 0.0
        if not first:
            since = t - mem[WHEEL_T]
            if left == mem[LAST_LEFT] and right == mem[LAST_RIGHT]:
                changed = history[rows - 1, W_CHANGED]
            rim = abs(d - mem[D])
            if not math.isnan(turn):
                rim += limits[TRACK] / 2 * abs(turn - mem[TURN])
            jumps[k] = rim > limits[TOP_SPEED] * max(since, 0.01)
        rows = _room(history, rows)
        history[rows, W_T], history[rows, W_CHANGED] = t, changed
        mem[W_ROWS], mem[WHEEL_T], mem[D], mem[TURN] = rows + 1, t, d, turn
        mem[LAST_LEFT], mem[LAST_RIGHT] = left, right
        rolled[0, k], rolled[1, k] = d, turn


@njit(cache=True, error_model="numpy")
def _imu(imu: Any, mem: Any, gyro: Any, wheels: Any, commands: Any, limits: Any, inertial: Any) -> None:
    """Rate, forward acceleration and rest (n, 3) of new readings."""
    _fill(imu, 1, limits[FASTEST], mem, GZ)
    if limits[HAS_AX] != 0.0:
        _fill(imu, 2, limits[HARDEST], mem, AX)
    if limits[HAS_AY] != 0.0:
        _fill(imu, 3, limits[HARDEST], mem, AY)
    for k in range(imu.shape[0]):
        t = imu[k, 0]
        rate = 0.0 if math.isnan(imu[k, 1]) else imu[k, 1]
        inertial[k, 0] = rate
        spin = 0.0
        if mem[BEGUN] != 0.0:
            spin = (rate - mem[RATE]) / max(t - mem[RATE_T], 1e-4)
        if limits[HAS_AX] != 0.0:
            ay = imu[k, 3] if limits[HAS_AY] != 0.0 else 0.0
            forward = limits[COS] * imu[k, 2] - limits[SIN] * ay + rate * rate * limits[ARM_X] + spin * limits[ARM_Y]
            if not math.isnan(forward):
                inertial[k, 1] = min(max(forward, -limits[HARDEST]), limits[HARDEST])
        mem[BEGUN], mem[RATE_T], mem[RATE] = 1.0, t, rate
        rows = _room(gyro, int(mem[G_ROWS]))
        gyro[rows, G_T], gyro[rows, G_RATE] = t, rate
        mem[G_ROWS] = rows + 1
        resting = (
            _still(wheels, int(mem[W_ROWS]), t, limits[REST_TIME], limits[WHEEL_STEP])
            and _unasked(commands, int(mem[C_ROWS]), t, limits[REST_TIME])
            and _quiet(gyro, rows + 1, rows, limits)
        )
        inertial[k, 2] = 1.0 if resting else 0.0


@njit(cache=True, error_model="numpy")
def _commands(commands: Any, mem: Any, history: Any) -> None:
    for k in range(commands.shape[0]):
        rows = int(mem[C_ROWS])
        asked = history[rows - 1, C_ASKED] if rows else -math.inf
        asks = commands[k, 1] != 0.0 or commands[k, 2] != 0.0
        rows = _room(history, rows)
        history[rows, C_T], history[rows, C_ASKS] = commands[k, 0], 1.0 if asks else 0.0
        history[rows, C_ASKED] = commands[k, 0] if asks else asked
        mem[C_ROWS] = rows + 1


def _entry_point(digest: int) -> Callable[..., None]:
    """The compiled function; numba's cache notices changes of this file alone: it closes over a digest of `layout`."""

    @njit(cache=True, error_model="numpy")
    def take(
        commands: Any, wheels: Any, imu: Any, fixes: Any, ranges: Any, mem: Any, asked: Any, turned: Any, gyro: Any,
        limits: Any, rolled: Any, inertial: Any, t: Any, kind: Any, data: Any, flags: Any,
    ) -> None:  # fmt: skip
        jumps = np.zeros(wheels.shape[0], np.bool_)
        _commands(commands, mem, asked)
        _wheels(wheels, mem, turned, limits, rolled, jumps)
        _imu(imu, mem, gyro, turned, asked, limits, inertial)
        by_imu = limits[BY_IMU] != 0.0
        outs = imu.shape[0] if by_imu else wheels.shape[0]
        w, f, r, o = 0, 0, 0, 0
        for e in range(t.shape[0]):
            nearest, which = math.inf, -1
            if w < wheels.shape[0]:
                nearest, which = wheels[w, 0], WHEEL
            if f < fixes.shape[0] and fixes[f, 0] < nearest:
                nearest, which = fixes[f, 0], FIX
            if r < ranges.shape[0] and ranges[r, 0] < nearest:
                nearest, which = ranges[r, 0], RANGE
            if o < outs and (imu[o, 0] if by_imu else wheels[o, 0]) < nearest:
                nearest, which = imu[o, 0] if by_imu else wheels[o, 0], OUT
            t[e], kind[e], flags[e] = nearest, which, 0
            data[e, :] = 0.0 * digest
            if which == WHEEL:
                data[e, 0], data[e, 1] = rolled[0, w], rolled[1, w]
                flags[e] = JUMP if jumps[w] else 0
                w += 1
            elif which == FIX:
                data[e, :] = fixes[f, 1:]
                f += 1
            elif which == RANGE:
                data[e, :] = ranges[r, 1:]
                r += 1
            else:
                if by_imu:
                    data[e, 0], data[e, 1] = inertial[o, 0], inertial[o, 1]
                    flags[e] = REST if inertial[o, 2] != 0.0 else 0
                o += 1
            if _still(turned, int(mem[W_ROWS]), nearest, limits[STANDING], limits[WHEEL_STEP]):
                flags[e] |= STILL

    return take


take = _entry_point(zlib.crc32(Path(layout.__file__).read_bytes()) | 1)
"""take(commands, wheels, imu, fixes, ranges, mem, asked, turned, gyro, limits, rolled, inertial, t, kind, data, flags)

Fills rolled (2, W), inertial (I, 3), and the events: t, kind, data (E, 5), flags, in order of time and kind. commands
(C, 3), wheels (W, 3), imu (I, 4): stamp and columns, NaN where missing, which are filled in place; fixes, ranges
(., 6): stamp and the event's data. asked, turned, gyro: histories.
"""
