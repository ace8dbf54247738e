"""A small run for the scene's tests: a figure of eight with two methods, beacons and fixes; no store behind it."""

from __future__ import annotations

import contextlib
import json
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import msgpack
import numpy as np
import uvicorn
import viser
import websockets
import zstandard
from fastapi import FastAPI
from websockets.sync.client import ClientConnection, connect

from app import errors
from app.scene import api, proxy
from app.scene.data import SceneData, ScenePath, Spread
from app.scene.pool import Scenes
from app.security import Guard
from app.settings import Settings
from core.robot import RobotParams

DURATION = 60.0


def scene_data(run_id: str = "run-a", revision: str = "1", rows: int = 600) -> SceneData:
    """Truth drives the eight; encoders drift off with growing spread; the beacon gives no heading."""
    t = np.linspace(0.0, DURATION, rows)
    x, y = 4 * np.sin(2 * np.pi * t / DURATION), 2 * np.sin(4 * np.pi * t / DURATION)
    theta = np.unwrap(np.arctan2(np.gradient(y), np.gradient(x)))
    sd = 0.01 + t / DURATION
    paths = (
        ScenePath("truth", "Truth", t, x, y, theta),
        ScenePath("encoders", "Encoders", t, x + 0.01 * t, y, theta, Spread(sd, sd / 2, 0.1 * sd * sd)),
        ScenePath("beacon", "Beacon", t[::10], x[::10], y[::10], np.full(len(t[::10]), np.nan)),
    )
    beacons = {"B1": (-5.0, -3.0, 2.5), "B2": (5.0, 3.0, 2.5)}
    fixes, robot = np.column_stack((x[::10], y[::10])), RobotParams(0.075, 0.32)
    return SceneData(run_id, run_id, 0.0, DURATION, paths, beacons, fixes, robot, revision)


class Store:
    """Runs by id, as the real store would know them."""

    def __init__(self, *run_ids: str) -> None:
        self.revisions = dict.fromkeys(run_ids, "1")
        self.loads = 0

    def revision(self, run_id: str) -> str:
        if run_id not in self.revisions:
            raise errors.NotFoundError(f"there is no run {run_id!r}", what="run", id=run_id)
        return self.revisions[run_id]

    def load(self, run_id: str) -> SceneData:
        self.loads += 1
        return scene_data(run_id, self.revision(run_id))


@dataclass
class Site:
    """A running server: its address, its scenes, its runs."""

    host: str
    scenes: Scenes
    store: Store

    @property
    def http(self) -> str:
        return f"http://{self.host}"

    @property
    def ws(self) -> str:
        return f"ws://{self.host}"


@contextlib.contextmanager
def serve(settings: Settings, store: Store, **options: float) -> Iterator[Site]:
    """The scene's routes behind the guard on a free port, in a thread of their own."""
    app = FastAPI()
    errors.install(app)
    app.include_router(proxy.router)
    app.include_router(api.router, prefix="/api/v1")
    app.add_middleware(Guard, settings=settings)
    app.state.scenes = Scenes(store.load, store.revision, **options)  # type: ignore[arg-type]
    config = uvicorn.Config(app, host="127.0.0.1", port=0, log_level="warning", ws_per_message_deflate=False)
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, daemon=True)
    thread.start()
    try:
        while not server.started:
            assert thread.is_alive(), "the server did not start"
            thread.join(0.01)
        port = server.servers[0].sockets[0].getsockname()[1]
        yield Site(f"127.0.0.1:{port}", app.state.scenes, store)
    finally:
        server.should_exit = True
        thread.join(10)
        app.state.scenes.stop()


class Browser:
    """viser's client as far as the wire goes: it says where its camera is, and hears of nodes and poses."""

    CAMERA: ClassVar[dict[str, Any]] = {
        "type": "ViewerCameraMessage",
        "wxyz": [1.0, 0.0, 0.0, 0.0],
        "position": [0.0, -10.0, 10.0],
        "fov": 0.8,
        "near": 0.01,
        "far": 1000.0,
        "image_height": 360,
        "image_width": 640,
        "look_at": [0.0, 0.0, 0.0],
        "up_direction": [0.0, 0.0, 1.0],
    }

    def __init__(self, site: Site, run: str, viewer: str, **headers: str) -> None:
        self.socket: ClientConnection = connect(
            f"{site.ws}/scene/{run}/{viewer}",
            subprotocols=[websockets.Subprotocol(f"viser-v{viser.__version__}")],
            additional_headers={"Origin": site.http, **headers},
            max_size=None,
            compression=None,
            proxy=None,
        )

    def send(self, message: dict[str, Any]) -> None:
        self.socket.send(msgpack.packb(message))

    def look(self) -> Browser:
        """Become a client: viser waits for the first camera."""
        self.send(self.CAMERA)
        return self

    def hear(self, until: Callable[[dict[str, Any]], bool], patience: float = 10.0) -> list[dict[str, Any]]:
        """Messages up to and with the first that fits."""
        heard: list[dict[str, Any]] = []
        end = time.monotonic() + patience
        while time.monotonic() < end:
            for message in self._batch(end - time.monotonic()):
                heard.append(message)
                if until(message):
                    return heard
        raise AssertionError(f"not heard in {patience} s; heard {[m['type'] for m in heard]}")

    def quiet(self, seconds: float = 0.3) -> list[dict[str, Any]]:
        """What still comes, until it is quiet for that long."""
        heard: list[dict[str, Any]] = []
        with contextlib.suppress(TimeoutError):
            while True:
                heard += self._batch(seconds)
        return heard

    def _batch(self, patience: float) -> list[dict[str, Any]]:
        data = self.socket.recv(timeout=max(patience, 0.01))
        assert isinstance(data, bytes)
        size = int.from_bytes(data[8:16], "little")
        messages: list[dict[str, Any]] = msgpack.unpackb(zstandard.decompress(data[16 : 16 + size]))["messages"]
        return messages

    def close(self) -> None:
        self.socket.close()


class Hand:
    """A page's hand on a viewer's cursor."""

    def __init__(self, site: Site, run: str, viewer: str) -> None:
        self.socket = connect(
            f"{site.ws}/api/v1/scenes/{run}/cursor?viewer={viewer}",
            additional_headers={"Origin": site.http},
            proxy=None,
        )

    def move(self, **change: Any) -> None:
        self.socket.send(json.dumps(change))

    def hear(self, until: Callable[[dict[str, Any]], bool], patience: float = 10.0) -> dict[str, Any]:
        """The first message that fits."""
        end = time.monotonic() + patience
        while True:
            message: dict[str, Any] = json.loads(self.socket.recv(timeout=max(end - time.monotonic(), 0.01)))
            if until(message):
                return message

    def close(self) -> None:
        self.socket.close()


def eventually(condition: Callable[[], bool], patience: float = 10.0) -> bool:
    """Whether it comes true in time."""
    end = time.monotonic() + patience
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.01)
    return True
