"""ROS 2 without ROS: a recorded exchange with rosbridge and one with a Foxglove bridge become the same live streams."""

from __future__ import annotations

import asyncio
import base64
import json
import math
from pathlib import Path
from typing import Any

import pytest
from websockets.asyncio.server import ServerConnection, serve

from app.examples import ros_bridge
from app.live import messages

DATA = Path(__file__).resolve().parents[1] / "data" / "ros"
TOPICS: dict[str, Any] = {
    "/imu/data": "imu",
    "/joint_states": {"stream": "wheels", "left": "wheel_left_joint", "right": "wheel_right_joint"},
    "/cmd_vel": "commands",
    "/uwb/pose": {"stream": "beacon", "theta": True},
    "/odom": "truth",
}
RUN = {"name": "recorded", "robot": {"wheel_radius": 0.1, "track_width": 0.3}}
ROWS = {"imu": 3, "wheels": 2, "commands": 1, "beacon": 1, "truth": 3}


class Recorded:
    """The source's side of a recorded exchange; `asked` is what the bridge says beyond it."""

    def __init__(self, name: str) -> None:
        self.lines = [json.loads(line) for line in (DATA / name).read_text(encoding="utf-8").splitlines()]
        self.protocols = ["foxglove.sdk.v1"] if name.startswith("foxglove") else None
        self.asked: list[dict[str, Any]] = []

    async def answer(self, socket: ServerConnection) -> None:
        for line in self.lines:
            if line["from"] == "client":
                said = json.loads(await socket.recv())
                assert _unordered(said) == _unordered(line["text"])
            else:
                await socket.send(base64.b64decode(line["binary"]) if "binary" in line else json.dumps(line["text"]))
        async for frame in socket:
            self.asked.append(json.loads(frame))


def _unordered(message: dict[str, Any]) -> dict[str, Any]:
    return {k: sorted(map(str, v)) if isinstance(v, list) else v for k, v in message.items()}


class Dashboard:
    """The server's side of the live protocol, strict; the first connection breaks before anything is acknowledged."""

    def __init__(self) -> None:
        self.hellos: list[messages.CheckedHello] = []
        self.streams: dict[str, dict[str, list[float]]] = {}
        self.next = 0

    async def answer(self, socket: ServerConnection) -> None:
        self.hellos.append(messages.hello(messages.decode(await socket.recv())))
        await socket.send(json.dumps({"type": "welcome", "next": self.next}))
        async for frame in socket:
            if len(self.hellos) == 1:
                return
            batch = messages.batch(messages.decode(frame))
            assert batch.n == self.next
            self.next += 1
            for name, columns in batch.streams.items():
                held = self.streams.setdefault(name, {column: [] for column in columns})
                for column, values in columns.items():
                    held[column] += list(values)
            await socket.send(json.dumps({"type": "ack", "n": batch.n}))
            if len(self.hellos) == 2 and self.complete:
                await socket.send(json.dumps({"type": "command", "v": 0.2, "w": 0.1, "seq": 1, "valid_s": 0.05}))

    @property
    def complete(self) -> bool:
        return {name: len(columns["t"]) for name, columns in self.streams.items()} == ROWS


async def _bridged(name: str) -> tuple[Recorded, Dashboard]:
    source, dashboard = Recorded(name), Dashboard()
    async with (
        serve(source.answer, "127.0.0.1", 0, subprotocols=source.protocols) as a,  # type: ignore[arg-type]
        serve(dashboard.answer, "127.0.0.1", 0) as b,
    ):
        ros, live = (next(iter(s.sockets)).getsockname()[1] for s in (a, b))
        config = {"run": RUN, "topics": TOPICS}
        work = asyncio.create_task(
            ros_bridge.bridge(f"ws://127.0.0.1:{ros}", f"http://127.0.0.1:{live}", "mill", config, drive=True)
        )
        for _ in range(1000):
            driven = source.protocols or len(source.asked) >= 3
            if work.done() or (dashboard.complete and driven):
                break
            await asyncio.sleep(0.01)
        work.cancel()
        await asyncio.gather(work, return_exceptions=True)
    return source, dashboard


@pytest.mark.parametrize("name", ["rosbridge.jsonl", "foxglove.jsonl"])
def test_a_recorded_exchange_becomes_live_streams(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ros_bridge, "RETRY_S", 0.01)
    source, dashboard = asyncio.run(_bridged(name))
    first, again = dashboard.hellos[:2]
    assert first.session == again.session and again.drive and again.run["robot"]["track_width"] == 0.3
    streams = dashboard.streams
    assert streams["imu"]["t"] == pytest.approx([0.0, 0.01, 0.02])  # one came twice, one late
    assert streams["imu"]["gz"] == [0.01, 0.012, 0.014]
    assert (streams["imu"]["ax"][0], streams["imu"]["az"][0], streams["imu"]["gy"][0]) == (0.1, 9.81, -0.002)
    assert streams["wheels"]["t"] == pytest.approx([0.004, 0.024])
    assert (streams["wheels"]["left"], streams["wheels"]["right"]) == ([0.5, 0.7], [0.6, 0.9])
    assert (streams["commands"]["v"], streams["commands"]["w"]) == ([0.3], [-0.2])
    assert 0 <= streams["commands"]["t"][0] < 5  # it has no stamp: when it arrived
    assert [streams["beacon"][c][0] for c in ("t", "x", "y", "theta")] == pytest.approx([0.03, 1.25, -0.5, math.pi / 6])
    assert streams["truth"]["theta"] == pytest.approx([0.0, 0.0, math.pi / 2])
    if name.startswith("rosbridge"):  # the stick comes back as a Twist, and lets go by itself
        advertised, moved, stopped = source.asked[:3]
        assert (advertised["op"], advertised["topic"]) == ("advertise", "/cmd_vel")
        assert (moved["msg"]["linear"]["x"], moved["msg"]["angular"]["z"]) == (0.2, 0.1)
        assert (stopped["msg"]["linear"]["x"], stopped["msg"]["angular"]["z"]) == (0.0, 0.0)


def test_odometry_is_turned_back_into_the_angles_of_its_wheels() -> None:
    translator = ros_bridge.Translator({"/odom": "wheels"}, {"wheel_radius": 0.1, "track_width": 0.3})
    lines = [json.loads(line) for line in (DATA / "rosbridge.jsonl").read_text(encoding="utf-8").splitlines()]
    told = [line["text"]["msg"] for line in lines if line["text"].get("topic") == "/odom" and "msg" in line["text"]]
    rows = [row for message in told for _, row in translator.rows("/odom", message, 0.0)]
    quarter = math.pi / 2 * 0.15 / 0.1  # a quarter turn on the spot, half of the track, over the radius
    assert [row["left"] for row in rows] == pytest.approx([0.0, 2.0, 2.0 - quarter])
    assert [row["right"] for row in rows] == pytest.approx([0.0, 2.0, 2.0 + quarter])


def test_odometry_without_the_robots_measures_is_refused() -> None:
    translator = ros_bridge.Translator({"/odom": "wheels"}, {})
    message = {"header": {"stamp": {"sec": 1, "nanosec": 0}}, "pose": {"pose": {}}}
    with pytest.raises(SystemExit, match="wheel_radius"):
        list(translator.rows("/odom", message, 0.0))
