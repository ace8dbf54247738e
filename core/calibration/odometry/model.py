"""What an odometry calibration says: each parameter with its standard deviation, or None and the reason why."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from core.errors import FormatError
from core.estimation.result import Value
from core.robot import ImuMount, TagMount
from core.run import Run
from core.sensors import WheelLog

SCHEMA = "odometry-calibration/1"


@dataclass(frozen=True)
class Parameter:
    """One unknown: unit, how far it may plausibly be off its nominal value (one sigma), and what would show it."""

    name: str
    unit: str
    width: float
    advice: str


TABLE = (
    Parameter("left_radius", "m", 0.03, "drive some metres where the reference sees them"),
    Parameter("right_radius", "m", 0.03, "drive some metres where the reference sees them"),
    Parameter("track_width", "m", 0.05, "turn on the spot, several full turns"),
    Parameter("gyro_scale", "1", 0.02, "turn on the spot, several full turns"),
    Parameter("tag_x", "m", 0.2, "turn on the spot in view of the beacons"),
    Parameter("tag_y", "m", 0.2, "turn on the spot in view of the beacons"),
    Parameter("tag_yaw", "rad", 0.1, "drive straight, some metres"),
    Parameter("imu_clock", "s", 0.05, "start and stop turning often"),
    Parameter("reference_delay", "s", 0.1, "drive fast, both ways over the same ground"),
    Parameter("imu_yaw", "rad", 0.1, "speed up and brake hard"),
    Parameter("imu_x", "m", 0.1, "turn fast on the spot"),
    Parameter("imu_y", "m", 0.1, "turn fast on the spot"),
)
"""Widths of radii, track and gyro scale are relative to nominal. The first nine are solved for together."""

NAMES = tuple(p.name for p in TABLE)
LEFT, RIGHT, TRACK, GYRO, TAG_X, TAG_Y, TAG_YAW, IMU_CLOCK, DELAY = range(9)
SHARED = 9  # solved for together, as corrections of nominal values


@dataclass(frozen=True)
class OdometryCalibration:
    """parameters: by name of TABLE, SI, None where the runs do not show it; `reasons` says why not.

    correlation: of pairs that stand above 0.9. noise: what was assumed or learnt of slip (m/sqrt(m)) and reference.
    """

    parameters: Mapping[str, Value | None]
    reasons: Mapping[str, str] = field(default_factory=dict)
    correlation: Mapping[str, float] = field(default_factory=dict)
    noise: Mapping[str, float] = field(default_factory=dict)
    reference: str = ""
    notes: tuple[str, ...] = ()

    def value(self, name: str) -> float | None:
        """The number alone."""
        found = self.parameters.get(name)
        return None if found is None else found.value

    def to_json(self) -> dict[str, Any]:
        """Plain data in schema odometry-calibration/1."""
        values = {
            name: None if v is None else {"value": v.value, "sd": v.sd, "unit": v.unit}
            for name, v in self.parameters.items()
        }
        return {
            "schema": SCHEMA,
            "reference": self.reference,
            "parameters": values,
            "reasons": dict(self.reasons),
            "correlation": dict(self.correlation),
            "noise": dict(self.noise),
            "notes": list(self.notes),
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> OdometryCalibration:
        """Read that schema. Raises FormatError."""
        if data.get("schema") != SCHEMA or not isinstance(data.get("parameters"), Mapping):
            raise FormatError(
                f"expected schema {SCHEMA!r} with parameters, found {data.get('schema')!r}",
                key="schema",
                expected=SCHEMA,
                found=data.get("schema"),
            )
        values = {
            name: None if v is None else Value(float(v["value"]), v.get("sd"), v.get("unit", ""))
            for name, v in data["parameters"].items()
        }
        return cls(
            values, dict(data.get("reasons", {})), dict(data.get("correlation", {})), dict(data.get("noise", {})),
            str(data.get("reference", "")), tuple(data.get("notes", ())),
        )  # fmt: skip


def corrected(run: Run, calibration: OdometryCalibration) -> Run:
    """The run as a nominal robot would have recorded it: wheel angles in one radius, mounts and track put right.

    What the calibration does not know stays as it is.
    """
    robot, wheels = run.meta.robot, run.wheels
    r, b = robot.wheel_radius, robot.track_width
    left, right = (calibration.value(f"{side}_radius") for side in ("left", "right"))
    if wheels is not None and r and left is not None and right is not None:
        wheels = WheelLog(wheels.t, wheels.left * (left / r), wheels.right * (right / r))
    known = {name: v.value for name, v in calibration.parameters.items() if v is not None}
    robot = dataclasses.replace(
        robot,
        track_width=known.get("track_width", b),
        tag=TagMount(known.get("tag_x", robot.tag.x), known.get("tag_y", robot.tag.y), robot.tag.z),
        imu=ImuMount(
            known.get("imu_x", robot.imu.x), known.get("imu_y", robot.imu.y), known.get("imu_yaw", robot.imu.yaw)
        ),
    )
    imu, scale = run.imu, known.get("gyro_scale")
    if imu is not None and scale:
        imu = dataclasses.replace(imu, gz=imu.gz / scale)
    return dataclasses.replace(run, meta=dataclasses.replace(run.meta, robot=robot), wheels=wheels, imu=imu)
