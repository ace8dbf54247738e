"""An effect set in the languages of simulators and controllers that people use. To add a target: a row in TARGETS."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass

from app.exports.effects_base import EffectExport, all_effects
from app.exports.effects_mjcf import effects_mjcf
from app.exports.effects_ros2 import effects_ros2_control
from app.exports.effects_sdf import effects_sdf
from core.errors import ParameterError
from core.robot import EffectSet
from core.run import RunMeta


@dataclass(frozen=True)
class Target:
    """A language to export to."""

    label: str
    what: str
    make: Callable[[RunMeta, EffectSet], EffectExport]


def effects_json(meta: RunMeta, effects: EffectSet) -> EffectExport:
    """`{"effects": ...}` as `driftscope simulate` takes it: the simulator's own and those on top, what is on only."""
    values, on = all_effects(meta, effects)
    told = {e: {name: v for name, v in values[e].items() if not _infinite(v)} for e in on}
    return EffectExport("effects.json", "application/json", json.dumps({"effects": told}, indent=2) + "\n", on)


def _infinite(value: float | str) -> bool:
    return not isinstance(value, str) and math.isinf(value)


TARGETS: dict[str, Target] = {
    "json": Target("JSON", "the effects as driftscope simulate takes them", effects_json),
    "sdf": Target("Gazebo SDF", "a world with the robot, its IMU's noise and a diff-drive plugin", effects_sdf),
    "ros2_control": Target("ros2_control YAML", "parameters of diff_drive_controller", effects_ros2_control),
    "mjcf": Target("MuJoCo MJCF", "a model that MuJoCo loads and drives", effects_mjcf),
}


def export_effects(target: str, meta: RunMeta, effects: EffectSet) -> EffectExport:
    """The effect set in one of TARGETS. Raises ParameterError (target, effects, or a robot without geometry)."""
    if target not in TARGETS:
        raise ParameterError(
            f"there is no export {target!r}", parameter="target", expected=sorted(TARGETS), found=target
        )
    return TARGETS[target].make(meta, effects)
