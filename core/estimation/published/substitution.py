"""Fig. 7, first half: which sensor carries the next step, encoders or IMU, and what that says of its uncertainty."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.estimation.assumptions import Assumptions
from core.estimation.published.decisions import Decisions
from core.estimation.published.signals import Signals
from core.estimation.result import Event

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

SPEED_SD = 0.05  # m/s, of the speed at which the accelerometers take over
SHORTEST = 0.05  # s: a shorter replacement is no event
APART = 0.2  # s: replacements closer than this are one event


@dataclass(frozen=True)
class Steps:
    """Per IMU stamp (N,): distance [m], turn [rad] of the step that ends there, their variances; whether by the IMU."""

    distance: Array
    turn: Array
    var_distance: Array
    var_turn: Array
    by_imu: Flags


def choose(s: Signals, numbers: Assumptions, choice: Decisions) -> tuple[Steps, tuple[Event, ...]]:
    """The steps, and one event per stretch in which the IMU stands in for the encoders."""
    from core.estimation.published._substitute_numba import STATE

    n = len(s.t)
    back = max(1, round(choice.window / max(float(np.median(s.dt[1:])), 1e-6))) if n > 1 else 1
    gained = np.cumsum(s.forward * s.dt)
    before = np.maximum(np.arange(n) - back, 0)
    change = (s.speed - s.speed[before]) - (gained - gained[before])
    steps, speed, limit = substituted(s, change, numbers, choice, np.zeros(STATE))
    return steps, tuple(_event(s, speed, change, limit, a, b) for a, b in stretches(s.t, steps.by_imu, APART, SHORTEST))


def substituted(
    s: Signals, change: Array, numbers: Assumptions, choice: Decisions, state: Array
) -> tuple[Steps, Array, Array]:
    """The steps, the IMU's speed (N,) and the limits (N, 2), given by how much more the speed has changed (N,) by the
    encoders than by the accelerometers; on from `state` and into it."""
    from core.estimation.published._substitute_numba import Limits, substitute

    n = len(s.t)
    speed, age, limit, by_imu = np.zeros(n), np.zeros(n), np.zeros((n, 2)), np.zeros(n, np.bool_)
    limits = Limits(
        choice.mean_factor, choice.mean_time, choice.floor_speed, choice.floor_turn, choice.window,
        choice.accel_drift, choice.longest_bridge,
    )  # fmt: skip
    limits = Limits(*(float(v) for v in limits))  # one type, so that it is compiled once
    substitute(
        s.dt, s.rest, s.speed, s.rate, s.gyro, s.forward, s.left, change, limits, state, speed, by_imu, age, limit
    )  # fmt: skip
    rolled = np.abs(s.distance)
    var_rolled = (numbers.slip**2 / 2 + numbers.distance_scale_sd**2) * rolled
    var_bridged = (2 * SPEED_SD**2 * age + choice.accel_drift**2 * age**3) * s.dt
    steps = Steps(
        distance=np.where(by_imu, speed * s.dt, s.distance),
        turn=s.turn,
        var_distance=np.where(by_imu, var_bridged, var_rolled),
        # Constant errors of scale are no random walk; over a typical bend they amount to this.
        var_turn=s.turn_variance + numbers.gyro_scale_sd**2 * math.pi / 2 * np.abs(s.turn),
        by_imu=by_imu,
    )
    return steps, speed, limit


def stretches(t: Array, flags: Flags, apart: float, shortest: float) -> list[tuple[int, int]]:
    """First and last rows of stretches where flags hold; closer ones are one, shorter ones are left out."""
    at = np.flatnonzero(flags)
    if not at.size:
        return []
    cut = np.flatnonzero(np.diff(t[at]) > apart)
    first, last = np.concatenate(([0], cut + 1)), np.concatenate((cut, [at.size - 1]))
    pairs = ((int(at[a]), int(at[b])) for a, b in zip(first, last, strict=True))
    return [(a, b) for a, b in pairs if t[b] - t[a] >= shortest]


def _event(s: Signals, imu: Array, change: Array, limit: Array, a: int, b: int) -> Event:
    inside = slice(a, b + 1)
    dw = np.abs(s.rate - s.gyro)
    bound_v, bound_w = np.maximum(limit[inside], 1e-9).T
    share_v, share_w = np.abs(change[inside]) / bound_v, dw[inside] / bound_w
    if share_v.max() >= share_w.max():
        k = a + int(np.argmax(share_v))
        why = f"speed changed by {change[k]:+.2g} m/s more by encoders than by accelerometers"
        bound = f"limit {limit[k, 0]:.2g} m/s"
    else:
        k = a + int(np.argmax(share_w))
        why = f"encoders turn at {s.rate[k]:.2g} rad/s, the gyro at {s.gyro[k]:.2g} rad/s"
        bound = f"limit {limit[k, 1]:.2g} rad/s"
    middle = (a + b) // 2
    told = f"then {s.speed[middle]:.2g} m/s by encoders, {imu[middle]:.2g} m/s by accelerometers"
    return Event(
        "slip", float(s.t[a]), float(s.t[b]), f"{why} ({bound}); {told}", "encoders by accelerometers and gyro"
    )
