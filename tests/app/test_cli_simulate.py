"""`driftscope simulate`: a run and an effect set in, a run folder out."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from app.cli import main
from core.formats import read_run
from core.simulation import simulate
from core.simulation.scenarios import SCENARIOS

MISSION = Path(__file__).resolve().parents[2] / "app" / "examples" / "simulated-mission"


def test_it_writes_what_the_library_simulates(tmp_path: Path) -> None:
    effects = {"gyro_scale": {"scale": 1.02}}
    (tmp_path / "e.json").write_text(json.dumps({"effects": effects}))
    arguments = ["simulate", str(MISSION), "--effects", str(tmp_path / "e.json"), "--seed", "7", "--out"]
    assert main([*arguments, str(tmp_path / "out")]) == 0
    made, expected = read_run(tmp_path / "out"), simulate(read_run(MISSION), effects, 7)
    assert made.imu is not None and expected.imu is not None
    np.testing.assert_array_equal(made.imu.gz, expected.imu.gz)
    assert made.meta.effects == read_run(MISSION).meta.effects
    assert made.meta.extra["simulated"] == {"effects": effects, "seed": 7, "simulator": "nominal"}


def test_a_diagnosis_gives_its_joint_explanation(tmp_path: Path) -> None:
    likely = {"effect": "gyro_bias", "probability": 0.97, "parameters": {"bias": {"value": 0.01, "std": 1e-4}}}
    doubtful = {"effect": "track_width", "probability": 0.2, "parameters": {"scale": {"value": 1.1, "std": 0.1}}}
    (tmp_path / "d.json").write_text(json.dumps({"schema": "gap/1", "causes": [likely, doubtful]}))
    run = ["simulate", "scenario:straight", "--no-noise", "--out"]
    assert main([*run, str(tmp_path / "a"), "--effects", str(tmp_path / "d.json")]) == 0
    expected = simulate(SCENARIOS["straight"].run(), {"gyro_bias": {"bias": 0.01}}, 0, noise=False)
    imu = read_run(tmp_path / "a").imu
    assert imu is not None and expected.imu is not None
    np.testing.assert_array_equal(imu.gz, expected.imu.gz)


@pytest.mark.parametrize(
    ("document", "named"),
    [
        ({"effects": {"gyro_bias": {"bias": 90.0}}}, "gyro_bias: bias is 90 rad/s"),
        ({"effects": {"gravity_waves": {}}}, "gravity_waves"),
        ({"effects": {"gyro_bias": {"offset": 0.1}}}, "offset"),
        ({"effects": {"gyro_bias": 0.1}}, "effects.gyro_bias must be an object"),
        ({"schema": "gap/1", "causes": {}}, "causes must be a list"),
        ([1], "expected an object, found list"),
        ({"x": 1}, "neither an effect set"),
    ],
)
def test_bad_effects_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], document: object, named: str
) -> None:
    (tmp_path / "e.json").write_text(json.dumps(document))
    arguments = ["simulate", "scenario:straight", "--effects", str(tmp_path / "e.json"), "--out", str(tmp_path / "o")]
    assert main(arguments) == 2
    told = capsys.readouterr().err
    assert named in told and told.count("\n") == 1
    assert not (tmp_path / "o").exists()


def test_an_unknown_scenario_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "scenario:moon", "--out", str(tmp_path / "o")]) == 2
    assert "figure-eight" in capsys.readouterr().err
