"""ROS 2 into Driftscope's live protocol, with no ROS installed here: a client of rosbridge or of a Foxglove WebSocket.

    python ros_bridge.py --from ws://robot:9090 --to http://127.0.0.1:8000 --robot mill --topics topics.json [--drive]

rosbridge speaks JSON; a Foxglove bridge sends ROS 2's own bytes (CDR), which are decoded here. `topics.json` says which
topic becomes which stream, and holds the run's description (wheel radius, track width, beacons, noise):

    {"run": {"robot": {"wheel_radius": 0.075, "track_width": 0.32}},
     "topics": {"/imu/data": "imu", "/uwb/pose": "beacon", "/cmd_vel": "commands", "/ground_truth": "truth",
                "/joint_states": {"stream": "wheels", "left": "wheel_left_joint", "right": "wheel_right_joint"}}}

What becomes what: sensor_msgs/Imu -> imu. sensor_msgs/JointState -> wheels. nav_msgs/Odometry -> wheels (turned back
into the wheels' angles, with the radius and track width given) or truth. geometry_msgs/PoseWithCovarianceStamped ->
beacon or truth; `"theta": true` where its heading means something. geometry_msgs/Twist(Stamped) -> commands.
With --drive the stick on the page comes back as Twist on the commands' topic, through rosbridge only.

Everything needed is this file and the package `websockets`. Guide: /guide/ros.
"""

from __future__ import annotations

import argparse
import asyncio
import collections
import contextlib
import json
import math
import os
import secrets
import struct
import sys
import time
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path
from typing import Any

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import WebSocketException

FLUSH_S = 0.05
RETRY_S = 1.0
KEPT = 2000  # batches that may wait for a server that is away: then readings are left out
FOXGLOVE = ("foxglove.sdk.v1", "foxglove.websocket.v1")
Message = dict[str, Any]
Row = tuple[str, dict[str, Any]]  # stream, columns with `t`


# ------------------------------------------------------------------------------------------- ROS messages to rows


class Translator:
    """Messages of ROS, as dictionaries, to rows of streams. t = 0 is the first stamp that comes."""

    def __init__(self, topics: dict[str, Any], robot: dict[str, Any]) -> None:
        self._topics = {name: spec if isinstance(spec, dict) else {"stream": spec} for name, spec in topics.items()}
        self._radius, self._track = robot.get("wheel_radius"), robot.get("track_width")
        self._zero: tuple[int, float] | None = None  # first stamp [ns], and when it arrived [s]
        self._last: dict[str, float] = {}
        self._wheels: tuple[float, float] | None = None  # angles out of odometry
        self._before: tuple[float, float, float] | None = None

    def rows(self, topic: str, message: Message, arrived: float) -> Iterator[Row]:
        """The row of a message; none where it is older than its stream, or says nothing."""
        spec = self._topics.get(topic)
        if spec is None:
            return
        t = self._time(message, arrived)
        stream = spec["stream"]
        columns = self._columns(stream, spec, message) if t is not None else None
        if t is None or columns is None or not t > self._last.get(stream, -1e-9):
            return
        self._last[stream] = t
        yield stream, {"t": t, **columns}

    def _time(self, message: Message, arrived: float) -> float | None:
        """Seconds of the run. A message without a stamp has the time of its arrival, laid onto the stamps' clock."""
        stamp = message.get("header", {}).get("stamp")
        if stamp is None:
            return None if self._zero is None else arrived - self._zero[1]
        at: int = stamp.get("sec", stamp.get("secs", 0)) * 1_000_000_000 + stamp.get("nanosec", stamp.get("nsecs", 0))
        if self._zero is None:
            self._zero = (at, arrived)
        return (at - self._zero[0]) * 1e-9

    def _columns(self, stream: str, spec: Message, message: Message) -> Message | None:
        if stream == "imu":
            return _imu(message)
        if stream == "commands":
            twist = message.get("twist", message)
            return {"v": twist["linear"]["x"], "w": twist["angular"]["z"]}
        if stream == "wheels":
            return _joints(spec, message) if "name" in message else self._odometry(message)
        x, y, theta = _pose(message)
        return {"x": x, "y": y, "theta": theta} if stream == "truth" or spec.get("theta") else {"x": x, "y": y}

    def _odometry(self, message: Message) -> Message | None:
        """Angles of the wheels whose odometry this is: way and turn since the last message, turned back."""
        if not self._radius or not self._track:
            raise SystemExit("Odometry becomes wheels only with `robot.wheel_radius` and `robot.track_width`")
        x, y, theta = _pose(message)
        left, right = self._wheels or (0.0, 0.0)
        if self._before is not None:
            dx, dy = x - self._before[0], y - self._before[1]
            turn = math.remainder(theta - self._before[2], 2 * math.pi)
            middle = self._before[2] + turn / 2
            way = dx * math.cos(middle) + dy * math.sin(middle)
            left += (way - turn * self._track / 2) / self._radius
            right += (way + turn * self._track / 2) / self._radius
        self._before, self._wheels = (x, y, theta), (left, right)
        return {"left": left, "right": right}


def _imu(message: Message) -> Message:
    rate, force = message["angular_velocity"], message["linear_acceleration"]
    columns = {"gx": rate["x"], "gy": rate["y"], "gz": rate["z"]}
    if message.get("linear_acceleration_covariance", [0.0])[0] != -1:  # -1: there is no accelerometer
        columns |= {"ax": force["x"], "ay": force["y"], "az": force["z"]}
    return columns


def _joints(spec: Message, message: Message) -> Message | None:
    angles = dict(zip(message["name"], message["position"], strict=False))
    if spec["left"] not in angles or spec["right"] not in angles:
        return None
    return {"left": angles[spec["left"]], "right": angles[spec["right"]]}


def _pose(message: Message) -> tuple[float, float, float]:
    pose = message["pose"]["pose"] if "pose" in message["pose"] else message["pose"]
    q = pose["orientation"]
    yaw = math.atan2(2 * (q["w"] * q["z"] + q["x"] * q["y"]), 1 - 2 * (q["y"] ** 2 + q["z"] ** 2))
    return float(pose["position"]["x"]), float(pose["position"]["y"]), yaw


# ------------------------------------------------------------------------------------------------- ROS 2's bytes


class Cdr:
    """Reads CDR (OMG XCDR1): four bytes of header, then values, each aligned to its own size."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = memoryview(data)[4:], 0
        self._order = "<" if data[1] & 1 else ">"

    def take(self, code: str) -> Any:
        """One value by its `struct` code."""
        size = struct.calcsize(code)
        self._at += -self._at % size
        value = struct.unpack_from(self._order + code, self._data, self._at)[0]
        self._at += size
        return value

    def doubles(self, count: int) -> list[float]:
        """`count` of them."""
        return [self.take("d") for _ in range(count)]

    def text(self) -> str:
        """A string, its closing zero left out."""
        length = self.take("I")
        self._at += length
        return bytes(self._data[self._at - length : self._at - 1]).decode("utf-8", "replace")

    def header(self) -> Message:
        """std_msgs/Header."""
        stamp = {"sec": self.take("i"), "nanosec": self.take("I")}
        return {"stamp": stamp, "frame_id": self.text()}

    def vector(self) -> Message:
        """geometry_msgs/Vector3 or Point."""
        return dict(zip("xyz", self.doubles(3), strict=True))

    def pose(self) -> Message:
        """geometry_msgs/PoseWithCovariance."""
        pose = {"position": self.vector(), "orientation": dict(zip("xyzw", self.doubles(4), strict=True))}
        return {"pose": pose, "covariance": self.doubles(36)}

    def twist(self) -> Message:
        """geometry_msgs/Twist."""
        return {"linear": self.vector(), "angular": self.vector()}


def _cdr_imu(r: Cdr) -> Message:
    header, _ = r.header(), r.doubles(13)  # orientation and its covariance
    rate, _, force = r.vector(), r.doubles(9), r.vector()
    return {
        "header": header, "angular_velocity": rate, "linear_acceleration": force,
        "linear_acceleration_covariance": r.doubles(9),
    }  # fmt: skip


def _cdr_joints(r: Cdr) -> Message:
    header = r.header()
    names = [r.text() for _ in range(r.take("I"))]
    return {"header": header, "name": names, "position": r.doubles(r.take("I"))}


def _cdr_odometry(r: Cdr) -> Message:
    header, _ = r.header(), r.text()
    return {"header": header, "pose": r.pose()}


CDR: dict[str, Callable[[Cdr], Message]] = {
    "sensor_msgs/msg/Imu": _cdr_imu,
    "sensor_msgs/msg/JointState": _cdr_joints,
    "nav_msgs/msg/Odometry": _cdr_odometry,
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda r: {"header": r.header(), "pose": r.pose()},
    "geometry_msgs/msg/Twist": lambda r: r.twist(),
    "geometry_msgs/msg/TwistStamped": lambda r: {"header": r.header(), "twist": r.twist()},
}


# --------------------------------------------------------------------------------------------------- the sources


class Source:
    """A WebSocket of ROS messages: `messages()` gives (topic, message); `drive` sends a Twist back."""

    def __init__(self, address: str, topics: list[str]) -> None:
        self.address, self.topics = address, topics
        self._socket: ClientConnection | None = None
        self._advertised = False
        self._channels: dict[int, tuple[str, str, str]] = {}  # subscription -> topic, schema, encoding

    async def messages(self) -> AsyncIterator[tuple[str, Message]]:
        """Until the source goes away. Which of the two it is shows in the subprotocol that it chose."""
        protocols: Any = list(FOXGLOVE)
        async with connect(self.address, subprotocols=protocols, max_size=8 << 20, proxy=None) as socket:
            self._socket, self._advertised = socket, False
            if socket.subprotocol is None:
                for topic in self.topics:
                    await socket.send(json.dumps({"op": "subscribe", "topic": topic}))
            try:
                async for frame in socket:
                    if isinstance(frame, bytes):
                        found = self.decode(frame)
                    else:
                        found = await self._hear(json.loads(frame))
                    if found is not None:
                        yield found
            finally:
                self._socket = None

    async def _hear(self, told: Message) -> tuple[str, Message] | None:
        """A text frame: a message of rosbridge, or what a Foxglove bridge offers."""
        if told.get("op") == "publish":
            return told["topic"], told["msg"]
        if told.get("op") == "status" and told.get("level") in ("error", 2):
            sys.stderr.write(f"{self.address}: {told.get('msg') or told.get('message')}\n")
        if told.get("op") == "advertise" and self._socket is not None:
            wanted = self.choose(told["channels"])
            if wanted:
                await self._socket.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
        return None

    def choose(self, channels: list[Message]) -> list[Message]:
        """Subscriptions to those channels that are asked for and can be read."""
        wanted = []
        for c in channels:
            readable = c["encoding"] == "json" or (c["encoding"] == "cdr" and c["schemaName"] in CDR)
            if c["topic"] in self.topics and readable:
                self._channels[c["id"]] = (c["topic"], c["schemaName"], c["encoding"])
                wanted.append({"id": c["id"], "channelId": c["id"]})
        return wanted

    def decode(self, frame: bytes) -> tuple[str, Message] | None:
        """A binary frame of a Foxglove bridge: opcode 1, subscription, time of receipt [ns], payload."""
        if len(frame) < 13 or frame[0] != 1:
            return None
        subscription, _received = struct.unpack_from("<IQ", frame, 1)
        if subscription not in self._channels:
            return None
        topic, schema, encoding = self._channels[subscription]
        return topic, json.loads(frame[13:]) if encoding == "json" else CDR[schema](Cdr(frame[13:]))

    async def drive(self, topic: str, v: float, w: float) -> None:
        """Publish a Twist through rosbridge."""
        if self._socket is None or self._socket.subprotocol is not None:
            return
        if not self._advertised:
            self._advertised = True
            kind = {"op": "advertise", "topic": topic, "type": "geometry_msgs/msg/Twist"}
            await self._socket.send(json.dumps(kind))
        twist = {"linear": {"x": v, "y": 0.0, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": w}}
        with contextlib.suppress(WebSocketException):
            await self._socket.send(json.dumps({"op": "publish", "topic": topic, "msg": twist}))


# ------------------------------------------------------------------------------------------------ Driftscope's side


class Live:
    """The robot's side of driftscope-live/1: numbered batches, kept until they are acknowledged."""

    def __init__(self, address: str, robot: str, run: Message, drive: Callable[[float, float], Any] | None) -> None:
        base = address.replace("http", "ws", 1).rstrip("/")
        self.address, self._drive = f"{base}/api/v1/live/{robot}", drive
        self._hello = {
            "type": "hello", "protocol": "driftscope-live/1", "session": secrets.token_hex(8), "run": run,
            "drive": drive is not None,
        }  # fmt: skip
        self._waiting: collections.deque[Message] = collections.deque()
        self._n = self._sent = 0  # number of the next batch; of the next to send
        self._rows: dict[str, list[Message]] = {}
        self._valid = self._pause = 0.0  # a command is valid, the server wants quiet until then
        self.left_out = 0

    def add(self, stream: str, row: Message) -> None:
        """A reading, for the next batch."""
        self._rows.setdefault(stream, []).append(row)

    def flush(self) -> None:
        """Close the batch; what lacks a column in some rows has null there."""
        if not self._rows:
            return
        if len(self._waiting) >= KEPT:
            self.left_out += sum(map(len, self._rows.values()))
        else:
            streams = {
                name: {c: [row.get(c) for row in rows] for c in {c: None for row in rows for c in row}}
                for name, rows in self._rows.items()
            }
            self._waiting.append({"type": "batch", "n": self._n, "sent": time.time(), "streams": streams})
            self._n += 1
        self._rows = {}

    async def run(self) -> None:
        """Send for ever; come back after every broken connection and go on where the last acknowledgement stood."""
        token = os.environ.get("DRIFTSCOPE_TOKEN")
        headers = {"Authorization": f"Bearer {token}"} if token else {}
        while True:
            try:
                async with connect(self.address, additional_headers=headers, proxy=None) as socket:
                    await socket.send(json.dumps(self._hello))
                    self._heard(json.loads(await socket.recv()))
                    hearing = asyncio.create_task(self._hear(socket))
                    try:
                        await self._send(socket, hearing)
                    finally:
                        hearing.cancel()
            except (OSError, WebSocketException) as error:
                sys.stderr.write(f"{self.address}: {error}; again in {RETRY_S:g} s\n")
            await asyncio.sleep(RETRY_S)

    async def _send(self, socket: ClientConnection, hearing: asyncio.Task[None]) -> None:
        while not hearing.done():
            for batch in [b for b in self._waiting if b["n"] >= self._sent]:
                if time.monotonic() < self._pause:
                    break
                await socket.send(json.dumps(batch))
                self._sent = batch["n"] + 1
            await asyncio.sleep(FLUSH_S)
            self.flush()
            if self._drive is not None and 0 < self._valid < time.monotonic():  # dead man: nothing newer came
                self._valid = 0.0
                await self._drive(0.0, 0.0)

    async def _hear(self, socket: ClientConnection) -> None:
        async for frame in socket:
            told = json.loads(frame)
            self._heard(told)
            if self._drive is not None and told["type"] in ("command", "stop"):
                v, w = told.get("v", 0.0), told.get("w", 0.0)
                self._valid = time.monotonic() + told.get("valid_s", 0.0)
                await self._drive(v, w)

    def _heard(self, told: Message) -> None:
        """Welcome and acknowledgements: what the server has need not be kept."""
        if told["type"] == "error":
            raise SystemExit(f"{self.address}: {told['detail']} {told['where']}")
        if told["type"] in ("welcome", "throttle"):
            self._sent, self._pause = told["next"], time.monotonic() + told.get("wait_s", 0.0)
        upto = told["next"] - 1 if told["type"] == "welcome" else told["n"] if told["type"] == "ack" else -1
        while self._waiting and self._waiting[0]["n"] <= upto:
            self._waiting.popleft()


async def bridge(source: str, server: str, robot: str, config: Message, drive: bool = False) -> None:
    """Run until cancelled."""
    run, topics = config.get("run", {}), config["topics"]
    commands = next((t for t, s in topics.items() if (s if isinstance(s, str) else s["stream"]) == "commands"), None)
    ros, translator = Source(source, list(topics)), Translator(topics, run.get("robot", {}))
    back = (lambda v, w: ros.drive(commands, v, w)) if drive and commands else None
    live = Live(server, robot, run, back)
    sending = asyncio.create_task(live.run())
    try:
        while not sending.done():
            try:
                async for topic, message in ros.messages():
                    for stream, row in translator.rows(topic, message, time.monotonic()):
                        live.add(stream, row)
            except (OSError, WebSocketException) as error:
                sys.stderr.write(f"{source}: {error}; again in {RETRY_S:g} s\n")
            await asyncio.sleep(RETRY_S)
        await sending
    finally:
        sending.cancel()


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description="ROS 2, through rosbridge or Foxglove, into Driftscope.")
    parser.add_argument("--from", dest="source", required=True, help="ws://robot:9090 (rosbridge) or :8765 (Foxglove)")
    parser.add_argument("--to", required=True, help="the dashboard, http://127.0.0.1:8000")
    parser.add_argument("--robot", required=True, help="the robot's name there")
    parser.add_argument("--topics", required=True, type=Path, help="JSON: run and topics, see above")
    parser.add_argument("--drive", action="store_true", help="let the page drive, through rosbridge")
    o = parser.parse_args()
    config = json.loads(o.topics.read_text(encoding="utf-8"))
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(bridge(o.source, o.to, o.robot, config, o.drive))


if __name__ == "__main__":
    main()
