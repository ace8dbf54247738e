"""A simulator that is not ours: effects around it are the ones inside ours, or refused; bad answers are named."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from core.effects import EFFECTS
from core.errors import FormatError, ParameterError
from core.robot import EffectSet
from core.run import Run
from core.simulation import simulate
from core.simulation.foreign import FINISHED, REFUSED, Foreign, around, recorded
from core.simulation.scenarios import SCENARIOS

SIZES: dict[str, dict[str, float | str]] = {
    "command_delay": {"delay": 0.13},
    "deadband": {"width": 0.05},
    "drive_gain": {"gain": 0.93},
    "battery_sag": {"rate": 0.002},
    "wheel_radius": {"scale": 1.03},
    "track_width": {"scale": 1.05},
    "gyro_bias": {"bias": 0.01},
    "gyro_drift": {"amplitude": 0.01, "tau": 25.0},
    "gyro_temperature": {"slope": 1e-3},
    "gyro_scale": {"scale": 1.04},
    "gyro_clip": {"limit": 0.3},
    "accel_bias": {"x": 0.05, "y": -0.02},
    "accel_scale": {"x": 1.05, "y": 0.9},
    "imu_yaw": {"angle": 0.2},
    "imu_offset": {"x": 0.1, "y": 0.05},
    "beacon_delay": {"delay": 0.21},
    "beacon_shift": {"x": 0.2, "y": -0.1},
    "beacon_rotation": {"angle": 0.1},
    "beacon_scale": {"scale": 1.02},
    "tag_offset": {"x": 0.1, "y": 0.02},
    "anchor_moved": {"beacon": "B2", "x": 0.3, "y": 0.1},
    "range_bias": {"bias": 0.2},
    "imu_clock": {"offset": 0.017},
    "clock_drift": {"skew": 1e-3},
}
NOISY = {
    "gyro_walk": {"density": 1e-3},
    "gyro_noise": {"factor": 3.0},
    "beacon_noise": {"factor": 3.0},
    "beacon_outliers": {"rate": 0.2, "size": 2.0},
}


@pytest.fixture(scope="module")
def run() -> Run:
    made = SCENARIOS["slalom"].run()
    assert made.imu is not None
    warm = 20.0 + np.linspace(0.0, 8.0, len(made.imu))
    return dataclasses.replace(made, imu=dataclasses.replace(made.imu, temperature=warm))


def nominal(run: Run, effects: EffectSet, seed: int) -> Run:
    """Our own simulator without noise, in the place of the user's."""
    assert not effects
    return simulate(run, {}, seed, noise=False)


FOREIGN = Foreign("theirs", nominal)


def silent(run: Run) -> Run:
    """Without data-sheet noise."""
    noise = dataclasses.replace(
        run.meta.noise, gyro_density=0.0, accel_density=0.0, beacon_xy=0.0, beacon_theta=0.0, range=0.0
    )
    return dataclasses.replace(run, meta=dataclasses.replace(run.meta, noise=noise))


def columns(run: Run) -> dict[str, Any]:
    return {
        f"{stream}.{f.name}": getattr(log, f.name)
        for stream, log in run.logs().items()
        if stream != "commands"
        for f in dataclasses.fields(log)
        if isinstance(getattr(log, f.name), np.ndarray)
    }


@pytest.mark.parametrize("effect", SIZES)
def test_around_is_as_inside(run: Run, effect: str) -> None:
    run = silent(run)
    expected = columns(simulate(run, {effect: SIZES[effect]}, 0, noise=False))
    found = columns(around(FOREIGN, run, {effect: SIZES[effect]}, 0))
    assert found.keys() == expected.keys()
    late = SIZES[effect].get("delay", 0.0) if effect == "beacon_delay" else 0.0
    for name, values in expected.items():
        if late and name.startswith(("beacon.", "ranges.")):
            values = values[len(values) - len(found[name]) :]  # asked for before the run began: left out
        if name.startswith("imu.a") and effect == "deadband":  # blows of a jump, spread over EDGE
            assert np.median(np.abs(found[name] - values)) < 1e-6
            continue
        # ours lets the battery fade in a chord per piece, around it the chords are longer
        near = 2e-5 if effect == "battery_sag" and name.startswith("imu.a") else 2e-6
        np.testing.assert_allclose(found[name], values, atol=near, rtol=0, err_msg=name)


@pytest.mark.parametrize("effect", NOISY)
def test_noise_around_is_as_large_as_inside(run: Run, effect: str) -> None:
    theirs = Foreign("theirs", lambda run, effects, seed: simulate(run, {}, 5))
    quiet = columns(simulate(run, {}, 0, noise=False))
    inside, outside = (
        columns(simulate(run, {effect: NOISY[effect]}, 1)),
        columns(around(theirs, run, {effect: NOISY[effect]}, 2)),
    )
    for name in ("imu.gz",) if effect.startswith("gyro") else ("beacon.x", "ranges.range"):
        sizes = [np.std(each[name] - quiet[name]) for each in (inside, outside)]
        assert sizes[1] == pytest.approx(sizes[0], rel=0.6 if effect in ("gyro_walk", "beacon_outliers") else 0.1)


def test_every_effect_goes_around_or_is_refused_with_its_reason(run: Run) -> None:
    assert {*SIZES, *NOISY, *REFUSED} == set(EFFECTS)
    for effect in REFUSED:
        values = {p.name: p.neutral for p in EFFECTS[effect].parameters}
        switched = {p: 0.5 if np.isinf(float(values[p])) else float(values[p]) + 0.05 for p in EFFECTS[effect].switch}
        with pytest.raises(ParameterError, match=REFUSED[effect].split(",")[0]):
            around(FOREIGN, run, {effect: {**values, **switched}}, 0)
        assert effect in FOREIGN.refuses()


def test_effects_of_its_own_reach_the_simulator(run: Run) -> None:
    got: list[EffectSet] = []

    def theirs(run: Run, effects: EffectSet, seed: int) -> Run:
        got.append(effects)
        return simulate(run, effects, seed, noise=False)

    foreign = Foreign("theirs", theirs, frozenset({"motor_lag"}))
    around(foreign, run, {"motor_lag": {"tau": 0.1}, "gyro_bias": {"bias": 0.01}}, 0)
    assert got == [{"motor_lag": {"tau": 0.1}}]
    assert "motor_lag" not in foreign.refuses()


def test_a_recording_gives_its_readings_and_takes_no_inputs(run: Run) -> None:
    made = simulate(run, {}, 3)
    foreign = recorded("last week", made)
    found = around(foreign, silent(run), {"gyro_bias": {"bias": 0.01}}, 0)
    assert made.imu is not None and found.imu is not None
    np.testing.assert_allclose(found.imu.gz, made.imu.gz + 0.01, atol=1e-12)
    assert set(foreign.refuses()) == EFFECTS.keys() - FINISHED
    for effect in ("drive_gain", "imu_yaw", "beacon_delay"):
        with pytest.raises(ParameterError, match=f"{effect} .* recording"):
            around(foreign, run, {effect: SIZES[effect]}, 0)
    other = dataclasses.replace(run, commands=dataclasses.replace(run.commands, v=run.commands.v * 1.1))
    with pytest.raises(ParameterError, match="driven by other commands"):
        around(foreign, other, {}, 0)


@pytest.mark.parametrize(
    ("broken", "named"),
    [
        (lambda r: dataclasses.replace(r, imu=None), "no imu"),
        (lambda r: dataclasses.replace(r, wheels=r.wheels.crop(0.0, 3.0)), "wheels at other stamps"),
        (lambda r: dataclasses.replace(r, truth=dataclasses.replace(r.truth, x=r.truth.x * np.nan)), r"truth\.x"),
    ],
)
def test_a_bad_answer_is_named(run: Run, broken: Any, named: str) -> None:
    foreign = Foreign("theirs", lambda run, effects, seed: broken(simulate(run, {}, 0)))
    with pytest.raises(FormatError, match=named) as caught:
        around(foreign, run, {}, 0)
    assert "theirs" in str(caught.value)


def test_less_noise_than_there_is_is_refused(run: Run) -> None:
    with pytest.raises(ParameterError, match="gyro_noise below 1"):
        around(FOREIGN, run, {"gyro_noise": {"factor": 0.5}}, 0)
