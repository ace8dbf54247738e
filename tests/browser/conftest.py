"""A real server and a real Chromium, shared by all browser tests.

A page that logs an error, fails on a script or asks any other origin for anything fails its test.
"""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
import pytest
from playwright.sync_api import Browser, BrowserContext, ConsoleMessage, Page, Request, Route, expect, sync_playwright

sys.path.insert(0, str(Path(__file__).parent))
import install

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "app" / "examples"
FLAGS = ["--no-sandbox", "--disable-dev-shm-usage", "--disable-background-networking"]
FLAT = ["--disable-gpu"]  # an emulated GPU takes thrice the time for pages without 3D
WEBGL = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
# 3D in software takes a core at full rate; a few pictures a second show the same.
SLOW_3D = """if (location.pathname.startsWith("/scene")) {
    const soon = window.requestAnimationFrame.bind(window);
    window.requestAnimationFrame = (draw) => window.setTimeout(() => soon(draw), 150);
    window.cancelAnimationFrame = (waiting) => window.clearTimeout(waiting);
}"""
PATIENCE_MS = 60_000  # for what a slow, shared machine may take; nothing waits that long when it works
expect.set_options(timeout=PATIENCE_MS)


@dataclass
class Server:
    """A running `driftscope serve`: `url`, its data folder, and a client of its API."""

    url: str
    data: Path
    client: httpx.Client = field(repr=False)

    def upload(self, path: Path, **params: str) -> dict[str, Any]:
        """Store a file or a run folder, and wait until its paths are estimated; the run as the API has it."""
        name, body = (path.name, path.read_bytes()) if path.is_file() else (f"{path.name}.zip", zipped(path))
        answer = self.client.post("/api/v1/runs", params={"filename": name, **params}, content=body)
        assert answer.status_code in (200, 201), answer.text
        return self.estimated(answer.json()["id"])

    def estimated(self, run_id: str) -> dict[str, Any]:
        """The run once no job works on it."""
        end = time.monotonic() + 120
        while time.monotonic() < end:
            run: dict[str, Any] = self.client.get(f"/api/v1/runs/{run_id}").raise_for_status().json()
            if run["estimates"] and not run["jobs"]:
                return run
            time.sleep(0.1)
        raise AssertionError(f"run {run_id} was not estimated in two minutes")


def zipped(folder: Path) -> bytes:
    """A run folder as a zip."""
    import io
    import zipfile

    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for path in sorted(folder.iterdir()):
            archive.write(path, path.name)
    return buffer.getvalue()


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture(scope="session")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """One server for all browser tests, with an empty data folder."""
    folder = tmp_path_factory.mktemp("server")
    port = free_port()
    command = [sys.executable, "-m", "app.cli", "serve", "--port", str(port), "--data", str(folder / "data")]
    environment = {**os.environ, "DRIFTSCOPE_WORKERS": "1", "PYTHONPATH": str(ROOT)}
    with (folder / "log").open("w") as log:
        process = subprocess.Popen(command, cwd=folder, env=environment, stdout=log, stderr=log)
    url = f"http://127.0.0.1:{port}"
    try:
        with httpx.Client(base_url=url, timeout=180) as client:
            _wait_until_up(client, process, folder / "log")
            ready = Server(url, folder / "data", client)
            ready.upload(EXAMPLES / "square-with-disturbance", tags="square")  # the workers start with the first job
            yield ready
    finally:
        process.terminate()
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _wait_until_up(client: httpx.Client, process: subprocess.Popen[bytes], log: Path) -> None:
    end = time.monotonic() + 60
    while time.monotonic() < end and process.poll() is None:
        with contextlib.suppress(httpx.TransportError):
            if client.get("/runs.json").status_code == 200:
                return
        time.sleep(0.1)
    raise AssertionError(f"the server did not start:\n{log.read_text()}")


@pytest.fixture(scope="session")
def browsers() -> Iterator[Callable[[bool], Browser]]:
    """One Chromium for all tests, and one with WebGL for those of 3D: `browsers(with_3d)`."""
    path = install.find()
    if path is None:
        pytest.fail("the browser tests need Chromium: run tests/browser/install.py")
    running: dict[bool, Browser] = {}
    with sync_playwright() as playwright:

        def get(with_3d: bool) -> Browser:
            if with_3d not in running:
                args = [*FLAGS, *(WEBGL if with_3d else FLAT)]
                running[with_3d] = playwright.chromium.launch(executable_path=path, args=args)
            return running[with_3d]

        yield get
        for chromium in running.values():
            chromium.close()


@dataclass
class Watch:
    """What must not happen on a page. `allow`: parts of messages that a test brings about on purpose."""

    origin: str
    faults: list[str] = field(default_factory=list)
    allow: list[str] = field(default_factory=list)

    def follow(self, page: Page) -> None:
        page.on("console", self._console)
        page.on("pageerror", lambda error: self._fault(f"script error: {error}"))
        page.on("request", self._request)

    def _console(self, message: ConsoleMessage) -> None:
        # a refusal by the API is an answer that the page shows, though the browser logs it as an error
        answered = "Failed to load resource" in message.text and "status of 4" in message.text
        if message.type == "error" and not answered:
            self._fault(f"console: {message.text}")

    def _request(self, request: Request) -> None:
        parts = urlsplit(request.url)
        if parts.scheme not in ("data", "blob", "about") and parts.netloc != self.origin:
            self._fault(f"request to another origin: {request.url}")

    def _fault(self, text: str) -> None:
        if not any(part in text for part in self.allow):
            self.faults.append(text)


@pytest.fixture
def watch(server: Server) -> Iterator[Watch]:
    """What goes wrong on the pages of a test; must stay empty."""
    watch = Watch(urlsplit(server.url).netloc)
    yield watch
    assert not watch.faults, "\n".join(watch.faults)


@pytest.fixture
def new_page(server: Server, browsers: Callable[[bool], Browser], watch: Watch) -> Iterator[Callable[..., Page]]:
    """Makes pages in contexts of their own: `new_page(color_scheme="dark", viewport={...})`.

    The 3D view stays empty unless with_3d: it would load and draw beside every test.
    """
    contexts: list[BrowserContext] = []

    def make(*, with_3d: bool = False, **options: Any) -> Page:
        options.setdefault("viewport", {"width": 1280, "height": 800})
        context = browsers(with_3d).new_context(base_url=server.url, **options)
        context.set_default_timeout(PATIENCE_MS)
        if with_3d:
            context.add_init_script(SLOW_3D)
        else:
            context.route("**/scene/**", _nothing)
        contexts.append(context)
        page = context.new_page()
        watch.follow(page)
        return page

    yield make
    for context in contexts:
        context.close()


def _nothing(route: Route) -> None:
    route.fulfill(body="<!doctype html><title>3D</title>", content_type="text/html")


@pytest.fixture
def page(new_page: Callable[..., Page]) -> Page:
    """A page of 1280 by 800, light."""
    return new_page(color_scheme="light")


@pytest.fixture(scope="session")
def square(server: Server) -> dict[str, Any]:
    """A recorded run with wheels and truth, stored and estimated."""
    return server.upload(EXAMPLES / "square-with-disturbance", tags="square")


@pytest.fixture(scope="session")
def mission(server: Server) -> dict[str, Any]:
    """A simulated run with every stream, stored and estimated."""
    return server.upload(EXAMPLES / "simulated-mission", tags="simulated")


@pytest.fixture(scope="session")
def lawn(server: Server) -> dict[str, Any]:
    """A recorded run with ranges to beacons, stored and estimated."""
    return server.upload(EXAMPLES / "lawn-mower-with-uwb", tags="outdoors")
