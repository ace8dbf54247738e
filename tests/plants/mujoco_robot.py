"""A differential-drive robot in MuJoCo: a plant that shares nothing with the product's own simulator.

Rigid bodies with contact: two servo-driven tyres, a caster, an IMU on the body. The physics is sampled at its own step;
an IMU reading is the mean over its period, its stamp the period's middle. Sensors add noise, quantisation and lies.
`core` is used for its data types only. Worlds to drive in: `mujoco_worlds.py`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import mujoco
import numpy as np
import numpy.typing as npt

from core.robot import ImuMount, Noise, Pose, RobotParams, TagMount
from core.run import Run, RunMeta
from core.sensors import BeaconLog, CommandLog, ImuLog, RangeLog, TruthLog, WheelLog

Floats = npt.NDArray[np.float64]

STEP = 0.002  # s, of the physics
CONTROL = 0.05  # s, between commands
IMU_STEPS, WHEEL_STEPS, TRUTH_STEPS, FIX_STEPS = 5, 10, 5, 50

RADIUS, TRACK, TICKS = 0.075, 0.32, 2048
ROBOT = RobotParams(
    wheel_radius=RADIUS,
    track_width=TRACK,
    ticks_per_rev=TICKS,
    imu=ImuMount(0.05, -0.02),
    tag=TagMount(0.08, 0.03, 0.4),
)
BEACONS = {"B1": (-2.0, -3.0, 2.5), "B2": (6.0, -3.0, 2.2), "B3": (6.0, 4.0, 2.5), "B4": (-2.0, 4.0, 2.3)}


@dataclass(frozen=True)
class Flaws:
    """What the run's description does not say of the robot."""

    inequality: float = 0.003  # right tyre over left, minus one
    track: float = 0.008  # real track over nominal, minus one
    gyro_bias: float = 4e-3  # rad/s
    gyro_scale: float = 0.005  # reading over rate, minus one
    accel_bias: tuple[float, float] = (0.04, -0.04)  # m/s^2
    mount_yaw: float = 0.010  # rad

    @staticmethod
    def of(rng: np.random.Generator) -> Flaws:
        """The sizes above with signs by chance."""
        a, b, c, d, e, f, g = rng.choice((-1.0, 1.0), 7)
        return Flaws(0.003 * a, 0.008 * b, 4e-3 * c, 0.005 * d, (0.04 * e, 0.04 * f), 0.010 * g)


@dataclass(frozen=True)
class Sensors:
    """Noise as in data sheets (densities one-sided), what there is, and the share of wild fixes or ranges."""

    gyro_density: float = 1.9e-4
    accel_density: float = 2.0e-3
    fix_xy: float = 0.03
    fix_theta: float = 0.02
    range: float = 0.05
    fixes: bool = True
    headings: bool = True
    ranges: bool = False
    wild_share: float = 0.01
    wild_size: float = 0.4


@dataclass(frozen=True)
class Mark:
    """What really happened: kind (spin, contact, lost, lying, carried), from t0 to t1 [s]."""

    kind: str
    t0: float
    t1: float


@dataclass(frozen=True)
class World:
    """A run, what really happened in it, and the robot's flaws."""

    run: Run
    marks: tuple[Mark, ...]
    flaws: Flaws


@dataclass
class History:
    """Per physics step (n,): t; pose (n, 3) of the axle's midpoint; wheels (n, 2) [rad]; gyro (n,), accel (n, 2);
    spin (n,) largest slip of a tyre [m/s]. Per control step: commands (m, 3) of t, v, w. Marks that missions set."""

    t: Floats
    pose: Floats
    wheels: Floats
    gyro: Floats
    accel: Floats
    spin: Floats
    commands: Floats
    marks: list[Mark] = field(default_factory=list)


def mjcf(flaws: Flaws, scenery: str = "") -> str:
    """The robot, 8 kg, its axle's midpoint over the origin, facing x. Tyres are ellipsoids: one point on the floor."""
    left, right = RADIUS * (1 - flaws.inequality / 2), RADIUS * (1 + flaws.inequality / 2)
    half = TRACK * (1 + flaws.track) / 2
    imu = f'pos="{ROBOT.imu.x} {ROBOT.imu.y} 0" euler="0 0 {flaws.mount_yaw}"'
    return f"""
<mujoco>
  <compiler angle="radian"/>
  <option timestep="{STEP}" integrator="implicitfast" cone="elliptic" impratio="10"/>
  <default><geom solref="0.01 1" friction="0.8 0.005 0.0001"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="20 20 1"/>
    {scenery}
    <body name="hand" mocap="true" pos="0 0 -1"/>
    <body name="base" pos="0 0 {RADIUS}">
      <freejoint name="free"/>
      <geom name="body" type="box" size="0.15 0.12 0.04" pos="-0.05 0 0.03" mass="7"/>
      <geom name="bumper" type="cylinder" size="0.02 0.03" pos="0.12 0 0.01" mass="0.1" friction="0.1" priority="1"/>
      <geom name="caster" type="sphere" size="0.045" pos="-0.17 0 -0.03" mass="0.1" friction="0.02" priority="1"/>
      <site name="axle"/> <site name="imu" {imu}/>
      <body pos="0 {half} 0"><joint name="left" axis="0 1 0" damping="0.01" armature="0.02"/>
        <geom name="left" type="ellipsoid" size="{left} 0.02 {left}" mass="0.4"/></body>
      <body pos="0 {-half} 0"><joint name="right" axis="0 1 0" damping="0.01" armature="0.02"/>
        <geom name="right" type="ellipsoid" size="{right} 0.02 {right}" mass="0.4"/></body>
    </body>
  </worldbody>
  <equality><weld name="grip" body1="hand" body2="base" active="false" solref="0.04 1"/></equality>
  <actuator>
    <velocity joint="left" kv="1.5" forcerange="-3 3"/> <velocity joint="right" kv="1.5" forcerange="-3 3"/>
  </actuator>
  <sensor>
    <gyro site="imu"/> <accelerometer site="imu"/>
    <framepos objtype="site" objname="axle"/> <framexaxis objtype="site" objname="axle"/>
    <framelinvel objtype="site" objname="axle"/> <jointpos joint="left"/> <jointpos joint="right"/>
    <jointvel joint="left"/> <jointvel joint="right"/>
  </sensor>
</mujoco>"""


class Machine:
    """The physics and its record: `go` drives one control step towards a twist, as a robot's firmware would."""

    def __init__(self, flaws: Flaws, seconds: float, scenery: str = "", start: Pose = Pose()) -> None:
        self.model = mujoco.MjModel.from_xml_string(mjcf(flaws, scenery))
        self.data = mujoco.MjData(self.model)
        self.data.qpos[:7] = (start.x, start.y, RADIUS, math.cos(start.theta / 2), 0, 0, math.sin(start.theta / 2))
        for _ in range(200):  # settle on its springs
            mujoco.mj_step(self.model, self.data)
        self.data.time = 0.0
        self.steps = round(seconds / STEP)
        self.record = np.empty((self.steps, self.model.nsensordata))
        self.commands = [(0.0, 0.0, 0.0)]
        self.marks: list[Mark] = []
        self.done = 0

    @property
    def time(self) -> float:
        """Seconds since the start."""
        return self.done * STEP

    @property
    def over(self) -> bool:
        """Whether the record is full."""
        return self.done >= self.steps

    @property
    def pose(self) -> tuple[float, float, float]:
        """x, y, theta of the axle's midpoint, as they are."""
        d = self.data.sensordata
        return float(d[6]), float(d[7]), math.atan2(d[10], d[9])

    def go(self, v: float, w: float, accel: float = 0.6, turn_accel: float = 2.5) -> None:
        """One control step: the command moves towards (v, w) at limited rates, linearly until the step's end."""
        _, v0, w0 = self.commands[-1]
        v1 = v0 + min(max(v - v0, -accel * CONTROL), accel * CONTROL)
        w1 = w0 + min(max(w - w0, -turn_accel * CONTROL), turn_accel * CONTROL)
        count = min(round(CONTROL / STEP), self.steps - self.done)
        share = (np.arange(count) + 1) * STEP / CONTROL
        speed, turn = v0 + share * (v1 - v0), w0 + share * (w1 - w0)
        rims = np.column_stack((speed - turn * TRACK / 2, speed + turn * TRACK / 2)) / RADIUS
        model, data, step = self.model, self.data, mujoco.mj_step
        for i, pair in enumerate(rims):
            data.ctrl[:] = pair
            step(model, data)
            self.record[self.done + i] = data.sensordata
        self.done += count
        self.commands.append((self.time, v1, w1))

    def mark(self, kind: str, t0: float) -> None:
        """Something went on from t0 until now."""
        self.marks.append(Mark(kind, t0, self.time))

    def history(self) -> History:
        """What was recorded so far."""
        r = self.record[: self.done]
        theta = np.unwrap(np.arctan2(r[:, 10], r[:, 9]))
        forward = np.cos(theta) * r[:, 12] + np.sin(theta) * r[:, 13]
        half = r[:, 2] * TRACK / 2
        slips = r[:, 17:19] * RADIUS - np.column_stack((forward - half, forward + half))
        return History(
            t=np.arange(self.done) * STEP,  # MuJoCo's sensors are as of each step's beginning
            pose=np.column_stack((r[:, 6], r[:, 7], theta)),
            wheels=r[:, 15:17] - r[0, 15:17],
            gyro=r[:, 2],
            accel=r[:, 3:5],
            spin=np.abs(slips).max(axis=1),
            commands=np.array(self.commands),
            marks=self.marks,
        )


Lie = Callable[[Floats, Floats, np.random.Generator], tuple[Floats, npt.NDArray[np.bool_]]]
"""(stamps, tag poses (n, 3), rng) -> (poses as the beacons see them, which of them are lost)."""


def sense(
    history: History, name: str, rng: np.random.Generator, flaws: Flaws, sensors: Sensors, lie: Lie | None = None
) -> Run:
    """The run that the robot's sensors recorded."""
    start = history.pose[0]
    commands = history.commands
    fixes = _fixes(history, rng, sensors, lie) if sensors.fixes else None
    return Run(
        RunMeta(
            name=name,
            robot=ROBOT,
            beacons=BEACONS,
            start=Pose(float(start[0]), float(start[1]), float(start[2])),
            noise=Noise(
                sensors.gyro_density,
                sensors.accel_density,
                sensors.fix_xy,
                sensors.fix_theta,
                sensors.range,
                1e-3,
                1e-3,
            ),
        ),
        commands=CommandLog(commands[:, 0].copy(), commands[:, 1].copy(), commands[:, 2].copy()),
        wheels=_wheels(history),
        imu=_imu(history, rng, flaws, sensors),
        beacon=fixes,
        ranges=_ranges(history, rng, sensors, lie) if sensors.ranges else None,
        truth=TruthLog(history.t[::TRUTH_STEPS], *history.pose[::TRUTH_STEPS].T.copy()),
    )


def _wheels(history: History) -> WheelLog:
    tick = 2 * np.pi / TICKS
    left, right = (np.floor(c / tick + 0.5) * tick for c in history.wheels[::WHEEL_STEPS].T)
    return WheelLog(history.t[::WHEEL_STEPS], left, right)


def _imu(history: History, rng: np.random.Generator, flaws: Flaws, sensors: Sensors) -> ImuLog:
    n = len(history.t) // IMU_STEPS

    def mean(column: Floats) -> Floats:
        return column[: n * IMU_STEPS].reshape(n, IMU_STEPS).mean(axis=1)

    half_rate = 0.5 / (IMU_STEPS * STEP)
    gyro_sd, accel_sd = (d * math.sqrt(half_rate) for d in (sensors.gyro_density, sensors.accel_density))
    gz = mean(history.gyro) * (1 + flaws.gyro_scale) + flaws.gyro_bias + gyro_sd * rng.standard_normal(n)
    ax, ay = (mean(history.accel[:, i]) + flaws.accel_bias[i] + accel_sd * rng.standard_normal(n) for i in (0, 1))
    return ImuLog(mean(history.t), gz, ax=ax, ay=ay)


def _tag(history: History) -> tuple[Floats, Floats]:
    t, pose = history.t[FIX_STEPS - 1 :: FIX_STEPS], history.pose[FIX_STEPS - 1 :: FIX_STEPS]
    cos, sin, tag = np.cos(pose[:, 2]), np.sin(pose[:, 2]), ROBOT.tag
    x, y = pose[:, 0] + cos * tag.x - sin * tag.y, pose[:, 1] + sin * tag.x + cos * tag.y
    return t, np.column_stack((x, y, pose[:, 2]))


def _fixes(history: History, rng: np.random.Generator, sensors: Sensors, lie: Lie | None) -> BeaconLog:
    t, tag = _tag(history)
    lost = np.zeros(len(t), bool)
    if lie is not None:
        tag, lost = lie(t, tag, rng)
    wild = sensors.wild_size * (rng.random(len(t)) < sensors.wild_share)
    way = rng.uniform(-np.pi, np.pi, len(t))
    x = tag[:, 0] + sensors.fix_xy * rng.standard_normal(len(t)) + wild * np.cos(way)
    y = tag[:, 1] + sensors.fix_xy * rng.standard_normal(len(t)) + wild * np.sin(way)
    theta = np.remainder(tag[:, 2] + sensors.fix_theta * rng.standard_normal(len(t)) + np.pi, 2 * np.pi) - np.pi
    seen = ~lost
    return BeaconLog(t[seen], x[seen], y[seen], theta[seen] if sensors.headings else None)


def _ranges(history: History, rng: np.random.Generator, sensors: Sensors, lie: Lie | None) -> RangeLog:
    t, tag = _tag(history)
    lost = np.zeros(len(t), bool)
    if lie is not None:
        tag, lost = lie(t, tag, rng)
    places = np.array(list(BEACONS.values()))
    which = (np.arange(len(t)) % len(places)).astype(np.int16)
    arm = np.column_stack((tag[:, :2], np.full(len(t), ROBOT.tag.z))) - places[which]
    wild = sensors.wild_size * (rng.random(len(t)) < sensors.wild_share)
    reading = np.linalg.norm(arm, axis=1) + sensors.range * rng.standard_normal(len(t)) + wild
    return RangeLog(t[~lost], which[~lost], reading[~lost], tuple(BEACONS))
