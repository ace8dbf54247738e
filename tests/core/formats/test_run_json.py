"""`run.json`: each key has its type and range; what is unknown is kept; nothing gets lost in writing back."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from core.errors import FormatError, TooLargeError
from core.formats import Limits, meta_from_json, meta_to_json, open_run
from core.formats.run_json import parse_json
from core.robot import ImuMount, Noise, Pose, Procedure, RobotParams, Segment, TagMount

FULL: dict[str, Any] = {
    "format": "run/1",
    "name": "corridor lap 3",
    "robot": {
        "wheel_radius": 0.075, "track_width": 0.32, "ticks_per_rev": 2048,
        "imu": {"x": 0.1, "y": 0.0, "yaw": 0.5}, "tag": {"x": 0.0, "y": 0.0, "z": 0.4},
    },
    "beacons": {"B1": [0.0, 0.0, 2.5], "B2": [5.0, 0.0, 2.5]},
    "start": {"x": 1.0, "y": 2.0, "theta": 0.5},
    "noise": {"gyro_density": 1.9e-4, "beacon_xy": 0.03, "range": 0.05},
    "simulator": {"effects": {"motor_lag": {"tau": 0.08}, "anchor_moved": {"beacon": "B1", "x": 0.1, "y": 0.0}}},
    "procedure": {"kind": "rest", "segments": [{"t0": 0.0, "t1": 60.0, "gravity": [0, 0, 9.80665], "rate": [0, 0, 0]}]},
}  # fmt: skip


def test_every_key_arrives() -> None:
    meta = meta_from_json(FULL)
    assert meta.name == "corridor lap 3"
    assert meta.robot == RobotParams(0.075, 0.32, 2048.0, ImuMount(0.1, 0.0, 0.5), TagMount(0.0, 0.0, 0.4))
    assert meta.beacons == {"B1": (0.0, 0.0, 2.5), "B2": (5.0, 0.0, 2.5)}
    assert meta.start == Pose(1.0, 2.0, 0.5)
    assert meta.noise == Noise(gyro_density=1.9e-4, beacon_xy=0.03, range=0.05)
    assert meta.effects["anchor_moved"] == {"beacon": "B1", "x": 0.1, "y": 0.0}
    assert meta.procedure == Procedure("rest", (Segment(0.0, 60.0, (0.0, 0.0, 9.80665), (0.0, 0.0, 0.0)),))
    assert meta.extra == {}
    assert meta_to_json(meta) == FULL


def test_missing_numbers_are_unknown_not_zero() -> None:
    meta = meta_from_json({"format": "run/1", "robot": {"wheel_radius": None}, "noise": {}})
    assert meta.robot.wheel_radius is None and meta.noise.range is None and meta.start is None
    assert meta_to_json(meta) == {"format": "run/1"}


def test_unknown_keys_are_kept_in_their_place_and_told(tmp_path: Path) -> None:
    data = json.loads(json.dumps(FULL))
    data["weather"] = {"rain": True, "wind": [1, 2, None]}
    data["robot"]["colour"] = "red"
    data["robot"]["imu"]["model"] = "X"
    data["simulator"]["version"] = "1.2"
    data["procedure"]["segments"][0]["note"] = "z up"
    assert meta_to_json(meta_from_json(data)) == data
    (tmp_path / "run.json").write_text(json.dumps(data))
    (tmp_path / "imu.csv").write_text("t,gz\n0,1\n")
    with open_run(tmp_path) as source:
        told = " ".join(source.warnings)
    for key in ("robot.colour", "robot.imu.model", "simulator.version", "procedure.segments.0.note", "weather"):
        assert f"unknown key {key!r}" in told


def changed(path: str, value: object) -> dict[str, Any]:
    data = json.loads(json.dumps(FULL))
    *parents, key = path.split(".")
    place: Any = data
    for parent in parents:
        place = place[int(parent)] if isinstance(place, list) else place.setdefault(parent, {})
    place[int(key) if isinstance(place, list) else key] = value
    return data


@pytest.mark.parametrize(
    ("path", "value", "key", "expected"),
    [
        ("format", "run/2", "format", "'run/1'"),
        ("format", None, "format", "'run/1'"),
        ("format", 1, "format", "text"),
        ("name", 5, "name", "a name"),
        ("name", "a\nb", "name", "a name"),
        ("name", "a\0b", "name", "a name"),
        ("name", "x" * 201, "name", "a name"),
        ("robot", [], "robot", "an object"),
        ("robot.wheel_radius", 0, "robot.wheel_radius", "a number over 0"),
        ("robot.wheel_radius", -0.1, "robot.wheel_radius", "a number over 0"),
        ("robot.wheel_radius", "0.1", "robot.wheel_radius", "a number over 0"),
        ("robot.track_width", True, "robot.track_width", "a number over 0"),
        ("robot.ticks_per_rev", [1], "robot.ticks_per_rev", "a number over 0"),
        ("robot.wheel_radius", 10**400, "robot.wheel_radius", "a finite number"),
        ("robot.imu.yaw", "0", "robot.imu.yaw", "a number"),
        ("beacons", [], "beacons", "an object"),
        ("beacons.B3", [0, 0], "beacons.B3", "a list of 3 numbers"),
        ("beacons.B3", [0, 0, None], "beacons.B3", "a number"),
        ("beacons.B3", None, "beacons.B3", "a value"),
        ("beacons. ", [0, 0, 0], "beacons. ", "a beacon name"),
        ("start", {"x": 0, "y": 0}, "start.theta", "a value"),
        ("noise.range", -1, "noise.range", "a number of at least 0"),
        ("simulator.effects", [], "simulator.effects", "an object"),
        ("simulator.effects.motor_lag", 0.1, "simulator.effects.motor_lag", "an object"),
        ("simulator.effects.motor_lag.tau", [1], "simulator.effects.motor_lag.tau", "a finite number or a name"),
        ("procedure.kind", "dance", "procedure.kind", "one of rest"),
        ("procedure.segments", {}, "procedure.segments", "a list of objects"),
        ("procedure.segments.0", 5, "procedure.segments[0]", "an object"),
        ("procedure.segments.0.t1", -1, "procedure.segments[0].t1", "at least t0"),
        ("procedure.segments.0.gravity", [0, 0, "g"], "procedure.segments[0].gravity", "a number"),
    ],
)
def test_a_wrong_value_names_its_key(path: str, value: object, key: str, expected: str) -> None:
    with pytest.raises(FormatError) as caught:
        meta_from_json(changed(path, value), file="run.json")
    assert caught.value.where["key"] == key
    assert str(caught.value.where["expected"]).startswith(expected)
    assert caught.value.where["file"] == "run.json" and caught.value.where["found"]


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (b"", "expected JSON"),
        (b"{", "line 1"),
        (b"[]", "an object"),
        (b"null", "an object"),
        (b'{"a": 1, "a": 2}', "each key once"),
        (b'{"a": {"b": 1, "b": 2}}', "each key once"),
        (b'{"a": NaN}', "finite numbers"),
        (b'{"a": -Infinity}', "finite numbers"),
        (b'{"a": 1e999}', "finite numbers"),
        (b'{"a": ' + b"1" * 5000 + b"}", "finite numbers"),
        (b'{"a": "\\ud800"}', "half a surrogate"),
        ('{"a": "µ"}'.encode("latin-1"), "UTF-8 text"),
        ('{"a": 1}'.encode("utf-16"), "UTF-8 text"),
    ],
)
def test_what_is_no_sound_json_is_refused(data: bytes, told: str) -> None:
    with pytest.raises(FormatError, match=told):
        parse_json(data, "run.json")


def test_a_byte_order_mark_is_harmless() -> None:
    assert parse_json(b'\xef\xbb\xbf{"a": "\xc2\xb5"}', "run.json") == {"a": "µ"}


DEEP = (b"[" * 100_000 + b"]" * 100_000, b"[" * 40 + b"]" * 40, b'{"a":' * 40 + b"1" + b"}" * 40)


@pytest.mark.parametrize("deep", DEEP)
def test_deep_json_is_refused(deep: bytes) -> None:
    with pytest.raises(TooLargeError, match="levels"):
        parse_json(b'{"a": ' + deep + b"}", "run.json")


def test_gigantic_json_is_refused_unread(tmp_path: Path) -> None:
    with (tmp_path / "run.json").open("wb") as f:
        f.truncate(10 << 30)  # a hole: reading it would take ten gigabytes
    (tmp_path / "imu.csv").write_text("t,gz\n0,1\n")
    with pytest.raises(TooLargeError, match="bytes"):
        open_run(tmp_path)
    with pytest.raises(TooLargeError):
        parse_json(b'{"a": 1}', "run.json", Limits(max_json_bytes=4))
