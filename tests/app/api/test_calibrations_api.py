"""Calibrations over HTTP: made from runs, uploaded, applied to a run, and out to other programs."""

from __future__ import annotations

import io
import json
import math
import re
import tempfile
import time
import xml.etree.ElementTree as ET
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from fastapi.testclient import TestClient

from core.calibration.imu import AXES, ImuCalibration, constants, initial_state, step
from core.formats import write_run
from core.run import Run
from tests.plants.imu_rig import DEG, Rig, draw_rig, rate_table_run, rest_run, six_position_run


@pytest.fixture(scope="module")
def rig() -> Rig:
    return draw_rig(3, rate=50.0)


def sent(server: TestClient, run: Run, name: str) -> str:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.zip"
        write_run(run, path, "zip-parquet")
        asked = {"filename": "run.zip", "name": name, "robot": "rig"}
        run_id: str = server.post("/api/v1/runs", params=asked, content=path.read_bytes()).json()["id"]
    waiting = server.get("/api/v1/jobs", params={"run": run_id, "state": "queued"}).json()["items"]
    for job in waiting:  # what is queued for every new run is not what is tested here
        server.post(f"/api/v1/jobs/{job['id']}/cancel")
    return run_id


def ended(server: TestClient, job: dict[str, Any]) -> dict[str, Any]:
    end = time.monotonic() + 280
    while job["state"] in ("queued", "running"):
        assert time.monotonic() < end
        time.sleep(0.05)
        job = server.get(f"/api/v1/jobs/{job['id']}").json()
    assert job["state"] == "done", job
    return job


@pytest.fixture(scope="module")
def runs(server: TestClient, rig: Rig) -> list[str]:
    """A rest, six positions and a rate table of one IMU."""
    return [
        sent(server, rest_run(rig, 1, 120.0), "rest"),
        sent(server, six_position_run(rig, 2, 8.0, handling=3.0), "six"),
        sent(server, rate_table_run(rig, 3, (-80 * DEG, 80 * DEG), 8.0), "table"),
    ]


@pytest.fixture(scope="module")
def made(server: TestClient, runs: list[str]) -> dict[str, Any]:
    job = server.post("/api/v1/calibrations", json={"runs": runs})
    assert job.status_code == 202, job.text
    done = ended(server, job.json())
    found: dict[str, Any] = server.get(f"/api/v1/calibrations/{done['result']['calibration_id']}").json()
    return found


def model_of(calibration: dict[str, Any]) -> ImuCalibration:
    return ImuCalibration.from_json(calibration["calibration"])


def test_runs_made_for_it_are_known_by_their_procedure(server: TestClient, runs: list[str], run_id: str) -> None:
    offered = {r["id"]: r["kind"] for r in server.get("/api/v1/calibrations/runs", params={"robot": "rig"}).json()}
    assert [offered[r] for r in runs] == ["rest", "six_position", "rate_table"]
    assert run_id not in offered


def test_a_calibration_finds_the_rig_and_says_what_it_stands_on(
    made: dict[str, Any], rig: Rig, runs: list[str]
) -> None:
    model = model_of(made)
    assert np.abs(model.gyro.static_bias - rig.gyro.static_bias).max() < 2e-4  # rad/s, of biases of 0.02
    assert np.abs(model.gyro.matrix - rig.gyro.matrix).max() < 1e-3
    assert np.abs(model.accel.matrix - rig.accel.matrix).max() < 0.02  # eight seconds a position
    assert made["robot"] == "rig" and made["source"] == "runs" and made["code_version"]
    assert [r["id"] for r in made["runs"]] == runs and len(made["run_sha256"]) == 3
    assert {line["axis"] for line in made["report"]["lines"]} == set(AXES)
    assert set(made["report"]["axes"]) == set(AXES)
    assert "gyro noise" in made["knows"] and made["sentence"].startswith("Gyro z reads")
    assert made["bode"]["window"] == 40 and made["bode"]["delay"] == pytest.approx(19.5 / 50, rel=1e-3)
    turns = np.pi * made["bode"]["f"][9] * 40 / 50
    assert made["bode"]["gain"][9] == pytest.approx(abs(np.sin(turns) / turns), rel=1e-3)  # eq. 8


def test_the_json_comes_back_as_the_same_calibration(server: TestClient, made: dict[str, Any]) -> None:
    text = server.get(f"/api/v1/calibrations/{made['id']}/files/calibration.json").text
    again = server.post("/api/v1/calibrations/upload", params={"name": "copy", "robot": "other"}, json=json.loads(text))
    assert again.status_code == 201
    assert again.json()["calibration"] == made["calibration"] and again.json()["source"] == "upload"
    listed = server.get("/api/v1/calibrations", params={"robot": "other"}).json()["items"]
    assert [c["name"] for c in listed] == ["copy"]
    path = f"/api/v1/calibrations/{again.json()['id']}"
    renamed = server.patch(path, json={"name": "  spare   part ", "robot": ""}).json()
    assert renamed["name"] == "spare part" and renamed["robot"] is None
    assert server.delete(path).status_code == 204
    assert server.get(path).status_code == 404


def test_kalibr_reads_densities_in_its_units(server: TestClient, made: dict[str, Any]) -> None:
    text = server.get(f"/api/v1/calibrations/{made['id']}/files/kalibr-imu.yaml", params={"rate": 50}).text
    read = yaml.safe_load(text)
    noise = model_of(made)
    assert read["update_rate"] == 50
    assert read["gyroscope_noise_density"] == pytest.approx(noise.gyro.noise_sd.max() / math.sqrt(50), rel=1e-5)
    assert read["accelerometer_noise_density"] == pytest.approx(noise.accel.noise_sd.max() / math.sqrt(50), rel=1e-5)
    for key in ("gyroscope_noise_density", "accelerometer_noise_density"):
        line = next(line for line in text.splitlines() if line.startswith(key))
        assert re.search(r"# \[(rad/s|m/s\^2)/sqrt\(Hz\)\]", line)


def test_densities_can_come_from_a_runs_allan_fit(server: TestClient, made: dict[str, Any], runs: list[str]) -> None:
    asked = {"axes": ["gx", "gy", "gz"], "methods": ["C"]}
    ended(server, server.post(f"/api/v1/runs/{runs[0]}/imu", json=asked).json())
    fitted = server.get(f"/api/v1/runs/{runs[0]}/imu").json()["noise"]
    path = f"/api/v1/calibrations/{made['id']}/files/kalibr-imu.yaml"
    read = yaml.safe_load(server.get(path, params={"run": runs[0]}).text)
    assert read["gyroscope_noise_density"] == pytest.approx(max(fitted[a]["N"] for a in ("gx", "gy", "gz")), rel=1e-5)


def test_sdf_holds_a_noise_block_per_axis(server: TestClient, made: dict[str, Any]) -> None:
    path = f"/api/v1/calibrations/{made['id']}/files/imu-noise.sdf"
    sensor = ET.fromstring(server.get(path, params={"rate": 50}).text)
    assert sensor.get("type") == "imu" and float(sensor.findtext("update_rate") or 0) == 50
    model = model_of(made)
    for part, triad, sd in (
        ("angular_velocity", model.gyro, model.sd.gyro),
        ("linear_acceleration", model.accel, model.sd.accel),
    ):
        for k, axis in enumerate("xyz"):
            noise = sensor.find(f"imu/{part}/{axis}/noise")
            assert noise is not None and noise.get("type") == "gaussian"
            figures = {child.tag: float(child.text or "nan") for child in noise}
            assert figures["bias_mean"] == pytest.approx(triad.static_bias[k], rel=1e-6)
            assert figures["bias_stddev"] == pytest.approx(sd.static_bias[k], rel=1e-6)
            assert figures["stddev"] == pytest.approx(triad.noise_sd[k], rel=1e-6)
            if triad.drifts[k]:  # Gazebo takes the driving noise: its process has sd = stddev * sqrt(tau / 2)
                process = figures["dynamic_bias_stddev"] * math.sqrt(figures["dynamic_bias_correlation_time"] / 2)
                assert process == pytest.approx(abs(triad.drift_amplitude[k]), rel=1e-6)
            else:
                assert "dynamic_bias_stddev" not in figures


@pytest.mark.parametrize("tracker", ["best", "C"])
def test_firmware_is_what_the_library_generates(server: TestClient, made: dict[str, Any], tracker: str) -> None:
    from core.firmware import generate

    path = f"/api/v1/calibrations/{made['id']}/files/firmware.zip"
    asked = {"rate": 50, "bias": tracker}
    answer = server.get(path, params=asked)
    assert answer.headers["content-type"] == "application/zip"
    with zipfile.ZipFile(io.BytesIO(answer.content)) as archive:
        found = {name: archive.read(name).decode() for name in archive.namelist()}
    assert found == generate(model_of(made), rate_hz=50.0, bias=tracker)
    assert server.get(path, params=asked).content == answer.content


def test_a_run_is_corrected_as_a_microcontroller_would(
    server: TestClient, made: dict[str, Any], runs: list[str], rig: Rig
) -> None:
    job = server.post(f"/api/v1/runs/{runs[1]}/corrections", json={"calibration": made["id"]})
    corrected = server.get(f"/api/v1/runs/{ended(server, job.json())['result']['run_id']}").json()
    assert corrected["name"] == "six (corrected)" and "corrected" in corrected["tags"]
    origin = corrected["source"]["corrected"]
    assert origin["from_run"] == runs[1] and origin["calibration"] == made["id"] and origin["code_version"]
    known = six_position_run(rig, 2, 8.0, handling=3.0).imu
    assert known is not None
    constant = constants(model_of(made))
    state = initial_state(constant, float(known.t[0]))
    for i in range(100):
        dt = known.t[i] - known.t[max(i - 1, 0)]
        state, out = step(constant, state, [getattr(known, axis)[i] for axis in AXES], float(dt))
    end = float(known.t[99])
    asked = {"columns": "gz,az", "t0": end - 0.05, "t1": end + 0.05}
    series = server.get(f"/api/v1/runs/{corrected['id']}/streams/imu", params=asked).json()["series"]
    for s in series:
        place = int(np.argmin(np.abs(np.array(s["t"]) - end)))
        assert s["y"][place] == pytest.approx(out[AXES.index(s["column"])], rel=1e-5, abs=1e-9)


def test_a_calibration_is_judged_on_a_run(
    server: TestClient, made: dict[str, Any], runs: list[str], make_run: Callable[..., Run]
) -> None:
    path = f"/api/v1/runs/{runs[0]}/imu/calibrations/{made['id']}"
    assert server.get(path).status_code == 404
    ended(server, server.post(path).json())
    found = server.get(path).json()["figures"]
    assert found["axes"] == list(AXES)
    for j in range(6):
        assert abs(found["online"]["mean"][j]) < 0.2 * abs(found["raw"]["mean"][j])
        assert found["noise_factor"][j] > 4  # an average of 40 readings
        assert found["correlation"][j] > 0.95
    short = sent(server, make_run(seconds=1.0), "too short")
    other = f"/api/v1/runs/{short}/imu/calibrations/{made['id']}"
    ended(server, server.post(other).json())
    told = server.get(other).json()
    assert told["error"] is not None and told["error"]["detail"]


@pytest.mark.parametrize(
    ("model", "said"),
    [
        ({}, "calibration/1"),
        ({"schema": "calibration/1"}, "at least one number"),
        ({"schema": "calibration/1", "gyro": {"static_bias": [1, 2]}}, "gyro.static_bias"),
        ({"schema": "calibration/1", "gyro": {"drift_tau": [0, 1, 1]}}, "gyro.drift_tau"),
    ],
)
def test_what_is_no_calibration_is_refused_with_its_place(server: TestClient, model: dict[str, Any], said: str) -> None:
    answer = server.post("/api/v1/calibrations/upload", params={"name": "x"}, json=model)
    assert answer.status_code == 422 and said in answer.json()["detail"]


def test_runs_that_cannot_calibrate_are_refused(server: TestClient, made: dict[str, Any]) -> None:
    assert server.post("/api/v1/calibrations", json={"runs": ["nothing"]}).status_code == 404
    assert server.post("/api/v1/calibrations", json={"runs": []}).status_code == 422
    for path in ("/calibrations/none", f"/calibrations/{made['id']}/files/firmware.zip?rate=0"):
        assert server.get(f"/api/v1{path}").status_code in (404, 422)


def test_what_is_not_known_is_left_out_of_exports(server: TestClient) -> None:
    model = {"schema": "calibration/1", "gyro": {"static_bias": [0.01, None, 0.02]}}
    made = server.post("/api/v1/calibrations/upload", params={"name": "a--b <gyro>"}, json=model).json()
    path = f"/api/v1/calibrations/{made['id']}/files"
    read = yaml.safe_load(server.get(f"{path}/kalibr-imu.yaml").text)
    assert set(read) == {"rostopic", "update_rate"}
    sensor = ET.fromstring(server.get(f"{path}/imu-noise.sdf").text)
    assert sensor.findtext("imu/angular_velocity/x/noise/bias_mean") == "0.01"
    assert sensor.find("imu/angular_velocity/y/noise/bias_mean") is None
    assert server.delete(f"/api/v1/calibrations/{made['id']}").status_code == 204
