"""Each link alone agrees with the whole chain where nothing is wrong, and stays blind to the links before it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from core.errors import MissingStreamError, ParameterError
from core.robot import EffectSet
from core.run import Run
from core.simulation import simulate
from core.simulation.links import (
    beacon_from_path,
    body_from_commands,
    body_from_poses,
    body_from_wheels,
    imu_from_path,
    ranges_from_path,
    truth_from_path,
    wheels_from_commands,
)

DRIVE: EffectSet = {"motor_lag": {"tau": 0.2}, "drive_gain": {"gain": 0.9}}
GROUND: EffectSet = {"track_width": {"scale": 0.9}, "side_slip": {"k": 0.1}}
SENSORS: EffectSet = {
    "gyro_bias": {"bias": 0.01}, "gyro_clip": {"limit": 0.9}, "accel_scale": {"x": 1.1, "y": 0.9},
    "imu_clock": {"offset": 0.02}, "beacon_shift": {"x": 0.3, "y": 0.0}, "range_bias": {"bias": 0.2},
}  # fmt: skip


def test_wheels_from_commands(wild: Run) -> None:
    effects = {**DRIVE, "missed_ticks": {"left": 0.01, "right": 0.0}}
    whole = simulate(wild, {**effects, **GROUND}, 0, noise=False).wheels
    alone = wheels_from_commands(wild, effects)
    assert whole is not None
    np.testing.assert_allclose(alone.left, whole.left, rtol=0, atol=1e-7)
    np.testing.assert_allclose(alone.right, whole.right, rtol=0, atol=1e-7)


@pytest.mark.parametrize("effects", [DRIVE, GROUND, SENSORS, {**DRIVE, **GROUND, **SENSORS}])
def test_sensors_along_the_commanded_path_are_the_whole_chains(effects: EffectSet, wild: Run) -> None:
    whole = simulate(wild, effects, 0, noise=False)
    path = body_from_commands(wild, effects)
    assert whole.imu and whole.beacon and whole.ranges and whole.truth and whole.imu.ax is not None
    imu, fixes = imu_from_path(path, wild, effects), beacon_from_path(path, wild, effects)
    np.testing.assert_allclose(imu.gz[3:], whole.imu.gz[3:], atol=2e-3)
    np.testing.assert_allclose(np.median(np.abs(imu.gz - whole.imu.gz)), 0.0, atol=1e-9)
    assert imu.ax is not None
    np.testing.assert_allclose(np.median(np.abs(imu.ax - whole.imu.ax)), 0.0, atol=1e-9)
    np.testing.assert_allclose(fixes.x, whole.beacon.x, atol=1e-9)
    np.testing.assert_allclose(ranges_from_path(path, wild, effects).range, whole.ranges.range, atol=1e-9)
    truth = truth_from_path(path, wild)
    assert truth.theta is not None and whole.truth.theta is not None
    np.testing.assert_allclose(truth.theta, whole.truth.theta, atol=1e-9)


def test_body_from_wheels_does_not_see_the_drive(wild: Run) -> None:
    """Recorded wheels carry what the drive did and what ticks were missed; the link adds only what comes after."""
    effects: EffectSet = {**DRIVE, **GROUND, "missed_ticks": {"left": 0.03, "right": 0.01}}
    recorded = simulate(wild, effects, 0, noise=False)
    path = body_from_wheels(recorded, effects)
    found = truth_from_path(path, recorded)
    truth = recorded.truth
    assert truth and truth.x is not None and truth.y is not None and found.x is not None and found.y is not None
    assert np.max(np.hypot(found.x - truth.x, found.y - truth.y)) < 0.01
    np.testing.assert_array_equal(
        path.nodes, body_from_wheels(recorded, {k: effects[k] for k in effects if k not in DRIVE}).nodes
    )
    blind = truth_from_path(body_from_wheels(recorded, {}), recorded)
    assert blind.x is not None and blind.y is not None
    assert np.max(np.hypot(blind.x - truth.x, blind.y - truth.y)) > 0.3


def test_sensors_along_a_recorded_path(wild: Run) -> None:
    """Poses at 50 Hz of a smooth drive give the gyro, accelerometer, fixes and ranges of that drive."""
    smooth = dataclasses.replace(wild, commands=dataclasses.replace(wild.commands, v=wild.commands.v * 0 + 0.4))  # type: ignore[type-var, union-attr]
    drive = simulate(smooth, {"motor_lag": {"tau": 0.3}}, 0, noise=False)
    assert drive.truth and drive.imu and drive.beacon and drive.ranges and drive.imu.ax is not None
    assert drive.truth.x is not None and drive.truth.y is not None and drive.truth.theta is not None
    wrapped = np.angle(np.exp(1j * drive.truth.theta))
    path = body_from_poses(drive, drive.truth.t, drive.truth.x, drive.truth.y, wrapped)
    inner = (drive.imu.t > 1.0) & (drive.imu.t < 59.0)
    imu = imu_from_path(path, drive, {})
    assert imu.ax is not None and imu.ay is not None and drive.imu.ay is not None
    assert np.std((imu.gz - drive.imu.gz)[inner]) < 1e-3
    assert np.std((imu.ax - drive.imu.ax)[inner]) < 0.02
    assert np.std((imu.ay - drive.imu.ay)[inner]) < 0.02
    assert np.max(np.abs(beacon_from_path(path, drive, {}).x - drive.beacon.x)) < 1e-4
    assert np.max(np.abs(ranges_from_path(path, drive, {}).range - drive.ranges.range)) < 1e-4
    tilted = imu_from_path(path, drive, {"floor_tilt": {"slope_x": 0.02}})
    assert tilted.ax is not None
    assert np.max(np.abs(tilted.ax - imu.ax)) == pytest.approx(0.02 * 9.80665, rel=0.02)


def test_what_a_link_lacks_is_named(wild: Run) -> None:
    path = body_from_commands(wild, {})
    for stream, link in (("imu", imu_from_path), ("beacon", beacon_from_path), ("ranges", ranges_from_path)):
        with pytest.raises(MissingStreamError, match=f"{stream}|fixes"):
            link(path, dataclasses.replace(wild, **{stream: None}), {})  # type: ignore[arg-type]
    with pytest.raises(MissingStreamError, match="wheels"):
        body_from_wheels(dataclasses.replace(wild, wheels=None), {})
    with pytest.raises(MissingStreamError, match="commands"):
        wheels_from_commands(dataclasses.replace(wild, commands=None), {})
    with pytest.raises(MissingStreamError, match="truth"):
        truth_from_path(path, dataclasses.replace(wild, truth=None))
    three = np.arange(3.0)
    with pytest.raises(ParameterError, match="four"):
        body_from_poses(wild, three, three, three, three)
