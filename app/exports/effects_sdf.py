"""An effect set as a Gazebo model: true geometry in the links, the IMU's errors in `<noise>`, a nominal diff-drive.

Fixed offsets stand in `<mean>`: Gazebo gives `<bias_mean>` either sign at random. A random walk is a dynamic bias with
a correlation time far beyond any run: its deviation per root of a second is then `dynamic_bias_stddev`.
"""

from __future__ import annotations

import math

from app.exports.effects_base import EffectExport, TrueRobot, Values, accel_sd, gyro_sd, number, opening
from core.robot import EffectSet
from core.run import RunMeta

EXPRESSED = {
    "wheel_radius", "unequal_wheels", "track_width", "drive_gain", "gyro_bias", "gyro_walk", "gyro_noise",
    "accel_bias", "imu_yaw", "imu_offset", "tag_offset", "floor_tilt",
}  # fmt: skip
NEAREST = {
    "speed_limit": "the plugin limits the body's speed, not each rim's: right on straights only",
    "accel_limit": "the plugin limits the body's acceleration, not each rim's: right on straights only",
    "gyro_drift": "the asymptote stands as a fixed offset; take amplitude*exp(-t/tau) off gz while it warms up",
    "wheel_slip": "a WheelSlip compliance k*g, right at 1 m/s with all weight on the driven wheels",
}
WALK_TAU = 1e6  # s
GRAVITY = 9.80665  # m/s^2
WIDTH, MASS = 0.03, 8.0  # m, kg: of wheels and body, of no matter to the effects


def effects_sdf(meta: RunMeta, effects: EffectSet, *, rate: float = 100.0) -> EffectExport:
    """A world file with one robot. `rate`: readings of the IMU per second. Raises ParameterError."""
    values, robot, lists, comment = opening(meta, effects, EXPRESSED, NEAREST)
    text = "\n".join(
        [
            '<?xml version="1.0"?>',
            f"<!-- Effects of a robot; SI units.\n{comment}\n-->",
            '<sdf version="1.10">',
            '<world name="driftscope">',
            f"  <gravity>{_gravity(values)}</gravity>",
            *_ground(),
            '  <model name="robot">',
            *_links(robot, _imu(meta, values, robot, rate)),
            *_plugins(values, robot),
            "  </model>",
            "</world>",
            "</sdf>",
            "",
        ]
    )
    return EffectExport("robot.sdf", "application/xml", text, **lists)


def _gravity(values: Values) -> str:
    """A floor that rises by the slopes reads in the body like gravity turned against them."""
    x, y = number(values, "floor_tilt", "slope_x"), number(values, "floor_tilt", "slope_y")
    return f"{-GRAVITY * x:.9g} {-GRAVITY * y:.9g} {-GRAVITY:.9g}"


def _ground() -> list[str]:
    plane = "<plane><normal>0 0 1</normal></plane>"
    return [
        '  <model name="floor"><static>true</static><link name="link">',
        f'    <collision name="floor"><geometry>{plane}</geometry></collision>',
        "  </link></model>",
    ]


def _links(robot: TrueRobot, imu: list[str]) -> list[str]:
    height = (robot.left + robot.right) / 2
    casters = [
        f'      <collision name="caster_{name}"><pose>{x:.9g} 0 {0.05 - height:.9g} 0 0 0</pose>'
        "<geometry><sphere><radius>0.05</radius></sphere></geometry>"
        "<surface><friction><ode><mu>0</mu><mu2>0</mu2></ode></friction></surface></collision>"
        for name, x in (("front", robot.true_track * 0.6), ("rear", -robot.true_track * 0.6))
    ]
    x, y, z = robot.tag
    return [
        '    <link name="base_link">',
        f"      <pose>0 0 {height:.9g} 0 0 0</pose>",
        f"      {_inertia(MASS, robot.true_track / 2)}",
        *casters,
        *imu,
        "    </link>",
        *_wheel("left", robot.left, robot.true_track / 2),
        *_wheel("right", robot.right, -robot.true_track / 2),
        f'    <frame name="tag" attached_to="base_link"><pose>{x:.9g} {y:.9g} {z - height:.9g} 0 0 0</pose></frame>',
    ]


def _wheel(side: str, radius: float, y: float) -> list[str]:
    shape = f"<cylinder><radius>{radius:.9g}</radius><length>{WIDTH:g}</length></cylinder>"
    return [
        f'    <link name="{side}_wheel">',
        f"      <pose>0 {y:.9g} {radius:.9g} {-math.pi / 2:.9g} 0 0</pose>",
        f"      {_inertia(0.5, radius)}",
        f'      <collision name="tyre"><geometry>{shape}</geometry></collision>',
        "    </link>",
        f'    <joint name="{side}_wheel_joint" type="revolute">',
        f"      <parent>base_link</parent><child>{side}_wheel</child>",
        "      <axis><xyz>0 0 1</xyz></axis>",
        "    </joint>",
    ]


def _inertia(mass: float, size: float) -> str:
    i = mass * size**2 / 2
    diagonal = f"<ixx>{i:.6g}</ixx><iyy>{i:.6g}</iyy><izz>{i:.6g}</izz>"
    return f"<inertial><mass>{mass:g}</mass><inertia>{diagonal}</inertia></inertial>"


def _imu(meta: RunMeta, values: Values, robot: TrueRobot, rate: float) -> list[str]:
    x, y, yaw = robot.imu
    rest = number(values, "gyro_bias", "bias") + number(values, "gyro_drift", "amplitude")
    gyro, accel = gyro_sd(meta, values, rate), accel_sd(meta, rate)
    axes = [
        ("angular_velocity", "z", rest, gyro, number(values, "gyro_walk", "density")),
        ("linear_acceleration", "x", number(values, "accel_bias", "x"), accel, 0.0),
        ("linear_acceleration", "y", number(values, "accel_bias", "y"), accel, 0.0),
    ]
    lines = [
        '      <sensor name="imu" type="imu">',
        f"        <pose>{x:.9g} {y:.9g} 0 0 0 {yaw:.9g}</pose>",
        f"        <always_on>true</always_on><update_rate>{rate:g}</update_rate><imu>",
    ]
    for part in ("angular_velocity", "linear_acceleration"):
        noise = [_noise(axis, mean, sd, walk) for p, axis, mean, sd, walk in axes if p == part]
        lines += [f"          <{part}>", *noise, f"          </{part}>"]
    return [*lines, "        </imu>", "      </sensor>"]


def _noise(axis: str, mean: float, sd: float, walk: float) -> str:
    figures = f"<mean>{mean:.9g}</mean><stddev>{sd:.9g}</stddev>"
    if walk:
        figures += f"<dynamic_bias_stddev>{walk:.9g}</dynamic_bias_stddev>"
        figures += f"<dynamic_bias_correlation_time>{WALK_TAU:g}</dynamic_bias_correlation_time>"
    return f'            <{axis}><noise type="gaussian">{figures}</noise></{axis}>'


def _plugins(values: Values, robot: TrueRobot) -> list[str]:
    """The controller drives with nominal figures; a gain of the drive is a smaller wheel in its belief."""
    limits = []
    for name, effect, parameter in (
        ("linear_velocity", "speed_limit", "v_max"),
        ("linear_acceleration", "accel_limit", "a_max"),
    ):
        limit = number(values, effect, parameter)
        if math.isfinite(limit):
            limits += [f"      <max_{name}>{limit:.9g}</max_{name}>", f"      <min_{name}>{-limit:.9g}</min_{name}>"]
    gain = number(values, "drive_gain", "gain") or 1e-9
    drive = [
        '    <plugin filename="gz-sim-diff-drive-system" name="gz::sim::systems::DiffDrive">',
        "      <left_joint>left_wheel_joint</left_joint><right_joint>right_wheel_joint</right_joint>",
        f"      <wheel_separation>{robot.track:.9g}</wheel_separation>",
        f"      <wheel_radius>{robot.radius / gain:.9g}</wheel_radius>",
        *limits,
        "      <topic>cmd_vel</topic>",
        "    </plugin>",
    ]
    slip = number(values, "wheel_slip", "k") * GRAVITY
    if not slip:
        return drive
    wheels = [
        f'      <wheel link_name="{side}_wheel"><slip_compliance_lateral>0</slip_compliance_lateral>'
        f"<slip_compliance_longitudinal>{slip:.9g}</slip_compliance_longitudinal>"
        f"<wheel_normal_force>{MASS * GRAVITY / 2:.9g}</wheel_normal_force>"
        f"<wheel_radius>{radius:.9g}</wheel_radius></wheel>"
        for side, radius in (("left", robot.left), ("right", robot.right))
    ]
    head = '    <plugin filename="gz-sim-wheel-slip-system" name="gz::sim::systems::WheelSlip">'
    return [*drive, head, *wheels, "    </plugin>"]
