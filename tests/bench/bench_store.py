"""Storing 12 hours at 384 Hz: against polars reading the same file, over HTTP, and the first plot. Run by hand.

python tests/bench/bench_store.py [rows]
"""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import numpy as np
import polars as pl

ROWS = int(sys.argv[1]) if len(sys.argv) > 1 else 12 * 3600 * 384
RATE = 384.0
REPEATS = 3

READ = """
import sys, polars as pl
frame = pl.read_csv(sys.argv[1])
assert frame.height
"""
INGEST = """
import sys
from pathlib import Path
from app.ingest import IngestOptions, ingest_file
ingest_file(Path(sys.argv[2]), Path(sys.argv[1]), IngestOptions(file_name="imu.csv"))
"""
SERVE = """
import sys, uvicorn
from pathlib import Path
from app.main import create_app
from app.settings import Settings
app = create_app(Settings(data=Path(sys.argv[1])))
uvicorn.run(app, host="127.0.0.1", port=int(sys.argv[2]), log_level="warning")
"""
TIMED = """
import resource, sys, time
{prelude}
began = time.perf_counter()
{body}
took = time.perf_counter() - began
usage = resource.getrusage(resource.RUSAGE_SELF)
print(took, usage.ru_maxrss / 1024, usage.ru_utime + usage.ru_stime)
"""


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        path = root / "imu.csv"
        write(path)
        print(f"{ROWS:,} rows, {path.stat().st_size / 1e6:.0f} MB of CSV")
        read, stored = [], []
        for i in range(REPEATS):
            read.append(timed(READ, "import polars", path))
            prelude = "import app.ingest, polars, core.formats"
            stored.append(timed(INGEST, prelude, path, root / f"data{i}"))
        reading, storing = min(read), min(stored)
        show("polars read_csv", reading)
        show("ingest_file", storing)
        print(f"storing takes {storing[0] / reading[0]:.2f} times as long as reading (limit 2)")
        over_http(root, path, reading[0])


def write(path: Path) -> None:
    rng = np.random.default_rng(1)
    t = np.round(np.arange(ROWS) / RATE, 6)
    pl.DataFrame({"t": t, "gz": np.round(rng.normal(0, 0.1, ROWS), 7)}).write_csv(path)


def timed(body: str, prelude: str, *arguments: Path) -> tuple[float, float, float]:
    """Seconds, peak MB, CPU seconds of a snippet in a fresh process."""
    code = TIMED.format(body=body, prelude=prelude)
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        check=True,
        capture_output=True,
        text=True,
        env=environment(),
    )
    seconds, megabytes, cpu = map(float, done.stdout.split())
    return seconds, megabytes, cpu


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}


def show(name: str, figures: tuple[float, float, float]) -> None:
    print(f"{name:24s} {figures[0]:6.2f} s   peak {figures[1]:5.0f} MB   CPU {figures[2]:5.2f} s")


def over_http(root: Path, path: Path, reading: float) -> None:
    """POST /runs on loopback, then the run's first plots."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    server = subprocess.Popen([sys.executable, "-c", SERVE, str(root / "served"), str(port)], env=environment())
    try:
        with httpx.Client(base_url=f"http://127.0.0.1:{port}/api/v1", timeout=300) as client:
            until_ready(client)
            client.post("/runs", params={"filename": "wheels.csv"}, content=b"t,left,right\n0,0,0\n1,1,1\n")  # warm
            peaks = Peaks(server.pid)
            began = time.perf_counter()
            answer = client.post(
                "/runs", params={"filename": "imu.csv"}, content=pieces(path), headers={"Prefer": "wait"}
            )
            took = time.perf_counter() - began
            answer.raise_for_status()
            print(f"POST /runs               {took:6.2f} s   ({took / reading:.2f} times reading, upload included)")
            for role, peak in peaks.stop().items():
                print(f"    peak RSS of the {role}: {peak:.0f} MB")
            plots(client, answer.json()["id"])
    finally:
        server.terminate()
        server.wait(30)


def plots(client: httpx.Client, run_id: str) -> None:
    def ask(label: str, path: str, **params: object) -> None:
        began = time.perf_counter()
        answer = client.get(path, params=params)
        took = time.perf_counter() - began
        answer.raise_for_status()
        print(f"{label:32s} {1000 * took:7.1f} ms   {len(answer.content) / 1024:6.0f} KiB")

    ask("run page's data", f"/runs/{run_id}")
    ask("first plot, 12 h in 4,000 points", f"/runs/{run_id}/streams/imu", points=4000)
    ask("the same again", f"/runs/{run_id}/streams/imu", points=4000)
    ask("the same as Arrow", f"/runs/{run_id}/streams/imu", points=4000, format="arrow")
    ask("one hour", f"/runs/{run_id}/streams/imu", points=4000, t0=7200, t1=10800)
    ask("one minute", f"/runs/{run_id}/streams/imu", points=4000, t0=7200, t1=7260)


def pieces(path: Path) -> Iterator[bytes]:
    with path.open("rb") as file:
        while piece := file.read(1 << 18):
            yield piece


def until_ready(client: httpx.Client) -> None:
    for _ in range(200):
        try:
            client.get("/runs").raise_for_status()
            return
        except httpx.TransportError:
            time.sleep(0.1)
    raise RuntimeError("the server did not start")


class Peaks:
    """Peak resident memory of a process and of its descendants, sampled."""

    def __init__(self, pid: int) -> None:
        self._pid, self._going = pid, True
        self._peaks: dict[str, float] = {"server": 0.0, "largest worker": 0.0}
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()

    def _watch(self) -> None:
        while self._going:
            self._peaks["server"] = max(self._peaks["server"], resident(self._pid))
            for child in descendants(self._pid):
                self._peaks["largest worker"] = max(self._peaks["largest worker"], resident(child))
            time.sleep(0.02)

    def stop(self) -> dict[str, float]:
        self._going = False
        self._thread.join()
        return self._peaks


def descendants(pid: int) -> list[int]:
    try:
        children = [int(c) for c in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
        for task in Path(f"/proc/{pid}/task").iterdir():
            children += [int(c) for c in (task / "children").read_text().split()]
    except OSError:
        return []
    return [p for c in set(children) for p in (c, *descendants(c))]


def resident(pid: int) -> float:
    """MB, without the pages of mapped files."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0.0
    return next((int(line.split()[1]) / 1024 for line in lines if line.startswith("RssAnon")), 0.0)


if __name__ == "__main__":
    main()
