"""`driftscope diagnose` with another simulator, and with the evidence of its report."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from app.cli import main
from core.formats import write_run
from core.simulation import simulate
from tests.plants.gap_plant import Plan, record


def test_diagnose_against_a_recorded_simulation_writes_the_evidence(tmp_path: Path) -> None:
    real = record(Plan(11, seconds=14.0, sensors="none", effects={"gyro_bias": {"bias": 0.02}}))
    folder = tmp_path / "real"
    write_run(real, folder, "folder-parquet")
    write_run(simulate(real, {"gyro_bias": {"bias": 0.005}}, 1), folder / "sim", "folder-parquet")
    out, evidence = tmp_path / "gap.json", tmp_path / "evidence.json"
    command = ["diagnose", str(folder), "--simulator", "sim", "--json", str(out), "--evidence", str(evidence)]
    assert main([*command, "--seed", "1", "--tolerance", "track_width.scale=0.01", "accel_bias.x=0.01"]) == 0
    causes = json.loads(out.read_text())["causes"]
    assert [one["effect"] for one in causes if one["probability"] > 0.5] == ["gyro_bias"]
    assert causes[0]["parameters"]["bias"]["value"] == pytest.approx(0.02, abs=1e-3)
    told = json.loads(evidence.read_text())
    assert told["schema"] == "gap-evidence/1"
    assert told["signatures"]["gyro_bias"]["stream"] == "imu.gz"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--simulator", "nope"], "there is no simulator 'nope'"),
        (["--tolerance", "track_width.scale"], "expected EFFECT.PARAMETER=SIZE"),
        (["--tolerance", "track_width.scale=0.01", "nope.x=1"], "--tolerance: there is no 'nope.x'"),
    ],
    ids=["simulator", "form", "effect"],
)
def test_options_that_mean_nothing_are_named(
    options: list[str], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_run(record(Plan(11, seconds=5.0, imu=False)), tmp_path / "run", "folder-parquet")
    assert main(["diagnose", str(tmp_path / "run"), *options]) == 2
    assert words in capsys.readouterr().err
