"""Runs over HTTP: in, found, changed, deleted, restored, out."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fastapi.testclient import TestClient

from core.formats import read_run
from core.run import Run

API = "/api/v1"
Zipped = Callable[..., bytes]


def problem(answer: object, status: int, code: str) -> dict:
    """The body of a refusal, whose shape must be whole."""
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    body = answer.json()
    assert set(body) == {"type", "title", "status", "detail", "code", "where", "instance"}
    assert body["status"] == status and body["code"] == code and body["detail"]
    return body


def test_upload_list_and_detail(server: TestClient, zipped: Zipped) -> None:
    data = zipped(turn=0.31)
    query = {"filename": "c:\\logs\\lap 7.zip", "name": "seventh", "robot": "Drum", "tags": "wet, night"}
    answer = server.post(f"{API}/runs", params=query, content=data)
    assert answer.status_code == 201, answer.text
    run = answer.json()
    assert answer.headers["location"] == f"{API}/runs/{run['id']}"
    assert run["name"] == "seventh" and run["robot"] == "Drum" and run["tags"] == ["night", "wet"]
    assert run["source"]["file_name"] == "lap 7.zip" and run["sha256"].startswith(run["id"])
    assert set(run["methods"]) >= {"encoders", "encoders+gyro", "beacon", "fused"}
    imu = next(s for s in run["streams"] if s["name"] == "imu")
    assert imu["gaps"] == 1 and imu["columns"] == ["t", "gz", "ax"] and imu["rate_hz"] == pytest.approx(50, rel=1e-3)
    again = server.post(f"{API}/runs", params={"filename": "copy.zip", "tags": "third"}, content=data)
    assert again.status_code == 200 and again.json()["id"] == run["id"]
    assert again.json()["tags"] == ["night", "third", "wet"]
    page = server.get(f"{API}/runs", params={"q": "seventh robot:drum has:truth", "tag": "wet"}).json()
    assert [item["id"] for item in page["items"]] == [run["id"]] and page["next"] is None
    assert page["facets"]["robots"] == {"Drum": 1} and page["facets"]["streams"]["imu"] == 1


def test_the_upload_leaves_only_the_run(server: TestClient, run_id: str) -> None:
    assert list((server.app.state.settings.data / "uploads").glob("*")) == []


def test_change_delete_restore(server: TestClient, run_id: str) -> None:
    path = f"{API}/runs/{run_id}"
    changed = server.patch(path, json={"notes": "slipped twice", "tags": ["b", "a"]}).json()
    assert changed["notes"] == "slipped twice" and changed["tags"] == ["a", "b"] and changed["robot"] == "mill"
    assert server.delete(path).json()["deleted_at"] is not None
    assert "can be restored" in problem(server.get(path), 404, "not_found")["detail"]
    problem(server.delete(path), 404, "not_found")
    assert run_id in [r["id"] for r in server.get(f"{API}/runs/deleted").json()]
    assert server.post(f"{path}/restore").json()["deleted_at"] is None
    problem(server.post(f"{path}/restore"), 409, "conflict")
    assert server.get(path).json()["notes"] == "slipped twice"


@pytest.mark.parametrize(
    ("path", "where"),
    [
        ("runs?limit=0", "limit"),
        ("runs?limit=x", "limit"),
        ("runs?sort=sha256", "sort"),
        ("runs?cursor=zzz", "cursor"),
        ("runs?q=" + "x" * 1001, "q"),
    ],
)
def test_impossible_lists(server: TestClient, path: str, where: str) -> None:
    assert problem(server.get(f"{API}/{path}"), 422, "parameter")["where"]["parameter"] == where


def test_impossible_changes(server: TestClient, run_id: str) -> None:
    path = f"{API}/runs/{run_id}"
    for change in ({"nam": "x"}, {"name": ""}, {"tags": ["x" * 61]}, {"notes": 3}):
        problem(server.patch(path, json=change), 422, "parameter")
    problem(server.patch(path, content=b"{", headers={"Content-Type": "application/json"}), 422, "parameter")
    problem(server.patch(f"{API}/runs/{'0' * 16}", json={"notes": "x"}), 404, "not_found")


def test_a_run_comes_out_as_it_went_in(
    server: TestClient, run_id: str, make_run: Callable[..., Run], tmp_path: Path
) -> None:
    for kind in ("run-csv.zip", "run-parquet.zip"):
        answer = server.get(f"{API}/runs/{run_id}/files/{kind}")
        assert answer.status_code == 200 and answer.headers["content-type"] == "application/zip"
        assert kind in answer.headers["content-disposition"]
        (tmp_path / kind).write_bytes(answer.content)
        back, sent = read_run(tmp_path / kind), make_run()
        assert list(back.logs()) == list(sent.logs())
        assert back.wheels is not None and sent.wheels is not None
        assert np.array_equal(back.wheels.left, sent.wheels.left)
        returned = server.post(f"{API}/runs", params={"filename": kind}, content=answer.content)
        assert returned.status_code == 200 and returned.json()["id"] == run_id
    assert list((server.app.state.settings.data / "tmp").glob("*")) == []


def test_truth_as_trajectories(server: TestClient, run_id: str, zipped: Zipped) -> None:
    tum = np.loadtxt(io.StringIO(server.get(f"{API}/runs/{run_id}/files/truth.tum").text))
    kitti = np.loadtxt(io.StringIO(server.get(f"{API}/runs/{run_id}/files/truth.kitti").text))
    assert tum.shape == (100, 8) and kitti.shape == (100, 12)
    assert tum[-1, 7] == pytest.approx(np.cos(0.1 * tum[-1, 0] / 2))
    data = io.BytesIO(zipped())
    bare = io.BytesIO()
    with zipfile.ZipFile(data) as source, zipfile.ZipFile(bare, "w") as target:
        for name in source.namelist():
            if not name.startswith("truth"):
                target.writestr(name, source.read(name))
    other = server.post(f"{API}/runs", params={"filename": "bare.zip"}, content=bare.getvalue()).json()["id"]
    problem(server.get(f"{API}/runs/{other}/files/truth.tum"), 422, "missing_stream")
    problem(server.get(f"{API}/runs/{run_id}/files/run.exe"), 422, "parameter")


def test_column_mappings(server: TestClient) -> None:
    mapping = {"streams": {"imu": {"t": {"column": "ms", "unit": "ms"}, "gz": {"column": "w", "sign": -1}}}}
    path = f"{API}/mappings/lab logger"
    stored = server.put(path, json=mapping).json()
    assert stored["mapping"]["streams"]["imu"]["gz"] == {"column": "w", "unit": "rad/s", "sign": -1}
    assert server.get(path).json() == stored
    assert "lab logger" in [m["name"] for m in server.get(f"{API}/mappings").json()]
    bad = {"streams": {"imu": {"t": {"column": "ms", "unit": "furlong"}, "gz": {"column": "w"}}}}
    assert problem(server.put(path, json=bad), 422, "parameter")["where"]["parameter"] == "streams.imu.t.unit"
    assert server.get(path).json() == stored
    assert server.delete(path).status_code == 204
    problem(server.get(path), 404, "not_found")
    problem(server.delete(path), 404, "not_found")


def test_addresses_that_lead_nowhere(server: TestClient) -> None:
    problem(server.get(f"{API}/nothing"), 404, "not_found")
    problem(server.put(f"{API}/runs"), 405, "method_not_allowed")
    page = server.get("/nothing", headers={"Accept": "text/html"})
    assert page.status_code == 404 and page.headers["content-type"].startswith("text/html")
    problem(server.get("/runs/nothing.json", headers={"Accept": "text/html"}), 404, "not_found")
