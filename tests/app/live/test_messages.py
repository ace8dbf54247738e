"""What a robot may send, and how it is told what it may not."""

from __future__ import annotations

import json
from typing import Any

import msgpack
import numpy as np
import pytest

from app.live.messages import LIMITS, batch, check_robot, decode, hello
from app.live.protocol import PROTOCOL
from core.errors import DriftscopeError

HELLO: dict[str, Any] = {"type": "hello", "protocol": PROTOCOL, "session": "s1", "run": {"name": "lap"}}


def a_batch(**streams: Any) -> dict[str, Any]:
    return {"type": "batch", "n": 0, "sent": 1.0, "streams": streams}


def test_json_and_messagepack_say_the_same_and_binary_columns_are_float64() -> None:
    columns = {"t": [0.0, 0.5], "gz": [0.1, None], "ax": [1.0, 2.0]}
    one = batch(decode(json.dumps(a_batch(imu=columns))))
    two = batch(decode(msgpack.packb(a_batch(imu=columns | {"ax": np.array([1.0, 2.0]).tobytes()}))))
    assert one.rows == two.rows == 2
    for name in columns:
        np.testing.assert_array_equal(one.streams["imu"][name], two.streams["imu"][name])
    assert np.isnan(one.streams["imu"]["gz"][1])


BROKEN = [
    (a_batch(lidar={"t": [0.0]}), "one of commands"),
    (a_batch(imu={"t": [0.0]}), "the column gz"),
    (a_batch(imu={"t": [0.0], "gz": [0.0], "volt": [0.0]}), "volt"),
    (a_batch(imu={"t": [0.0, 0.1], "gz": [0.0]}), "one length"),
    (a_batch(imu={"t": [0.0], "gz": ["fast"]}), "row 1"),
    (a_batch(imu={"t": [0.0], "gz": [True]}), "a number or null"),
    (a_batch(imu={"t": [0.2, 0.1], "gz": [0.0, 0.0]}), "a stamp after 0.2"),
    (a_batch(imu={"t": [None], "gz": [0.0]}), "a stamp in seconds"),
    (a_batch(imu={"t": [0.0], "gz": [1e999]}), "a finite number"),
    (a_batch(imu={"t": [0.0], "gz": b"12345"}), "float64"),
    (a_batch(ranges={"t": [0.0], "beacon": [3], "range": [1.0]}), "names of beacons"),
    (a_batch(wheels=[1, 2]), "columns by name"),
    ({**a_batch(), "n": -1}, "a whole number"),
    ({**a_batch(), "sent": "now"}, "the robot's clock"),
    ({**a_batch(), "heard": [1.0]}, "heard"),
    (a_batch(imu={"t": list(range(6000)), "gz": [0.0] * 6000}), "at most 5000"),
]


@pytest.mark.parametrize(("message", "told"), BROKEN)
def test_a_batch_that_breaks_the_schema_is_refused_with_its_place(message: dict[str, Any], told: str) -> None:
    with pytest.raises(DriftscopeError, match=told):
        batch(message)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"protocol": "driftscope-live/9"}, "speaks driftscope-live/1"),
        ({"session": ""}, "session"),
        ({"run": {"robot": {"wheel_radius": -1}}}, "over 0"),
        ({"run": 3}, "run.json"),
        ({"drive": "yes"}, "true or false"),
        ({"limits": {"v": 0.0, "w": 1.0}}, "limits"),
        ({"type": "batch"}, "hello"),
    ],
)
def test_a_hello_that_breaks_the_schema_is_refused(change: dict[str, Any], told: str) -> None:
    with pytest.raises(DriftscopeError, match=told):
        hello({**HELLO, **change})


@pytest.mark.parametrize("frame", ["{", b"\xc1", "[]", "NaN", "x" * (LIMITS["batch_bytes"] + 1), "[" * 100_000])
def test_a_frame_that_is_no_message_is_refused(frame: str | bytes) -> None:
    with pytest.raises(DriftscopeError):
        decode(frame)


@pytest.mark.parametrize("name", ["", "a/b", "..\n", "x" * 65, "ö"])
def test_a_robot_needs_a_plain_name(name: str) -> None:
    with pytest.raises(DriftscopeError, match="robot"):
        check_robot(name)
