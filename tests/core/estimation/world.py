"""A small world of its own for these tests: a robot that drives by the clock, and sensors that lie as they are told.

Shares no code with the library's simulator. The body moves at 1 kHz by plain summation; the robot's real geometry, gyro
and slip differ from what the run says by the errors given.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.robot import Noise, Pose, RobotParams, TagMount
from core.run import Run, RunMeta
from core.sensors import BeaconLog, ImuLog, RangeLog, TruthLog, WheelLog

Array = npt.NDArray[np.float64]

STEP = 1e-3
BEACONS = {"B1": (-3.0, -3.0, 2.5), "B2": (6.0, -2.5, 2.4), "B3": (5.5, 6.0, 2.6), "B4": (-2.5, 5.0, 2.5)}
ROBOT = RobotParams(wheel_radius=0.075, track_width=0.32, ticks_per_rev=2048, tag=TagMount(0.1, 0.05, 0.4))


@dataclass(frozen=True)
class Flaws:
    """What the run does not say of the robot."""

    bias: float = 0.0  # rad/s
    bias_walk: float = 0.0  # rad/s/sqrt(s)
    gyro_scale: float = 0.0
    distance_scale: float = 0.0  # real distance over the wheels', minus one
    inequality: float = 0.0
    track_scale: float = 0.0
    slip: float = 0.0  # m/sqrt(m), as core.estimation.assumptions
    side_slip: float = 0.0


@dataclass(frozen=True)
class Sensors:
    """Rates [Hz], 0 for an absent sensor, and noise."""

    imu: float = 100.0
    wheels: float = 50.0
    fixes: float = 10.0
    ranges: float = 0.0
    gyro_density: float = 3e-4
    fix_xy: float = 0.04
    fix_theta: float | None = 0.03
    range: float = 0.05


@dataclass(frozen=True)
class World:
    """The run, and the true pose (N, 3) at the truth's stamps."""

    run: Run
    truth: Array


def drive(t: Array, rest: float) -> tuple[Array, Array]:
    """Forward speed and turn rate: at rest for `rest` s at both ends, in between smooth, with turns both ways."""
    s = np.clip(t - rest, 0.0, max(t[-1] - 2 * rest, 0.0))
    ease = np.clip(s, 0, 1) * np.clip(t[-1] - rest - t, 0, 1)
    return ease * (0.45 + 0.2 * np.sin(0.5 * s)), ease * (0.5 * np.sin(0.35 * s) + 0.25 * np.cos(0.11 * s) + 0.1)


def simulate(
    seed: int,
    seconds: float = 60.0,
    flaws: Flaws = Flaws(),
    sensors: Sensors = Sensors(),
    *,
    start: Pose | None = Pose(0.3, -0.2, 0.7),
    start_known: bool = True,
    rest: float = 2.0,
) -> World:
    """A run of that length, its readings drawn from the seed; truth at 20 Hz."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds + STEP / 2, STEP)
    v, w = drive(t, rest)
    d, turn = v[:-1] * STEP, w[:-1] * STEP
    along = d + flaws.slip / np.sqrt(2) * np.sqrt(np.abs(d)) * rng.standard_normal(d.size)
    across = flaws.side_slip * np.sqrt(np.abs(d)) * rng.standard_normal(d.size)
    pose = _path(start or Pose(), along, across, turn)
    meta = RunMeta(
        name="world",
        robot=ROBOT,
        beacons=BEACONS,
        start=start if start_known else None,
        noise=Noise(
            gyro_density=sensors.gyro_density,
            beacon_xy=sensors.fix_xy,
            beacon_theta=sensors.fix_theta,
            range=sensors.range,
        ),
    )
    every = _rows(t, 20.0)
    truth = pose[every]
    return World(
        Run(
            meta,
            wheels=_wheels(rng, t, d, turn, flaws, sensors.wheels) if sensors.wheels else None,
            imu=_imu(rng, t, v, w, pose[:, 2], flaws, sensors) if sensors.imu else None,
            beacon=_fixes(rng, t, pose, sensors) if sensors.fixes else None,
            ranges=_ranges(rng, t, pose, sensors) if sensors.ranges else None,
            truth=TruthLog(t[every], *truth.T.copy()),
        ),
        truth,
    )


def _path(start: Pose, along: Array, across: Array, turn: Array) -> Array:
    theta = start.theta + np.concatenate(([0.0], np.cumsum(turn)))
    middle = (theta[1:] + theta[:-1]) / 2
    cos, sin = np.cos(middle), np.sin(middle)
    x = start.x + np.concatenate(([0.0], np.cumsum(cos * along - sin * across)))
    y = start.y + np.concatenate(([0.0], np.cumsum(sin * along + cos * across)))
    return np.column_stack((x, y, theta))


def _rows(t: Array, rate: float) -> npt.NDArray[np.intp]:
    return np.arange(0, t.size, round(1 / (rate * STEP)))


def _wheels(rng: np.random.Generator, t: Array, d: Array, turn: Array, flaws: Flaws, rate: float) -> WheelLog:
    assert ROBOT.wheel_radius and ROBOT.track_width and ROBOT.ticks_per_rev
    b = ROBOT.track_width
    told = d * (1 - flaws.distance_scale)
    spread = 2 * flaws.slip**2 * (np.abs(d) + b / 2 * np.abs(turn)) / b**2
    turned = turn * (1 + flaws.track_scale) - flaws.inequality * d / b + np.sqrt(spread) * rng.standard_normal(d.size)
    rows, step = _rows(t, rate), 2 * np.pi / ROBOT.ticks_per_rev
    angles = [
        np.concatenate(([0.0], np.cumsum(told + side * turned * b / 2)))[rows] / ROBOT.wheel_radius for side in (-1, 1)
    ]
    left, right = (np.floor((a + 100.0) / step) * step for a in angles)
    return WheelLog(t[rows], left, right)


def _imu(
    rng: np.random.Generator, t: Array, v: Array, w: Array, theta: Array, flaws: Flaws, sensors: Sensors
) -> ImuLog:
    rows = _rows(t, sensors.imu)
    half = round(0.5 / (sensors.imu * STEP))
    a, b = np.clip(rows - half, 0, t.size - 1), np.clip(rows + half, 0, t.size - 1)
    rate = (theta[b] - theta[a]) / (t[b] - t[a]) * (1 + flaws.gyro_scale)
    wander = flaws.bias_walk * np.sqrt(1 / sensors.imu) * np.cumsum(rng.standard_normal(rows.size))
    noise = sensors.gyro_density * np.sqrt(sensors.imu / 2) * rng.standard_normal(rows.size)
    forward = (v[b] - v[a]) / (t[b] - t[a])
    return ImuLog(t[rows], rate + flaws.bias + wander + noise, ax=forward, ay=v[rows] * w[rows])


def _tag(pose: Array) -> Array:
    cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    tag = ROBOT.tag
    return np.column_stack((pose[:, 0] + cos * tag.x - sin * tag.y, pose[:, 1] + sin * tag.x + cos * tag.y))


def _fixes(rng: np.random.Generator, t: Array, pose: Array, sensors: Sensors) -> BeaconLog:
    rows = _rows(t, sensors.fixes)
    xy = _tag(pose[rows]) + sensors.fix_xy * rng.standard_normal((rows.size, 2))
    theta = None
    if sensors.fix_theta is not None:
        theta = np.remainder(pose[rows, 2] + sensors.fix_theta * rng.standard_normal(rows.size), 2 * np.pi)
    return BeaconLog(t[rows], xy[:, 0], xy[:, 1], theta)


def _ranges(rng: np.random.Generator, t: Array, pose: Array, sensors: Sensors) -> RangeLog:
    rows = _rows(t, sensors.ranges)
    names = tuple(BEACONS)
    which = (np.arange(rows.size) % len(names)).astype(np.int16)
    arm = np.column_stack((_tag(pose[rows]), np.full(rows.size, ROBOT.tag.z))) - np.array(list(BEACONS.values()))[which]
    measured = np.linalg.norm(arm, axis=1) + sensors.range * rng.standard_normal(rows.size)
    return RangeLog(t[rows], which, measured, names)
