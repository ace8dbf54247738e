"""What is known of the robot before it drives: geometry, beacons, data-sheet noise, the run's procedure.

None means unknown, never zero; a method that needs a missing number says so (`core.errors.MissingStreamError`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Pose:
    """Body pose in the map: x, y [m], theta [rad]."""

    x: float = 0.0
    y: float = 0.0
    theta: float = 0.0


@dataclass(frozen=True)
class ImuMount:
    """Where the IMU sits in the body frame: x, y [m], yaw [rad]."""

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0


@dataclass(frozen=True)
class TagMount:
    """Where the beacon tag sits in the body frame [m]."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


@dataclass(frozen=True)
class RobotParams:
    """Nominal robot, as its simulator believes it to be."""

    wheel_radius: float | None = None  # m
    track_width: float | None = None  # m
    ticks_per_rev: float | None = None
    imu: ImuMount = field(default_factory=ImuMount)
    tag: TagMount = field(default_factory=TagMount)


@dataclass(frozen=True)
class Noise:
    """Data-sheet noise; one-sided densities, else one sigma per reading."""

    gyro_density: float | None = None  # rad/s/sqrt(Hz)
    accel_density: float | None = None  # m/s^2/sqrt(Hz)
    beacon_xy: float | None = None  # m
    beacon_theta: float | None = None  # rad
    range: float | None = None  # m
    truth_xy: float | None = None  # m
    truth_theta: float | None = None  # rad


@dataclass(frozen=True)
class Segment:
    """A stretch of a calibration run with its known specific force [m/s^2] and turn rate [rad/s] in the IMU frame."""

    t0: float
    t1: float
    gravity: tuple[float, float, float] | None = None
    rate: tuple[float, float, float] | None = None


PROCEDURES = ("rest", "rate_table", "six_position", "umbmark", "drive")


@dataclass(frozen=True)
class Procedure:
    """How a run was made: one of PROCEDURES, with its segments."""

    kind: str = "drive"
    segments: tuple[Segment, ...] = ()


BeaconMap = Mapping[str, tuple[float, float, float]]
"""Surveyed beacon positions in the map, by name [m]."""

EffectSet = Mapping[str, Mapping[str, float | str]]
"""Effects with their parameters, by id, as in `simulator.effects`."""
