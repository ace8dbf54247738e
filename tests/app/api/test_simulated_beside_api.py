"""A simulated run in `sim/` beside a real one: kept, given back, held against it, and gone with it."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from app.cli import main
from app.db.session import writing
from app.store import runs
from core.errors import FormatError
from core.formats import read_simulated, write_run
from core.run import Run
from core.simulation import simulate
from core.simulation.scenarios import SCENARIOS, Rates

RATES = Rates(commands=20, wheels=20, imu=50, beacon=5, ranges=4, truth=20)


@pytest.fixture(scope="module")
def pair() -> tuple[Run, Run]:
    """A run of a robot with a wider track than its simulator thinks, and what that simulator made of it."""
    drive = SCENARIOS["in-place"].run(RATES)
    return simulate(drive, {"track_width": {"scale": 1.04}}, 7), simulate(drive, {}, 8)


def stored(server: TestClient, path: Path) -> str:
    answer = server.post("/api/v1/runs", params={"filename": path.name}, content=path.read_bytes())
    assert answer.status_code in (200, 201), answer.text
    found: str = answer.json()["id"]
    return found


def moved(server: TestClient, **move: Any) -> dict[str, Any]:
    answer = server.post("/api/v1/sandbox/simulate", json=move)
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


def test_it_is_stored_shown_and_given_back(server: TestClient, pair: tuple[Run, Run], tmp_path: Path) -> None:
    real, made = pair
    write_run(real, tmp_path / "bare.zip", "zip-parquet")
    write_run(real, tmp_path / "both.zip", "zip-parquet", made)
    run_id = stored(server, tmp_path / "bare.zip")
    assert (
        server.post("/api/v1/diagnoses", json={"runs": [run_id], "options": {"simulator": "sim"}}).json()["where"][
            "parameter"
        ]
        == "options.simulator"
    )
    assert stored(server, tmp_path / "both.zip") == run_id  # the same readings: what lies beside is new
    detail = server.get(f"/api/v1/runs/{run_id}").json()
    assert set(detail["source"]["simulated"]) == set(made.logs())
    (tmp_path / "back.zip").write_bytes(server.get(f"/api/v1/runs/{run_id}/files/run-csv.zip").content)
    back = read_simulated(tmp_path / "back.zip")
    assert back is not None and back.imu is not None and made.imu is not None
    np.testing.assert_array_equal(back.imu.gz, made.imu.gz)

    both = moved(server, run=run_id, streams=["imu.gz"], points=20_000)
    assert both["source"]["simulated"] and [p["method"] for p in both["paths"]][-1] == "recorded"
    np.testing.assert_allclose(both["streams"][0]["recorded"], made.imu.gz, atol=1e-7)
    sim = moved(server, run=run_id, simulator="sim", streams=["imu.gz"], points=20_000)
    np.testing.assert_allclose(sim["streams"][0]["nominal"], made.imu.gz, atol=1e-7)
    own = both["gap"]
    assert sim["gap"]["before"] == pytest.approx(own["before"], rel=0.1)  # the same simulator, with noise
    mended = moved(server, run=run_id, simulator="sim", effects={"gyro_bias": {"bias": 0.1}}, start=5.0, end=20.0)
    assert mended["gap"]["now"] > mended["gap"]["before"]
    refused = server.post(
        "/api/v1/sandbox/simulate", json={"run": run_id, "simulator": "sim", "effects": {"deadband": {"width": 0.1}}}
    )
    assert refused.status_code == 422 and "recording" in refused.json()["detail"]

    app: Any = server.app
    with writing(app.state.engine) as session:
        runs.collect_arrays(session, app.state.settings.data, older_than=-1.0)
    assert moved(server, run=run_id, simulator="sim", streams=["imu.gz"])["gap"] == sim["gap"]


def test_a_fault_in_it_refuses_the_whole(server: TestClient, pair: tuple[Run, Run], tmp_path: Path) -> None:
    real, made = pair
    folder = tmp_path / "bad"
    write_run(dataclasses.replace(real, beacon=None), folder, "folder-csv", made)
    (folder / "sim" / "wheels.csv").write_text("t,left,right\n0,0,0\n0,1,1\n")
    with pytest.raises(FormatError, match="sim/wheels"):
        read_simulated(folder)
    before = server.get("/api/v1/runs").json()["total"]
    assert main(["import", str(folder), "--data", str(server.app.state.settings.data)]) == 2  # type: ignore[attr-defined]
    assert server.get("/api/v1/runs").json()["total"] == before


def test_the_command_line_takes_it_from_a_folder_and_from_the_store(
    server: TestClient, pair: tuple[Run, Run], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    real, made = pair
    write_run(real, tmp_path / "both.zip", "zip-parquet", made)
    run_id = stored(server, tmp_path / "both.zip")
    data = str(server.app.state.settings.data)  # type: ignore[attr-defined]
    told = []
    for k, source in enumerate((str(tmp_path / "both.zip"), run_id)):
        words = ["simulate", source, "--simulator", "sim", "--json", "-", "--data", data]
        assert main([*words, "--out", str(tmp_path / f"out-{k}")]) == 0
        told.append(capsys.readouterr().out)
    assert '"before"' in told[0] and told[0] == told[1]
