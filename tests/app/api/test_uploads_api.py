"""Resumable uploads: acknowledged means safe, every mismatch is told, what can't succeed leaves nothing."""

from __future__ import annotations

import hashlib
import shutil
import time
from collections.abc import Callable
from datetime import timedelta
from itertools import pairwise
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from app.db.session import writing
from app.db.tables import Upload, now
from app.store import uploads

API = "/api/v1"
Zipped = Callable[..., bytes]


def begin(server: TestClient, data: bytes, **more: object) -> str:
    body = {"file_name": "lap.zip", "size": len(data), **more}
    answer = server.post(f"{API}/uploads", json=body)
    assert answer.status_code == 201, answer.text
    assert answer.json()["received"] == 0
    return answer.json()["id"]


def send(server: TestClient, upload_id: str, offset: int, data: bytes) -> object:
    return server.patch(f"{API}/uploads/{upload_id}", content=data, headers={"Upload-Offset": str(offset)})


def finished(server: TestClient, upload_id: str, body: dict | None = None) -> dict:
    """The job that reads the upload, once it has ended."""
    answer = server.post(f"{API}/uploads/{upload_id}/finish", json=body or {})
    assert answer.status_code == 202, answer.text
    return ended(server, answer.json()["id"])


def ended(server: TestClient, job_id: str) -> dict:
    """The job, once it has ended."""
    for _ in range(600):
        job = server.get(f"{API}/jobs/{job_id}").json()
        if job["state"] in ("done", "failed", "cancelled"):
            return job
        time.sleep(0.05)
    raise AssertionError(f"the job never ended: {job}")


def gone(server: TestClient, upload_id: str) -> bool:
    """Whether the upload is dropped, which happens a moment after its job ends."""
    for _ in range(100):
        if server.get(f"{API}/uploads/{upload_id}").status_code == 404:
            return not path_of(server, upload_id).exists()
        time.sleep(0.02)
    return False


def path_of(server: TestClient, upload_id: str) -> Path:
    return uploads.path_of(server.app.state.settings, upload_id)


def count(server: TestClient) -> int:
    return len(list((server.app.state.settings.data / "uploads").glob("*")))


def test_in_pieces(server: TestClient, zipped: Zipped) -> None:
    data = zipped(turn=0.41)
    upload_id = begin(server, data, sha256=hashlib.sha256(data).hexdigest().upper(), tags=["pieces"])
    third = len(data) // 3
    assert send(server, upload_id, 0, data[:third]).json()["received"] == third
    assert server.get(f"{API}/uploads/{upload_id}").json()["received"] == third
    wrong = send(server, upload_id, 0, data)
    assert wrong.status_code == 409 and wrong.json()["where"]["expected"] == third
    early = server.post(f"{API}/uploads/{upload_id}/finish", json={})
    assert early.status_code == 422 and early.json()["code"] == "size_mismatch"
    assert send(server, upload_id, third, data[third:]).json()["received"] == len(data)
    job = finished(server, upload_id)
    assert job["state"] == "done", job
    run = server.get(f"{API}/runs/{job['result']['run_id']}").json()
    assert run["tags"] == ["pieces"] and gone(server, upload_id)


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.binary(min_size=1, max_size=300), cuts=st.lists(st.integers(0, 300), max_size=5).map(sorted))
def test_any_cutting_gives_the_same_bytes(server: TestClient, data: bytes, cuts: list[int]) -> None:
    upload_id = begin(server, data)
    edges = [0, *[min(c, len(data)) for c in cuts], len(data)]
    for a, b in pairwise(edges):
        assert send(server, upload_id, a, data[a:b]).json()["received"] == b
    assert path_of(server, upload_id).read_bytes() == data
    assert server.delete(f"{API}/uploads/{upload_id}").status_code == 204
    assert not path_of(server, upload_id).exists()


def test_more_than_announced(server: TestClient) -> None:
    upload_id = begin(server, b"12345")
    answer = send(server, upload_id, 0, b"123456")
    assert answer.status_code == 422 and answer.json()["code"] == "size_mismatch"
    assert server.get(f"{API}/uploads/{upload_id}").json()["received"] == 0
    server.delete(f"{API}/uploads/{upload_id}")


def test_wrong_checksum(server: TestClient, zipped: Zipped) -> None:
    data = zipped(turn=0.42)
    upload_id = begin(server, data, sha256="0" * 64)
    send(server, upload_id, 0, data)
    answer = server.post(f"{API}/uploads/{upload_id}/finish", json={})
    assert answer.status_code == 422 and answer.json()["code"] == "checksum_mismatch"
    assert answer.json()["where"]["found"] == hashlib.sha256(data).hexdigest()
    server.delete(f"{API}/uploads/{upload_id}")
    before = count(server)
    headers = {"X-Checksum-Sha256": "0" * 64}
    answer = server.post(f"{API}/runs", params={"filename": "a.zip"}, content=data, headers=headers)
    assert answer.status_code == 422 and answer.json()["code"] == "checksum_mismatch"
    headers = {"X-Checksum-Sha256": "xyz"}
    answer = server.post(f"{API}/runs", params={"filename": "a.zip"}, content=data, headers=headers)
    assert answer.status_code == 422 and answer.json()["where"]["parameter"] == "sha256"
    assert count(server) == before


@pytest.mark.parametrize(
    ("name", "data", "code", "where"),
    [
        ("imu.csv", b"t,gz\n0,1\n1,x\n", "format", {"stream": "imu", "row": 2, "column": "gz"}),
        ("imu.csv", b"t,gz\n", "format", {"stream": "imu"}),
        ("a.zip", b"PK\x03\x04 nonsense", "format", {}),
        ("a.exe", b"MZ\x00\x01", "unknown_format", {"file": "a.exe"}),
        ("empty.csv", b"", "size_mismatch", {"file": "empty.csv"}),
    ],
)
def test_malformed_files_are_refused_and_leave_nothing(
    server: TestClient, name: str, data: bytes, code: str, where: dict
) -> None:
    before, total = count(server), server.get(f"{API}/runs").json()["total"]
    answer = server.post(f"{API}/runs", params={"filename": name}, content=data)
    assert answer.status_code == 422, answer.text
    body = answer.json()
    assert body["code"] == code and where.items() <= body["where"].items(), body
    assert count(server) == before and server.get(f"{API}/runs").json()["total"] == total
    if data:
        upload_id = begin(server, data, file_name=name)
        send(server, upload_id, 0, data)
        job = finished(server, upload_id)
        assert job["state"] == "failed" and job["error"]["code"] == code and job["error"]["status"] == 422
        assert gone(server, upload_id)


def test_a_foreign_table_waits_for_its_mapping(server: TestClient) -> None:
    data = b"time_ms,yaw_rate\n0,1\n20,2\n40,3\n"
    answer = server.post(f"{API}/runs", params={"filename": "log.csv"}, content=data)
    assert answer.status_code == 422 and answer.json()["code"] == "needs_mapping"
    where = answer.json()["where"]
    assert where["columns"] == ["time_ms", "yaw_rate"]
    upload_id = where["upload"]
    table = server.get(f"{API}/uploads/{upload_id}/columns").json()
    assert table["needs_mapping"] and table["rows"][2] == {"time_ms": "40", "yaw_rate": "3"}
    job = finished(server, upload_id)
    assert job["error"]["code"] == "needs_mapping"
    bad = {"mapping": {"streams": {"imu": {"t": {"column": "time_ms", "unit": "year"}}}}}
    refused = server.post(f"{API}/uploads/{upload_id}/finish", json=bad)
    assert refused.status_code == 422 and refused.json()["code"] == "parameter"
    mapping = {"streams": {"imu": {"t": {"column": "time_ms", "unit": "ms"}, "gz": {"column": "yaw_rate"}}}}
    job = finished(server, upload_id, {"mapping": mapping})
    assert job["state"] == "done", job
    run = server.get(f"{API}/runs/{job['result']['run_id']}").json()
    assert run["source"]["mapping"]["streams"].keys() == {"imu"} and run["duration_s"] == pytest.approx(0.04)
    assert gone(server, upload_id)


def test_rows_whose_stamps_go_back_can_be_left_out(server: TestClient) -> None:
    rows = [(0.0, 1.0), (0.1, 1.5), (0.05, 9.0), (0.2, 2.0), (0.2, 9.0), (0.3, 2.5)]
    data = ("t,gz\n" + "".join(f"{t},{gz}\n" for t, gz in rows)).encode()
    total = server.get(f"{API}/runs").json()["total"]
    answer = server.post(f"{API}/runs", params={"filename": "imu.csv"}, content=data)
    assert answer.status_code == 422 and answer.json()["code"] == "stamp_order"
    where = answer.json()["where"]
    assert (where["stream"], where["row"], where["column"]) == ("imu", 3, "t")
    assert server.get(f"{API}/runs").json()["total"] == total
    again = finished(server, where["upload"])
    assert again["error"]["code"] == "stamp_order"
    job = finished(server, where["upload"], {"in_order": True})
    assert job["state"] == "done", job
    run = server.get(f"{API}/runs/{job['result']['run_id']}").json()
    assert "row 3 says 0.05 s after 0.1 s" in run["warnings"][0] and "2 of 6" in run["warnings"][0]
    shown = server.get(f"{API}/runs/{run['id']}/streams/imu", params={"columns": "gz"}).json()
    assert shown["series"][0]["y"] == [1.0, 1.5, 2.0, 2.5]
    assert gone(server, where["upload"])


def test_asynchronous_upload(server: TestClient, zipped: Zipped) -> None:
    headers = {"Prefer": "respond-async"}
    answer = server.post(f"{API}/runs", params={"filename": "a.zip"}, content=zipped(turn=0.43), headers=headers)
    assert answer.status_code == 202 and answer.json()["kind"] == "ingest"
    assert answer.headers["location"] == f"{API}/jobs/{answer.json()['id']}"
    assert ended(server, answer.json()["id"])["state"] == "done"
    for _ in range(100):  # the file is dropped a moment after
        if count(server) == 0:
            break
        time.sleep(0.02)
    assert count(server) == 0


def test_a_job_that_reads_keeps_others_off(server: TestClient, zipped: Zipped) -> None:
    data = zipped(turn=0.44)
    upload_id = begin(server, data)
    send(server, upload_id, 0, data)
    first = server.post(f"{API}/uploads/{upload_id}/finish", json={})
    assert first.status_code == 202
    second = server.post(f"{API}/uploads/{upload_id}/finish", json={})
    assert second.status_code in (404, 409)  # being read, or read already
    assert gone(server, upload_id)


def test_two_senders_at_once(server: TestClient) -> None:
    upload_id = begin(server, b"12345")
    server.app.state.busy_uploads.add(upload_id)
    try:
        for answer in (send(server, upload_id, 0, b"1"), server.delete(f"{API}/uploads/{upload_id}")):
            assert answer.status_code == 409 and answer.json()["code"] == "conflict"
    finally:
        server.app.state.busy_uploads.discard(upload_id)
    assert server.delete(f"{API}/uploads/{upload_id}").status_code == 204


def test_too_large(server: TestClient) -> None:
    limit = server.app.state.settings.max_upload_bytes
    answer = server.post(f"{API}/uploads", json={"file_name": "a.zip", "size": limit + 1})
    assert answer.status_code == 413 and answer.json()["where"] == {"expected": limit, "found": limit + 1}
    headers = {"Content-Length": str(limit + 1)}
    answer = server.post(f"{API}/runs", params={"filename": "a.zip"}, content=iter([b"x"]), headers=headers)
    assert answer.status_code == 413


def test_no_room(server: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    before = count(server)
    usage = shutil.disk_usage("/")
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=1 << 20))
    for answer in (
        server.post(f"{API}/uploads", json={"file_name": "a.zip", "size": 1 << 20}),
        server.post(f"{API}/runs", params={"filename": "a.zip"}, content=b"x"),
    ):
        assert answer.status_code == 507 and answer.json()["code"] == "disk_full"
    assert count(server) == before


def test_the_disk_fills_up_on_the_way(server: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    before = count(server)

    def full(self: uploads.Appender, chunk: bytes) -> None:
        raise OSError(28, "No space left on device")

    upload_id = begin(server, b"12345")
    with monkeypatch.context() as patched:
        patched.setattr(uploads.Appender, "write", full)
        answers = [
            send(server, upload_id, 0, b"12345"),
            server.post(f"{API}/runs", params={"filename": "a.zip"}, content=b"x"),
        ]
    for answer in answers:
        assert answer.status_code == 507 and answer.json()["code"] == "disk_full"
    assert send(server, upload_id, 0, b"12345").json()["received"] == 5
    server.delete(f"{API}/uploads/{upload_id}")
    assert count(server) == before


def disconnecting(server: TestClient, method: str, path: str, query: str, chunks: list[bytes], offset: int) -> None:
    """A request whose client vanishes after some chunks, straight through the ASGI door."""
    messages = [{"type": "http.request", "body": c, "more_body": True} for c in chunks] + [{"type": "http.disconnect"}]

    async def receive() -> dict:
        return messages.pop(0) if messages else {"type": "http.disconnect"}

    async def ignore(message: dict) -> None:
        return None

    scope = {
        "type": "http", "asgi": {"version": "3.0"}, "http_version": "1.1", "method": method, "path": path,
        "raw_path": path.encode(), "query_string": query.encode(), "root_path": "", "scheme": "http",
        "headers": [(b"host", b"testserver"), (b"upload-offset", str(offset).encode())],
        "client": ("127.0.0.1", 1), "server": ("testserver", 80), "state": {},
    }  # fmt: skip
    server.portal.call(server.app, scope, receive, ignore)


def test_a_lost_connection_keeps_what_came(server: TestClient) -> None:
    upload_id = begin(server, b"0123456789")
    disconnecting(server, "PATCH", f"{API}/uploads/{upload_id}", "", [b"0123", b"45"], 0)
    assert server.get(f"{API}/uploads/{upload_id}").json()["received"] == 6
    assert send(server, upload_id, 6, b"6789").json()["received"] == 10
    assert path_of(server, upload_id).read_bytes() == b"0123456789"
    server.delete(f"{API}/uploads/{upload_id}")


def test_a_lost_connection_of_a_direct_upload_leaves_nothing(server: TestClient) -> None:
    before = count(server)
    disconnecting(server, "POST", f"{API}/runs", "filename=a.zip", [b"PK\x03\x04", b"abc"], 0)
    assert count(server) == before


def test_bytes_beyond_what_was_acknowledged_are_cut_off(server: TestClient) -> None:
    upload_id = begin(server, b"0123456789")
    send(server, upload_id, 0, b"0123")
    with path_of(server, upload_id).open("ab") as file:  # written, but the crash came before the row
        file.write(b"garbage")
    assert send(server, upload_id, 4, b"456789").json()["received"] == 10
    assert path_of(server, upload_id).read_bytes() == b"0123456789"
    server.delete(f"{API}/uploads/{upload_id}")


def test_forgotten_uploads_are_dropped(server: TestClient) -> None:
    state = server.app.state
    old, young = begin(server, b"1"), begin(server, b"1")
    with writing(state.engine) as session:
        row = session.get(Upload, old)
        assert row is not None
        row.touched_at = now() - timedelta(hours=state.settings.upload_hours + 1)
    assert uploads.purge(state.engine, state.settings) == 1
    assert not path_of(server, old).exists() and path_of(server, young).exists()
    stray = state.settings.data / "uploads" / "stray"
    stray.write_bytes(b"half")
    uploads.purge_strays(state.engine, state.settings)
    assert not stray.exists() and path_of(server, young).exists()
    server.delete(f"{API}/uploads/{young}")


def test_unknown_uploads(server: TestClient) -> None:
    for answer in (
        server.get(f"{API}/uploads/zzz"),
        send(server, "..%2f..%2fdriftscope.db", 0, b"x"),
        server.delete(f"{API}/uploads/zzz"),
        server.get(f"{API}/uploads/zzz/columns"),
        server.post(f"{API}/uploads/zzz/finish", json={}),
    ):
        assert answer.status_code == 404 and answer.json()["code"] == "not_found"


@pytest.mark.parametrize("name", ["", " ", "..", "a/", "\x00", "x" * 301])
def test_impossible_file_names(server: TestClient, name: str) -> None:
    answer = server.post(f"{API}/uploads", json={"file_name": name, "size": 1})
    assert answer.status_code == 422 and answer.json()["code"] == "parameter"
