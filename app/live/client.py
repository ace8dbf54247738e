"""A robot's side of the live protocol: sends batches, keeps each until it is acknowledged, reconnects by itself."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

import websockets
from websockets.asyncio.client import ClientConnection, connect

from app.live.protocol import PROTOCOL
from core.errors import DriftscopeError, ParameterError
from core.run import Run
from core.sensors import RangeLog

LAST_TRY_S = 5.0  # longest wait between two tries to connect
MOST_KEPT = 20_000  # batches kept while the server is away; then the oldest go


class RefusedError(DriftscopeError):
    """The server does not want this robot. `code` of the server's answer is in `where`."""

    code = "refused"


@dataclass
class Client:
    """One robot. `run` connects and stays; `send` queues rows; on_command(v, w, valid_s), None for stop."""

    url: str
    robot: str
    hello: Mapping[str, Any]
    token: str | None = None
    on_command: Callable[[tuple[float, float, float] | None], None] = lambda command: None
    on_state: Callable[[str], None] = lambda state: None
    run_id: str | None = None
    _kept: deque[dict[str, Any]] = field(default_factory=deque)  # not acknowledged, in order
    _sent: int = 0  # of those, how many went out on this connection
    _next: int = 0
    _news: asyncio.Event = field(default_factory=asyncio.Event)
    _heard: list[float] | None = None
    _ending: bool = False

    def send(self, streams: Mapping[str, Any]) -> None:
        """Queue a batch; never waits."""
        self._kept.append({"type": "batch", "n": self._next, "sent": 0.0, "streams": streams})
        self._next += 1
        if len(self._kept) > MOST_KEPT:
            self._kept.popleft()
            self._sent = max(0, self._sent - 1)
        self._news.set()

    def end(self) -> None:
        """After all batches: the run is over."""
        self._ending = True
        self._news.set()

    @property
    def waiting(self) -> int:
        """Batches that are not acknowledged."""
        return len(self._kept)

    async def run(self) -> None:
        """Until the server has the end. RefusedError where it does not want this robot."""
        pause = 0.2
        while True:
            try:
                headers = {"Authorization": f"Bearer {self.token}"} if self.token else {}
                async with connect(
                    address(self.url, self.robot), additional_headers=headers, max_size=1 << 22, open_timeout=10
                ) as socket:
                    pause = 0.2
                    if await self._serve(socket):
                        return
            except (OSError, TimeoutError, websockets.WebSocketException) as error:
                if isinstance(error, websockets.InvalidStatus) and error.response.status_code in (401, 403):
                    raise RefusedError(f"{self.url} refuses: is the token right?", url=self.url) from None
                self.on_state(f"no connection to {self.url}: {error or type(error).__name__}")
            self.on_command(None)
            await asyncio.sleep(pause)
            pause = min(2 * pause, LAST_TRY_S)

    async def _serve(self, socket: ClientConnection) -> bool:
        """One connection; whether the run has ended."""
        await socket.send(json.dumps({"type": "hello", "protocol": PROTOCOL, **self.hello}))
        welcome = json.loads(await asyncio.wait_for(socket.recv(), 30))
        self._refused(welcome)
        self._resume(welcome["next"])
        self.run_id = welcome["run_id"]
        self.on_state(f"streaming to {self.url} as {self.robot!r}, run {self.run_id}")
        out = asyncio.create_task(self._write(socket))
        try:
            async for frame in socket:
                if await self._hear(json.loads(frame)):
                    return True
        finally:
            out.cancel()
            with contextlib.suppress(asyncio.CancelledError, websockets.WebSocketException):
                await out
        return False

    def _resume(self, following: int) -> None:
        """Go on with the batch that the server wants next; a server that knows less gets new numbers."""
        while self._kept and self._kept[0]["n"] < following:
            self._kept.popleft()
        for k, batch in enumerate(self._kept):
            batch["n"] = following + k
        self._next = following + len(self._kept)
        self._sent, self._heard = 0, None
        self._news.set()

    async def _write(self, socket: ClientConnection) -> None:
        while True:
            await self._news.wait()
            self._news.clear()
            while self._sent < len(self._kept):
                batch = self._kept[self._sent]
                self._sent += 1
                batch["sent"] = time.time()
                if self._heard is not None:
                    batch["heard"], self._heard = self._heard, None
                await socket.send(json.dumps(batch))
            if self._ending:
                await socket.send(json.dumps({"type": "end"}))
                return

    async def _hear(self, message: dict[str, Any]) -> bool:
        kind = message["type"]
        if kind == "ack":
            self._heard = [message["at"], time.time()]
            self._forget(message["n"] + 1)
        elif kind == "ended":  # all of it is on disk
            self._forget(message["n"])
        elif kind == "throttle":
            self.on_state(f"throttled: {message['reason']}")
            await asyncio.sleep(message["wait_s"])
            self._resume(message["next"])
        elif kind == "command":
            self.on_command((message["v"], message["w"], message["valid_s"]))
        elif kind == "stop":
            self.on_command(None)
        self._refused(message)
        return bool(kind == "ended")

    def _forget(self, following: int) -> None:
        """Batches before that number are on disk."""
        while self._kept and self._kept[0]["n"] < following:
            self._kept.popleft()
            self._sent = max(0, self._sent - 1)

    @staticmethod
    def _refused(message: Mapping[str, Any]) -> None:
        if message["type"] == "error":
            raise RefusedError(message["detail"], **{"code": message["code"], **message["where"]})


def address(url: str, robot: str) -> str:
    """The WebSocket's address, given the dashboard's."""
    parts = urlsplit(url if "//" in url else f"http://{url}")
    schemes = {"http": "ws", "https": "wss", "ws": "ws", "wss": "wss"}
    if parts.scheme not in schemes or not parts.netloc:
        raise ParameterError(f"{url!r} is no address of a dashboard, expected http://HOST:PORT", parameter="to")
    return f"{schemes[parts.scheme]}://{parts.netloc}{parts.path.rstrip('/')}/api/v1/live/{robot}"


def wire(piece: Run) -> dict[str, dict[str, list[Any]]]:
    """A piece of a run as a batch's streams."""
    streams: dict[str, dict[str, list[Any]]] = {}
    for name, log in piece.logs().items():
        columns = {c: [v if v == v else None for v in values.tolist()] for c, values in log.columns().items()}
        if isinstance(log, RangeLog):
            columns["beacon"] = [log.names[code] for code in log.beacon.tolist()]
        streams[name] = columns
    return streams
