"""`driftscope firmware` as a user meets it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from app.cli import main

SHOWN = {
    "schema": "calibration/1",
    "gyro": {
        "static_bias": [0.01, -0.02, 0.005],
        "drift_amplitude": [0.001, None, 0.002],
        "drift_tau": [900.0, None, 1200.0],
        "matrix": [[1.01, 0, 0], [0, 0.99, 0], [0, 0, 1.0]],
        "noise_sd": [0.002, 0.002, 0.002],
    },
    "accel": {"static_bias": None, "drift_amplitude": None, "drift_tau": None, "matrix": None, "noise_sd": None},
    "sd": {"gyro": {"static_bias": [1e-5, 1e-5, 2e-5]}},
}


@pytest.fixture
def calibration(tmp_path: Path) -> Path:
    path = tmp_path / "calibration.json"
    path.write_text(json.dumps(SHOWN), encoding="utf-8")
    return path


@pytest.mark.parametrize("bias", ["best", "C"])
def test_firmware_writes_the_files_and_says_what_it_decided(
    bias: str, calibration: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "made" / "here"
    assert main(["firmware", "--calibration", str(calibration), "--bias", bias, "--out", str(out)]) == 0
    said = capsys.readouterr()
    assert said.out == ""
    assert all(line.startswith("driftscope: note: ") for line in said.err.splitlines())
    assert "ax, ay, az: static bias is unknown" in said.err
    assert "gy: drifting bias is unknown" in said.err
    names = {path.name for path in out.iterdir()}
    assert {"driftscope.h", "driftscope.c", "ds_bias.h", "ds_bias.c", "ds_constants.h", "README.md"} <= names
    header = (out / "ds_constants.h").read_text(encoding="utf-8")
    assert "gz: calibration, sd 2e-05" in header
    assert "100 Hz" in header


def test_rate_and_noise_are_taken(calibration: Path, tmp_path: Path) -> None:
    allan = {"schema": "allan/1", "axis": "imu.gz", "N": 2e-4, "B": None, "K": 1e-6}
    (tmp_path / "allan.json").write_text(json.dumps(allan), encoding="utf-8")
    call = ["firmware", "--calibration", str(calibration), "--bias", "C", "--out", str(tmp_path), "--rate", "400"]
    assert main([*call, "--noise", str(tmp_path / "allan.json")]) == 0
    header = (tmp_path / "ds_constants.h").read_text(encoding="utf-8")
    assert "400 Hz" in header
    assert "#define DS_C_HALF_STEP_US 1250U" in header


@pytest.mark.parametrize(
    ("change", "options", "words"),
    [
        (None, [], "no such file"),
        ("{", [], "this is no JSON"),
        ({"schema": "calibration/2"}, [], "schema: expected 'calibration/1'; found calibration/2"),
        ({"gyro": {"static_bias": [1, 2]}}, [], "gyro.static_bias: expected a list of 3"),
        ({"gyro": {"matrix": [[1, 0, 0], [1, 0, 0], [0, 0, 1]]}}, [], "gyro.matrix: expected a matrix that can be"),
        ({}, ["--rate", "1e9"], "the IMU's rate is 1e+09 Hz, expected 10 to 10000"),
        ({}, ["--bias", "D"], "no bias tracker 'D'"),
        ({}, ["--noise", "nowhere.json"], "nowhere.json: no such file"),
    ],
)
def test_bad_input_is_told_in_one_line(
    change: object,
    options: list[str],
    words: str,
    calibration: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    if change is None:
        calibration.unlink()
    else:
        text = change if isinstance(change, str) else json.dumps({**SHOWN, **change})
        calibration.write_text(text, encoding="utf-8")
    out = tmp_path / "out"
    assert main(["firmware", "--calibration", str(calibration), "--bias", "C", "--out", str(out), *options]) == 2
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1
    assert not out.exists()
