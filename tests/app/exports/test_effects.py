"""Exports of an effect set, read back by a parser of their target; the MuJoCo one is driven."""

from __future__ import annotations

import dataclasses
import json
import math
import xml.etree.ElementTree as ET

import mujoco
import numpy as np
import pytest
import yaml

from app.exports.effects import TARGETS, EffectExport, export_effects
from core.effects import EFFECTS
from core.effects.chosen import effects_of
from core.errors import ParameterError
from core.robot import EffectSet, RobotParams
from core.run import RunMeta
from core.simulation.scenarios import SCENARIOS

META = dataclasses.replace(SCENARIOS["straight"].run().meta, start=None)
RADIUS, TRACK = 0.075, 0.32
GEOMETRY: EffectSet = {
    "wheel_radius": {"scale": 1.02},
    "unequal_wheels": {"ratio": 0.99},
    "track_width": {"scale": 1.05},
}
LEFT, RIGHT = 2 * RADIUS * 1.02 / 1.99, 2 * RADIUS * 1.02 * 0.99 / 1.99


def every_effect() -> dict[str, dict[str, float | str]]:
    """All effects on, each at a small deviation from neutral within its range."""
    out: dict[str, dict[str, float | str]] = {}
    for effect in EFFECTS.values():
        out[effect.id] = {p.name: "B1" if p.text else _off_neutral(p) for p in effect.parameters}
    return out


def _off_neutral(parameter: object) -> float:
    p = parameter
    neutral = float(p.neutral)  # type: ignore[attr-defined]
    value = 1.0 if math.isinf(neutral) else neutral + 0.01
    return min(max(value, p.low), p.high)  # type: ignore[attr-defined]


@pytest.mark.parametrize("target", TARGETS)
def test_each_effect_is_modelled_or_told_why_not(target: str) -> None:
    made = export_effects(target, META, every_effect())
    told = [*made.expressed, *made.nearest, *made.missing]
    assert sorted(told) == sorted(EFFECTS)


@pytest.mark.parametrize("target", ["sdf", "ros2_control", "mjcf"])
def test_the_text_says_what_it_leaves_out(target: str) -> None:
    made = export_effects(target, META, every_effect())
    for effect, advice in made.missing.items():
        assert f"not: {effect}: {advice}" in made.text


def test_json_is_what_simulate_takes() -> None:
    meta = dataclasses.replace(META, effects={"motor_lag": {"tau": 0.08}})
    made = export_effects("json", meta, {**GEOMETRY, "gyro_bias": {"bias": 0.0}})
    assert effects_of(json.loads(made.text)) == {**GEOMETRY, "motor_lag": {"tau": 0.08}}


def test_sdf_holds_geometry_and_noise() -> None:
    effects: EffectSet = {
        **GEOMETRY,
        "gyro_bias": {"bias": 0.004},
        "gyro_walk": {"density": 1e-4},
        "gyro_noise": {"factor": 2.0},
        "imu_yaw": {"angle": 0.1},
        "drive_gain": {"gain": 0.9},
        "floor_tilt": {"slope_x": 0.01, "slope_y": 0.0},
    }
    world = ET.fromstring(export_effects("sdf", META, effects).text.split("?>", 1)[1]).find("world")
    assert world is not None

    def value(path: str) -> float:
        text = world.findtext(path)  # type: ignore[union-attr]
        assert text is not None, path
        return float(text.split()[0])

    for side, radius in (("left", LEFT), ("right", RIGHT)):
        assert value(f".//link[@name='{side}_wheel']//radius") == pytest.approx(radius)
    poses = [float(str(world.findtext(f".//link[@name='{s}_wheel']/pose")).split()[1]) for s in ("left", "right")]
    assert poses[0] - poses[1] == pytest.approx(TRACK * 1.05)
    noise = ".//sensor/imu/angular_velocity/z/noise"
    assert value(f"{noise}/mean") == pytest.approx(0.004)
    assert value(f"{noise}/stddev") == pytest.approx(2 * 1.9e-4 * math.sqrt(50))
    assert value(f"{noise}/dynamic_bias_stddev") == pytest.approx(1e-4)
    assert float(str(world.findtext(".//sensor/pose")).split()[5]) == pytest.approx(0.1)
    assert value(".//plugin/wheel_separation") == pytest.approx(TRACK)
    assert value(".//plugin/wheel_radius") == pytest.approx(RADIUS / 0.9)
    assert value("gravity") == pytest.approx(-9.80665 * 0.01)


def test_ros2_control_holds_multipliers_and_limits() -> None:
    made = export_effects("ros2_control", META, {**GEOMETRY, "speed_limit": {"v_max": 0.8}})
    told = yaml.safe_load(made.text)["diff_drive_controller"]["ros__parameters"]
    assert told["wheel_separation"] * told["wheel_separation_multiplier"] == pytest.approx(TRACK * 1.05)
    assert told["wheel_radius"] * told["left_wheel_radius_multiplier"] == pytest.approx(LEFT)
    assert told["wheel_radius"] * told["right_wheel_radius_multiplier"] == pytest.approx(RIGHT)
    assert told["linear.x.max_velocity"] == pytest.approx(0.8)
    assert told["angular.z.max_velocity"] == pytest.approx(2 * 0.8 / (TRACK * 1.05))
    assert "speed_limit" in made.nearest


class Driven:
    """The exported robot in MuJoCo, driven by body twists; readings per step."""

    def __init__(self, effects: EffectSet) -> None:
        self.export: EffectExport = export_effects("mjcf", META, effects)
        self.model = mujoco.MjModel.from_xml_string(self.export.text)
        self.data = mujoco.MjData(self.model)
        self.drive(0.0, 0.0, 0.2)

    def drive(self, v: float, w: float, seconds: float) -> dict[str, np.ndarray]:
        """Rows of every sensor while the set-points are held."""
        self.data.ctrl[:] = (v - w * TRACK / 2) / RADIUS, (v + w * TRACK / 2) / RADIUS
        rows = []
        for _ in range(round(seconds / self.model.opt.timestep)):
            mujoco.mj_step(self.model, self.data)
            rows.append(np.concatenate(([self.data.time], self.data.sensordata, self.data.qvel[6:8])))
        table = np.array(rows)
        out = {"t": table[:, 0], "rates": table[:, -2:]}
        for i in range(self.model.nsensor):
            at = 1 + self.model.sensor_adr[i]
            out[self.model.sensor(i).name] = table[:, at : at + self.model.sensor_dim[i]]
        return out


def test_mujoco_drives_as_far_and_turns_as_fast_as_the_geometry_says() -> None:
    robot = Driven({"wheel_radius": {"scale": 1.02}})
    robot.drive(0.4, 0.0, 1.0)
    straight = robot.drive(0.4, 0.0, 2.0)
    gone = np.linalg.norm(straight["truth"][-1] - straight["truth"][0]) / (straight["t"][-1] - straight["t"][0])
    assert gone == pytest.approx(0.4 * 1.02, rel=5e-3)
    robot = Driven({"track_width": {"scale": 1.1}})
    robot.drive(0.0, 1.0, 1.0)
    turning = robot.drive(0.0, 1.0, 2.0)
    assert turning["gyro"][:, 2].mean() == pytest.approx(1.0 / 1.1, rel=0.02)


def test_mujoco_wheels_lag_wait_and_stop_at_their_limit() -> None:
    nominal = 0.4 / RADIUS
    lag = Driven({"motor_lag": {"tau": 0.15}}).drive(0.4, 0.0, 1.0)
    share = np.interp(0.15, lag["t"] - lag["t"][0], lag["rates"][:, 0]) / nominal
    assert share == pytest.approx(1 - math.exp(-1), abs=0.02)
    late = Driven({"command_delay": {"delay": 0.1}}).drive(0.4, 0.0, 0.5)
    reached = late["t"][np.argmax(late["rates"][:, 0] > nominal / 2)] - late["t"][0]
    assert reached == pytest.approx(0.1, abs=0.01)
    limited = Driven({"speed_limit": {"v_max": 0.25}}).drive(0.4, 0.0, 1.0)
    assert limited["rates"][-1, 0] * RADIUS == pytest.approx(0.25, rel=5e-3)
    gain = Driven({"drive_gain": {"gain": 0.9}}).drive(0.4, 0.0, 1.0)
    assert gain["rates"][-1, 0] == pytest.approx(0.9 * nominal, rel=5e-3)


def test_mujoco_imu_reads_tilt_mount_and_clip() -> None:
    tilted = Driven({"floor_tilt": {"slope_x": 0.02, "slope_y": 0.0}}).drive(0.0, 0.0, 0.5)
    assert tilted["accelerometer"][-50:, 0].mean() == pytest.approx(9.80665 * 0.02, rel=0.02)
    turned = Driven({"floor_tilt": {"slope_x": 0.02, "slope_y": 0.0}, "imu_yaw": {"angle": math.pi / 2}})
    assert turned.drive(0.0, 0.0, 0.5)["accelerometer"][-50:, 1].mean() == pytest.approx(-9.80665 * 0.02, rel=0.02)
    clipped = Driven({"gyro_clip": {"limit": 0.5}}).drive(0.0, 1.0, 1.0)
    assert clipped["gyro"][-50:, 2].max() == pytest.approx(0.5)


def test_what_cannot_be_exported_is_named() -> None:
    with pytest.raises(ParameterError, match="wheel_radius and track_width"):
        export_effects("sdf", RunMeta(robot=RobotParams()), {})
    with pytest.raises(ParameterError, match="no export 'urdf'"):
        export_effects("urdf", META, {})
    with pytest.raises(ParameterError, match="gyro_bias"):
        export_effects("mjcf", META, {"gyro_bias": {"bias": math.nan}})
