"""Many robots at one server: latency from sending to estimate, loss, memory. `python tests/bench/bench_live.py`

    --robots 50 --seconds 60 --batch-ms 100     robots at 100 Hz IMU, 50 Hz wheels, 10 Hz fixes
    --minutes 30                                the long form: memory over the time

The server is `driftscope serve` as a process of its own with its workers; this process is all robots. Latency is taken
by the server: its clock when the estimate is there less the robot's clock when the batch was sent (one machine, one
clock), the median and 99th percentile of the last ten seconds of each robot, listed at the end.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import secrets
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import httpx
import msgpack
import numpy as np
import websockets

from app.live.protocol import PROTOCOL
from core.formats.run_json import meta_to_json
from core.live.pieces import pieces
from core.run import Run
from core.simulation import simulate
from core.simulation.scenarios import SCENARIOS, Rates

ROOT = Path(__file__).resolve().parents[2]


def recording(batch_s: float) -> tuple[Run, list[dict[str, dict[str, Any]]]]:
    """A drive, cut into batches of columns as arrays; played again and again with later stamps."""
    rates = Rates(commands=20.0, wheels=50.0, imu=100.0, beacon=10.0, ranges=0.0, truth=0.0)
    run = simulate(SCENARIOS["figure-eight"].run(rates), {}, 1)
    parts = [{n: dict(log.columns()) for n, log in piece.logs().items()} for piece in pieces(run, batch_s)]
    return run, parts[: int(run.duration / batch_s)]


async def robot(url: str, name: str, run: Run, parts: list[Any], batch_s: float, end: float, seen: list[int]) -> int:
    """One robot, in step with the clock; the batches that it sent. `seen` counts acknowledged ones."""
    async with websockets.connect(f"{url.replace('http', 'ws')}/api/v1/live/{name}", compression=None) as socket:
        hello = {"type": "hello", "protocol": PROTOCOL, "session": secrets.token_hex(4), "run": meta_to_json(run.meta)}
        await socket.send(json.dumps(hello))
        await socket.recv()
        acks = asyncio.create_task(_acks(socket, seen))
        n, began = 0, time.monotonic() + np.random.default_rng(list(name.encode())).uniform(0, batch_s)
        turns = np.zeros(2)
        span = len(parts) * batch_s
        while time.monotonic() < end:
            lap, k = divmod(n, len(parts))
            if k == 0 and n:
                last = parts[-1]["wheels"]
                turns += np.array((last["left"][-1], last["right"][-1]))
            await asyncio.sleep(max(began + (n + 1) * batch_s - time.monotonic(), 0.0))
            await socket.send(_frame(n, parts[k], lap * span, turns))
            n += 1
        for _ in range(200):
            if seen[0] >= n:
                break
            await asyncio.sleep(0.05)
        acks.cancel()
        return n


def _frame(n: int, part: dict[str, dict[str, Any]], later: float, turns: Any) -> bytes:
    streams = {}
    for name, columns in part.items():
        made = dict(columns)
        made["t"] = columns["t"] + later
        if name == "wheels":
            made["left"], made["right"] = columns["left"] + turns[0], columns["right"] + turns[1]
        streams[name] = {c: np.asarray(v, "<f8").tobytes() for c, v in made.items()}
    packed: bytes = msgpack.packb({"type": "batch", "n": n, "sent": time.time(), "streams": streams})
    return packed


async def _acks(socket: Any, seen: list[int]) -> None:
    async for frame in socket:
        message = msgpack.unpackb(frame) if isinstance(frame, bytes) else json.loads(frame)
        if message["type"] == "ack":
            seen[0] = max(seen[0], message["n"] + 1)
        elif message["type"] != "driver":
            print("told:", message)


def memory_mb(pid: int) -> dict[str, float]:
    """Resident memory of the server and its live workers."""
    found = {"server": _rss(pid)}
    for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
        command = Path(f"/proc/{child}/cmdline").read_bytes()
        if b"app.live.worker" in command:
            found["live workers"] = found.get("live workers", 0.0) + _rss(int(child))
    return found


def _rss(pid: int) -> float:
    line = next(x for x in Path(f"/proc/{pid}/status").read_text().splitlines() if x.startswith("VmRSS"))
    return int(line.split()[1]) / 1024


def cpu_s(pid: int) -> dict[str, float]:
    """Processor time of the server and its live workers so far."""
    tick = os.sysconf("SC_CLK_TCK")

    def of(p: int) -> float:
        fields = Path(f"/proc/{p}/stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / tick

    found = {"server": of(pid)}
    for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split():
        if b"app.live.worker" in Path(f"/proc/{child}/cmdline").read_bytes():
            found["live workers"] = found.get("live workers", 0.0) + of(int(child))
    return found


async def run_all(url: str, pid: int, options: argparse.Namespace) -> None:
    batch_s = options.batch_ms / 1e3
    run, parts = recording(batch_s)
    seconds = options.minutes * 60 if options.minutes else options.seconds
    seen = [[0] for _ in range(options.robots)]
    async with httpx.AsyncClient(base_url=f"{url}/api/v1", timeout=60) as web:
        warm = [0]
        await robot(url, "warm-up", run, parts, batch_s, time.monotonic() + 8.0, warm)
        for _ in range(240):  # kernels are loaded, or compiled, by then
            rows = (await web.get("/live")).json()["items"]
            if rows[0]["quality"]["backlog"] == 0:
                break
            await asyncio.sleep(0.5)
        await web.post("/live/warm-up/end")
        before, began, own = cpu_s(pid), time.monotonic(), time.process_time()
        end = began + seconds
        robots = [robot(url, f"r{k}", run, parts, batch_s, end, seen[k]) for k in range(options.robots)]
        work = asyncio.gather(*robots)
        while not work.done():
            await asyncio.sleep(min(max(end - time.monotonic() - 1.0, 0.5), 60.0))
            if options.minutes:
                print(
                    f"{(time.monotonic() - began) / 60:5.1f} min",
                    {k: round(v) for k, v in memory_mb(pid).items()},
                    "MB",
                )
            elif not work.done():
                break
        listed = (await web.get("/live")).json()["items"]
        after, passed, own = cpu_s(pid), time.monotonic() - began, time.process_time() - own
        sent = await work
        rows = (await web.get("/live")).json()["items"]
    told = [r["quality"] for r in listed if r["quality"]["delay_ms"] is not None]
    delay = np.array([q["delay_ms"] for q in told])
    worst = np.array([q["latency_p99_ms"] + q["delay_ms"] - q["latency_ms"] for q in told])
    lost = sum(n - s[0] for n, s in zip(sent, seen, strict=True))
    imu = sum(r["rows"].get("imu", 0) for r in rows)
    dropped = sum(r["quality"]["late_rows"] for r in rows)
    print(f"{options.robots} robots, batches of {options.batch_ms} ms, {seconds:g} s")
    print(f"{sum(sent)} batches, {lost} not acknowledged; {imu} IMU rows, {dropped} rows dropped")
    print(f"sending to estimate: median {np.median(delay):.1f} ms, 99th percentile {np.median(worst):.1f} ms", end=" ")
    print(f"of the typical robot, {worst.max():.1f} ms of the worst")
    spent = {**{k: after[k] - before.get(k, 0.0) for k in after}, "these robots": own}
    driven = imu / 100.0  # s of all robots together
    used = {
        k: f"{100 * v / passed:.0f} % of a core, {1e3 * v / driven:.2f} ms per robot and second"
        for k, v in spent.items()
    }
    held = {k: f"{v:.0f} MB" for k, v in memory_mb(pid).items()}
    print("processor:", used)
    print("memory:", held, "load:", round(os.getloadavg()[0], 1))


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--robots", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--minutes", type=float, default=0.0)
    parser.add_argument("--batch-ms", type=int, default=100)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as data:
        command = [sys.executable, "-m", "app.cli", "serve", "--port", "0", "--data", data]
        server = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
        try:
            assert server.stdout is not None
            url = server.stdout.readline().split()[-1]
            asyncio.run(run_all(url, server.pid, options))
        finally:
            server.terminate()
            server.wait(20)
    return 0


if __name__ == "__main__":
    sys.exit(main())
