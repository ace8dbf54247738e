"""The MuJoCo robot as a gap case: rigid bodies with contact, a servo's lag, and one change (or none) that is asked for.

What MuJoCo can do itself is done in the physics (tyres, track, servo, its limits, the IMU's mount, a tilted floor); the
sensors' flaws are put into the recorded signals here. Nothing comes from `core` but data types.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from core.robot import Pose
from core.run import Run
from tests.plants.gap_plant import Effects, get
from tests.plants.mujoco_robot import CONTROL, RADIUS, Flaws, Floats, History, Machine, Sensors, mjcf, sense
from tests.plants.mujoco_robot import TRACK as ROBOT_TRACK
from tests.plants.mujoco_worlds import rest, visit

SERVO = 7.0  # N m s/rad: with this robot's inertia a lag of some 6 ms, which run.json does not tell


@dataclass(frozen=True)
class Ride:
    """One drive of the MuJoCo robot."""

    seed: int
    part: int = 0
    seconds: float = 70.0
    effects: Effects = field(default_factory=dict)
    truth: bool = True
    ranges: bool = False


# It turns on the spot and drives straight: what sideways force does, it cannot show.
PHYSICAL = (
    "wheel_radius", "unequal_wheels", "track_width", "motor_lag", "command_delay", "speed_limit", "drive_gain",
    "deadband", "battery_sag", "imu_yaw", "imu_offset", "floor_tilt", "gyro_bias", "gyro_scale", "gyro_drift",
    "gyro_noise", "gyro_clip", "accel_bias", "accel_scale", "missed_ticks", "beacon_delay",
    "beacon_shift", "beacon_rotation", "beacon_scale", "tag_offset", "beacon_noise", "imu_clock", "clock_drift",
)  # fmt: skip


class Robot(Machine):
    """The machine with a stiffer servo, its changed parts, and firmware that spoils the set-points."""

    def __init__(self, ride: Ride, flaws: Flaws, start: Pose) -> None:
        super().__init__(flaws, ride.seconds, start=start)
        e = ride.effects
        text = mjcf(flaws).replace('kv="1.5" forcerange="-3 3"', f'kv="{_servo(e):.4f}" forcerange="-40 40"')
        text = text.replace('pos="0.05 -0.02 0"', f'pos="{0.05 + get(e, "imu_offset", "x", 0.0)} '
                            f'{-0.02 + get(e, "imu_offset", "y", 0.0)} 0"')  # fmt: skip
        text = text.replace('damping="0.01"', 'damping="0"').replace('solref="0.01 1"', 'solref="0.004 1"')
        scale = get(e, "wheel_radius", "scale", 1.0)
        if scale != 1.0:  # the caster as well, or the IMU would be tilted
            text = text.replace('pos="-0.17 0 -0.03"', f'pos="-0.17 0 {-0.03 - RADIUS * (scale - 1.0)}"')
            for side in (RADIUS * (1 - flaws.inequality / 2), RADIUS * (1 + flaws.inequality / 2)):
                text = text.replace(f'size="{side} 0.02 {side}"', f'size="{side * scale} 0.02 {side * scale}"')
        self.model = mujoco.MjModel.from_xml_string(text)
        g = 9.81
        sx, sy = get(e, "floor_tilt", "slope_x", 0.0), get(e, "floor_tilt", "slope_y", 0.0)
        self.model.opt.gravity[:] = (-g * sx, -g * sy, -g)
        self.data = mujoco.MjData(self.model)
        self.data.qpos[:7] = (
            start.x,
            start.y,
            RADIUS * scale,
            math.cos(start.theta / 2),
            0,
            0,
            math.sin(start.theta / 2),
        )
        for _ in range(200):
            mujoco.mj_step(self.model, self.data)
        self.data.time = 0.0
        self.effects = e
        self.late = [np.zeros(2)] * round(get(e, "command_delay", "delay", 0.0) / 0.002)

    def go(self, v: float, w: float, accel: float = 0.6, turn_accel: float = 2.5) -> None:
        """As the machine's, with what the drive does to each rim's set-point."""
        e, track = self.effects, 0.32
        _, v0, w0 = self.commands[-1]
        v1 = v0 + min(max(v - v0, -accel * CONTROL), accel * CONTROL)
        w1 = w0 + min(max(w - w0, -turn_accel * CONTROL), turn_accel * CONTROL)
        count = min(round(CONTROL / 0.002), self.steps - self.done)
        share = (np.arange(count) + 1) * 0.002 / CONTROL
        speed, turn = v0 + share * (v1 - v0), w0 + share * (w1 - w0)
        rims = np.column_stack((speed - turn * track / 2, speed + turn * track / 2))
        rims[np.abs(rims) < get(e, "deadband", "width", 0.0)] = 0.0
        rims *= get(e, "drive_gain", "gain", 1.0) * math.exp(-get(e, "battery_sag", "rate", 0.0) * self.time)
        top = get(e, "speed_limit", "v_max", math.inf)
        rims = np.clip(rims, -top, top) / RADIUS
        for i, pair in enumerate(rims):
            if self.late:
                self.late.append(pair)
                pair = self.late.pop(0)
            self.data.ctrl[:] = pair
            mujoco.mj_step(self.model, self.data)
            self.record[self.done + i] = self.data.sensordata
        self.done += count
        self.commands.append((self.time, v1, w1))


def _servo(e: Effects) -> float:
    """Gain of the servo: a lag asked for comes on top of its own."""
    lag = get(e, "motor_lag", "tau", 0.0)
    own = 0.0415 / SERVO
    return 0.0415 / max(lag, own)


def leaning(effects: Effects, seed: int) -> Effects:
    """The effects with what the physics adds: on unequal tyres the robot leans, and its accelerometer with it; the
    bias of that is on top of the little that this robot's accelerometer has anyway."""
    if "unequal_wheels" not in effects:
        return effects
    lean = RADIUS * (get(effects, "unequal_wheels", "ratio", 1.0) - 1.0) / ROBOT_TRACK
    bias, own = -9.81 * lean, 1e-3 * trifles(seed)[4:6]
    return effects if abs(bias) < 0.002 else {**effects, "accel_bias": {"x": own[0], "y": bias + own[1]}}


def trifles(seed: int) -> Floats:
    """(8,) what this robot has a little of, in units of `ride_run`."""
    return np.random.default_rng([7, seed]).uniform(-1.0, 1.0, 8)


def ride_run(ride: Ride) -> Run:
    """The run that this robot records."""
    rng = np.random.default_rng([6, ride.seed, ride.part])
    e = ride.effects
    small = trifles(ride.seed)
    flaws = Flaws(
        inequality=get(e, "unequal_wheels", "ratio", 1.0 + 4e-4 * small[0]) - 1.0,
        track=get(e, "track_width", "scale", 1.0 + 1e-3 * small[1]) - 1.0,
        gyro_bias=get(e, "gyro_bias", "bias", 5e-5 * small[2]),
        gyro_scale=get(e, "gyro_scale", "scale", 1.0 + 1e-3 * small[3]) - 1.0,
        accel_bias=(get(e, "accel_bias", "x", 1e-3 * small[4]), get(e, "accel_bias", "y", 1e-3 * small[5])),
        mount_yaw=get(e, "imu_yaw", "angle", 4e-3 * small[6]),
    )
    m = Robot(ride, flaws, Pose(0.5, 0.5, float(rng.uniform(-3, 3))))
    rest(m, float(rng.uniform(2, 4)))
    while m.time < ride.seconds - 6.0:
        to = (float(rng.uniform(-1.0, 5.0)), float(rng.uniform(-2.0, 3.0)))
        visit(m, [to], float(rng.uniform(0.2, 0.6)), float(rng.uniform(0, 2)))
    while not m.over:
        m.go(0.0, 0.0)
    h = _spoiled(m.history(), e)
    sensors = Sensors(wild_share=0.0, ranges=ride.ranges)
    run = sense(h, f"mujoco {ride.seed}.{ride.part}", rng, flaws, sensors)
    run = _flawed(run, h, e, sensors, rng)
    return run if ride.truth else replace(run, truth=None)


def _spoiled(h: History, e: Effects) -> History:
    """The physics' signals as the sensors take them."""
    wheels = h.wheels * np.array(
        [1.0 - get(e, "missed_ticks", "left", 0.0), 1.0 - get(e, "missed_ticks", "right", 0.0)]
    )
    accel = h.accel * np.array([get(e, "accel_scale", "x", 1.0), get(e, "accel_scale", "y", 1.0)])
    gyro = h.gyro + get(e, "gyro_g_sensitivity", "k", 0.0) * h.accel[:, 1]
    if "gyro_drift" in e:
        gyro = gyro + get(e, "gyro_drift", "amplitude", 0.0) * (1 - np.exp(-h.t / get(e, "gyro_drift", "tau", 1.0)))
    return replace(h, wheels=wheels, accel=accel, gyro=gyro)


def _flawed(run: Run, h: History, e: Effects, sensors: Sensors, rng: np.random.Generator) -> Run:
    """The recorded streams with clocks, clips and noise of the effects; fixes taken again where they are late."""
    imu, beacon = run.imu, run.beacon
    if imu is not None:
        t = imu.t * (1.0 + get(e, "clock_drift", "skew", 0.0)) + get(e, "imu_clock", "offset", 0.0)
        gz = imu.gz + math.sqrt(max(get(e, "gyro_noise", "factor", 1.0) ** 2 - 1.0, 0.0)) * (
            sensors.gyro_density * math.sqrt(50.0) * rng.standard_normal(len(imu.t))
        )
        limit = get(e, "gyro_clip", "limit", math.inf)
        imu = replace(imu, t=t, gz=np.clip(gz, -limit, limit))
    if beacon is not None:
        beacon = _fixes(beacon, h, e, sensors, rng)
    return replace(run, imu=imu, beacon=beacon)


def _fixes(beacon, h: History, e: Effects, sensors: Sensors, rng: np.random.Generator):
    when = beacon.t - get(e, "beacon_delay", "delay", 0.004)
    x, y, theta = (np.interp(when, h.t, column) for column in h.pose.T)
    tx, ty = 0.08 + get(e, "tag_offset", "x", 0.003), 0.03 + get(e, "tag_offset", "y", -0.002)
    x, y = x + tx * np.cos(theta) - ty * np.sin(theta), y + tx * np.sin(theta) + ty * np.cos(theta)
    angle, scale = get(e, "beacon_rotation", "angle", 5e-4), get(e, "beacon_scale", "scale", 1.0)
    u = scale * (math.cos(angle) * x - math.sin(angle) * y) + get(e, "beacon_shift", "x", 0.002)
    v = scale * (math.sin(angle) * x + math.cos(angle) * y) + get(e, "beacon_shift", "y", 0.001)
    loud = get(e, "beacon_noise", "factor", 1.0)
    noise: Floats = loud * rng.standard_normal((3, len(x)))
    heading = theta + angle + sensors.fix_theta * noise[2]
    return replace(
        beacon,
        x=u + sensors.fix_xy * noise[0],
        y=v + sensors.fix_xy * noise[1],
        theta=np.remainder(heading + np.pi, 2 * np.pi) - np.pi,
    )
