"""A MuJoCo robot drawn by its seed, as a gap case: rigid bodies, contact, servos, and what is asked to be wrong.

What MuJoCo can do is done in the physics (tyres, track, servo, the IMU's mount, a tilted floor, a wheel out of round);
firmware spoils the set-points; slip that contact laws do not give is laid over the motion (`gap_mujoco_over.py`);
electronics, fixes and ranges are the plant's (`gap_plant.py`). The robot's description is calibrated by a drive without
effects, as its maker would. Nothing comes from `core` but data types.
"""

from __future__ import annotations

import functools
import math
from collections import deque
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from core.robot import Noise, Pose, RobotParams
from core.run import Run, RunMeta
from core.sensors import CommandLog, ImuLog, TruthLog, WheelLog
from tests.plants.gap_mujoco_over import G, H, Motion, felt_means, laid_over
from tests.plants.gap_ordinary import Effects
from tests.plants.gap_plant import BEACONS, Plan, acting, distances, fixes, get, readings, rig, robot

CENTRE, FAR = (2.5, 2.0), 1.8
"""It drives about here, and turns back beyond so far [m]."""
PHYSICAL = (
    "wheel_radius", "unequal_wheels", "track_width", "motor_lag", "command_delay", "speed_limit", "accel_limit",
    "drive_gain", "deadband", "battery_sag", "wheel_slip", "side_slip", "bump", "slip_patch", "imu_yaw", "imu_offset",
    "floor_tilt", "gyro_bias", "gyro_scale", "gyro_drift", "gyro_walk", "gyro_temperature", "gyro_g_sensitivity",
    "gyro_noise", "gyro_clip", "accel_bias", "accel_scale", "vibration", "missed_ticks", "beacon_delay",
    "beacon_shift", "beacon_rotation", "beacon_scale", "tag_offset", "beacon_noise", "beacon_outliers",
    "beacon_shadow", "anchor_moved", "range_bias", "imu_clock", "clock_drift",
)  # fmt: skip
UNLISTED = {
    "left_motor": (0.008, 0.03),  # the left wheel alone turns slower by this share
    "out_of_round": (4e-4, 1.2e-3),  # the left tyre sits this far off its axle [m]
    "encoder_wobble": (0.008, 0.02),  # the right encoder reads c*sin(angle) more
    "mount_rings": (4.0, 8.0),  # the IMU swings on its mount at so many hertz
    "tyre_yields": (0.03, 0.08),  # the body follows its wheels with this lag [s]
    "magnet": (3e-3, 1e-2),  # the gyro is off by so much at a place
    "thermal_step": (2e-3, 8e-3),  # the gyro's bias steps
    "one_way": (0.006, 0.015),  # gz += c*|w|
    "gyro_cubic": (0.01, 0.025),
    "gyro_fade": (0.02, 0.05),
    "load_shift": (0.03, 0.1),  # the load slips, the body pitches: ax steps [m/s^2]
    "grain": (0.015, 0.05),  # a carpet: the body is faster by c*|v|*cos(heading)
    "pull": (0.02, 0.06),  # w += c*v*|v|
    "clock_wanders": (4e-3, 1e-2),  # the IMU's stamps by c*sin(t/5)
    "fix_warp": (0.04, 0.1),  # fixes are off by c*sin(1.5 x): a map that is not true
    "long_anchor": (0.08, 0.2),
    "heading_echo": (0.06, 0.15),
    "fix_drift": (6e-4, 2e-3),
}
"""Causes of no list, and between which sizes they are drawn."""
BY_SENSOR = ("gyro_cubic", "gyro_fade", "long_anchor", "heading_echo", "fix_drift")
"""Those that the plant's sensors know."""


@dataclass(frozen=True)
class Make:
    """A robot's build: mass [kg], its centre and caster ahead of the axle [m], tyres, contact, servo, drive."""

    mass: float
    ahead: float
    caster: float
    tyre: str
    soft: float
    grip: float
    impratio: float
    lag: float
    hold: int
    style: str
    accel: float
    truth_noise: float
    warm: bool
    leans: bool


def make_of(seed: int) -> Make:
    """A build by chance, everything small within the tolerances."""
    rng = np.random.default_rng([seed, 21])
    behind = float(rng.choice([-1.0, 1.0]))  # on which side the caster is, and the load a little
    return Make(
        mass=float(np.exp(rng.uniform(np.log(2.5), np.log(12.0)))),
        ahead=behind * float(rng.uniform(0.02, 0.06)),
        caster=behind * float(rng.uniform(0.12, 0.2)),
        tyre=str(rng.choice(["ellipsoid", "sphere"])),
        soft=float(rng.uniform(0.002, 0.005)),
        grip=float(rng.uniform(0.7, 1.2)),
        impratio=float(rng.choice([10.0, 30.0, 100.0])),
        lag=float(rng.uniform(2e-3, 4.5e-3)),
        hold=int(rng.choice([1, 2])),
        style=str(rng.choice(["arcs", "visits", "waves", "mixed"])),
        accel=float(rng.uniform(0.4, 1.2)),
        truth_noise=float(rng.choice([1e-4, 3e-4, 1e-3])),
        warm=bool(rng.random() < 0.6),
        leans=bool(rng.random() < 0.3),
    )


@functools.lru_cache(maxsize=64)
def described(seed: int) -> tuple[RobotParams, Noise, float, float, tuple[float, float]]:
    """A robot's description and noise, by how much its tyres and track must differ from it to roll as described, and
    what its accelerometer reads at rest."""
    params, noise = robot(seed + 50_000)
    plan = Plan(seed, seconds=8.0)
    first = Robot(plan, params, (1.0, 1.0), Pose())
    for v, w, span in ((0.0, 0.0, 0.5), (0.3, 0.0, 3.5), (0.0, 0.0, 1.0), (0.0, 0.6, 3.0)):
        end = first.time + span
        while first.time < end - 1e-9:
            first.go(v, w)
    still = first.record[50:200, 3:5].mean(axis=0)
    r, (a, b) = first.record[: first.done], (round(3.8 / H), first.done - 1)
    way = math.hypot(r[a, 6] - r[round(0.4 / H), 6], r[a, 7] - r[round(0.4 / H), 7])
    rolled = 0.5 * (r[a, 12:14] - r[round(0.4 / H), 12:14]).sum() * float(params.wheel_radius or 0)
    turned = np.unwrap(np.arctan2(r[a:, 10], r[a:, 9]))
    spun = (r[b, 13] - r[a, 13] - r[b, 12] + r[a, 12]) * float(params.wheel_radius or 0) * way / rolled
    track = float(params.track_width or 0) * float(turned[-1] - turned[0]) / spun
    return params, noise, rolled / way, track, (float(still[0]), float(still[1]))


def mjcf(plan: Plan, make: Make, params: RobotParams, sizes: tuple[float, float]) -> str:
    """The robot's model. sizes: tyres and track over what its description says."""
    e = acting(plan)
    radius, half = float(params.wheel_radius or 0), 0.5 * float(params.track_width or 0) * sizes[1]
    half *= get(e, "track_width", "scale", 1.0)
    ratio = get(e, "unequal_wheels", "ratio", 1.0)
    both = radius * sizes[0] * get(e, "wheel_radius", "scale", 1.0)
    wheels, inertia = "", 0.5 * 0.4 * radius**2 + 0.01
    for side, sign, size in (("left", 1, 2 * both / (1 + ratio)), ("right", -1, 2 * both * ratio / (1 + ratio))):
        lift = size - radius if not make.leans else both - radius
        shape = f'type="{make.tyre}" size="{size} 0.015 {size}"'
        off = plan.outside.get("out_of_round", 0.0) if side == "left" else 0.0
        wheels += (
            f'<body pos="0 {sign * half} {lift}"><joint name="{side}" axis="0 1 0" armature="0.01"/>'
            f'<geom {shape} pos="{off} 0 0" mass="0.4"/></body>\n'
        )
    lag = get(e, "motor_lag", "tau", 0.0) if softer(plan) else make.lag
    load = inertia + 0.5 * make.mass * radius**2  # what a wheel moves when both drive on
    servo = f'kv="{load / max(lag, make.lag):.5f}"'
    x, y = params.imu.x + get(e, "imu_offset", "x", 0.0), params.imu.y + get(e, "imu_offset", "y", 0.0)
    yaw = params.imu.yaw + get(e, "imu_yaw", "angle", 0.0)
    sx, sy = get(e, "floor_tilt", "slope_x", 0.0), get(e, "floor_tilt", "slope_y", 0.0)
    return f"""
<mujoco>
  <compiler angle="radian"/>
  <option timestep="{H / 2}" integrator="Euler" cone="elliptic" impratio="{make.impratio}"
    gravity="{-G * sx} {-G * sy} {-G}"/>
  <default><geom solref="{make.soft} 1" friction="{make.grip} 0.005 0.0001"/></default>
  <worldbody>
    <geom type="plane" size="20 20 1"/>
    <body name="base" pos="0 0 {radius}">
      <freejoint/>
      <geom type="box" size="0.15 0.1 0.04" pos="{make.ahead} 0 0.02" mass="{make.mass - 0.8}"/>
      <geom type="sphere" size="0.03" pos="{make.caster} 0 {0.03 - radius}" mass="0.1" condim="1" priority="1"/>
      <site name="axle"/> <site name="imu" pos="{x} {y} 0" euler="0 0 {yaw}"/>
      {wheels}
    </body>
  </worldbody>
  <actuator><velocity joint="left" {servo}/> <velocity joint="right" {servo}/></actuator>
  <sensor>
    <gyro site="imu"/> <accelerometer site="imu"/>
    <framepos objtype="site" objname="axle"/> <framexaxis objtype="site" objname="axle"/>
    <jointpos joint="left"/> <jointpos joint="right"/>
  </sensor>
</mujoco>"""


def softer(plan: Plan) -> bool:
    """Whether a lag that is asked for is the servo's; else the firmware's."""
    return "motor_lag" in plan.effects and plan.seed % 2 == 0


class Robot:
    """The physics and its record; `go` drives one control step towards a twist, as a robot's firmware would."""

    def __init__(self, plan: Plan, params: RobotParams, sizes: tuple[float, float], start: Pose) -> None:
        self.plan, self.make, self.params = plan, make_of(plan.seed), params
        self.model = mujoco.MjModel.from_xml_string(mjcf(plan, self.make, params, sizes))
        self.data = mujoco.MjData(self.model)
        radius = float(params.wheel_radius or 0)
        self.data.qpos[:7] = (start.x, start.y, radius, math.cos(start.theta / 2), 0, 0, math.sin(start.theta / 2))
        mujoco.mj_step(self.model, self.data, 400)  # settle on its springs
        self.steps = round(plan.seconds / H)
        self.record = np.empty((self.steps, self.model.nsensordata))
        self.commands = [(0.0, 0.0, 0.0)]
        self.done = 0
        self.effects, self.period = acting(plan), 1.0 / rig(plan).commands
        late = round(get(self.effects, "command_delay", "delay", 0.0) / H)
        self.late = deque([(0.0, 0.0)] * late)
        self.held = self.rims = (0.0, 0.0)

    @property
    def time(self) -> float:
        """Seconds since the start."""
        return self.done * H

    @property
    def pose(self) -> tuple[float, float, float]:
        """x, y, theta of the axle's midpoint, as they are."""
        d = self.data.sensordata
        return float(d[6]), float(d[7]), math.atan2(d[10], d[9])

    def go(self, v: float, w: float) -> None:
        """The command moves towards (v, w) at limited rates, linearly until the next one."""
        period = self.period
        t0, v0, w0 = self.commands[-1]
        accel, turn = self.make.accel, 3.0 * self.make.accel
        v1 = v0 + min(max(v - v0, -accel * period), accel * period)
        w1 = w0 + min(max(w - w0, -turn * period), turn * period)
        b, r = float(self.params.track_width or 0), float(self.params.wheel_radius or 0)
        for _ in range(min(round((t0 + period) / H) - self.done, self.steps - self.done)):
            if self.done % self.make.hold == 0:
                share = ((self.done + 0.5 * self.make.hold) * H - t0) / period
                speed, rate = v0 + share * (v1 - v0), w0 + share * (w1 - w0)
                self.held = self._firmware((speed - 0.5 * b * rate, speed + 0.5 * b * rate))
            self.data.ctrl[:] = self.held[0] / r, self.held[1] / r
            mujoco.mj_step(self.model, self.data)
            first = self.data.sensordata.copy()  # contact's jitter has a period of two steps: their mean is without it
            mujoco.mj_step(self.model, self.data)
            self.record[self.done] = 0.5 * (first + self.data.sensordata)
            self.done += 1
        self.commands.append((t0 + period, v1, w1))

    def _firmware(self, rims: tuple[float, float]) -> tuple[float, float]:
        """Set-points of both rims [m/s] as the drive gets them."""
        e, step = self.effects, H * self.make.hold
        for _ in range(self.make.hold if self.late else 0):
            self.late.append(rims)
            rims = self.late.popleft()
        gain = get(e, "drive_gain", "gain", 1.0) * math.exp(-get(e, "battery_sag", "rate", 0.0) * self.time)
        width, top = get(e, "deadband", "width", 0.0), get(e, "speed_limit", "v_max", math.inf)
        tau = 0.0 if softer(self.plan) else get(self.plan.effects, "motor_lag", "tau", 0.0)
        most = get(e, "accel_limit", "a_max", math.inf) * step
        out = []
        for side, (wanted, last) in enumerate(zip(rims, self.rims, strict=True)):
            u = 0.0 if abs(wanted) < width else gain * wanted
            u *= 1.0 - (self.plan.outside.get("left_motor", 0.0) if side == 0 else 0.0)
            u = last + (u - last) * (1.0 - math.exp(-step / tau)) if tau else u
            out.append(min(max(last + min(max(u - last, -most), most), -top), top))
        self.rims = (out[0], out[1])
        return self.rims


def drive(m: Robot) -> None:
    """Until its record is full: arcs, spins, straights and waves in turn, near the middle."""
    plan = m.plan
    rng = np.random.default_rng([plan.seed, 22, len(plan.profile)])
    span = float(rng.uniform(1.5, 3.0))
    v = w = 0.0
    styles = {"arcs": ("arc",), "visits": ("spin", "line"), "waves": ("wave", "arc"), "mixed": ("arc", "spin", "line")}
    kind, turns, begun = "rest", 0, 0.0
    while m.done < m.steps:
        x, y, theta = m.pose
        away = math.remainder(math.atan2(CENTRE[1] - y, CENTRE[0] - x) - theta, math.tau)
        if m.time > plan.seconds - 4.0:
            v = w = 0.0
        elif m.time >= begun + span:
            begun, turns, span = m.time, turns + 1, float(rng.uniform(1.5, 5.0))
            kinds = styles["mixed" if plan.profile == "stops" else m.make.style]
            kind = kinds[turns % len(kinds)] if rng.random() > 0.12 else "rest"
            v, w = float(rng.uniform(0.1, 0.7)), float(rng.choice([-1, 1]) * rng.uniform(0.15, 0.9))
        home = math.hypot(x - CENTRE[0], y - CENTRE[1]) > FAR and abs(away) > 0.5
        if kind == "rest" or m.time > plan.seconds - 4.0:
            m.go(0.0, 0.0)
        elif kind == "spin":
            m.go(0.0, w)
        elif home:
            m.go(min(v, 0.2), math.copysign(0.7, away))
        elif kind == "line":
            m.go(v, 0.0)
        elif kind == "wave":
            m.go(v, 0.8 * math.sin(1.8 * (m.time - begun)))
        else:
            m.go(v, w)


def leaning(plan: Plan) -> Effects:
    """The effects with what the physics adds: on unequal tyres a robot may lean, and its accelerometer with it."""
    params, make = described(plan.seed)[0], make_of(plan.seed)
    if "unequal_wheels" not in plan.effects or not make.leans:
        return plan.effects
    ratio = get(plan.effects, "unequal_wheels", "ratio", 1.0)
    tilt = G * float(params.wheel_radius or 0) * 2.0 * (ratio - 1.0) / (1.0 + ratio) / float(params.track_width or 1)
    x, y = -tilt * math.sin(params.imu.yaw), -tilt * math.cos(params.imu.yaw)
    return plan.effects if abs(tilt) < 0.002 else {**plan.effects, "accel_bias": {"x": x, "y": y}}


def ride_run(plan: Plan) -> Run:
    """The run that the plan's robot records."""
    params, noise, tyres, track, still = described(plan.seed)
    make, kind, e = make_of(plan.seed), rig(plan), acting(plan)
    rng = np.random.default_rng([plan.seed, 23, len(plan.profile)])
    m = Robot(plan, params, (tyres, track), Pose(*CENTRE, float(rng.uniform(-3, 3))))
    drive(m)
    m.record[:, 3:5] -= still
    body = laid_over(plan, params, Motion.of(m.record[: m.done]))
    t = np.arange(0.0, plan.seconds, 1.0 / kind.wheels)
    tick, angles = 2.0 * np.pi / float(params.ticks_per_rev or 1), []
    for side, column in (("left", body.left), ("right", body.right)):
        angle = np.interp(t, body.t, column) * (1.0 - get(e, "missed_ticks", side, 0.0))
        if side == "right":
            angle = angle + plan.outside.get("encoder_wobble", 0.0) * np.sin(angle)
        angles.append(tick * np.floor(angle / tick + 0.5))
    at = np.arange(0.0, plan.seconds - 0.05, 1.0 / kind.truth)
    truth = [np.interp(at, body.t, column) + make.truth_noise * rng.standard_normal(len(at)) for column in body.pose.T]
    commands = np.array(m.commands)
    path = dict(zip(("x", "y", "theta"), body.pose.T, strict=True)) | {"t": body.t}
    seen = replace(plan, outside={k: v for k, v in plan.outside.items() if k in BY_SENSOR})
    fix, ranges = fixes(seen, params, noise, path, rng), distances(seen, params, noise, path, rng)
    warp = plan.outside.get("fix_warp", 0.0)
    fix = replace(fix, x=fix.x + warp * np.sin(1.5 * fix.x)) if warp else fix
    told = replace(noise, truth_xy=max(make.truth_noise, 1e-3), truth_theta=max(make.truth_noise, 1e-3))
    x, y, theta = body.pose[0]
    start = Pose(float(x), float(y), float(theta))
    return Run(
        meta=RunMeta(f"mujoco {plan.seed} {plan.profile}", robot=params, beacons=BEACONS, start=start, noise=told),
        commands=CommandLog(*commands.T.copy()),
        wheels=WheelLog(t, angles[0], angles[1]),
        imu=_imu(seen, plan.outside, make, params, noise, body, rng),
        beacon=fix if plan.sensors in ("fix", "both") else None,
        ranges=ranges if plan.sensors in ("ranges", "both") else None,
        truth=TruthLog(at, *truth),
    )


def _imu(plan: Plan, outside, make: Make, params: RobotParams, noise: Noise, body: Motion, rng) -> ImuLog:
    """Means over a sample's period, by the IMU's own clock, through the plant's electronics."""
    e, rate = acting(plan), rig(plan).imu
    stamps = (np.arange(int((plan.seconds - 0.1) * rate)) + 0.5) / rate
    skew, offset = get(e, "clock_drift", "skew", 0.0), get(e, "imu_clock", "offset", 0.0)
    real = (stamps - offset) / (1.0 + skew) + outside.get("clock_wanders", 0.0) * np.sin(stamps / 5.0)
    gz, ax, ay, speed = felt_means(body, real, 0.5 / rate, outside)
    log = readings(plan, noise, stamps, real, (gz, ax, ay), speed, rng)
    return log if make.warm or "gyro_temperature" in plan.effects else replace(log, temperature=None)
