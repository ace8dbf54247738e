"""Every number that an estimator assumes, in one place: from `run.json` where it says, else the defaults here.

A caller may set any of them by name (`estimate(run, method, {"fix_xy": 0.1})`); what was assumed for want of knowledge
is written into the estimate's notes. Defaults are typical of small indoor robots with a consumer MEMS gyro and are
wide on purpose: a filter that doubts its parameters learns them, one that trusts them wrongly cannot.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass

from core.errors import ParameterError
from core.run import Run

Config = Mapping[str, float | str | bool]


@dataclass(frozen=True)
class Assumptions:
    """One sigma each unless said otherwise; SI and radians."""

    gyro_density: float = 3.5e-4  # rad/s/sqrt(Hz), one-sided: 0.02 deg/s/sqrt(Hz), a plain MEMS gyro
    bias_sd: float = 0.01  # rad/s, gyro bias at switching on
    bias_walk: float = 1e-5  # rad/s/sqrt(s), its random walk
    gyro_scale_sd: float = 0.005  # relative
    quantum: float = 0.01  # rad, one encoder step where ticks_per_rev is unknown
    slip: float = 0.0066  # m/sqrt(m): travelled distance the wheels misread, sd after one metre
    distance_scale_sd: float = 0.008  # relative, of the mean wheel radius
    inequality_sd: float = 0.003  # relative, right radius against left
    track_scale_sd: float = 0.03  # relative, of the effective track width
    side_slip: float = 0.0033  # m/sqrt(m): sideways motion, sd after one metre
    accel: float = 1.0  # m/s/sqrt(s), how fast the forward speed wanders
    turn_accel: float = 2.0  # rad/s/sqrt(s), how fast the turn rate wanders, where there is no gyro
    memory: float = 2.0  # s, how soon speed and turn rate are forgotten while the wheels are silent
    accel_density: float = 2e-3  # m/s^2/sqrt(Hz), one-sided
    accel_noise: float = 0.1  # m/s/sqrt(s), what the accelerometer's speed gathers: noise, vibration, bumps
    accel_bias_sd: float = 0.1  # m/s^2, accelerometer bias and tilt of the floor
    tilt_walk: float = 0.02  # m/s^2/sqrt(s), how fast that changes
    coast: float = 1.5  # s for which the accelerometer alone carries the speed
    pause_rate: float = 0.3  # rad/sqrt(s), turning while the gyro pauses
    top_speed: float = 10.0  # m/s, hard bound: a wheel reading beyond it is a jump of the counter
    fix_xy: float = 0.05  # m
    fix_theta: float = 0.05  # rad
    range: float = 0.2  # m
    range_scale_sd: float = 0.03  # relative, speed of sound or clock
    range_bias_sd: float = 0.2  # m, of all ranges alike
    delay_sd: float = 0.02  # s, of the beacon system
    clock: float = 0.002  # s, of the stamps of IMU or wheels, by which poses are given
    lasting_fix: float = 0.0  # m, error of fixes that lasts
    lasting_range: float = 0.0  # m, error of one beacon's ranges that lasts
    lasting_time: float = 10.0  # s, how long
    skid: float = 0.0  # m, by which a skid-steered robot turns about another place than its axle's midpoint
    slide: float = 0.04  # m/sqrt(s), how far a robot slides while its wheels slip
    carried: float = 0.7  # m/sqrt(s), how far something else moves the robot
    carried_turn: float = 0.02  # rad/sqrt(s), and how far it turns it unseen by the gyro
    stubborn: float = 60.0  # s for which fixes that leapt without a reason are not believed
    leap: float = 3.0  # m/s: a robot does not move faster than that without its wheels
    parameter_walk: float = 2e-5  # 1/sqrt(s), how fast scales wander
    start_xy: float = 0.01  # m, of a start pose given in run.json
    start_theta: float = 0.01  # rad
    gate: float = 0.999  # probability that a sound reading passes its chi-square gate
    reaccept: float = 10  # rejections of one sensor in a row, after which the filter doubts itself
    rest_time: float = 0.5  # s that wheels must stand still for the robot to be at rest
    rest_rate: float = 0.1  # rad/s, largest gyro bias: a faster reading is a turn
    event_false_alarms: float = 1.0  # per hour and kind: slips, blows and the like that did not happen


FIELDS: dict[str, dataclasses.Field[float]] = {f.name: f for f in dataclasses.fields(Assumptions)}

_FROM_RUN = {
    "gyro_density": "gyro_density",
    "accel_density": "accel_density",
    "fix_xy": "beacon_xy",
    "fix_theta": "beacon_theta",
    "range": "range",
}
_WORDS = {
    "gyro_density": "gyro noise density {:.2g} rad/s/√Hz",
    "fix_xy": "fix noise {:.2g} m",
    "fix_theta": "fix heading noise {:.2g} rad",
    "range": "range noise {:.2g} m",
}
_STREAM = {"gyro_density": "imu", "fix_xy": "beacon", "fix_theta": "beacon", "range": "ranges"}


def assume(run: Run, config: Config | None = None) -> tuple[Assumptions, tuple[str, ...]]:
    """The numbers for this run, and notes on those that neither the run nor the caller gave.

    Raises ParameterError for an unknown name or a value that is not a finite, non-negative number.
    """
    given = {name: _checked(name, value) for name, value in (config or {}).items()}
    values = {}
    notes = []
    for name, key in _FROM_RUN.items():
        sheet = getattr(run.meta.noise, key)
        if name in given:
            continue
        if sheet is not None and sheet > 0:
            values[name] = float(sheet)
        elif name not in _WORDS or (name == "fix_theta" and _headless(run)):
            continue
        elif getattr(run, _STREAM[name]) is not None:
            notes.append(f"Assumed, as run.json is silent: {_WORDS[name].format(FIELDS[name].default)}.")
    return Assumptions(**{**values, **given}), tuple(notes)


def _headless(run: Run) -> bool:
    return run.beacon is None or run.beacon.theta is None


def _checked(name: str, value: object) -> float:
    if name not in FIELDS:
        raise ParameterError(f"unknown option {name!r}", parameter=name, expected=tuple(FIELDS), found=name)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value) or value < 0:
        raise ParameterError(
            f"option {name} is {value!r}, expected a number >= 0", parameter=name, expected="number >= 0", found=value
        )
    return float(value)


def encoder_quantum(run: Run, numbers: Assumptions) -> float:
    """One encoder step [rad]."""
    ticks = run.meta.robot.ticks_per_rev
    return 2 * math.pi / ticks if ticks else numbers.quantum
