"""Scenes: time to open, memory and threads of 30 opened and closed three times over, cost of a tick, export."""

from __future__ import annotations

import gc
import sys
import threading
import time
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parents[1] / "app"), str(Path(__file__).parents[2])]

from scene_world import Browser, Hand, Store, scene_data, serve  # noqa: E402

from app.scene.export import export_html  # noqa: E402
from app.scene.pool import Scenes  # noqa: E402
from app.settings import Settings  # noqa: E402


def rss_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096 / 2**20


def opening() -> None:
    store = Store(*(f"run-{i}" for i in range(30)))
    scenes = Scenes(store.load, store.revision, limit=40)
    for lap in range(3):
        start = time.perf_counter()
        for run_id in store.revisions:
            scenes.open(run_id)
        opened, threads, high = time.perf_counter() - start, threading.active_count(), rss_mb()
        start = time.perf_counter()
        scenes.close_idle(0)
        closed = time.perf_counter() - start
        gc.collect()
        print(
            f"lap {lap}: open {opened / 30 * 1e3:.1f} ms each, close {closed / 30 * 1e3:.1f} ms each, "
            f"{threads} threads and {high:.0f} MB open, {threading.active_count()} and {rss_mb():.0f} MB closed"
        )
    scenes.stop()


def playing(seconds: float = 5.0) -> None:
    with serve(Settings(data=Path()), Store("run-a")) as site:
        browser, hand = Browser(site, "run-a", "v1").look(), Hand(site, "run-a", "v1")
        browser.hear(lambda m: m.get("name") == "/world/now/encoders")
        browser.quiet()
        cpu, start = time.process_time(), time.perf_counter()
        hand.move(playing=True)
        end = start + seconds
        heard = browser.hear(lambda m: time.perf_counter() > end, seconds + 5)
        used = (time.process_time() - cpu) / (time.perf_counter() - start)
        moves = [m for m in heard if m["type"] == "SetPositionMessage" and m["name"] == "/world/robots/truth"]
        print(f"playing: {len(moves) / seconds:.1f} poses/s per robot, {used:.0%} of a core with this client in it")
        browser.close()
        hand.close()


def large() -> None:
    data = scene_data(rows=1_000_000)
    start = time.perf_counter()
    html = export_html(data, "light")
    print(
        f"a million rows, 2 methods: an HTML file of {len(html) / 2**20:.1f} MiB in {time.perf_counter() - start:.2f} s"
    )


if __name__ == "__main__":
    opening()
    playing()
    large()
