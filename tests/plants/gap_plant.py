"""A differential-drive robot for the gap, written apart from the product's simulator: fixed steps, its own equations.

The plant steps at H: drive states by exponential steps, the pose by midpoints, IMU readings as means over the fine
steps. It knows the effects of `effects.md`, and some that no library has (OUTSIDE). Only data types come from `core`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from core.robot import ImuMount, Noise, Pose, RobotParams, TagMount
from core.run import Run, RunMeta
from core.sensors import BeaconLog, CommandLog, ImuLog, RangeLog, TruthLog, WheelLog
from tests.plants.gap_ordinary import Rig, drawn_rig, ordinary, rounded

Floats = npt.NDArray[np.float64]
Effects = Mapping[str, Mapping[str, float | str]]

H = 0.002  # s
G = 9.80665
BEACONS = {"A": (-1.0, -1.5, 2.4), "B": (6.5, -1.0, 2.1), "C": (6.0, 5.5, 2.6), "D": (-1.2, 5.0, 2.2)}
OUTSIDE = {
    "gyro_cubic": 0.012,  # gz += c*w^3
    "gyro_fade": 0.03,  # the gyro's scale falls by this share at 0.5 m/s
    "resonance": 0.02,  # a rubbing tyre: w += c*v*sin(angle of the right wheel)
    "heading_echo": 0.08,  # ranges long by c*cos(heading)^2: an echo off the body
    "fix_clock": 6e-3,  # fixes come late by c*t
    "drag": 0.04,  # the body is slower by c*v*|v|
    "ramp": 0.02,  # one half of the floor slopes along x
    "sag_rest": 0.04,  # the battery sags with driving and recovers at rest
    "load_play": 0.004,  # the left encoder is off by c*tanh(acceleration/0.2)
    "gyro_sign": 0.004,  # gz += c*sign(w)
    "left_motor": 0.015,  # the left wheel alone turns slower by this share
    "encoder_wobble": 0.01,  # the right encoder reads c*sin(angle) more
    "caster": 0.05,  # w += c*v*|v|: a caster that drags more the faster it goes
    "headwind": 0.03,  # v += c*cos(theta): a push along the map's x
    "fix_drift": 4e-4,  # fixes wander along x by c*t
    "long_anchor": 0.12,  # ranges to one anchor are long
}


@dataclass(frozen=True)
class Plan:
    """One drive: what to do, for how long, with which sensors and effects."""

    seed: int
    profile: str = "mixed"
    seconds: float = 100.0
    effects: Effects = field(default_factory=dict)
    outside: Mapping[str, float] = field(default_factory=dict)
    sensors: str = "both"  # fix, ranges, both, none
    truth: bool = True
    commands: bool = True
    imu: bool = True
    stated: float = 1.0  # the description states this many times the real noise
    ordinary: bool = False  # a robot as robots are: a little of everything, other rates, rounded readings


def acting(plan: Plan) -> Effects:
    """All effects of a plan, the ordinary ones below those that were chosen."""
    return {**ordinary(plan.seed, list(BEACONS)), **plan.effects} if plan.ordinary else plan.effects


def rig(plan: Plan) -> Rig:
    """Rates and roundings of a plan's robot."""
    return drawn_rig(plan.seed) if plan.ordinary else Rig()


def robot(seed: int) -> tuple[RobotParams, Noise]:
    """A robot and its sensors' real noise, by chance."""
    rng = np.random.default_rng([seed, 1])
    params = RobotParams(
        wheel_radius=float(rng.choice([0.05, 0.0625, 0.075, 0.1])),
        track_width=float(rng.uniform(0.25, 0.5)),
        ticks_per_rev=float(rng.choice([1024, 2048, 4096])),
        imu=ImuMount(
            float(rng.uniform(-0.08, 0.08)), float(rng.uniform(-0.04, 0.04)), float(rng.choice([0.0, 1.5708]))
        ),
        tag=TagMount(float(rng.uniform(-0.1, 0.1)), float(rng.uniform(-0.05, 0.05)), 0.5),
    )
    noise = Noise(
        gyro_density=float(rng.uniform(1.5e-4, 3.5e-4)),
        accel_density=float(rng.uniform(1e-3, 3e-3)),
        beacon_xy=float(rng.uniform(0.01, 0.04)),
        beacon_theta=float(rng.uniform(0.01, 0.03)),
        range=float(rng.uniform(0.02, 0.05)),
    )
    return params, noise


def commands(plan: Plan) -> tuple[Floats, Floats, Floats]:
    """Stamps, v and w: ramps between levels that the profile draws, back near the middle now and then."""
    rng = np.random.default_rng([plan.seed, 2, len(plan.profile)])
    knots: list[tuple[float, float, float]] = [(0.0, 0.0, 0.0), (2.0, 0.0, 0.0)]
    t, x, y, theta = 2.0, 2.5, 2.0, 0.3
    while t < plan.seconds - 6.0:
        away = math.remainder(math.atan2(2.0 - y, 2.5 - x) - theta, math.tau)
        far = math.hypot(x - 2.5, y - 2.0)
        if plan.profile == "stops" and rng.random() < 0.3:
            v, w, span = 0.0, 0.0, rng.uniform(1.0, 3.0)
        elif plan.profile == "turns" and rng.random() < 0.5:
            v, w, span = 0.0, float(rng.choice([-1, 1]) * rng.uniform(0.3, 1.2)), rng.uniform(1.0, 4.0)
        else:
            v, w, span = rng.uniform(0.1, 0.7), rng.uniform(-0.9, 0.9), rng.uniform(1.0, 4.0)
        if far > 1.8:
            w = float(np.clip(0.8 * away, -0.9, 0.9))
            v = v if abs(away) < 1.0 else 0.15
        ramp = rng.uniform(0.4, 1.0)
        knots += [(t + ramp, v, w), (t + ramp + span, v, w)]
        for _ in range(10):
            theta += w * (ramp + span) / 10
            x, y = x + v * math.cos(theta) * (ramp + span) / 10, y + v * math.sin(theta) * (ramp + span) / 10
        t += ramp + span
    knots += [(t + 1.0, 0.0, 0.0), (plan.seconds, 0.0, 0.0)]
    at = np.array(knots)
    stamps = np.arange(0.0, plan.seconds, 1.0 / rig(plan).commands)
    return stamps, np.interp(stamps, at[:, 0], at[:, 1]), np.interp(stamps, at[:, 0], at[:, 2])


def get(effects: Effects, name: str, parameter: str, neutral: float) -> float:
    """A parameter, neutral where the effect is absent."""
    return float(effects.get(name, {}).get(parameter, neutral))


def wheel(u: Floats, t: Floats, e: Effects) -> Floats:
    """Rim speed from rim set-point."""
    width = get(e, "deadband", "width", 0.0)
    u = (
        np.where(np.abs(u) < width, 0.0, u)
        * get(e, "drive_gain", "gain", 1.0)
        * np.exp(-get(e, "battery_sag", "rate", 0.0) * t)
    )
    tau, fastest = get(e, "motor_lag", "tau", 0.0), get(e, "accel_limit", "a_max", math.inf) * H
    if tau > 0.0 or math.isfinite(fastest):
        keep = math.exp(-H / tau) if tau > 0.0 else 0.0
        lagged, out, held = 0.0, 0.0, []
        for value in u.tolist():
            lagged = value + (lagged - value) * keep
            out += min(max(lagged - out, -fastest), fastest)
            held.append(out)
        u = np.array(held)
    top = get(e, "speed_limit", "v_max", math.inf)
    return np.clip(u, -top, top)


def drive(plan: Plan, params: RobotParams, start: Pose) -> dict[str, Floats]:
    """Everything on the fine grid: wheels' angles, pose, speeds, map velocity's derivative in the body."""
    e, out = acting(plan), dict(plan.outside)
    stamps, v_set, w_set = commands(plan)
    t = np.arange(0.0, plan.seconds + 0.5, H)
    r, b = float(params.wheel_radius or 0), float(params.track_width or 0)
    late = t + 0.5 * H - get(e, "command_delay", "delay", 0.0)
    v, w = np.interp(late, stamps, v_set), np.interp(late, stamps, w_set)
    left, right = wheel(v - 0.5 * b * w, t, e), wheel(v + 0.5 * b * w, t, e)
    left = left * (1.0 - out.get("left_motor", 0.0))
    if "sag_rest" in out:
        load = np.abs(left) + np.abs(right)
        drained = np.array(lfilter([H / 20.0], [1.0, H / 20.0 - 1.0], load))
        left, right = left * (1.0 - out["sag_rest"] * drained), right * (1.0 - out["sag_rest"] * drained)
    ratio, scale = get(e, "unequal_wheels", "ratio", 1.0), get(e, "wheel_radius", "scale", 1.0)
    k = get(e, "wheel_slip", "k", 0.0)
    ground = []
    for rim, factor in ((left, 2.0 / (1.0 + ratio)), (right, 2.0 * ratio / (1.0 + ratio))):
        a = np.gradient(rim, H)
        ground.append((1.0 - np.clip(k * a * np.sign(rim), -1.0, 1.0)) * rim * scale * factor)
    v = 0.5 * (ground[0] + ground[1])
    w = (ground[1] - ground[0]) / (b * get(e, "track_width", "scale", 1.0))
    w = w + out.get("caster", 0.0) * v * np.abs(v)
    v = v - out.get("drag", 0.0) * v * np.abs(v)
    if "resonance" in out:
        w = w + out["resonance"] * v * np.sin(np.cumsum(right * H) / r)
    if "bump" in e:
        s = t - get(e, "bump", "time", 0.0)
        push = np.where((s > 0.0) & (s < 0.3), (1.0 - np.cos(2.0 * np.pi * s / 0.3)) / 0.3, 0.0)
        v, w = v + get(e, "bump", "distance", 0.0) * push, w + get(e, "bump", "turn", 0.0) * push
    side = -get(e, "side_slip", "k", 0.0) * v * w + (1e-4 * np.tanh(v / 0.02) if plan.ordinary else 0.0)
    if "slip_patch" in e:
        v, w, side = through_patch(e, v, w, side, start)
    theta = start.theta + np.concatenate(([0.0], np.cumsum(w[:-1] * H)))
    if "headwind" in out:
        moving = np.abs(v) > 0.02
        v = v + out["headwind"] * np.cos(theta) * moving
    middle = theta + 0.5 * H * w
    x = start.x + np.concatenate(([0.0], np.cumsum((v * np.cos(middle) - side * np.sin(middle))[:-1] * H)))
    y = start.y + np.concatenate(([0.0], np.cumsum((v * np.sin(middle) + side * np.cos(middle))[:-1] * H)))
    turned = [np.concatenate(([0.0], np.cumsum(rim[:-1] * H))) / r for rim in (left, right)]
    return {"t": t, "x": x, "y": y, "theta": theta, "v": v, "w": w, "side": side, "left": turned[0], "right": turned[1]}


def through_patch(e: Effects, v: Floats, w: Floats, side: Floats, start: Pose) -> tuple[Floats, Floats, Floats]:
    """Speeds with those inside the disc taken down, step by step, for where it is depends on them."""
    cx, cy = get(e, "slip_patch", "x", 0.0), get(e, "slip_patch", "y", 0.0)
    radius, slip = get(e, "slip_patch", "radius", 0.0), get(e, "slip_patch", "slip", 0.0)
    x, y, theta, grip = start.x, start.y, start.theta, []
    for forward, turn, sideways in zip(v.tolist(), w.tolist(), side.tolist(), strict=True):
        g = 1.0 - slip if (x - cx) ** 2 + (y - cy) ** 2 < radius * radius else 1.0
        grip.append(g)
        middle = theta + 0.5 * H * g * turn
        c, s = math.cos(middle), math.sin(middle)
        x, y = x + H * (g * forward * c - g * g * sideways * s), y + H * (g * forward * s + g * g * sideways * c)
        theta += H * g * turn
    held = np.array(grip)
    return v * held, w * held, side * held**2


def imu(plan: Plan, params: RobotParams, noise: Noise, body: dict[str, Floats], rng: np.random.Generator) -> ImuLog:
    """Means over a sample period, then the sensor's own flaws."""
    e, kind = acting(plan), rig(plan)
    rate = kind.imu
    stamps = (np.arange(int(plan.seconds * rate)) + 0.5) / rate
    skew, offset = get(e, "clock_drift", "skew", 0.0), get(e, "imu_clock", "offset", 0.0)
    real = (stamps - offset) / (1.0 + skew)
    t, v, w, theta = body["t"], body["v"], body["w"], body["theta"]
    px, py = params.imu.x + get(e, "imu_offset", "x", 0.0), params.imu.y + get(e, "imu_offset", "y", 0.0)
    half = 0.5 / rate

    def mean(rows: Floats) -> Floats:
        total = np.concatenate(([0.0], np.cumsum(rows[:-1] * H)))
        return (np.interp(real + half, t, total) - np.interp(real - half, t, total)) / (2 * half)

    def change(rows: Floats) -> Floats:
        at = t if rows is theta else t + 0.5 * H  # speeds are those of each step's middle
        return (np.interp(real + half, at, rows) - np.interp(real - half, at, rows)) / (2 * half)

    gz = change(theta)
    fx = change(v) - mean(w * body["side"]) - change(w) * py - mean(w * w) * px
    fy = change(body["side"]) + mean(w * v) + change(w) * px - mean(w * w) * py
    sx, sy = get(e, "floor_tilt", "slope_x", 0.0), get(e, "floor_tilt", "slope_y", 0.0)
    c, s = mean(np.cos(theta)), mean(np.sin(theta))
    sx = sx + plan.outside.get("ramp", 0.0) * (np.interp(real, t, body["x"]) > 2.5)
    fx, fy = fx + G * (sx * c + sy * s), fy + G * (sy * c - sx * s)
    yaw = params.imu.yaw + get(e, "imu_yaw", "angle", 0.0)
    ax, ay = math.cos(yaw) * fx + math.sin(yaw) * fy, math.cos(yaw) * fy - math.sin(yaw) * fx
    return readings(plan, noise, stamps, real, (gz, ax, ay), np.interp(real, t, v), rng)


def readings(
    plan: Plan,
    noise: Noise,
    stamps: Floats,
    real: Floats,
    felt: tuple[Floats, Floats, Floats],
    speed: Floats,
    rng: np.random.Generator,
) -> ImuLog:
    """What an IMU's electronics make of what it feels (rate, specific force in its own axes), at instants `real`."""
    e, kind, rate = acting(plan), rig(plan), rig(plan).imu
    gz, ax, ay = felt
    warm = 25.0 + kind.warm * (1.0 - np.exp(-stamps / kind.warm_tau)) + 0.5 * np.sin(stamps / 17.0)
    white = float(noise.gyro_density or 0) * math.sqrt(rate / 2)
    reading = gz * get(e, "gyro_scale", "scale", 1.0) + get(e, "gyro_bias", "bias", 0.0)
    reading = (
        reading + plan.outside.get("gyro_cubic", 0.0) * gz**3 + plan.outside.get("gyro_sign", 0.0) * np.tanh(gz / 0.02)
    )
    reading = reading - plan.outside.get("gyro_fade", 0.0) * gz * np.abs(speed) / 0.5
    if "gyro_drift" in e:
        reading = reading + get(e, "gyro_drift", "amplitude", 0.0) * (
            1.0 - np.exp(-np.maximum(real, 0) / get(e, "gyro_drift", "tau", 1.0))
        )
    reading = (
        reading
        + get(e, "gyro_temperature", "slope", 0.0) * (warm - warm[0])
        + get(e, "gyro_g_sensitivity", "k", 0.0) * ay
    )
    walk = np.cumsum(rng.standard_normal(len(stamps))) * get(e, "gyro_walk", "density", 0.0) / math.sqrt(rate)
    reading = reading + walk + white * get(e, "gyro_noise", "factor", 1.0) * rng.standard_normal(len(stamps))
    limit = get(e, "gyro_clip", "limit", math.inf)
    rough = float(noise.accel_density or 0) * math.sqrt(rate / 2)
    shake = get(e, "vibration", "k", 0.0) * np.abs(speed)
    axes = []
    for value, axis in ((ax, "x"), (ay, "y")):
        value = value * get(e, "accel_scale", axis, 1.0) + get(e, "accel_bias", axis, 0.0)
        axes.append(value + rough * rng.standard_normal(len(value)) + shake * rng.standard_normal(len(value)))
    ax, ay = (rounded(axis, kind.accel_step) for axis in axes)
    gz = rounded(np.clip(reading, -limit, limit), kind.gyro_step)
    return ImuLog(t=stamps, gz=gz, ax=ax, ay=ay, temperature=warm)


def tag(plan: Plan, params: RobotParams, body: dict[str, Floats], at: Floats) -> tuple[Floats, Floats, Floats]:
    """The tag's place and the heading when a fix of these stamps was taken."""
    e = acting(plan)
    when = at - get(e, "beacon_delay", "delay", 0.0) - plan.outside.get("fix_clock", 0.0) * at
    x, y, theta = (np.interp(when, body["t"], body[name]) for name in ("x", "y", "theta"))
    tx, ty = params.tag.x + get(e, "tag_offset", "x", 0.0), params.tag.y + get(e, "tag_offset", "y", 0.0)
    return x + tx * np.cos(theta) - ty * np.sin(theta), y + tx * np.sin(theta) + ty * np.cos(theta), theta


def seen(plan: Plan, x: Floats, y: Floats) -> npt.NDArray[np.bool_]:
    """Whether the tag is out of the shadow."""
    e = acting(plan)
    far = np.hypot(x - get(e, "beacon_shadow", "x", 0.0), y - get(e, "beacon_shadow", "y", 0.0))
    return far >= get(e, "beacon_shadow", "radius", 0.0)


def fixes(
    plan: Plan, params: RobotParams, noise: Noise, body: dict[str, Floats], rng: np.random.Generator
) -> BeaconLog:
    """Pose fixes."""
    e, rate = acting(plan), rig(plan).fixes
    n = int(plan.seconds * rate)
    t = (np.arange(n) + 1.0) / rate
    x, y, theta = tag(plan, params, body, t)
    keep = seen(plan, x, y)
    angle, scale = get(e, "beacon_rotation", "angle", 0.0), get(e, "beacon_scale", "scale", 1.0)
    u = scale * (math.cos(angle) * x - math.sin(angle) * y) + get(e, "beacon_shift", "x", 0.0)
    v = scale * (math.sin(angle) * x + math.cos(angle) * y) + get(e, "beacon_shift", "y", 0.0)
    u = u + plan.outside.get("fix_drift", 0.0) * t
    louder = get(e, "beacon_noise", "factor", 1.0)
    wild = rng.random(n) < get(e, "beacon_outliers", "rate", 0.0)
    size = get(e, "beacon_outliers", "size", 0.0)
    xy = [
        value + louder * float(noise.beacon_xy or 0) * rng.standard_normal(n) + wild * size * rng.standard_normal(n)
        for value in (u, v)
    ]
    heading = theta + angle + louder * float(noise.beacon_theta or 0) * rng.standard_normal(n)
    return BeaconLog(t=t[keep], x=xy[0][keep], y=xy[1][keep], theta=heading[keep])


def distances(
    plan: Plan, params: RobotParams, noise: Noise, body: dict[str, Floats], rng: np.random.Generator
) -> RangeLog:
    """Ranges to the beacons in turn."""
    e, rate = acting(plan), rig(plan).ranges
    n = int(plan.seconds * rate)
    t = (np.arange(n) + 0.5) / rate
    names = tuple(BEACONS)
    which = (np.arange(n) % len(names)).astype(np.int16)
    places = np.array(list(BEACONS.values()))
    if "anchor_moved" in e:
        places[names.index(str(e["anchor_moved"]["beacon"])), :2] += (
            get(e, "anchor_moved", "x", 0.0),
            get(e, "anchor_moved", "y", 0.0),
        )
    x, y, theta = tag(plan, params, body, t)
    keep = seen(plan, x, y)
    far = np.sqrt((x - places[which, 0]) ** 2 + (y - places[which, 1]) ** 2 + (params.tag.z - places[which, 2]) ** 2)
    far = far * get(e, "beacon_scale", "scale", 1.0) + get(e, "range_bias", "bias", 0.0)
    far = far + plan.outside.get("long_anchor", 0.0) * (which == 2)
    far = far + plan.outside.get("heading_echo", 0.0) * np.cos(theta) ** 2
    wild = (rng.random(n) < get(e, "beacon_outliers", "rate", 0.0)) * get(e, "beacon_outliers", "size", 0.0)
    far = (
        far
        + get(e, "beacon_noise", "factor", 1.0) * float(noise.range or 0) * rng.standard_normal(n)
        + wild * rng.standard_normal(n)
    )
    return RangeLog(t=t[keep], beacon=which[keep], range=far[keep], names=names)


def record(plan: Plan) -> Run:
    """The run that this robot records."""
    params, noise = robot(plan.seed)
    rng = np.random.default_rng([plan.seed, 3, len(plan.profile), int(plan.seconds)])
    start = Pose(2.5, 2.0, 0.3)
    body = drive(plan, params, start)
    stamps, v, w = commands(plan)
    e, kind = acting(plan), rig(plan)
    t = np.arange(0.0, plan.seconds, 1.0 / kind.wheels)
    tick = 2.0 * np.pi / float(params.ticks_per_rev or 1)
    sides = {}
    for side in ("left", "right"):
        angle = np.interp(t, body["t"], body[side]) * (1.0 - get(e, "missed_ticks", side, 0.0))
        if side == "left":
            pull = np.gradient(body["v"], H)
            angle = angle + plan.outside.get("load_play", 0.0) * np.tanh(np.interp(t, body["t"], pull) / 0.2)
        if side == "right":
            angle = angle + plan.outside.get("encoder_wobble", 0.0) * np.sin(angle)
        sides[side] = tick * np.floor(angle / tick)
    seen_at = np.arange(0.0, plan.seconds, 1.0 / kind.truth)
    columns = {
        name: np.interp(seen_at, body["t"], body[name]) + 3e-4 * rng.standard_normal(len(seen_at))
        for name in ("x", "y", "theta")
    }
    told = replace(
        noise,
        **{
            k: getattr(noise, k) * plan.stated
            for k in ("gyro_density", "accel_density", "beacon_xy", "beacon_theta", "range")
        },
    )
    fix, ranges = fixes(plan, params, noise, body, rng), distances(plan, params, noise, body, rng)
    return Run(
        meta=RunMeta(name=f"plant {plan.seed} {plan.profile}", robot=params, beacons=BEACONS, start=start, noise=told),
        commands=CommandLog(t=stamps, v=v, w=w) if plan.commands else None,
        wheels=WheelLog(t=t, left=sides["left"], right=sides["right"]),
        imu=imu(plan, params, noise, body, rng) if plan.imu else None,
        beacon=fix if plan.sensors in ("fix", "both") else None,
        ranges=ranges if plan.sensors in ("ranges", "both") else None,
        truth=TruthLog(t=seen_at, **columns) if plan.truth else None,
    )
