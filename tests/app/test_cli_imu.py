"""`driftscope bias` and `driftscope allan` as a user meets them."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from app.cli import main
from core.formats import write_run
from core.run import Run, RunMeta
from core.sensors import ImuLog, TruthLog, WheelLog


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Ten minutes at 50 Hz: rest, a turn of 1 rad, rest; bias 0.02 rad/s."""
    rng = np.random.default_rng(0)
    t = np.arange(0.0, 600.0, 0.02)
    rate = np.where((t > 300) & (t <= 310), 0.1, 0.0)
    imu = ImuLog(t, rate + 0.02 + 2e-3 * rng.standard_normal(len(t)))
    truth = TruthLog(t[::5], theta=np.clip(t[::5] - 300, 0, 10) * 0.1)
    write_run(Run(RunMeta(name="turn"), imu=imu, truth=truth), tmp_path / "turn", "folder-csv")
    return tmp_path / "turn"


@pytest.mark.parametrize("method", ["A", "B", "C", "best", "smoothed"])
def test_bias_writes_curve_and_result(
    method: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "bias.csv"
    assert main(["bias", str(folder), "--method", method, "--out", str(out), "--json", "-"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert set(result) == {"schema", "method", "max_deg", "deg_per_hour", "accepted", "segments", "runtime_s"}
    assert result["schema"] == "bias/1"
    assert result["method"] == method
    assert 0 < result["accepted"] <= result["segments"]
    assert result["max_deg"] < (90 if method in "AB" else 4)  # a turn at a steady rate is what B cannot see
    with out.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["t", "theta", "bias", "accepted"]
    assert len(rows) == 6000
    assert float(rows[-1]["bias"]) == pytest.approx(0.02, abs=1e-3)
    assert {row["accepted"] for row in rows} <= {"0", "1"}


def test_allan_writes_curve_and_fit(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["allan", str(folder), "--axis", "gz", "--json", "-"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["schema"] == "allan/1"
    assert result["axis"] == "imu.gz"
    columns = [result[key] for key in ("tau", "adev", "lo", "hi", "n")]
    assert len({len(column) for column in columns}) == 1
    assert all(low <= dev <= high for dev, low, high in zip(*columns[1:4], strict=True))
    assert {"N", "N_sd", "B", "B_sd", "K", "K_sd"} <= set(result)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["bias", "{run}", "--method", "D", "--out", "x.csv"], "no bias method 'D'"),
        (["allan", "{run}", "--axis", "ax"], "no imu.ax"),
        (["allan", "{run}", "--axis", "wheels"], "no IMU axis"),
        (["allan", "nowhere"], "no such file"),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    arguments: list[str], told: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([a.format(run=folder) for a in arguments]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert told in error


def test_a_run_without_gyro_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    t = np.arange(100.0)
    write_run(Run(wheels=WheelLog(t, t, t)), tmp_path / "wheels", "folder-csv")
    status = main(["bias", str(tmp_path / "wheels"), "--method", "best", "--out", str(tmp_path / "x.csv")])
    assert status == 2
    assert "no gyro" in capsys.readouterr().err


def test_allan_asks_about_degrees(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rate = 2e-3 * np.random.default_rng(1).standard_normal(5000)
    for name, scale in (("si", 1.0), ("degrees", 57.3)):
        run = Run(imu=ImuLog(np.arange(5000) / 50, scale * rate))
        write_run(run, tmp_path / name, "folder-csv")
        assert main(["allan", str(tmp_path / name)]) == 0
        told = capsys.readouterr().err
        assert ("deg/s" in told) == (name == "degrees")
        assert "not at rest" not in told
        assert "saturated" not in told


def test_allan_tells_movement_and_saturation(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    t = np.arange(3000) / 50
    rate = np.clip(6 * np.sin(t) + 2e-3 * np.random.default_rng(1).standard_normal(3000), -4.36, 4.36)
    write_run(Run(imu=ImuLog(t, rate)), tmp_path / "turning", "folder-csv")
    assert main(["allan", str(tmp_path / "turning")]) == 0
    told = capsys.readouterr().err
    assert "the record is not at rest" in told
    assert "limits, -4.36 and 4.36 rad/s: the gyro was saturated" in told


@pytest.mark.parametrize(
    "command", [["allan"], ["bias", "--method", "C", "--out", "{out}/x.csv"], ["calibrate", "--json", "{out}/c.json"]]
)
def test_a_clock_that_was_set_back_is_told_and_the_rest_is_used(
    command: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    t = np.arange(3000) / 50
    rate = 2e-4 * np.random.default_rng(1).standard_normal(3000)
    run = tmp_path / "run"
    write_run(Run(imu=ImuLog(np.where(t < 40, t, t - 4), rate)), run, "folder-csv")
    assert main([command[0], str(run), *(a.format(out=tmp_path) for a in command[1:])]) == 0
    assert "row 2001 says 36 s after 39.98 s; 200 of 3000 readings are left out" in capsys.readouterr().err
