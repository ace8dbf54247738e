"""The signals of Fig. 7 at the IMU's stamps: low-passed rates and accelerations, and what the encoders say there.

Offsets of gyro and accelerometers are the means of what they read at rest so far (recent rests count more); before the
first rest they are taken for zero. Accelerations are carried from the IMU's place to the axle's midpoint.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.estimation.assumptions import Assumptions
from core.estimation.cleaning import filled
from core.estimation.odometry import gyro_turns, longest_hold, wheel_path
from core.estimation.published.decisions import Decisions
from core.estimation.rest import at_rest
from core.run import Run

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

REST_MEMORY = 60.0  # s of rest that the offsets' mean looks back
HARDEST = 200.0  # m/s^2: beyond it an accelerometer reading is a fault


@dataclass(frozen=True)
class Signals:
    """Per IMU stamp (N,).

    t, dt [s] (at most a few steps: over a pause nothing is integrated); rest; by the encoders distance [m] of the
    step, speed [m/s], rate [rad/s]; gyro [rad/s], turn [rad] of the step by the gyro, its variance; forward,
    left [m/s^2] accelerations of the axle's midpoint, low-passed; sharp (N, 2) [m/s^2], what the low-pass of a second
    would hide: for shocks. rested: whether offsets were ever learnt.
    """

    t: Array
    dt: Array
    rest: Flags
    distance: Array
    speed: Array
    rate: Array
    gyro: Array
    turn: Array
    turn_variance: Array
    forward: Array
    left: Array
    sharp: Array
    rested: bool


def signals(run: Run, numbers: Assumptions, choice: Decisions) -> Signals:
    """All of them. The run has what `navigate.missing` asks for."""
    imu, wheels, robot = run.imu, run.wheels, run.meta.robot
    assert imu is not None and imu.ax is not None and imu.ay is not None and wheels is not None and robot.wheel_radius
    t = imu.t
    hz = max(imu.rate, 1.0)
    step = np.diff(t, prepend=t[0])
    dt = np.minimum(step, longest_hold(step))
    rest = at_rest(run, numbers).flags
    turns = gyro_turns(imu, numbers)
    held = np.where(step > 0, turns.step / np.where(step > 0, step, 1.0), 0.0)
    held[0] = held[1]
    rate = lowpass(held - offsets(held, rest, hz), hz, choice.gyro_cutoff)
    path = wheel_path(wheels, robot.wheel_radius, robot.track_width)
    distance = np.diff(np.interp(t, path.t, path.d), prepend=np.interp(t[0], path.t, path.d))
    wheel_turn = np.diff(np.interp(t, path.t, path.turn), prepend=np.interp(t[0], path.t, path.turn))
    safe = np.where(step > 0, step, 1.0)
    raw = [np.asarray(c, np.float64) for c in (imu.ax, imu.ay)]
    raw = [filled(t, np.where(np.abs(c) <= HARDEST, c, np.nan), f"imu.a{n}") for c, n in zip(raw, "xy", strict=True)]
    body = _to_axle(np.column_stack([c - offsets(c, rest, hz) for c in raw]), rate, safe, run)
    smooth = [lowpass(body[:, i], hz, choice.accel_cutoff) for i in (0, 1)]
    slow = np.column_stack([lowpass(body[:, i], hz, 1.0) for i in (0, 1)])
    return Signals(
        t=t,
        dt=dt,
        rest=rest,
        distance=distance,
        speed=lowpass(distance / safe, hz, choice.accel_cutoff),
        rate=lowpass(wheel_turn / safe, hz, choice.accel_cutoff),
        gyro=lowpass(rate, hz, choice.accel_cutoff),
        turn=np.where(rest, 0.0, rate * step),
        turn_variance=np.where(rest, 0.0, turns.variance),
        forward=smooth[0],
        left=smooth[1],
        sharp=body - slow,
        rested=bool(rest.any()),
    )


def lowpass(values: Array, hz: float, cutoff: float) -> Array:
    """Second-order Butterworth low-pass, causal, started at rest at the first value."""
    from scipy.signal import butter, lfilter, lfilter_zi

    if cutoff >= 0.45 * hz or not len(values):
        return values
    b, a = butter(2, cutoff, fs=hz)
    out, _ = lfilter(b, a, values, zi=lfilter_zi(b, a) * values[0])
    return np.asarray(out, np.float64)


def offsets(values: Array, rest: Flags, hz: float) -> Array:
    """(N,) mean of the values at rest so far, with exponential forgetting over REST_MEMORY of rest; 0 before it."""
    from scipy.signal import lfilter

    at = np.flatnonzero(rest)
    if not at.size:
        return np.zeros(len(values))
    keep = math.exp(-1.0 / (REST_MEMORY * hz))
    sums = lfilter([1 - keep], [1, -keep], values[at]) / (1 - keep ** np.arange(1, at.size + 1))
    seen = np.cumsum(rest)
    return np.where(seen > 0, sums[np.maximum(seen - 1, 0)], 0.0)


def _to_axle(accel: Array, rate: Array, dt: Array, run: Run) -> Array:
    """(N, 2) accelerations along the body's axes at the axle's midpoint: mounting turned back, lever arm taken off."""
    mount = run.meta.robot.imu
    cos, sin = math.cos(mount.yaw), math.sin(mount.yaw)
    ax, ay = cos * accel[:, 0] - sin * accel[:, 1], sin * accel[:, 0] + cos * accel[:, 1]
    spin = np.diff(rate, prepend=rate[0]) / dt if mount.x or mount.y else np.zeros(len(rate))
    return np.column_stack((ax + spin * mount.y + rate**2 * mount.x, ay - spin * mount.x + rate**2 * mount.y))
