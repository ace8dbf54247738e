"""The MuJoCo example, registered as a user would: it drives as the commands say, models its effects, takes the rest."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from app.simulators import SimulatorError, registered
from core.run import Run
from core.simulation import simulate
from core.simulation.foreign import Foreign, around
from core.simulation.scenarios import SCENARIOS, Rates

ENTRY = {
    "python": "app.examples.mujoco_robot:simulate",
    "effects": ["motor_lag", "speed_limit", "unequal_wheels", "floor_tilt"],
}
RATES = Rates(commands=20.0, wheels=20.0, imu=50.0, beacon=5.0, ranges=4.0, truth=20.0)


@pytest.fixture(scope="module")
def mujoco(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Foreign]:
    path = tmp_path_factory.mktemp("mujoco") / "simulators.json"
    path.write_text(json.dumps({"mujoco": ENTRY}))
    found = registered(path)["mujoco"]
    yield found
    found.simulate.close()  # type: ignore[attr-defined]  # ends its process


def drive(name: str) -> Run:
    return SCENARIOS[name].run(RATES)


def test_it_drives_and_reads_as_the_equations_say(mujoco: Foreign) -> None:
    run = drive("in-place").crop(0.0, 20.0)
    made, nominal = around(mujoco, run, {}, 1), simulate(run, {}, 1, noise=False)
    assert made.truth and made.imu and made.wheels and made.beacon and made.ranges
    assert nominal.truth and nominal.imu and nominal.wheels and nominal.beacon and nominal.ranges
    np.testing.assert_allclose(made.truth.theta, nominal.truth.theta, atol=0.01)
    np.testing.assert_allclose(made.truth.x, nominal.truth.x, atol=0.005)
    np.testing.assert_allclose(made.wheels.right, nominal.wheels.right, atol=0.05)
    assert np.corrcoef(made.imu.gz, nominal.imu.gz)[0, 1] > 0.99
    assert np.std(made.ranges.range - nominal.ranges.range) == pytest.approx(run.meta.noise.range, rel=0.3)
    assert np.std(made.beacon.x - nominal.beacon.x) == pytest.approx(run.meta.noise.beacon_xy, rel=0.3)
    again = around(mujoco, run, {}, 1)
    np.testing.assert_array_equal(made.imu.gz, again.imu.gz)  # type: ignore[union-attr]


def test_its_own_effects_and_those_around_it_are_found_again(mujoco: Foreign) -> None:
    run, tau, ratio, bias = drive("straight"), 0.15, 1.01, 0.02
    nominal = around(mujoco, run, {}, 1)
    effects = {"motor_lag": {"tau": tau}, "unequal_wheels": {"ratio": ratio}, "gyro_bias": {"bias": bias}}
    made = around(mujoco, run, effects, 1)
    assert run.commands and made.truth and made.wheels and nominal.wheels and made.imu and nominal.imu
    cruise = int(np.argmax(np.interp(run.wheels.t, run.commands.t, run.commands.v)))  # type: ignore[union-attr]
    fastest, radius, track = float(run.commands.v.max()), 0.075, 0.32
    behind = nominal.wheels.left[cruise + 40] - made.wheels.left[cruise + 40]
    assert behind == pytest.approx(fastest * tau / radius, rel=0.05)
    # wheels of 2r/(1 + q) and 2rq/(1 + q) turn the body by their difference over the track
    way = radius * float(made.wheels.left[-1])
    turned = float(made.truth.theta[-1] - made.truth.theta[0])  # type: ignore[index]
    assert turned == pytest.approx(2.0 * way * (ratio - 1.0) / (1.0 + ratio) / track, rel=0.05)
    assert float(np.mean(made.imu.gz - nominal.imu.gz)) - turned / run.duration == pytest.approx(bias, abs=1e-3)


def test_what_it_cannot_do_is_told(mujoco: Foreign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = drive("straight")
    with pytest.raises(SimulatorError, match=r"does not model bump"):
        mujoco.simulate(run, {"bump": {"time": 1.0, "distance": 0.1, "turn": 0.0}}, 0)
    with pytest.raises(SimulatorError, match="needs the run's commands"):
        mujoco.simulate(dataclasses.replace(run, commands=None), {}, 0)
    (tmp_path / "mujoco.py").write_text("raise ImportError('No module named mujoco')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    (tmp_path / "simulators.json").write_text(
        json.dumps({"mujoco": ENTRY, "typo": {"python": "no_such_room:simulate"}})
    )
    without = registered(tmp_path / "simulators.json")
    with pytest.raises(SimulatorError, match=r"needs MuJoCo .*driftscope\[mujoco\]"):
        without["mujoco"].simulate(run, {}, 0)
    with pytest.raises(SimulatorError, match="No module named 'no_such_room'"):
        without["typo"].simulate(run, {}, 0)
