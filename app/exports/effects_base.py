"""What the exports of an effect set share: the result, the robot as the effects make it, effects that are on."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from app.exports.effects_common import outside
from core.effects import active, check_effects, complete
from core.errors import ParameterError
from core.robot import EffectSet
from core.run import RunMeta


@dataclass(frozen=True)
class EffectExport:
    """An effect set in another program's language.

    expressed: effects that the text models as they are. nearest: effects that it models only roughly, and how.
    missing: effects that the target cannot express, each with the nearest thing to do instead.
    """

    file_name: str
    media_type: str
    text: str
    expressed: tuple[str, ...] = ()
    nearest: Mapping[str, str] = field(default_factory=dict)
    missing: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class TrueRobot:
    """Nominal and true geometry [m]: what the controller believes, and how the robot is built with the effects."""

    radius: float
    track: float
    left: float
    right: float
    true_track: float
    imu: tuple[float, float, float]  # x, y [m], yaw [rad] in the body
    tag: tuple[float, float, float]  # m, in the body


Values = Mapping[str, Mapping[str, float | str]]


def all_effects(meta: RunMeta, effects: EffectSet) -> tuple[Values, tuple[str, ...]]:
    """Those that the run's simulator models and `effects` on top: all parameters, and the ids that do something."""
    check_effects(effects)
    joined = {**meta.effects, **effects}
    return complete(joined), active(joined)


def number(values: Values, effect: str, parameter: str) -> float:
    """A parameter that is a number."""
    return float(values[effect][parameter])


def true_robot(meta: RunMeta, values: Values) -> TrueRobot:
    """Raises ParameterError where the run does not say the wheels' radius and track."""
    robot = meta.robot
    if not robot.wheel_radius or not robot.track_width:
        raise ParameterError(
            "the export needs the robot's wheel_radius and track_width, which this run does not state",
            parameter="robot",
            expected=["wheel_radius", "track_width"],
            found=None,
        )
    mean, ratio = (
        robot.wheel_radius * number(values, "wheel_radius", "scale"),
        number(values, "unequal_wheels", "ratio"),
    )
    offset, tag = values["imu_offset"], values["tag_offset"]
    yaw = robot.imu.yaw + number(values, "imu_yaw", "angle")
    return TrueRobot(
        radius=robot.wheel_radius,
        track=robot.track_width,
        left=2.0 * mean / (1.0 + ratio),
        right=2.0 * mean * ratio / (1.0 + ratio),
        true_track=robot.track_width * number(values, "track_width", "scale"),
        imu=(robot.imu.x + float(offset["x"]), robot.imu.y + float(offset["y"]), yaw),
        tag=(robot.tag.x + float(tag["x"]), robot.tag.y + float(tag["y"]), robot.tag.z),
    )


def gyro_sd(meta: RunMeta, values: Values, rate: float) -> float:
    """White noise of one gyro reading at `rate` [rad/s]; 0 where the data sheet's density is unknown."""
    return (meta.noise.gyro_density or 0.0) * math.sqrt(rate / 2.0) * number(values, "gyro_noise", "factor")


def accel_sd(meta: RunMeta, rate: float) -> float:
    """White noise of one accelerometer reading at `rate` [m/s^2]; 0 where unknown."""
    return (meta.noise.accel_density or 0.0) * math.sqrt(rate / 2.0)


def told(
    on: tuple[str, ...], expressed: set[str], nearest: Mapping[str, str], missing: Mapping[str, str]
) -> dict[str, Any]:
    """The three lists of `EffectExport` for the effects that are on. Every effect of the library stands in one."""
    return {
        "expressed": tuple(e for e in on if e in expressed),
        "nearest": {e: nearest[e] for e in on if e in nearest},
        "missing": {e: missing[e] for e in on if e in missing},
    }


def opening(
    meta: RunMeta, effects: EffectSet, expressed: set[str], nearest: Mapping[str, str]
) -> tuple[Values, TrueRobot, dict[str, Any], str]:
    """What a robot's description begins with: all parameters, its geometry, the three lists, and these as remarks
    for an XML comment. Raises ParameterError."""
    values, on = all_effects(meta, effects)
    lists = told(on, expressed, nearest, outside(expressed | set(nearest)))
    lines = "\n".join(f"  {line.replace('--', '- -').replace('&', 'and')}" for line in remarks(lists))
    return values, true_robot(meta, values), lists, lines


def remarks(export: Mapping[str, Any]) -> list[str]:
    """Plain lines on what the text holds and what not, for a comment at its top."""
    lines = [f"modelled: {', '.join(export['expressed']) or 'none'}"]
    lines += [f"roughly: {e}: {how}" for e, how in export["nearest"].items()]
    lines += [f"not: {e}: {why}" for e, why in export["missing"].items()]
    return lines
