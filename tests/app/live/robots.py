"""Robots for the tests: what they say over a WebSocket of the test client."""

from __future__ import annotations

import json
import time
from typing import Any

from fastapi.testclient import TestClient
from starlette.testclient import WebSocketTestSession

from app.live.client import wire
from app.live.protocol import PROTOCOL
from core.formats.run_json import meta_to_json
from core.run import Run

API = "/api/v1/live"
OPEN: list[WebSocketTestSession] = []  # closed by `hang_up`


def hello(run: Run, session: str = "s1", **more: Any) -> dict[str, Any]:
    return {"type": "hello", "protocol": PROTOCOL, "session": session, "run": meta_to_json(run.meta), **more}


def batch(n: int, piece: Run) -> dict[str, Any]:
    return {"type": "batch", "n": n, "sent": time.time(), "streams": wire(piece)}


def heard(socket: WebSocketTestSession, kind: str, **wanted: Any) -> dict[str, Any]:
    """The next message of that kind with these values; others are passed over."""
    for _ in range(3000):
        message: dict[str, Any] = json.loads(socket.receive_text())
        if message["type"] == kind and all(message.get(k) == v for k, v in wanted.items()):
            return message
    raise AssertionError(f"no {kind} came")


def join(client: TestClient, name: str, said: dict[str, Any]) -> WebSocketTestSession:
    """A robot's connection, entered, its Hello sent."""
    socket = client.websocket_connect(f"{API}/{name}").__enter__()
    OPEN.append(socket)
    socket.send_text(json.dumps(said))
    return socket


def hang_up() -> None:
    """Close every robot's connection."""
    while OPEN:
        OPEN.pop().__exit__(None, None, None)


def stored(client: TestClient, live_id: str, seconds: float = 60.0) -> dict[str, Any]:
    """The run that a live one became."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        found = client.get(f"/api/v1/runs/{live_id}").json()
        if not found.get("is_live", True):
            return found
        time.sleep(0.05)
    raise AssertionError(f"{live_id} was not stored")
