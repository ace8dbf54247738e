"""Live robots: their WebSocket, NDJSON for those without one, the viewers' WebSocket, and the list."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import logging
import time
from collections.abc import Mapping
from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, Request, WebSocket, WebSocketDisconnect

from app import errors
from app.api import live_schemas as schemas
from app.errors import ConflictError, DiskFullError
from app.live import messages
from app.live.feed import Viewer, encoded
from app.live.hub import Hub
from app.live.messages import SchemaError, check_robot
from app.live.protocol import Ended, Error, Refused
from app.live.robot import Robot
from app.live.run import LiveRun
from core.errors import DriftscopeError

log = logging.getLogger("driftscope.live")
router = APIRouter(tags=["live"])
Name = Annotated[str, Path(description="the robot's name", examples=["mill"], max_length=64)]
OUTGOING = 256  # messages that may wait for a robot; acknowledgements of those it missed come with the next
HELLO_S = 10.0
ACK_S = 0.02  # acknowledgements within so long are one
CLOSE_POLICY = 1008
_numbers = itertools.count(1)


class Line:
    """A robot's WebSocket: messages go out in the kind of frame that the robot sends."""

    def __init__(self, socket: WebSocket) -> None:
        self._socket = socket
        self.binary = self.closing = self.owes = False
        self._queue: asyncio.Queue[tuple[Mapping[str, Any], bool]] = asyncio.Queue(OUTGOING)
        self.writer = asyncio.create_task(self._write())

    def send(self, message: Mapping[str, Any]) -> None:
        """Queue a message."""
        with contextlib.suppress(asyncio.QueueFull):
            self._queue.put_nowait((message, False))

    def close(self, message: Mapping[str, Any]) -> None:
        """Send a last message and close."""
        self.closing = True
        while self._queue.full():
            self._queue.get_nowait()
        self._queue.put_nowait((message, True))

    async def _write(self) -> None:
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            while True:
                message, last = await self._queue.get()
                frame = encoded(message, self.binary)
                await (self._socket.send_bytes(frame) if isinstance(frame, bytes) else self._socket.send_text(frame))
                if last:
                    await self._socket.close(CLOSE_POLICY if message["type"] == "error" else 1000)
                    return

    async def finish(self) -> None:
        """Let the last message out, then stop writing."""
        if self.closing:
            await asyncio.wait((self.writer,), timeout=1.0)
        self.writer.cancel()

    async def receive(self) -> str | bytes | None:
        """The next frame; None once the robot is gone."""
        message = await self._socket.receive()
        if message["type"] == "websocket.disconnect":
            return None
        frame: str | bytes = message["bytes"] if message.get("bytes") is not None else message["text"]
        self.binary = isinstance(frame, bytes)
        return frame


def problem(error: BaseException) -> Error:
    """An error as a robot is told."""
    told = errors.problem_of(error)
    if told["status"] == 500:
        log.error("a live robot's connection failed", exc_info=error)
    return Error(type="error", code=told["code"], detail=told["detail"], where=told["where"])


@router.websocket("/live/{robot}")
async def robot_socket(socket: WebSocket, robot: str) -> None:
    """A robot streams: see `app.live.protocol`."""
    hub: Hub = socket.app.state.live
    await socket.accept()
    line = Line(socket)
    joined: Robot | None = None
    try:
        check_robot(robot)
        first = await asyncio.wait_for(line.receive(), HELLO_S)
        if first is not None:
            said = messages.hello(messages.decode(first))
            joined, welcome = await hub.join(robot, said, line)
            line.send(welcome)
            await _stream(hub, joined, line)
    except TimeoutError:
        line.close(problem(SchemaError(f"no hello came within {HELLO_S:g} s", field="type", expected="hello")))
    except (DriftscopeError, OSError) as error:
        line.close(problem(error))
    finally:
        if joined is not None:
            hub.leave(joined, line)
        await line.finish()


async def _stream(hub: Hub, robot: Robot, line: Line) -> None:
    """Frames until the robot goes or ends its run."""
    run = robot.run
    assert run is not None

    def acknowledged(error: OSError | None) -> None:
        if error is not None:
            line.close(problem(error))
        elif not line.owes:
            line.owes = True
            asyncio.get_running_loop().call_later(ACK_S, acknowledge)

    def acknowledge() -> None:
        line.owes = False
        line.send(hub.ack(run))

    durable = hub.acknowledge(run, acknowledged)
    while (frame := await line.receive()) is not None:
        if run.ended or line.closing:
            return
        message = messages.decode(frame)
        if message.get("type") == "end":
            await _end(hub, robot, run, line)
            return
        if message.get("type") != "batch":
            raise SchemaError(
                f"type: expected batch or end; found {str(message.get('type'))[:60]}",
                field="type", expected="batch or end", found=str(message.get("type"))[:60],
            )  # fmt: skip
        taken = run.take(messages.batch(message), frame, hub.sink(run), durable)
        if taken.throttle is not None:
            if run.tell_throttle(taken.throttle):
                line.send(taken.throttle)
        elif not taken.new:
            line.send(hub.ack(run))


async def _end(hub: Hub, robot: Robot, run: LiveRun, line: Line) -> None:
    count = run.next
    await hub.end(robot)
    line.close(Ended(type="ended", run_id=run.id, n=count))


@router.post("/live/{robot}/rows", summary="Send rows of a live robot without a WebSocket")
async def post_live_rows(request: Request, robot: Name) -> schemas.RowsTaken:
    """NDJSON: one Hello, Batch or End of the live protocol per line, at most 1 MiB in all. The answer comes once all
    batches are on disk; a later request of the same session begins with the same Hello again."""
    check_robot(robot)
    hub: Hub = request.app.state.live
    joined: Robot | None = None
    run: LiveRun | None = None
    ended = False
    waiting: list[asyncio.Future[None]] = []
    for line in (await request.body()).splitlines():
        if not line.strip():
            continue
        message = messages.decode(line.decode("utf-8", "replace"))
        if run is None or message.get("type") == "hello":
            joined, _ = await hub.join(robot, messages.hello(message), None)
            run = joined.run
        elif message.get("type") == "end" and joined is not None:
            await _all(waiting)
            await hub.end(joined)
            ended = True
            break
        else:
            _take(hub, run, message, line.decode("utf-8", "replace"), waiting)
    if run is None:
        raise SchemaError("the body holds no message", field="body", expected="a Hello on the first line")
    await _all(waiting)
    return schemas.RowsTaken(run_id=run.id, next=run.next, ended=ended)


async def _all(waiting: list[asyncio.Future[None]]) -> None:
    for done in waiting:
        await done
    waiting.clear()


def _take(hub: Hub, run: LiveRun, message: dict[str, Any], frame: str, waiting: list[asyncio.Future[None]]) -> None:
    done: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def on_disk(error: OSError | None) -> None:
        if error is not None:
            done.set_exception(DiskFullError(f"the batch could not be written: {error.strerror}"))
        else:
            done.set_result(None)

    taken = run.take(messages.batch(message), frame, hub.sink(run), hub.acknowledge(run, on_disk))
    if taken.throttle is not None:
        raise ConflictError(taken.throttle["reason"], **taken.throttle)
    if taken.new:
        waiting.append(done)


@router.get("/live", summary="Robots that are live")
async def list_live(request: Request) -> schemas.LiveList:
    """Those that stream, and those that are silent for less than the time-out."""
    hub: Hub = request.app.state.live
    return schemas.LiveList(items=[schemas.LiveRobot.model_validate(row) for row in hub.robots()])


@router.post("/live/{robot}/end", summary="End a live run", status_code=202)
async def end_live(request: Request, robot: Name) -> schemas.RowsTaken:
    """The run is stored as it is; a robot that goes on sending must begin a new session."""
    hub: Hub = request.app.state.live
    found = hub.known(robot)
    run, connection = found.run, found.connection
    assert run is not None
    count = run.next
    await hub.end(found)
    if connection is not None:
        connection.close(Ended(type="ended", run_id=run.id, n=count))
    return schemas.RowsTaken(run_id=run.id, next=count, ended=True)


@router.websocket("/live/{robot}/watch")
async def watch_socket(socket: WebSocket, robot: str, encoding: Annotated[str, Query()] = "json") -> None:
    """A viewer: see `app.live.protocol`."""
    hub: Hub = socket.app.state.live
    await socket.accept()
    try:
        check_robot(robot)
    except DriftscopeError as error:
        await socket.send_text(str(encoded(problem(error), False)))
        await socket.close(CLOSE_POLICY)
        return
    viewer = Viewer(f"viewer {next(_numbers)}", encoding == "msgpack")
    found = hub.robot(robot)
    found.viewers[viewer] = None
    viewer.tell(found.snapshot(viewer))
    writer = asyncio.create_task(_write(socket, viewer))
    try:
        while (message := await socket.receive())["type"] != "websocket.disconnect":
            frame = message["bytes"] if message.get("bytes") is not None else message["text"]
            try:
                refused = _obey(found, viewer, messages.decode(frame))
            except DriftscopeError as error:
                refused = Refused(type="refused", code="schema", detail=error.message)
            if refused is not None:
                viewer.tell(refused)
    finally:
        writer.cancel()
        found.viewers.pop(viewer, None)
        if found.drive.release(viewer):
            found.tell_driver()
        hub.forget_idle(found)


async def _write(socket: WebSocket, viewer: Viewer) -> None:
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        while True:
            frame = await viewer.queue.get()
            await (socket.send_bytes(frame) if isinstance(frame, bytes) else socket.send_text(frame))


def _obey(robot: Robot, viewer: Viewer, message: dict[str, Any]) -> Refused | None:
    now, kind = time.time(), message.get("type")
    if kind == "drive":
        v, w = message.get("v"), message.get("w")
        if not messages.finite(v) or not messages.finite(w):
            return Refused(type="refused", code="schema", detail="drive needs v [m/s] and w [rad/s]")
        assert v is not None and w is not None
        return robot.drive.drive(viewer, float(v), float(w), now)
    if kind == "stop":
        if robot.drive.halt(viewer):
            robot.tell_driver()
        return None
    if kind == "drive_release":
        if robot.drive.release(viewer):
            robot.tell_driver()
        return None
    if kind != "drive_request":
        return Refused(type="refused", code="schema", detail=f"no message of a viewer: {str(kind)[:60]}")
    name = message.get("name")
    if isinstance(name, str) and name.strip() and name.isprintable():
        viewer.name = name.strip()[:40]
    refused = robot.drive.request(viewer, message.get("take_over") is True, now)
    if refused is None:
        robot.tell_driver()
    return refused
