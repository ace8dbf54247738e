"""The sandbox as it is felt: ms from an input event on a slider to the last paint of 2D, in Chromium, by its marks.

A recorded mission (130 s) and a drive of 17 min, every stream, on a server of its own. Singles: one key press after the
other, each once the last is painted. Held: 40 presses a second. `request`: from asking to the answer's arrival;
`drawing`: from there to the paint. 3D in software draws on the same cores: once with it, once without. Wall times want
a quiet machine; `processor`: what a single move costs the page's main thread and the server, the gap number included.
`bench_sandbox.py mission flat` does one drive, without 3D.
"""

from __future__ import annotations

import dataclasses
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import httpx
from playwright.sync_api import Page, sync_playwright

sys.path[:0] = [str(Path(__file__).parents[1] / "browser"), str(Path(__file__).parents[2])]

import install  # noqa: E402
from conftest import FLAGS, FLAT, ROOT, WEBGL, free_port  # noqa: E402

from core.formats import write_run  # noqa: E402
from core.simulation import simulate  # noqa: E402
from core.simulation.scenarios import SCENARIOS  # noqa: E402

MARK = "sandbox-move"
NO_3D = """Object.defineProperty(window, "IntersectionObserver", { value: class extends IntersectionObserver {
    observe(e) { if (e.id !== "scene") super.observe(e); } } });"""
EFFECTS = '{"track_width":{"scale":1.02},"motor_lag":{"tau":0.08}}'
DRIVES, WITH = (("mission", 1), ("17 min", 8)), ("without 3D", "with 3D")
SINGLES, HELD_S = 20, 3.0


def made(folder: Path, name: str, laps: int) -> Path:
    """A zip of the mission, driven so many times."""
    mission = SCENARIOS["mission"]
    legs = [leg for _ in range(laps) for leg in mission.legs()]
    run = dataclasses.replace(mission, name=name, legs=lambda: legs).run()
    path = folder / f"{name}.zip"
    write_run(simulate(run, {"track_width": {"scale": 1.03}}, 1), path, "zip-parquet")
    return path


def stored(client: httpx.Client, path: Path) -> str:
    """Its id, once all paths are estimated."""
    answer = client.post("/api/v1/runs", params={"filename": path.name}, content=path.read_bytes())
    run_id: str = answer.raise_for_status().json()["id"]
    while client.get(f"/api/v1/runs/{run_id}").json()["jobs"]:
        time.sleep(0.5)
    return run_id


def measures(page: Page) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = page.evaluate(
        f"""() => performance.getEntriesByName("{MARK}").map((m) => ({{ ms: m.duration, ...m.detail }}))"""
    )
    return found


class Clock:
    """Processor time [s] of the page's main thread and of the server."""

    def __init__(self, page: Page, server: int) -> None:
        self._cdp, self._server = page.context.new_cdp_session(page), server
        self._cdp.send("Performance.enable", {"timeDomain": "threadTicks"})

    def __call__(self) -> tuple[float, float]:
        metrics = {m["name"]: m["value"] for m in self._cdp.send("Performance.getMetrics")["metrics"]}
        spent = Path(f"/proc/{self._server}/stat").read_text().rsplit(")", 1)[1].split()[11:13]
        return metrics["TaskDuration"], sum(map(int, spent)) / os.sysconf("SC_CLK_TCK")


def told(what: str, found: list[dict[str, Any]]) -> None:
    columns = []
    for key in ("ms", "runtime_ms", "request_ms", "drawing_ms"):
        values = sorted(m[key] for m in found)
        at = [statistics.median(values), values[int(0.9 * (len(values) - 1))], values[-1]]
        columns.append(" ".join(f"{v:5.0f}" for v in at))
    late = sum(m["ms"] > 100.0 for m in found)
    print(f"  {what:22s} {len(found):4d} moves | {' | '.join(columns)} | {late} over 100 ms", flush=True)


def bench(page: Page, run_id: str, what: str, server: int) -> None:
    page.goto(f"/sandbox?run={run_id}&effects={EFFECTS}")
    page.wait_for_selector("html[data-ready=sandbox]")
    if what == "with 3D":
        page.wait_for_selector('#scene[data-scene="ready"]')
    time.sleep(5.0)
    page.get_by_label("track width, scale", exact=True).focus()
    page.keyboard.press("ArrowRight")
    time.sleep(1.0)
    page.evaluate("() => performance.clearMeasures()")
    clock = Clock(page, server)
    before = clock()
    for k in range(SINGLES):
        page.keyboard.press("ArrowRight" if k % 10 < 5 else "ArrowLeft")
        page.wait_for_function(f"""() => performance.getEntriesByName("{MARK}").length >= {k + 1}""")
        time.sleep(0.25)
    spent = [1e3 * (b - a) / SINGLES for a, b in zip(before, clock(), strict=True)]
    told(f"singles, {what}", measures(page))
    print(f"  processor: main thread {spent[0]:.0f} ms, server {spent[1]:.0f} ms a move", flush=True)
    page.evaluate("() => performance.clearMeasures()")
    began, k = time.monotonic(), 0
    while time.monotonic() - began < HELD_S:
        page.keyboard.press("ArrowRight" if k % 40 < 20 else "ArrowLeft")
        k += 1
        time.sleep(max(began + k / 40 - time.monotonic(), 0.0))
    time.sleep(0.5)
    told(f"held, {k} keys, {what}", measures(page))


def main() -> None:
    with tempfile.TemporaryDirectory() as name, sync_playwright() as playwright:
        folder, port = Path(name), free_port()
        command = [sys.executable, "-m", "app.cli", "serve", "--port", str(port), "--data", str(folder / "data")]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        with (folder / "log").open("w") as log:
            server = subprocess.Popen(command, cwd=folder, env=environment, stdout=log, stderr=log)
        try:
            client = httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=300)
            while True:
                try:
                    client.get("/runs.json")
                    break
                except httpx.TransportError:
                    time.sleep(0.2)
            print("median, 90 %, most of: input to paint | simulating | request | drawing [ms]")
            for label, laps in DRIVES:
                if sys.argv[1:] and label not in sys.argv[1:]:
                    continue
                path = made(folder, label.replace(" ", "-"), laps)
                run_id = stored(client, path)
                print(f"{label}:")
                for what in WITH:
                    if "flat" in sys.argv[1:] and what == "with 3D":
                        continue
                    flags = [*FLAGS, *(WEBGL if what == "with 3D" else FLAT)]
                    browser = playwright.chromium.launch(executable_path=install.find(), args=flags)
                    context = browser.new_context(
                        base_url=str(client.base_url), viewport={"width": 1280, "height": 800}
                    )
                    context.set_default_timeout(180_000)
                    if what == "without 3D":
                        context.add_init_script(NO_3D)
                    bench(context.new_page(), run_id, what, server.pid)
                    browser.close()
        finally:
            server.terminate()
            server.wait()


if __name__ == "__main__":
    main()
