"""What is tried: every effect of the table as one or more candidates, each with a start and its free parameters.

A candidate that is smooth at its start is a set of derivatives there. One that is not (a dead band, a clip) is a
secant: the whole change from neutral to its start is one column, of weight about one where the start is right.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.effects import EFFECTS
from core.robot import EffectSet

Array = npt.NDArray[np.float64]
Values = Mapping[str, float | str]

STEPS = {
    "command_delay.delay": 2e-3, "motor_lag.tau": 2e-3, "drive_gain.gain": 1e-3, "battery_sag.rate": 1e-5,
    "deadband.width": 1e-3, "speed_limit.v_max": 2e-3, "accel_limit.a_max": 5e-3,
    "wheel_radius.scale": 1e-3, "unequal_wheels.ratio": 1e-3, "track_width.scale": 1e-3,
    "wheel_slip.k": 2e-3, "side_slip.k": 2e-3, "floor_tilt.slope_x": 1e-3, "floor_tilt.slope_y": 1e-3,
    "slip_patch.x": 5e-3, "slip_patch.y": 5e-3, "slip_patch.radius": 5e-3, "slip_patch.slip": 5e-3,
    "bump.time": 2e-3, "bump.distance": 1e-3, "bump.turn": 1e-3,
    "gyro_bias.bias": 1e-3, "gyro_drift.amplitude": 1e-3, "gyro_drift.tau": 1.0, "gyro_temperature.slope": 1e-4,
    "gyro_scale.scale": 1e-3, "gyro_clip.limit": 2e-3, "gyro_g_sensitivity.k": 1e-3,
    "accel_bias.x": 1e-2, "accel_bias.y": 1e-2, "accel_scale.x": 1e-2, "accel_scale.y": 1e-2,
    "imu_yaw.angle": 1e-3, "imu_offset.x": 5e-3, "imu_offset.y": 5e-3,
    "missed_ticks.left": 1e-3, "missed_ticks.right": 1e-3,
    "beacon_delay.delay": 1e-2, "beacon_shift.x": 1e-2, "beacon_shift.y": 1e-2, "beacon_rotation.angle": 1e-3,
    "beacon_scale.scale": 1e-3, "tag_offset.x": 1e-2, "tag_offset.y": 1e-2,
    "anchor_moved.x": 1e-2, "anchor_moved.y": 1e-2, "range_bias.bias": 1e-2,
    "imu_clock.offset": 1e-3, "clock_drift.skew": 1e-6,
}  # fmt: skip
"""Steps of finite differences: well above rounding, well below what bends the response."""
TAUS = (20.0, 45.0, 100.0, 220.0)
"""Warm-up times tried [s]."""
SHARES = (0.97, 0.88, 0.75, 0.6, 0.45)
"""Limits tried, as shares of what the run reaches."""
BANDS = (0.006, 0.015, 0.03, 0.06, 0.1)
"""Dead bands tried [m/s]."""
SEARCHED = ("slip_patch", "bump")
"""Effects whose place is searched in the residuals first (`search.py`)."""


@dataclass(frozen=True)
class Candidate:
    """One way to add an effect. start: all its parameters; free: those that are fitted; secant: see the module."""

    effect: str
    start: Values
    free: tuple[str, ...]
    secant: bool = False

    @property
    def smooth(self) -> bool:
        """Whether what it promises to first order is what it brings."""
        return not self.secant and EFFECTS[self.effect].smooth

    @property
    def keys(self) -> tuple[str, ...]:
        """Names of the columns: one per free parameter, one in all for a secant."""
        return (f"{self.effect}*",) if self.secant else tuple(f"{self.effect}.{name}" for name in self.free)


@dataclass(frozen=True)
class Reach:
    """What the runs reach: rim speed [m/s], rim acceleration [m/s²], turn rate [rad/s], lowest rim speed [m/s]."""

    speed: float
    acceleration: float
    turn: float


def free_of(effect: str, values: Values) -> tuple[str, ...]:
    """The numeric parameters of an effect that is in the model."""
    return tuple(p.name for p in EFFECTS[effect].parameters if not p.text and math.isfinite(float(values[p.name])))


def bounds(effect: str, name: str) -> tuple[float, float]:
    """Plausible range of a parameter."""
    parameter = EFFECTS[effect].parameter(name)
    return parameter.low, parameter.high


def tolerance(effect: str, name: str, reach: Reach) -> float | None:
    """The size below which a parameter's deviation from neutral is immaterial; None where another one decides."""
    parameter = EFFECTS[effect].parameter(name)
    if parameter.small is None:
        return None
    if not parameter.small_of_reach:
        return parameter.small
    return (
        parameter.small
        * {"speed_limit": reach.speed, "accel_limit": reach.acceleration, "gyro_clip": reach.turn}[effect]
    )


def candidates(
    channels: Sequence[str], beacons: Sequence[str], reach: Reach, known: EffectSet, warm: bool
) -> list[Candidate]:
    """All that these channels could show, but for `SEARCHED` and what only adds noise. known: already modelled."""
    out: list[Candidate] = []
    for effect in EFFECTS.values():
        if effect.noise_only or effect.id in SEARCHED or not set(effect.streams) & set(channels):
            continue
        if effect.id == "gyro_temperature" and not warm:
            continue
        neutral = {**effect.neutral, **known.get(effect.id, {})}
        if effect.id in known:
            out.append(Candidate(effect.id, neutral, free_of(effect.id, neutral)))
        elif effect.id == "gyro_drift":
            out += [Candidate(effect.id, {"amplitude": 0.0, "tau": tau}, ("amplitude",)) for tau in TAUS]
        elif effect.id == "anchor_moved":
            out += [Candidate(effect.id, {"beacon": name, "x": 0.0, "y": 0.0}, ("x", "y")) for name in beacons]
        elif effect.id == "deadband":
            out += [Candidate(effect.id, {"width": width}, ("width",), secant=True) for width in BANDS]
        elif effect.id in ("speed_limit", "accel_limit", "gyro_clip"):
            top = {"speed_limit": reach.speed, "accel_limit": reach.acceleration, "gyro_clip": reach.turn}[effect.id]
            name = effect.parameters[0].name
            out += [Candidate(effect.id, {name: share * top}, (name,), secant=True) for share in SHARES if top > 0]
        else:
            out.append(Candidate(effect.id, neutral, tuple(p.name for p in effect.parameters)))
    return out
