"""The IMU over HTTP: a run is analysed by itself, and what is asked for is what was recorded."""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from core.formats import write_run
from core.run import Run, RunMeta
from core.sensors import ImuLog, TruthLog

RATE, SD, BIAS = 100.0, 0.002, 0.01  # Hz, rad/s of a reading, rad/s


def rest_turn_rest() -> Run:
    """48 s of rest, a turn of 1 rad in 3 s, rest again; ax is a dead axis, the die warms up by 2 degrees."""
    t = np.arange(0, 99, 1 / RATE)
    rate = np.where((t >= 48) & (t < 51), 1 / 3, 0.0)
    noise = np.random.default_rng(1).normal(0, SD, t.size)
    heading = np.clip((t - 48) / 3, 0, 1)
    return Run(
        meta=RunMeta(name="rest, turn, rest"),
        imu=ImuLog(t, rate + BIAS + noise, ax=np.zeros(t.size), temperature=25 + 2 * t / 99),
        truth=TruthLog(t[::10], theta=heading[::10]),
    )


@pytest.fixture(scope="module")
def run_id(server: TestClient, tmp_path_factory: pytest.TempPathFactory) -> str:
    path: Path = tmp_path_factory.mktemp("imu") / "run.zip"
    write_run(rest_turn_rest(), path, "zip-csv")
    found: str = server.post("/api/v1/runs", params={"filename": "run.zip"}, content=path.read_bytes()).json()["id"]
    settle(server, found)
    return found


def settle(server: TestClient, run_id: str) -> None:
    end = time.monotonic() + 120
    while server.get("/api/v1/jobs", params={"run": run_id, "state": "active"}).json()["items"]:
        assert time.monotonic() < end
        time.sleep(0.05)


@pytest.fixture
def ask(server: TestClient, run_id: str) -> Callable[..., Any]:
    def get(what: str = "", **params: Any) -> Any:
        answer = server.get(f"/api/v1/runs/{run_id}/imu{what}", params=params)
        assert answer.status_code == 200, answer.text
        return answer.text if params.get("format") == "csv" else answer.json()

    return get


def test_a_new_run_is_analysed_by_itself(ask: Callable[..., Any]) -> None:
    found = ask()
    assert found["sentence"].startswith("Gyro z: 0.011 °/s/√Hz white (two-sided)")  # 0.002 rad/s / √100 Hz
    assert "from truth" in found["sentence"]
    assert [m["method"] for m in found["methods"]] == ["A", "B", "C", "best", "smoothed"]
    assert found["axes"] == ["gz", "ax"] and found["has_temperature"] and found["has_heading"]
    assert found["job"]["state"] == "done" and found["job"]["kind"] == "imu"
    for method in found["methods"]:
        assert method["provenance"]["code_version"] and len(method["provenance"]["run_sha256"]) == 64


def test_a_dead_axis_says_so_and_the_rest_is_given(server: TestClient, run_id: str, ask: Callable[..., Any]) -> None:
    assert "equal" in ask()["refusals"]["allan.ax"]["detail"]
    refused = server.get(f"/api/v1/runs/{run_id}/imu/allan", params={"axis": "ax"})
    assert refused.status_code == 422 and "equal" in refused.json()["detail"]
    assert ask("/allan", axis="gz")["curve"]["tau"]


def test_white_noise_is_found_at_rest_in_every_unit(ask: Callable[..., Any]) -> None:
    allan = ask("/allan", axis="gz")
    assert allan["readings"] == "rest" and 0.8 < allan["rest_share"] < 0.98  # the turn is left out
    white = next(term for term in allan["noise"] if term["name"] == "N")
    assert abs(white["value"] - SD / RATE**0.5) < 5 * white["sd"]
    forms = {form["unit"]: form["value"] for form in white["forms"]}
    assert forms["°/√h"] == pytest.approx(np.degrees(white["value"]) * 60)
    assert forms["°/s/√Hz one-sided"] == pytest.approx(2**0.5 * np.degrees(white["value"]))
    whole = ask("/allan", axis="gz", kind="whole")["curve"]
    assert max(whole["deviation"]) > 10 * min(allan["curve"]["deviation"])  # the turn stands out
    rows = list(csv.DictReader(io.StringIO(ask("/allan", axis="gz", format="csv"))))
    assert [float(r["tau"]) for r in rows] == allan["curve"]["tau"]


def test_statistics_are_of_all_readings_of_the_stretch(ask: Callable[..., Any]) -> None:
    run = rest_turn_rest()
    assert run.imu is not None
    inside = run.imu.gz[(run.imu.t >= 6) & (run.imu.t <= 12)]
    found = ask("/statistics", axis="gz", t0=6, t1=12)
    told = found["description"]
    assert told["count"] == inside.size
    for name, value in (("mean", inside.mean()), ("sd", inside.std(ddof=1)), ("median", np.median(inside))):
        assert told[name] == pytest.approx(value, rel=1e-9)
    assert sum(found["histogram"]["counts"]) == inside.size
    assert found["probability"]["correlation"] > 0.99
    assert found["probability"]["total"] == inside.size
    rows = dict(list(csv.reader(io.StringIO(ask("/statistics", axis="gz", t0=6, t1=12, format="csv"))))[1:])
    assert float(rows["mean"]) == told["mean"]
    dead = ask("/statistics", axis="ax", t0=6, t1=12)
    assert dead["histogram"] is None and "no spread" in dead["notes"][0] and dead["description"]["mean"] == 0


def test_methods_agree_with_their_own_curves(ask: Callable[..., Any]) -> None:
    for method in ask("/bias")["items"]:
        figures = method["summary"]
        name = method["method"]
        got = {s["column"]: s for s in ask(f"/bias/{name}/series", points=20_000)["series"]}
        counted = [got[c]["total"] for c in ("accepted", "rejected_by_range", "rejected_by_average")]
        assert sum(counted) + figures["empty"] == figures["segments"]
        assert counted[0] == figures["accepted"]
        assert got["error"]["y"][-1] == pytest.approx(figures["final_rad"])
        assert got["reference"]["y"][-1] - got["theta"]["y"][-1] == pytest.approx(figures["final_rad"], abs=1e-6)
        assert got["bias"]["y"][-1] == pytest.approx(BIAS, abs=5e-4)
        # B takes the steady turn for rest, since its range is small: that is why there is a C
        assert abs(figures["final_rad"]) == pytest.approx(1.0 if name == "B" else 0.0, abs=0.05)
    thinned = ask("/bias/best/series", columns="bias,accepted", points=50)["series"]
    assert all(s["shown"] <= 51 < s["total"] for s in thinned)
    rows = list(csv.DictReader(io.StringIO(ask("/bias/C/series", columns="bias", points=20, format="csv"))))
    assert {r["column"] for r in rows} == {"bias"} and len(rows) <= 21


def test_bias_against_temperature(ask: Callable[..., Any]) -> None:
    found = ask("/temperature")
    assert found["temperature"] == sorted(found["temperature"])
    assert found["total"] == len(found["bias"]) > 10
    assert abs(found["summary"]["slope"]) < 2e-4  # the bias did not follow the die


def test_other_segments_on_request(server: TestClient, run_id: str, ask: Callable[..., Any]) -> None:
    before = ask("/segments", axis="gz", columns="mean")["total"]
    asked = {"axes": ["gz"], "methods": ["C"], "length": 1.5}
    answer = server.post(f"/api/v1/runs/{run_id}/imu", json=asked)
    assert answer.status_code == 202 and answer.json()["kind"] == "imu"
    settle(server, run_id)
    assert ask("/segments", axis="gz", columns="mean")["total"] == 2 * before
    by_c = next(m for m in ask("/bias")["items"] if m["method"] == "C")
    assert by_c["summary"]["segments"] == 2 * before and by_c["provenance"]["config"] == {"length": 1.5}
    assert server.post(f"/api/v1/runs/{run_id}/imu", json={}).status_code == 202
    settle(server, run_id)


def test_a_run_without_an_imu(server: TestClient, zipped: Callable[..., bytes], make_run: Callable[..., Run]) -> None:
    import dataclasses
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.zip"
        write_run(dataclasses.replace(make_run(), imu=None), path, "zip-csv")
        sent = path.read_bytes()
    run_id = server.post("/api/v1/runs", params={"filename": "no-imu.zip"}, content=sent).json()["id"]
    found = server.get(f"/api/v1/runs/{run_id}/imu").json()
    assert found["axes"] == [] and found["sentence"] == "This run has no IMU." and found["job"] is None
    refused = server.post(f"/api/v1/runs/{run_id}/imu", json={})
    assert refused.status_code == 422 and refused.json()["where"]["missing"] == "imu"


@pytest.mark.parametrize(
    ("what", "params", "status", "said"),
    [
        ("/allan", {"axis": "north"}, 422, "axis"),
        ("/bias/D/series", {}, 404, "bias.D"),
        ("/bias/C/series", {"columns": "speed"}, 422, "speed"),
        ("/segments", {"columns": "speed"}, 422, "speed"),
        ("/statistics", {"t0": 9, "t1": 3}, 422, "before"),
        ("/statistics", {"axis": "gx"}, 422, "gx"),
    ],
)
def test_refusals_name_what_is_wrong(
    server: TestClient, run_id: str, what: str, params: dict[str, Any], status: int, said: str
) -> None:
    answer = server.get(f"/api/v1/runs/{run_id}/imu{what}", params=params)
    assert answer.status_code == status, answer.text
    assert said in answer.json()["detail"]


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"axes": ["gx"]}, "gx"),
        ({"methods": ["D"]}, "'D'"),
        ({"axes": []}, "null means all"),
        ({"length": -1}, "length"),
    ],
)
def test_what_cannot_be_analysed(server: TestClient, run_id: str, asked: dict[str, Any], said: str) -> None:
    answer = server.post(f"/api/v1/runs/{run_id}/imu", json=asked)
    assert answer.status_code == 422 and said in answer.json()["detail"]
