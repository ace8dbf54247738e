"""An effect set as parameters of ros2_control's diff_drive_controller: the controller told how the robot really is.

The multipliers are the controller's own way to say that wheels and track differ from the drawing; with them its
odometry and its wheel commands fit the robot that the diagnosis found.
"""

from __future__ import annotations

import math

from app.exports.effects_base import EffectExport, all_effects, number, remarks, told, true_robot
from app.exports.effects_common import outside
from core.robot import EffectSet
from core.run import RunMeta

EXPRESSED = {"wheel_radius", "unequal_wheels", "track_width"}
NEAREST = {
    "speed_limit": "the controller limits the body's speed and turn rate, not each rim's",
    "accel_limit": "the controller limits the body's accelerations, not each rim's",
}


def effects_ros2_control(meta: RunMeta, effects: EffectSet, *, rate: float = 50.0) -> EffectExport:
    """YAML for the controller manager. `rate`: updates per second. Raises ParameterError."""
    values, on = all_effects(meta, effects)
    robot = true_robot(meta, values)
    lists = told(on, EXPRESSED, NEAREST, outside(EXPRESSED | set(NEAREST)))
    lines = [
        "# Lengths in m, speeds in m/s and rad/s, accelerations in m/s^2 and rad/s^2.",
        *(f"# {line}" for line in remarks(lists)),
        "controller_manager:",
        "  ros__parameters:",
        f"    update_rate: {round(rate)}",
        "    diff_drive_controller:",
        "      type: diff_drive_controller/DiffDriveController",
        "diff_drive_controller:",
        "  ros__parameters:",
        "    left_wheel_names: [left_wheel_joint]",
        "    right_wheel_names: [right_wheel_joint]",
        f"    wheel_separation: {robot.track:.9g}",
        f"    wheel_separation_multiplier: {robot.true_track / robot.track:.9g}",
        f"    wheel_radius: {robot.radius:.9g}",
        f"    left_wheel_radius_multiplier: {robot.left / robot.radius:.9g}",
        f"    right_wheel_radius_multiplier: {robot.right / robot.radius:.9g}",
        *_limits("velocity", number(values, "speed_limit", "v_max"), robot.true_track),
        *_limits("acceleration", number(values, "accel_limit", "a_max"), robot.true_track),
    ]
    return EffectExport("diff_drive_controller.yaml", "application/yaml", "\n".join([*lines, ""]), **lists)


def _limits(what: str, rim: float, track: float) -> list[str]:
    """Straight on the body is as fast as the rims; on the spot it turns with both rims at their limit."""
    if not math.isfinite(rim):
        return []
    pairs = (("linear.x", rim), ("angular.z", 2.0 * rim / track))
    lines = []
    for axis, limit in pairs:
        lines += [f"    {axis}.max_{what}: {limit:.9g}", f"    {axis}.min_{what}: {-limit:.9g}"]
    return lines
