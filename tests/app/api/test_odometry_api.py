"""Odometry calibration over REST: asked for, made by a worker, read back, refused where there is nothing to go by."""

from __future__ import annotations

import dataclasses
import io
import tempfile
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from core.formats import write_run
from core.run import Run
from core.simulation import simulate
from core.simulation.scenarios import SCENARIOS, Rates


def sent(server: TestClient, run: Run, name: str) -> str:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.zip"
        write_run(run, path, "zip-parquet")
        content = io.BytesIO(path.read_bytes()).getvalue()
    answer = server.post("/api/v1/runs", params={"filename": name}, content=content)
    assert answer.status_code in (200, 201), answer.text
    return str(answer.json()["id"])


def test_a_run_is_calibrated_on_request(server: TestClient) -> None:
    rates = Rates(imu=0.0, wheels=20.0, beacon=5.0, ranges=0.0, truth=0.0, commands=10.0)
    wide = {"track_width": {"scale": 1.03}, "unequal_wheels": {"ratio": 1.01}}
    run = simulate(SCENARIOS["figure-eight"].run(rates), wide, seed=3)
    run_id = sent(server, run, "eight.zip")
    path = f"/api/v1/runs/{run_id}/odometry"
    assert server.get(path).json() == {"run_id": run_id, "calibration": None}
    job = server.post(path, json={"reference": "beacon"})
    assert job.status_code == 202, job.text
    with server.stream("GET", f"/api/v1/jobs/{job.json()['id']}/events") as events:
        assert any('"state":"done"' in line.replace(" ", "") for line in events.iter_lines())
    found = server.get(path).json()["calibration"]
    track = found["parameters"]["track_width"]
    assert track["value"] == pytest.approx(0.32 * 1.03, abs=5 * track["sd"]) and track["sd"] < 0.003
    assert found["robot"]["track_width"] == track["value"] and found["robot"]["ticks_per_rev"] == 2048
    assert found["reference"] == "beacon" and found["reasons"]["gyro_scale"] == "no run has an imu"
    blind = sent(server, dataclasses.replace(run, beacon=None), "blind.zip")
    refused = server.post(f"/api/v1/runs/{blind}/odometry", json={})
    assert refused.status_code == 422 and "truth, beacon or ranges" in refused.json()["detail"]
