"""The diagnosis on robots of another program: causes found, clean runs left alone, strangers not given a name."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from core.errors import MissingStreamError, NotEnoughDataError, ParameterError
from core.gap import Diagnosis, as_json, diagnose
from core.gap._pose_numba import whiten_offset
from core.gap.floor import measure
from core.gap.reference import restarts_of
from core.gap.scatter import angle_costs
from core.gap.smoothing import smooth
from core.gap.whiten import residuals_of
from core.gap.world import make_world
from core.run import Run
from tests.plants.gap_plant import Effects, Plan, record

SEED = 11


def made(effects: Effects, seconds: float = 30.0, **options: object) -> Run:
    """One drive of the plant with these effects."""
    return record(Plan(SEED, seconds=seconds, effects=effects, **options))  # type: ignore[arg-type]


def causes(found: Diagnosis) -> dict[str, dict[str, float]]:
    """Effects of the joint explanation with their parameters."""
    return {
        one.effect: {name: float(v.value) for name, v in one.parameters.items() if not isinstance(v.value, str)}
        for one in found.causes
        if one.probability > 0.5
    }


def test_clean_robot_is_left_alone() -> None:
    found = diagnose([made({})])
    assert found.verdict == "none"
    assert not causes(found)
    assert found.where == ()
    assert found.gap.total.before == pytest.approx(found.gap.total.floor, rel=0.05)


def test_two_causes_in_two_links_are_both_found_and_the_gap_closes_on_another_drive() -> None:
    effects = {"motor_lag": {"tau": 0.06}, "gyro_scale": {"scale": 1.02}}
    found = diagnose([made(effects)], held_out=[made(effects, profile="stops")])
    assert found.verdict == "explained"
    sizes = causes(found)
    assert set(sizes) == set(effects)
    assert sizes["motor_lag"]["tau"] == pytest.approx(0.06, abs=0.002)
    assert sizes["gyro_scale"]["scale"] == pytest.approx(1.02, abs=5e-4)
    assert found.gap.held_out
    assert found.gap.shrink is not None and found.gap.shrink > 0.95
    assert found.where[0].stream.startswith("wheels")
    assert found.link == "commands to wheels"


def test_an_effect_of_no_library_gets_no_name() -> None:
    found = diagnose([made({}, outside={"gyro_cubic": 0.03})])
    assert found.verdict == "unknown"
    assert not causes(found)
    assert found.unexplained is not None
    assert found.unexplained.stream == "imu.gz"
    assert "truth.w" in found.unexplained.depends_on


def test_without_truth_and_with_what_the_simulator_knows_already() -> None:
    effects = {"motor_lag": {"tau": 0.06}, "beacon_delay": {"delay": 0.3}}
    run = made(effects, truth=False)
    found = diagnose([run], simulator={"motor_lag": {"tau": 0.06}})
    assert causes(found) == {"beacon_delay": {"delay": pytest.approx(0.3, abs=0.01)}}


def test_a_flaw_below_its_tolerance_is_told_apart() -> None:
    found = diagnose([made({"track_width": {"scale": 1.0015}})])
    assert found.verdict == "none"
    assert "track_width" in [one.effect for one in found.immaterial]


def test_a_servo_that_lags_otherwise_in_turning_is_no_cause() -> None:
    run = made({})
    assert run.wheels is not None
    half = 0.5 * (run.wheels.right - run.wheels.left)
    late = 0.003 * np.gradient(half) / np.gradient(run.wheels.t)
    wheels = dataclasses.replace(run.wheels, left=run.wheels.left + late, right=run.wheels.right - late)
    found = diagnose([dataclasses.replace(run, wheels=wheels)])
    assert found.verdict == "none"
    assert not causes(found)


def test_a_sheet_that_is_wrong_for_all_sensors_is_no_cause() -> None:
    found = diagnose([made({}, stated=1 / 1.5)])
    assert found.verdict == "none"
    assert any("times what run.json states" in note for note in found.notes)


def test_json_is_gap_1_without_nan() -> None:
    slow = {"gyro_bias": {"bias": 0.004}}  # without commands the drive is smoothed from encoders: its flaws are no walk
    out = as_json(diagnose([made(slow, commands=False)]))
    text = json.dumps(out, allow_nan=False)
    assert json.loads(text)["schema"] == "gap/1"
    assert [one["effect"] for one in out["causes"] if one["probability"] > 0.5] == ["gyro_bias"]
    assert {"before", "after", "floor", "shrink", "shrink_ci", "held_out", "by_stream"} <= set(out["gap"])
    assert out["unexplained"] is None


def test_bad_input_is_refused_with_advice() -> None:
    run = made({}, seconds=12.0)
    with pytest.raises(MissingStreamError, match="neither commands nor wheels"):
        diagnose([dataclasses.replace(run, commands=None, wheels=None)])
    with pytest.raises(ParameterError, match="also given to fit"):
        diagnose([run], held_out=[run])
    other = dataclasses.replace(
        run, meta=dataclasses.replace(run.meta, robot=dataclasses.replace(run.meta.robot, wheel_radius=0.2))
    )
    with pytest.raises(ParameterError, match="another robot"):
        diagnose([run, other])
    with pytest.raises(MissingStreamError, match=r"run 2 .* has no commands, run 1 has"):
        diagnose([run, dataclasses.replace(run, commands=None)])
    with pytest.raises(NotEnoughDataError, match="too few"):
        diagnose([run.crop(0.0, 2.0)])
    assert run.imu is not None and run.truth is not None and run.beacon is not None and run.commands is not None
    with pytest.raises(ParameterError, match=r"beacon of .* 3\.\d s after it: their clocks do not match"):
        diagnose([dataclasses.replace(run, beacon=dataclasses.replace(run.beacon, t=run.beacon.t + 3.0))])
    with pytest.raises(ParameterError, match=r"commands of .* 2\.0 s after it"):
        diagnose([dataclasses.replace(run, commands=dataclasses.replace(run.commands, t=run.commands.t + 2.0))])
    with pytest.raises(MissingStreamError, match=r"imu\.gz of .* holds no value"):
        diagnose([dataclasses.replace(run, imu=dataclasses.replace(run.imu, gz=np.full(len(run.imu), np.nan)))])
    with pytest.raises(ParameterError, match=r"imu of .* 2\.0 s after it: their clocks do not match"):
        diagnose([dataclasses.replace(run, imu=dataclasses.replace(run.imu, t=run.imu.t + 2.0))])
    with pytest.raises(ParameterError, match=r"truth of .* 1\.5 s before it"):
        diagnose([dataclasses.replace(run, truth=dataclasses.replace(run.truth, t=run.truth.t - 1.5))])


def test_floor_is_the_sensors_own_noise_whatever_effect_acts() -> None:
    run = made({"gyro_bias": {"bias": 0.05}, "beacon_delay": {"delay": 0.4}})
    world = make_world(run, restarts_of(run))
    body = world.body([{}])
    floor = measure([world], [residuals_of(world, world.wheels([{}]), body)], [body.speed[0]])
    for name in ("imu.gz", "imu.ax", "beacon.theta", "ranges.range"):
        assert floor.sigma[name] == pytest.approx(floor.sheet[name], rel=0.12)
    assert floor.sigma["truth.x"] == pytest.approx(3e-4, rel=0.1)


def test_what_smoothed_encoders_leave_is_whitened_and_a_walk_beside_it_is_not() -> None:
    rng, n, rate, sway, pace = np.random.default_rng(3), 6000, 100.0, 4e-3, 4.0
    push = np.sqrt(4.0 * 0.7 * pace * sway**2 * rate) * rng.standard_normal(n)
    angle, speed, sways = 0.0, 0.0, np.zeros(n)
    for k in range(n):
        speed += (push[k] - 1.4 * pace * speed - pace**2 * angle) / rate
        angle += speed / rate
        sways[k] = speed
    values = sways + 1e-3 * rng.standard_normal(n)
    t, white = np.arange(n) / rate, values[None, :].copy()
    whiten_offset(t, np.full(n, 1e-3), 0.0, sway, pace, white)
    assert np.mean(white**2) == pytest.approx(1.0, abs=0.1)
    assert abs(np.mean(white[0, 1:] * white[0, :-1])) < 0.08
    means, sums = values.reshape(-1, 100).mean(axis=1), np.full(n // 100, 1e-6 / 100)
    walks = np.array([0.0, 2e-4, 5e-4, 1e-3])
    at = np.arange(n // 100, dtype=np.float64) + 0.5
    assert np.argmin(angle_costs(at, np.cumsum(means), sums, (sway / pace) ** 2, walks)) == 0
    walk = np.cumsum(rng.standard_normal(n // 100)) * 5e-4
    assert walks[np.argmin(angle_costs(at, np.cumsum(means + walk), sums, (sway / pace) ** 2, walks))] == 5e-4


def test_smoothing_keeps_motion_and_takes_noise() -> None:
    t = np.linspace(0.0, 10.0, 600)
    curve = np.sin(t)
    noisy = curve + np.random.default_rng(1).normal(0.0, 0.05, len(t))
    assert np.sqrt(np.mean((smooth(noisy, 0.05) - curve) ** 2)) < 0.4 * 0.05
