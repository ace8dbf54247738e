"""kill -9 of the server in the middle of a stream: no acknowledged row is lost, and the run goes on."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from app.live.client import Client, wire
from core.formats.run_json import meta_to_json
from core.live.pieces import pieces
from core.simulation import simulate
from core.simulation.scenarios import SCENARIOS

ROOT = Path(__file__).resolve().parents[3]
SERVE = """
import sys, uvicorn
from pathlib import Path
from app.main import create_app
from app.settings import Settings
app = create_app(Settings(data=Path(sys.argv[1]), workers=1))
uvicorn.run(app, host="127.0.0.1", port=int(sys.argv[2]), log_level="error")
"""
RUN = simulate(SCENARIOS["straight"].run(), {}, 2).crop(0.0, 6.0)


def start(data: Path, port: int) -> subprocess.Popen[bytes]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen([sys.executable, "-c", SERVE, str(data), str(port)], cwd=ROOT, env=environment)


async def drive(client: Client, kill: Any) -> None:
    """Stream the run; `kill` comes in the middle. Cuts anywhere in the log: `test_log.py`."""
    serving = asyncio.create_task(client.run())
    parts = list(pieces(RUN, 0.05))
    for n, piece in enumerate(parts):
        client.send(wire(piece))
        await asyncio.sleep(0.004)
        if n == len(parts) // 2:
            while client.waiting == n + 1:  # something is acknowledged
                await asyncio.sleep(0.01)
            await asyncio.to_thread(kill)
    while client.waiting:
        await asyncio.sleep(0.05)
    serving.cancel()


def test_a_killed_server_loses_no_acknowledged_row_and_the_run_goes_on(tmp_path: Path) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    servers = [start(tmp_path, port)]

    def kill() -> None:
        servers[-1].send_signal(signal.SIGKILL)
        servers[-1].wait(10)
        servers.append(start(tmp_path, port))

    hello = {"session": "one", "run": meta_to_json(RUN.meta)}
    client = Client(f"http://127.0.0.1:{port}", "mill", hello)
    try:
        asyncio.run(drive(client, kill))
        with httpx.Client(base_url=f"http://127.0.0.1:{port}/api/v1", timeout=30) as web:
            sent = {n: len(log) for n, log in RUN.logs().items()}
            found: dict[str, Any] = {"streams": []}
            end = time.monotonic() + 120
            while {s["name"]: s["rows"] for s in found["streams"]} != sent and time.monotonic() < end:
                time.sleep(0.1)
                found = web.get(f"/runs/{client.run_id}").json()
            assert {s["name"]: s["rows"] for s in found["streams"]} == sent and found["is_live"]
            assert [r["id"] for r in web.get("/runs").json()["items"]] == [client.run_id]  # it went on, none began anew
            got = web.get(f"/runs/{client.run_id}/streams/imu?columns=gz&points=5000").json()["series"][0]
            assert RUN.imu is not None
            np.testing.assert_array_equal(got["t"], RUN.imu.t)
            np.testing.assert_array_equal(got["y"], RUN.imu.gz)
    finally:
        servers[-1].terminate()
        servers[-1].wait(20)
