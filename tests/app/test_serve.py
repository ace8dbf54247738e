"""`driftscope serve` as a process: its address, a port in use, event streams, an end that leaves nothing behind."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import psutil
import pytest

from app.serve import GRACE_S, sole_server

ROOT = Path(__file__).resolve().parents[2]
CIRCLE = ROOT / "tests" / "data" / "optiodom-circle"
COMMAND = [sys.executable, "-m", "app.cli", "serve", "--port", "0", "--data"]
SLACK_S = 20.0  # a busy machine; what is tested is that nothing waits for a reader or a job, which would take forever


@pytest.fixture
def process(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    env = {**os.environ, "PYTHONPATH": str(ROOT), "DRIFTSCOPE_WORKERS": "1"}
    subprocess.run(
        [sys.executable, "-m", "app.cli", "import", str(CIRCLE), "--data", str(tmp_path / "data")],
        env=env, check=True, capture_output=True, timeout=60,
    )  # fmt: skip
    with subprocess.Popen([*COMMAND, str(tmp_path / "data")], stdout=subprocess.PIPE, text=True, env=env) as started:
        yield started
        started.kill()


def test_an_open_event_stream_ends_with_the_server_and_nothing_stays(process: subprocess.Popen[str]) -> None:
    assert process.stdout is not None
    greeting = process.stdout.readline()
    assert greeting.startswith("Driftscope is at http://127.0.0.1:")
    url = greeting.split()[-1]
    heard = []
    with httpx.Client(base_url=url, timeout=60) as client:
        assert client.get("/runs").status_code == 200
        with client.stream("GET", "/api/v1/jobs/events") as stream:
            lines = stream.iter_lines()
            for line in lines:
                if line.startswith("data:"):
                    heard.append(json.loads(line[5:]))
                    if heard[-1]["state"] == "done":
                        break
            family = psutil.Process(process.pid).children(recursive=True)
            assert family
            process.send_signal(signal.SIGTERM)
            rest = list(lines)  # ends: the server closes the stream
    assert all(not line.startswith("data:") or json.loads(line[5:]) for line in rest)
    assert process.wait(GRACE_S + SLACK_S) == 0
    states = [job["state"] for job in heard]  # of what `import` had queued
    assert states == sorted(states, key=["queued", "running", "done"].index)
    _, alive = psutil.wait_procs(family, timeout=SLACK_S)
    assert not [p for p in alive if p.is_running() and p.status() != psutil.STATUS_ZOMBIE]


def test_it_stops_while_the_cluster_still_starts(process: subprocess.Popen[str]) -> None:
    assert process.stdout is not None
    process.stdout.readline()
    process.send_signal(signal.SIGINT)
    began = time.monotonic()
    assert process.wait(GRACE_S + SLACK_S) == 0
    assert time.monotonic() - began < GRACE_S + SLACK_S


def test_a_port_in_use_is_told_in_one_line(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        command = [sys.executable, "-m", "app.cli", "serve", "--port", port, "--data", str(tmp_path / "data")]
        done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=60, check=False)
    assert done.returncode == 1
    assert done.stderr == f"driftscope: 127.0.0.1:{port} is in use: stop what listens there, or choose another --port\n"
    assert not (tmp_path / "data").exists()


def test_a_second_server_on_the_same_data_is_refused(tmp_path: Path) -> None:
    with sole_server(tmp_path):
        done = subprocess.run(
            [*COMMAND, str(tmp_path)], capture_output=True, text=True, cwd=ROOT, timeout=60, check=False
        )
    assert done.returncode == 1
    assert "is in use by another server" in done.stderr
    assert done.stderr.count("\n") == 1
