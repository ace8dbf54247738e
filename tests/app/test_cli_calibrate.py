"""`driftscope calibrate` and `driftscope correct` as a user meets them."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from app.cli import main
from core.formats import read_run, write_run
from core.run import Run, RunMeta
from core.sensors import ImuLog, WheelLog
from tests.plants.imu_rig import draw_rig, rest_run

RIG = draw_rig(21, rate=20.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two minutes at rest, gyro only, and the calibration from it."""
    here = tmp_path_factory.mktemp("calibrate")
    run = rest_run(RIG, 1, 120.0)
    assert run.imu is not None
    run = dataclasses.replace(run, imu=dataclasses.replace(run.imu, ax=None, ay=None, az=None))
    write_run(run, here / "rest", "folder-csv")
    assert main(["calibrate", str(here / "rest"), "--json", str(here / "calibration.json")]) == 0
    t = np.arange(60) / 50
    write_run(Run(RunMeta(name="bare"), wheels=WheelLog(t, t, t)), here / "bare", "folder-csv")
    write_run(Run(RunMeta(name="short"), imu=ImuLog(t, np.sin(t))), here / "short", "folder-csv")
    (here / "bad.json").write_text('{"schema": "calibration/1", "gyro": {"matrix": 3}}')
    return here


def test_calibrate_writes_schema_and_table(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate", str(folder / "rest"), "--json", str(folder / "again.json")]) == 0
    out, err = capsys.readouterr()
    assert [line.split()[0] for line in out.splitlines()[1:]] == ["gx", "gy", "gz", "ax", "ay", "az"]
    assert "driftscope: note: gyro.matrix: null" in err
    data = json.loads((folder / "again.json").read_text())
    assert data["schema"] == "calibration/1"
    np.testing.assert_allclose(data["gyro"]["static_bias"], RIG.gyro.static_bias, atol=2e-4)
    assert data["accel"]["noise_sd"] == [None, None, None]


def test_correct_writes_a_run_and_its_report(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["correct", str(folder / "rest"), "--calibration", str(folder / "calibration.json")]
    assert main([*arguments, "--out", str(folder / "out"), "--json", "-"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["schema"] == "correction/1"
    assert report["axes"] == ["ax", "ay", "az", "gx", "gy", "gz"]
    assert report["online"]["mean"][0] is None
    assert min(report["noise_factor"][3:]) > 5
    made = read_run(folder / "out")
    assert made.imu is not None
    assert abs(float(np.mean(made.imu.gz))) < 1e-4
    assert made.meta.procedure is not None
    assert main([*arguments, "--out", str(folder / "out")]) == 2
    assert "is there already" in capsys.readouterr().err
    assert main([*arguments, "--out", str(folder / "hindsight"), "--offline"]) == 0
    assert read_run(folder / "hindsight").imu is not None


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["calibrate", "nowhere"], "no such file"),
        (["calibrate", "{folder}/bare"], "none of the runs has IMU readings"),
        (["calibrate", "{folder}/short"], "too short"),
        (["correct", "{folder}/rest", "--calibration", "nowhere.json", "--out", "{folder}/x"], "nowhere.json: no such"),
        (["correct", "{folder}/rest", "--calibration", "{folder}/bad.json", "--out", "{folder}/x"], "gyro.matrix"),
        (["correct", "{folder}/rest", "--calibration", "{folder}/rest", "--out", "{folder}/x"], "no such file"),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    arguments: list[str], told: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    assert main([a.format(folder=folder) for a in arguments]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert told in error
