"""An effect in people's words: how robot and simulator differ, and its parameters with units as people read them."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Mapping
from typing import Any

from app.figures.units import angle, bias, length, significant
from core.effects import EFFECTS

Parameters = Mapping[str, Mapping[str, Any]]  # gap/1: {name: {"value", "std"}}


def label(effect: str) -> str:
    """`track width`; an effect that the table no longer has by its id."""
    return EFFECTS[effect].label if effect in EFFECTS else effect.replace("_", " ")


def percent(share: float, digits: int = 2) -> str:
    """2.1 %, at most `digits` significant digits, whole from 10 on."""
    value = 100.0 * share
    if abs(value) >= 9.95:
        return f"{value:.0f} %".replace("-", "−")
    return f"{significant(value, digits)} %"


def share(value: float | None) -> str:
    """A part of a whole; what is next to nothing is told so."""
    if not value:
        return "0 %"
    return "< 0.1 %" if 0.0 < value < 0.001 else percent(value)


def number_as_set(value: float, std: float | None) -> str:
    """A parameter to type in: as many digits as its deviation leaves meaning, and no thousands apart."""
    if not math.isfinite(value):
        return "inf" if value > 0 else "-inf"
    if std and math.isfinite(std) and value:
        digits = max(1, math.floor(math.log10(abs(value))) - math.floor(math.log10(std)) + 1)
        return f"{float(f'{value:.{min(digits, 9)}g}'):.9g}"  # 50, not 5e+01
    return f"{value:.4g}"


def as_set(effect: str, parameters: Parameters) -> str:
    """`track_width: 1.021`, or with several parameters `slip_patch: x 4.6, y 2, radius 0.7, slip 0.25`."""
    told = {name: _plain(entry) for name, entry in parameters.items()}
    if len(told) == 1:
        return f"{effect}: {next(iter(told.values()))}"
    return f"{effect}: {', '.join(f'{name} {value}' for name, value in told.items())}"


def _plain(entry: Mapping[str, Any]) -> str:
    value = entry.get("value")
    if value is None:
        return "inf"
    return value if isinstance(value, str) else number_as_set(float(value), entry.get("std"))


def difference(effect: str, parameters: Parameters) -> str:
    """How robot and simulator differ, a whole sentence; for an effect without words its label."""
    values = {name: entry.get("value") for name, entry in parameters.items()}
    words = WORDS.get(effect)
    if words is not None and None not in values.values():
        with contextlib.suppress(KeyError):  # stored by a version whose effect had other parameters
            return words(values)
    return f"The robot shows {label(effect)} that the simulator lacks."


def _scale(value: float) -> str:
    """`2.1 % more` for 1.021."""
    return f"{percent(abs(value - 1.0))} {'more' if value > 1.0 else 'less'}"


def _signed(value: float, form: Callable[[float], str], plus: str, minus: str) -> str:
    return f"{form(abs(value))} {plus if value > 0 else minus}"


def _ms(seconds: float) -> str:
    return f"{significant(1000.0 * seconds, 2)} ms" if abs(seconds) < 1.0 else f"{significant(seconds)} s"


def _speed(value: float) -> str:
    return f"{significant(value)} m/s" if abs(value) >= 0.1 else f"{significant(100.0 * value, 2)} cm/s"


def _where(v: Mapping[str, Any]) -> str:
    return f"x {significant(v['x'], 3)} m, y {significant(v['y'], 3)} m"


def _reach(v: Mapping[str, Any]) -> str:
    return length(math.hypot(v["x"], v["y"]))


def _missed(v: Mapping[str, Any]) -> str:
    told = [f"{percent(abs(part))} {'of its ticks' if part >= 0 else 'too many'}" for part in (v["left"], v["right"])]
    verbs = ["misses" if part >= 0 else "counts" for part in (v["left"], v["right"])]
    return f"The left encoder {verbs[0]} {told[0]}, the right one {verbs[1]} {told[1]}."


def _bump(v: Mapping[str, Any]) -> str:
    return (
        f"Something pushed the robot at {significant(v['time'])} s, by {length(v['distance'])} and {angle(v['turn'])}."
    )


def _acceleration(v: Mapping[str, Any]) -> str:
    return f"{significant(math.hypot(v['x'], v['y']), 2)} m/s²"


WORDS: dict[str, Callable[[Mapping[str, Any]], str]] = {
    "command_delay": lambda v: f"The robot acts on commands {_ms(v['delay'])} later than your simulator.",
    "motor_lag": lambda v: f"The robot's wheels follow their commands with {_ms(v['tau'])} more lag.",
    "speed_limit": lambda v: f"The robot's wheels go no faster than {_speed(v['v_max'])}.",
    "accel_limit": lambda v: f"The robot's wheels speed up no faster than {significant(v['a_max'])} m/s².",
    "deadband": lambda v: f"The robot's wheels stand still below {_speed(v['width'])}.",
    "drive_gain": lambda v: f"The robot's wheels turn {_scale(v['gain'])} than they are told.",
    "battery_sag": lambda v: "The robot slows down as its battery sags, by "
    f"{percent(-math.expm1(-60 * v['rate']))} a minute.",
    "wheel_radius": lambda v: f"Your simulator drives {percent(abs(1 / v['scale'] - 1))} "
    f"{'less far' if v['scale'] > 1 else 'farther'} than the robot.",
    "unequal_wheels": lambda v: f"The robot pulls to the {'left' if v['ratio'] > 1 else 'right'}: its "
    f"{'right' if v['ratio'] > 1 else 'left'} wheel is {percent(abs(max(v['ratio'], 1 / v['ratio']) - 1))} larger.",
    "track_width": lambda v: f"Your simulator turns {_scale(v['scale'])} than the robot.",
    "wheel_slip": lambda v: "The robot's wheels slip when it speeds up and brakes"
    f" ({percent(v['k'])} at 1 m/s²).",
    "side_slip": lambda v: f"The robot slides {'outwards' if v['k'] > 0 else 'inwards'} in turns.",
    "slip_patch": lambda v: f"The robot's wheels lose {percent(v['slip'])} of their way in a patch of "
    f"{length(v['radius'])} around {_where(v)}.",
    "bump": _bump,
    "floor_tilt": lambda v: f"The floor is tilted by {angle(math.atan(math.hypot(v['slope_x'], v['slope_y'])))}.",
    "gyro_bias": lambda v: f"The robot's gyro reads {_signed(v['bias'], bias, 'too much', 'too little')}.",
    "gyro_drift": lambda v: f"The robot's gyro drifts by {bias(v['amplitude'])} as it warms up.",
    "gyro_walk": lambda v: "The robot's gyro bias wanders.",
    "gyro_temperature": lambda v: f"The robot's gyro bias changes by {bias(v['slope'])} per kelvin.",
    "gyro_scale": lambda v: f"The robot's gyro reads {_scale(v['scale'])} than it turns.",
    "gyro_noise": lambda v: f"The robot's gyro is {significant(v['factor'], 2)} times as noisy as stated.",
    "gyro_clip": lambda v: f"The robot's gyro reads no more than {angle(v['limit'])}/s.",
    "gyro_g_sensitivity": lambda v: "The robot's gyro feels sideways acceleration.",
    "accel_bias": lambda v: f"The robot's accelerometer is off by {_acceleration(v)}.",
    "accel_scale": lambda v: f"The robot's accelerometer reads {_scale(v['x'])} along x and {_scale(v['y'])} along y.",
    "imu_yaw": lambda v: f"The robot's IMU is mounted {angle(abs(v['angle']))} askew.",
    "imu_offset": lambda v: f"The robot's IMU sits {_reach(v)} from where it is said to.",
    "vibration": lambda v: "The robot shakes its accelerometer as it drives.",
    "missed_ticks": _missed,
    "beacon_delay": lambda v: f"Fixes and ranges come {_ms(v['delay'])} late.",
    "beacon_shift": lambda v: f"The beacons' map is shifted by {_reach(v)}.",
    "beacon_rotation": lambda v: f"The beacons' map is turned by {angle(v['angle'])}.",
    "beacon_scale": lambda v: f"Fixes and ranges are {_scale(v['scale'])} than true.",
    "tag_offset": lambda v: f"The robot's tag sits {_reach(v)} from where it is said to.",
    "beacon_noise": lambda v: f"Fixes and ranges are {significant(v['factor'], 2)} times as noisy as stated.",
    "beacon_outliers": lambda v: f"{percent(v['rate'])} of fixes and ranges are off by {length(v['size'])} or so.",
    "beacon_shadow": lambda v: f"No fix comes within {length(v['radius'])} of {_where(v)}.",
    "anchor_moved": lambda v: f"Beacon {v['beacon']} stands {_reach(v)} from its surveyed place.",
    "range_bias": lambda v: f"Every range is {_signed(v['bias'], length, 'too long', 'too short')}.",
    "imu_clock": lambda v: f"The IMU's stamps are {_signed(v['offset'], _ms, 'late', 'early')}.",
    "clock_drift": lambda v: "The IMU's clock runs "
    f"{_signed(v['skew'] * 1e6, lambda x: f'{significant(x, 2)} ppm', 'fast', 'slow')}.",
}  # fmt: skip
"""By effect, from its values: what differs, seen from robot or simulator, whichever is plainer."""


def quantity(value: float | str | None, unit: str, digits: int = 3, hourly: bool = True) -> str:
    """A parameter's value as people read it, in `digits` significant digits; slow turning `hourly`, as a bias is."""
    if value is None or isinstance(value, str):
        return value or "no limit"
    factor, shown = edge(unit)
    if hourly and unit == "rad/s" and 0 < abs(value) < math.radians(1.0):
        factor, shown = factor * 3600.0, "°/h"
    elif steps := [step for step in SMALL.get(unit, ()) if 0 < abs(value) < step[0]]:
        _, factor, shown = steps[-1]
    gap = "" if shown in ("", "°") else " "
    return f"{significant(factor * value, digits)}{gap}{shown}"


SMALL = {
    "m": ((0.1, 100.0, "cm"), (0.001, 1000.0, "mm")),
    "s": ((1.0, 1000.0, "ms"),),
    "m/s": ((0.1, 100.0, "cm/s"), (0.001, 1000.0, "mm/s")),
}
"""Below which sizes other units read better, the smallest last."""


def edge(unit: str) -> tuple[float, str]:
    """The factor to the unit that people read: degrees for radians."""
    if unit.startswith("rad"):
        return math.degrees(1.0), "°" + unit.removeprefix("rad")
    return 1.0, unit


def digits_of(value: float, std: float | None) -> int:
    """Significant digits so that the deviation shows in its first."""
    if not std or not value or not math.isfinite(std) or not math.isfinite(value):
        return 3
    return min(max(math.floor(math.log10(abs(value))) - math.floor(math.log10(std)) + 1, 2), 7)
