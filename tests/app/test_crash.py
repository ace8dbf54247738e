"""kill -9 in the middle of an upload: what was acknowledged is there after the restart, and the upload goes on."""

from __future__ import annotations

import hashlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

ROOT = Path(__file__).resolve().parents[2]
PIECE = 1 << 18
SERVE = """
import sys, uvicorn
from pathlib import Path
from app.api import uploads
from app.main import create_app
from app.settings import Settings
uploads.CHECKPOINT = uploads.HOP = 1 << 19
app = create_app(Settings(data=Path(sys.argv[1]), workers=1))
uvicorn.run(app, host="127.0.0.1", port=int(sys.argv[2]), log_level="error")
"""


class Server:
    """A server process on a free port."""

    def __init__(self, data: Path) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        self.process = subprocess.Popen(
            [sys.executable, "-c", SERVE, str(data), str(port)], cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}
        )
        self.client = httpx.Client(base_url=f"http://127.0.0.1:{port}/api/v1", timeout=30)
        for _ in range(600):
            try:
                self.client.get("/runs").raise_for_status()
                return
            except httpx.TransportError:
                time.sleep(0.05)
        raise AssertionError("the server did not start")

    def kill(self) -> None:
        self.process.send_signal(signal.SIGKILL)
        self.process.wait(10)
        self.client.close()


@pytest.fixture
def servers(tmp_path: Path) -> Iterator[list[Server]]:
    """Servers started by the test; none survives it."""
    started: list[Server] = []
    yield started
    for server in started:
        if server.process.poll() is None:
            server.kill()


def test_killed_in_mid_upload(tmp_path: Path, servers: list[Server]) -> None:
    rows = "".join(f"{i / 100:.2f},{(i * 7919) % 1000 / 1000}\n" for i in range(400_000))
    data = ("t,gz\n" + rows).encode()
    assert len(data) > 16 * PIECE
    servers.append(Server(tmp_path / "data"))
    first = servers[-1]
    begun = first.client.post(
        "/uploads",
        json={"file_name": "imu.csv", "size": len(data), "sha256": hashlib.sha256(data).hexdigest()},
    )
    upload_id = begun.json()["id"]
    headers = {"Upload-Offset": "0"}
    acknowledged = first.client.patch(f"/uploads/{upload_id}", content=data[:PIECE], headers=headers).json()["received"]

    def interrupted() -> Iterator[bytes]:
        for at in range(PIECE, len(data), PIECE):
            yield data[at : at + PIECE]
            if at >= 8 * PIECE:
                time.sleep(0.3)
                first.process.send_signal(signal.SIGKILL)

    with pytest.raises(httpx.TransportError):
        first.client.patch(f"/uploads/{upload_id}", content=interrupted(), headers={"Upload-Offset": str(PIECE)})
    first.process.wait(10)

    servers.append(Server(tmp_path / "data"))
    second = servers[-1]
    received = second.client.get(f"/uploads/{upload_id}").json()["received"]
    assert acknowledged + (1 << 19) <= received < len(data)  # a checkpoint was passed, the end was not reached
    stored = (tmp_path / "data" / "uploads" / upload_id).read_bytes()
    assert stored[:received] == data[:received]
    headers = {"Upload-Offset": str(received)}
    done = second.client.patch(f"/uploads/{upload_id}", content=data[received:], headers=headers)
    assert done.json()["received"] == len(data)
    job = second.client.post(f"/uploads/{upload_id}/finish", json={})
    assert job.status_code == 202, job.text
    second.kill()  # and once more, while the file is read

    servers.append(Server(tmp_path / "data"))
    third = servers[-1]
    for _ in range(600):
        ended = third.client.get(f"/jobs/{job.json()['id']}").json()
        if ended["state"] in ("done", "failed"):
            break
        time.sleep(0.1)
    assert ended["state"] == "done", ended
    run = third.client.get(f"/runs/{ended['result']['run_id']}").json()
    assert run["streams"][0]["rows"] == 400_000
    assert third.client.get("/runs").json()["total"] == 1
