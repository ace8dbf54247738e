"""The monitor as it is seen: from a robot's sending to the map's drawing, in Chromium.

    python tests/bench/bench_monitor.py --seconds 30 --views map,both        map alone, and beside the 3D view

One robot at 100 Hz IMU, 50 Hz wheels, 10 Hz fixes sends every 50 ms; server, robot, browser and this script share one
machine and one clock. Delay: from sending the batch that a pose stems from to the animation frame in which the map
draws that pose. Frames: animation frames of the page, and of the 3D view; a display adds up to one more. 3D is drawn
in software here, on the same cores: with a graphics card it is not.
"""

from __future__ import annotations

import argparse
import asyncio
import bisect
import contextlib
import json
import secrets
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import websockets
from playwright.sync_api import Page, sync_playwright

sys.path[:0] = [str(Path(__file__).parents[1] / "browser"), str(Path(__file__).parent), str(Path(__file__).parents[2])]

import install  # noqa: E402
from bench_live import _frame, recording  # noqa: E402
from conftest import FLAGS, FLAT, ROOT, WEBGL  # noqa: E402

from app.live.protocol import PROTOCOL  # noqa: E402
from core.formats.run_json import meta_to_json  # noqa: E402

BATCH_S = 0.05
WATCH = """
window.drawn = []; window.frames = [];
new MutationObserver(() => window.drawn.push([Date.now() / 1000, Number(document.documentElement.dataset.poseT)]))
    .observe(document, { subtree: true, attributeFilter: ["data-pose-t"] });
const tick = (now) => { window.frames.push(now); requestAnimationFrame(tick); };
requestAnimationFrame(tick);
"""


class Robot(threading.Thread):
    """Drives until it is told to stop; `sent`: newest stamp of each batch and when it went."""

    def __init__(self, url: str) -> None:
        super().__init__(daemon=True)
        self.url, self.stopping = url, threading.Event()
        self.sent: list[tuple[float, float]] = []

    def run(self) -> None:
        asyncio.run(self._drive())

    async def _drive(self) -> None:
        run, parts = recording(BATCH_S)
        address = f"{self.url.replace('http', 'ws')}/api/v1/live/bench"
        async with websockets.connect(address, compression=None) as socket:
            said = {
                "type": "hello",
                "protocol": PROTOCOL,
                "session": secrets.token_hex(4),
                "run": meta_to_json(run.meta),
            }
            await socket.send(json.dumps(said))
            reading = asyncio.create_task(self._listen(socket))
            began, turns = time.monotonic(), np.zeros(2)
            for n in range(10**9):
                lap, k = divmod(n, len(parts))
                if k == 0 and n:
                    turns += np.array((parts[-1]["wheels"]["left"][-1], parts[-1]["wheels"]["right"][-1]))
                await asyncio.sleep(max(began + (n + 1) * BATCH_S - time.monotonic(), 0.0))
                if self.stopping.is_set():
                    break
                newest = max(float(columns["t"][-1]) for columns in parts[k].values()) + lap * len(parts) * BATCH_S
                self.sent.append((newest, time.time()))
                await socket.send(_frame(n, parts[k], lap * len(parts) * BATCH_S, turns))
            reading.cancel()

    @staticmethod
    async def _listen(socket: Any) -> None:
        with contextlib.suppress(websockets.ConnectionClosed):
            async for _ in socket:
                pass


def told(page: Page, robot: Robot, view: str, seconds: float) -> None:
    """Watch for a while, and print what was seen."""
    page.goto(f"/live/bench?view={view}")
    page.wait_for_selector("html[data-ready=monitor]")
    if view != "map":
        page.wait_for_selector('#scene[data-scene="ready"]', timeout=120_000)
    while page.evaluate("window.drawn.length") < 50:
        time.sleep(0.2)
    time.sleep(3.0)
    clear = "() => { window.drawn = []; window.frames = []; }"
    views = [frame for frame in page.frames if frame == page.main_frame or "/scene/" in frame.url]
    for frame in views:
        frame.evaluate(clear)
    time.sleep(seconds)
    drawn = page.evaluate("window.drawn")
    stamps = [t for t, _ in robot.sent]
    delay = np.array([1e3 * (at - robot.sent[bisect.bisect_left(stamps, t - 1e-6)][1]) for at, t in drawn[1:]])
    print(f"{view:5s} delay: median {np.median(delay):.0f} ms, 99th percentile {np.quantile(delay, 0.99):.0f} ms, "
          f"{len(delay) / seconds:.0f} drawings a second", end="")  # fmt: skip
    for frame in views:
        apart = np.diff(frame.evaluate("window.frames"))
        name = "page" if frame == page.main_frame else "3D"
        print(f"; {name}: {1e3 / np.mean(apart):.0f} frames a second, longest {apart.max():.0f} ms", end="")
    print(flush=True)


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--views", default="map,both")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as data, sync_playwright() as playwright:
        command = [sys.executable, "-m", "app.cli", "serve", "--port", "0", "--data", data]
        server = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
        assert server.stdout is not None
        url = server.stdout.readline().split()[-1]
        robot = Robot(url)
        robot.start()
        try:
            for view in options.views.split(","):
                flags = [*FLAGS, *(FLAT if view == "map" else WEBGL)]
                browser = playwright.chromium.launch(executable_path=install.find(), args=flags)
                page = browser.new_page(base_url=url, viewport={"width": 1280, "height": 900})
                page.add_init_script(WATCH)
                told(page, robot, view, options.seconds)
                browser.close()
        finally:
            robot.stopping.set()
            robot.join(5)
            server.terminate()
            server.wait(20)
    return 0


if __name__ == "__main__":
    sys.exit(main())
