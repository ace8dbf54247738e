"""The command line as a user meets it: files in, files out, statuses, one-line errors."""

from __future__ import annotations

import csv
import json
import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.cli import main

ROOT = Path(__file__).resolve().parents[2]
CIRCLE = ROOT / "tests" / "data" / "optiodom-circle"
HUSKY_ZIP = ROOT / "tests" / "data" / "husky-step-csv.zip"


def driftscope(*arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run the command in a process of its own."""
    command = [sys.executable, "-m", "app.cli", *map(str, arguments)]
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, env=env, timeout=120, check=False)


def one_line(capsys: pytest.CaptureFixture[str]) -> str:
    """Standard error, which has to be one line."""
    text = capsys.readouterr().err
    assert text.count("\n") == 1, text
    return text


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_help_needs_no_slow_import() -> None:
    code = (
        "import sys, app.cli\n"
        "try: app.cli.main(['--help'])\n"
        "except SystemExit: pass\n"
        "slow = {'numba', 'numpy', 'polars', 'fastapi', 'sqlalchemy', 'distributed', 'viser'}\n"
        "sys.exit(bool(slow & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, timeout=60, check=False
    )
    assert done.returncode == 0
    for command in ("serve", "import", "estimate"):
        assert command in done.stdout


def test_estimate_writes_the_path_and_the_result(tmp_path: Path) -> None:
    out = tmp_path / "path.csv"
    done = driftscope("estimate", CIRCLE, "--method", "encoders", "--out", out, "--json", "-", cwd=tmp_path)
    assert done.returncode == 0
    assert all(line.startswith("driftscope: note: ") for line in done.stderr.splitlines())
    result: dict[str, Any] = json.loads(done.stdout)
    assert set(result) == {"schema", "method", "final", "errors", "events", "nees", "runtime_s"}
    assert (result["schema"], result["method"]) == ("estimate/1", "encoders")
    assert set(result["errors"]) == {"ate_rmse_m", "final_m", "final_deg", "max_m"}
    assert result["errors"]["ate_rmse_m"] <= result["errors"]["max_m"]
    path = rows(out)
    assert list(path[0])[:4] == ["t", "x", "y", "theta"]
    assert {"sd_x", "sd_y", "sd_theta"} >= set(list(path[0])[4:])
    for name in ("x", "y", "theta"):
        assert float(path[-1][name]) == result["final"][name]
    t = np.array([float(row["t"]) for row in path])
    assert (np.diff(t) > 0).all()


def test_final_angle_is_in_degrees_where_the_key_says_so(tmp_path: Path) -> None:
    from core.estimation.pipeline import estimate
    from core.formats import read_run
    from core.metrics import evaluate

    target = tmp_path / "result.json"
    out = tmp_path / "path.csv"
    assert main(["estimate", str(CIRCLE), "--method", "encoders", "--out", str(out), "--json", str(target)]) == 0
    run = read_run(CIRCLE)
    assert run.truth is not None
    expected = evaluate(estimate(run, "encoders").trajectory, run.truth)
    errors = json.loads(target.read_text())["errors"]
    assert expected.final_rad is not None
    assert errors["final_deg"] == pytest.approx(math.degrees(expected.final_rad))
    assert errors["max_m"] == pytest.approx(expected.max_m)


def test_a_stored_run_is_estimated_by_its_id(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, direct, stored = tmp_path / "data", tmp_path / "direct.csv", tmp_path / "stored.csv"
    assert main(["import", str(CIRCLE), str(HUSKY_ZIP), "--data", str(data)]) == 0
    ids = capsys.readouterr().out.split()
    assert [len(i) for i in ids] == [16, 16]
    assert main(["import", str(CIRCLE), "--data", str(data), "--json", "-"]) == 0
    again = json.loads(capsys.readouterr().out)
    assert [(r["id"], r["new"]) for r in again["runs"]] == [(ids[0], False)]
    for source, out in ((str(CIRCLE), direct), (ids[0], stored)):
        assert main(["estimate", source, "--method", "encoders", "--out", str(out), "--data", str(data)]) == 0
    assert stored.read_bytes() == direct.read_bytes()


def test_imported_runs_wait_for_a_server_to_estimate_them(tmp_path: Path) -> None:
    from app.db.session import make_engine, reading
    from app.settings import Settings
    from app.store import jobs

    settings = Settings(data=tmp_path / "data")
    for _ in range(2):
        assert main(["import", str(CIRCLE), "--data", str(settings.data)]) == 0
    with reading(make_engine(settings.url)) as session:
        waiting = jobs.list_jobs(session)
        assert [(job.kind, job.state) for job in waiting] == [("estimate", "queued")]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["estimate", "nowhere", "--method", "encoders", "--out", "x.csv"], "nowhere: no such file or folder"),
        (["estimate", str(CIRCLE), "--method", "teleport", "--out", "x.csv"], "unknown method 'teleport'"),
        (["estimate", str(CIRCLE), "--method", "beacon", "--out", "x.csv"], "beacon cannot run"),
        (["import", "nowhere", "--data", "store"], "nowhere: no such file or folder"),
        (["serve", "--host", "0.0.0.0", "--data", "store"], "without a token"),
    ],
)
def test_bad_input_is_status_2_and_one_line(
    arguments: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DRIFTSCOPE_TOKEN", raising=False)
    assert main(arguments) == 2
    assert said in one_line(capsys)
    assert not (tmp_path / "x.csv").exists()


@pytest.mark.parametrize("arguments", [[], ["dance"], ["estimate"], ["serve", "--port", "65536"]])
def test_wrong_usage_is_status_2_and_one_line(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main(arguments)
    assert left.value.code == 2
    assert one_line(capsys).startswith("driftscope")


def test_a_broken_file_is_named_and_the_sound_one_stored(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    broken = tmp_path / "broken"
    broken.mkdir()
    (broken / "run.json").write_text('{"format": "run/1"}')
    (broken / "imu.csv").write_text("t,gz\n0,0.1\n1,abc\n")
    assert main(["import", str(broken), str(CIRCLE), "--data", str(tmp_path / "data")]) == 2
    printed = capsys.readouterr()
    assert len(printed.out.split()) == 1
    assert "row 2" in printed.err
    assert "gz" in printed.err


def test_a_result_that_cannot_be_written_is_status_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "missing" / "path.csv"
    assert main(["estimate", str(CIRCLE), "--method", "encoders", "--out", str(out)]) == 1
    assert str(out) in one_line(capsys)
