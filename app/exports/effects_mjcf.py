"""An effect set as a MuJoCo model (MJCF): a diff-drive robot that drives as the effects say.

Controls are the wheels' set-points [rad/s], nominal: left (v - w*b/2)/r, right (v + w*b/2)/r. A stiff servo holds each
wheel's speed; the drive's lag is a filter before it, its delay the actuator's, its gain the servo's.
"""

from __future__ import annotations

import math

from app.exports.effects_base import EffectExport, TrueRobot, Values, accel_sd, gyro_sd, number, opening
from core.robot import EffectSet
from core.run import RunMeta

EXPRESSED = {
    "command_delay", "motor_lag", "drive_gain", "speed_limit", "wheel_radius", "unequal_wheels", "track_width",
    "floor_tilt", "gyro_clip", "imu_yaw", "imu_offset", "tag_offset", "beacon_delay",
}  # fmt: skip
NEAREST = {
    "accel_limit": "each wheel's torque is limited to what gives this acceleration on a straight",
    "deadband": "dry friction that a set-point of the width just overcomes; faster set-points lose that width",
    "slip_patch": "a disc of lower friction lies on the floor; by how much tyres slide there is the contact's affair",
    "gyro_noise": "in the sensor's noise attribute, which MuJoCo keeps but does not add to the reading: add it there",
    "anchor_moved": "the beacon's site stands where it really is; ranges to it are yours to compute",
}
GRAVITY, STEP = 9.80665, 0.001  # m/s^2, s
MASS = 8.0  # kg


def effects_mjcf(meta: RunMeta, effects: EffectSet, *, rate: float = 100.0) -> EffectExport:
    """A model file that MuJoCo loads. `rate`: readings of the IMU per second. Raises ParameterError."""
    values, robot, lists, comment = opening(meta, effects, EXPRESSED, NEAREST)
    text = "\n".join(
        [
            '<mujoco model="robot">',
            f"  <!-- SI units. Controls: set-points of the wheels, rad/s.\n{comment}\n  -->",
            '  <compiler angle="radian" autolimits="true"/>',
            f'  <option timestep="{STEP:g}" integrator="Euler" cone="elliptic" impratio="20" '
            f'gravity="{_gravity(values)}"/>',
            "  <worldbody>",
            *_floor(meta, values),
            *_body(meta, values, robot),
            "  </worldbody>",
            *_drive(values, robot),
            *_sensors(meta, values, rate),
            "</mujoco>",
            "",
        ]
    )
    return EffectExport("robot.xml", "application/xml", text, **lists)


def _gravity(values: Values) -> str:
    x, y = number(values, "floor_tilt", "slope_x"), number(values, "floor_tilt", "slope_y")
    return f"{-GRAVITY * x:.9g} {-GRAVITY * y:.9g} {-GRAVITY:.9g}"


def _floor(meta: RunMeta, values: Values) -> list[str]:
    lines = ['    <geom name="floor" type="plane" size="0 0 1" friction="1 0.005 0.0001"/>']
    patch = values["slip_patch"]
    if float(patch["slip"]) and float(patch["radius"]):
        size = f"{float(patch['radius']):.9g} 0.0005"
        place = f"{float(patch['x']):.9g} {float(patch['y']):.9g} -0.0004"
        lines.append(
            f'    <geom name="slip_patch" type="cylinder" size="{size}" pos="{place}" friction="0.05" priority="1"/>'
        )
    moved = values["anchor_moved"]
    for name, (x, y, z) in meta.beacons.items():
        if name == moved["beacon"]:
            x, y = x + float(moved["x"]), y + float(moved["y"])
        lines.append(f'    <site name="beacon_{_name(name)}" pos="{x:.9g} {y:.9g} {z:.9g}" size="0.05"/>')
    return lines


def _body(meta: RunMeta, values: Values, robot: TrueRobot) -> list[str]:
    start, height, half = meta.start, (robot.left + robot.right) / 2, robot.true_track / 2
    x, y, theta = (start.x, start.y, start.theta) if start else (0.0, 0.0, 0.0)
    low = 0.02 - height
    imu, tag = robot.imu, robot.tag
    friction = _dry_friction(values, robot)
    return [
        f'    <body name="base" pos="{x:.9g} {y:.9g} {height:.9g}" euler="0 0 {theta:.9g}">',
        '      <freejoint name="base"/>',
        f'      <geom name="base" type="box" size="{half * 0.9:.9g} {half * 0.7:.9g} 0.03" mass="{MASS:g}" '
        'contype="0" conaffinity="0"/>',
        *(
            f'      <geom name="caster_{n}" type="sphere" size="0.02" pos="{at:.9g} 0 {low:.9g}" mass="0.05" '
            'friction="0" condim="1" priority="2"/>'
            for n, at in (("front", half), ("rear", -half))
        ),
        f'      <site name="imu" pos="{imu[0]:.9g} {imu[1]:.9g} 0" euler="0 0 {imu[2]:.9g}"/>',
        f'      <site name="tag" pos="{tag[0]:.9g} {tag[1]:.9g} {tag[2] - height:.9g}"/>',
        *_wheel("left", robot.left, half, robot.left - height, friction),
        *_wheel("right", robot.right, -half, robot.right - height, friction),
        "    </body>",
    ]


def _wheel(side: str, radius: float, y: float, z: float, friction: float) -> list[str]:
    # an ellipsoid touches the floor in one point, so that the track is exactly what is said
    return [
        f'      <body name="{side}_wheel" pos="0 {y:.9g} {z:.9g}">',
        f'        <joint name="{side}_wheel" axis="0 1 0" armature="{_armature(radius):.9g}" '
        f'damping="0" frictionloss="{friction:.9g}"/>',
        f'        <geom name="{side}_wheel" type="ellipsoid" size="{radius:.9g} 0.01 {radius:.9g}" mass="0.3"/>',
        "      </body>",
    ]


def _armature(radius: float) -> float:
    """The rotor's inertia seen at the wheel: that of half the robot at the rim [kg m^2].

    With a lighter one the servo is stiff within a step, and MuJoCo lets the tyres slip whenever the robot speeds up.
    """
    return 0.5 * MASS * radius**2


def _inertia(radius: float) -> float:
    """What one wheel has to speed up on a straight: rotor and half the robot [kg m^2]."""
    return _armature(radius) + 0.5 * MASS * radius**2


def _servo(radius: float) -> float:
    """Torque per rad/s of error: 3 ms to reach the set-point, small beside any lag that matters [N m s]."""
    return _inertia(radius) / 0.003


def _dry_friction(values: Values, robot: TrueRobot) -> float:
    width = number(values, "deadband", "width")
    return _servo(robot.radius) * width / robot.radius


def _drive(values: Values, robot: TrueRobot) -> list[str]:
    lag, gain = number(values, "motor_lag", "tau"), number(values, "drive_gain", "gain")
    limit, push = number(values, "speed_limit", "v_max"), number(values, "accel_limit", "a_max")
    delay = number(values, "command_delay", "delay")
    kv = _servo(robot.radius)
    extra = f' dyntype="filterexact" dynprm="{lag:.9g}"' if lag else ""
    if math.isfinite(limit):
        top = limit / robot.radius / (gain or 1.0)
        extra += f' ctrlrange="{-top:.9g} {top:.9g}"'
    if math.isfinite(push):
        torque = push / robot.radius * _inertia(robot.radius)
        extra += f' forcerange="{-torque:.9g} {torque:.9g}"'
    extra += _delayed(delay)
    tail = f'gainprm="{kv * gain:.9g}" biastype="affine" biasprm="0 0 {-kv:.9g}"{extra}/>'
    wheels = [f'    <general name="{side}_wheel" joint="{side}_wheel" {tail}' for side in ("left", "right")]
    return ["  <actuator>", *wheels, "  </actuator>"]


def _sensors(meta: RunMeta, values: Values, rate: float) -> list[str]:
    clip, delay = number(values, "gyro_clip", "limit"), number(values, "beacon_delay", "delay")
    cutoff = f' cutoff="{clip:.9g}"' if math.isfinite(clip) else ""
    return [
        "  <sensor>",
        f'    <gyro name="gyro" site="imu" noise="{gyro_sd(meta, values, rate):.9g}"{cutoff}/>',
        f'    <accelerometer name="accelerometer" site="imu" noise="{accel_sd(meta, rate):.9g}"/>',
        '    <jointpos name="left" joint="left_wheel"/>',
        '    <jointpos name="right" joint="right_wheel"/>',
        f'    <framepos name="fix" objtype="site" objname="tag"{_delayed(delay)}/>',
        '    <framepos name="truth" objtype="xbody" objname="base"/>',
        '    <framequat name="heading" objtype="xbody" objname="base"/>',
        "  </sensor>",
    ]


def _delayed(delay: float) -> str:
    return f' delay="{delay:.9g}" nsample="{math.ceil(delay / STEP) + 2}"' if delay else ""


def _name(text: str) -> str:
    return "".join(c if c.isalnum() or c in "_.-" else "_" for c in text)
