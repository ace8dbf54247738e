"""Compiled walk of the substitution: encoder data, or IMU data where they differ by more than the mean difference."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from numba import njit

STATE = 8  # begun, mean differences of speed and turn rate, replaced, for how long, calm since, the IMU's speed (2)


class Limits(NamedTuple):
    """What the walk goes by; see `decisions.Decisions`."""

    factor: float
    mean_time: float
    floor_speed: float
    floor_turn: float
    window: float
    drift: float
    longest: float


@njit(cache=True, nogil=True)
def substitute(
    dt: Any, rest: Any, speed: Any, rate: Any, gyro: Any, forward: Any, left: Any, change: Any, limits: Any,
    state: Any, imu: Any, by_imu: Any, age: Any, limit: Any,
) -> None:  # fmt: skip
    """Fill per step (N,): by_imu, imu speed [m/s] there, age [s] since the encoders were replaced; limit (N, 2).

    change (N,): the encoders' change of speed over the window, less the accelerometers'. limit: the differences of
    speed and turn rate that were too large at that stamp. state (STATE,): where it begins, zeros at first, and where it
    was left.
    """
    mean_v, mean_w = limits.floor_speed / limits.factor, limits.floor_turn / limits.factor
    if state[0] != 0.0:
        mean_v, mean_w = state[1], state[2]
    replaced, elapsed, calm = state[3] != 0.0, state[4], state[5]
    vx, vy = state[6], state[7]
    for k in range(dt.shape[0]):
        limit_v = max(limits.floor_speed, limits.factor * mean_v)
        limit_w = max(limits.floor_turn, limits.factor * mean_w)
        limit[k, 0], limit[k, 1] = limit_v, limit_w
        dv, dw = abs(change[k]), abs(rate[k] - gyro[k])
        if rest[k]:
            replaced, vx, vy = False, 0.0, 0.0
        elif not replaced:
            if dv > limit_v or dw > limit_w:
                replaced, elapsed, calm = True, 0.0, 0.0
                vx, vy = speed[k] - change[k], 0.0
        else:
            turned = gyro[k] * vy
            vy += (left[k] - gyro[k] * vx) * dt[k]
            vx += (forward[k] + turned) * dt[k]
            elapsed += dt[k]
            calm = calm + dt[k] if dv <= limit_v and dw <= limit_w else 0.0
            gap = abs(speed[k] - math.copysign(math.hypot(vx, vy), vx))
            agreed = calm >= limits.window and gap <= limit_v + limits.drift * elapsed
            if agreed or elapsed > limits.longest:
                replaced = False
        by_imu[k] = replaced
        imu[k] = math.copysign(math.hypot(vx, vy), vx) if replaced else 0.0
        age[k] = elapsed if replaced else 0.0
        if not rest[k]:
            share = dt[k] / limits.mean_time
            # A single slip must not teach the mean: no difference counts for more than the limit.
            mean_v += (min(dv, limit_v) - mean_v) * share
            mean_w += (min(dw, limit_w) - mean_w) * share
    state[0], state[1], state[2], state[3] = 1.0, mean_v, mean_w, 1.0 if replaced else 0.0
    state[4], state[5], state[6], state[7] = elapsed, calm, vx, vy
