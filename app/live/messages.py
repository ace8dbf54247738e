"""Frames of robots, checked: what is wrong is named with its place, and nothing of a wrong message is kept."""

from __future__ import annotations

import json
import math
import re
from dataclasses import dataclass
from typing import Any, NoReturn

import msgpack
import numpy as np
import numpy.typing as npt

from app.live.protocol import PROTOCOL, DriveLimits, Limits
from core.errors import DriftscopeError, TooLargeError
from core.formats.run_json import meta_from_json, meta_to_json
from core.run import RunMeta
from core.sensors import STREAMS

Array = npt.NDArray[np.float64]

ROBOT = re.compile(r"[A-Za-z0-9._-]{1,64}")
LIMITS = Limits(batch_rows=5000, batch_bytes=1 << 20, rows_per_s=20_000.0, batches_per_s=250.0, unacknowledged=512)
SLOWEST, FASTEST = -1e6, 1e9  # s: stamps outside are none
NAMES = 64  # beacons of one run
NAME_LENGTH = 200
DRIVE_LIMITS = DriveLimits(v=0.6, w=1.5)


class SchemaError(DriftscopeError):
    """A message breaks the live protocol. `where`: field, stream, column, row, expected, found."""

    code = "schema"


class ProtocolError(SchemaError):
    """Another protocol, or another version of it."""

    code = "protocol"


@dataclass(frozen=True)
class CheckedHello:
    """A Hello that holds; `run` as it will be stored."""

    session: str
    meta: RunMeta
    run: dict[str, Any]
    drive: bool
    virtual: bool
    limits: DriveLimits

    def message(self) -> dict[str, Any]:
        """As a Hello."""
        return {
            "type": "hello", "protocol": PROTOCOL, "session": self.session, "run": self.run, "drive": self.drive,
            "virtual": self.virtual, "limits": dict(self.limits),
        }  # fmt: skip


@dataclass(frozen=True)
class CheckedBatch:
    """A Batch that holds: columns by stream, float64 but for the beacons' names; all of one length within a stream."""

    n: int
    sent: float
    heard: tuple[float, float] | None
    streams: dict[str, dict[str, Any]]
    rows: int


def decode(frame: str | bytes) -> dict[str, Any]:
    """One message out of a text frame (JSON) or a binary one (MessagePack)."""
    if len(frame) > LIMITS["batch_bytes"]:
        limit = LIMITS["batch_bytes"]
        raise TooLargeError(f"a frame of {len(frame)} bytes, at most {limit}", expected=limit, found=len(frame))
    try:
        if isinstance(frame, str):
            message = json.loads(frame, parse_constant=_no_constant)
        else:
            message = msgpack.unpackb(frame, max_array_len=LIMITS["batch_rows"], max_map_len=64, strict_map_key=True)
    except (ValueError, RecursionError, msgpack.UnpackException) as error:
        raise SchemaError(f"the frame is no message: {error}"[:300], field="frame") from None
    if not isinstance(message, dict):
        _refuse("message", "an object", type(message).__name__)
    return message


def hello(message: dict[str, Any]) -> CheckedHello:
    """Check a Hello."""
    if message.get("type") != "hello":
        _refuse("type", "hello as the first message", message.get("type"))
    if message.get("protocol") != PROTOCOL:
        found = message.get("protocol")
        raise ProtocolError(f"this server speaks {PROTOCOL}, not {found!r}"[:200], expected=PROTOCOL, found=found)
    session = message.get("session")
    if not isinstance(session, str) or not 1 <= len(session) <= 64 or not session.isprintable():
        _refuse("session", "1 to 64 printable characters", session)
    run = message.get("run")
    if not isinstance(run, dict):
        _refuse("run", "run.json as an object", type(run).__name__)
    meta = meta_from_json({"format": "run/1", **run}, file="run.json")
    limits = message.get("limits", DRIVE_LIMITS)
    if not isinstance(limits, dict) or not all(finite(limits.get(k)) and 0 < limits[k] <= 20 for k in ("v", "w")):
        _refuse("limits", "v [m/s] and w [rad/s] over 0", limits)
    return CheckedHello(
        session, meta, meta_to_json(meta), _flag(message, "drive"), _flag(message, "virtual"),
        DriveLimits(v=float(limits["v"]), w=float(limits["w"])),
    )  # fmt: skip


def batch(message: dict[str, Any]) -> CheckedBatch:
    """Check a Batch by itself; what came before is the run's matter."""
    n, sent, streams = message.get("n"), message.get("sent"), message.get("streams")
    if not isinstance(n, int) or isinstance(n, bool) or n < 0:
        _refuse("n", "a whole number from 0 on", n)
    if not finite(sent):
        _refuse("sent", "the robot's clock in seconds", sent)
    assert sent is not None
    if not isinstance(streams, dict):
        _refuse("streams", "an object of streams", type(streams).__name__)
    checked = {name: _stream(name, columns) for name, columns in streams.items()}
    rows = sum(len(columns["t"]) for columns in checked.values())
    if rows > LIMITS["batch_rows"]:
        limit = LIMITS["batch_rows"]
        raise TooLargeError(f"batch {n} has {rows} rows, at most {limit}", expected=limit, found=rows)
    heard = message.get("heard")
    if heard is not None and not (isinstance(heard, list | tuple) and len(heard) == 2 and all(map(finite, heard))):
        _refuse("heard", "[server's stamp, robot's stamp]", heard)
    return CheckedBatch(n, float(sent), (float(heard[0]), float(heard[1])) if heard else None, checked, rows)


def _stream(name: str, columns: Any) -> dict[str, Any]:
    if name not in STREAMS:
        _refuse("streams", f"one of {', '.join(STREAMS)}", name)
    spec = STREAMS[name]
    if not isinstance(columns, dict):
        _refuse("streams", "columns by name", type(columns).__name__, stream=name)
    known = {column.name for column in spec.columns}
    for column in columns:
        if column not in known:
            _refuse("streams", f"columns among {', '.join(sorted(known))}", column, stream=name)
    for column in spec.columns:
        if column.required and column.name not in columns:
            _refuse("streams", f"the column {column.name}", "none", stream=name)
    if spec.at_least_one_of and not any(c in columns for c in spec.at_least_one_of):
        _refuse("streams", f"one of {', '.join(spec.at_least_one_of)}", "none", stream=name)
    made: dict[str, Any] | None = None if spec.text_columns else _block(columns)
    if made is None:
        made = {c: _names(v) if c in spec.text_columns else _numbers(v, name, c) for c, v in columns.items()}
    lengths = {c: len(v) for c, v in made.items()}
    if len(set(lengths.values())) > 1:
        _refuse("streams", "columns of one length", str(lengths), stream=name)
    _stamps(made["t"], name)
    return made


def _block(columns: dict[str, Any]) -> dict[str, Any] | None:
    """Binary columns of one length without infinity, as machines send them, at once; None for any other."""
    sizes = {len(v) if isinstance(v, bytes) else -1 for v in columns.values()}
    if len(sizes) > 1 or (size := sizes.pop()) < 0 or size % 8:
        return None
    block = np.frombuffer(b"".join(columns.values()), "<f8").reshape(len(columns), size // 8)
    if not np.isfinite(block).all() and np.isinf(block).any():
        return None
    return dict(zip(columns, block, strict=True))


def _numbers(values: Any, stream: str, column: str) -> Array:
    if isinstance(values, bytes):
        if len(values) % 8:
            _refuse("streams", "float64, little-endian", f"{len(values)} bytes", stream=stream, column=column)
        made = np.frombuffer(values, "<f8").astype(np.float64)
    else:
        if not isinstance(values, list):
            _refuse("streams", "a list of numbers", type(values).__name__, stream=stream, column=column)
        try:
            made = np.array(values, np.float64)
        except (TypeError, ValueError, OverflowError):
            made = np.zeros((0, 0))
        if made.ndim != 1 or (any(map(_no_number, values)) if len(values) else False):
            row = next((i for i, v in enumerate(values) if _no_number(v)), 0)
            found = str(values[row])[:60] if values else ""
            _refuse("streams", "a number or null", found, stream=stream, column=column, row=row + 1)
    if np.isinf(made).any():
        row = int(np.argmax(np.isinf(made)))
        _refuse("streams", "a finite number or null", str(made[row]), stream=stream, column=column, row=row + 1)
    return made


def _no_number(value: Any) -> bool:
    return value is not None and (isinstance(value, bool) or not isinstance(value, int | float))


def _names(values: Any) -> list[str]:
    good = isinstance(values, list) and all(
        isinstance(v, str) and v.strip() and len(v) <= NAME_LENGTH and v.isprintable() for v in values
    )
    if not good:
        _refuse("streams", "names of beacons", str(values)[:60], stream="ranges", column="beacon")
    return list(values)


def _stamps(t: Array, stream: str) -> None:
    if not len(t) or (t[0] > SLOWEST and t[-1] < FASTEST and (t[1:] > t[:-1]).all()):
        return
    bad = ~((t > SLOWEST) & (t < FASTEST))  # NaN too
    if bad.any():
        row = int(np.argmax(bad))
        _refuse("streams", "a stamp in seconds", str(t[row]), stream=stream, column="t", row=row + 1)
    back = np.diff(t) <= 0
    if back.any():
        row = int(np.argmax(back)) + 1
        expected, found = f"a stamp after {float(t[row - 1])!r}", f"{float(t[row])!r}"
        _refuse("streams", expected, found, stream=stream, column="t", row=row + 1)


def _flag(message: dict[str, Any], name: str) -> bool:
    value = message.get(name, False)
    if not isinstance(value, bool):
        _refuse(name, "true or false", value)
    return bool(value)


def finite(value: Any) -> bool:
    """Whether a value of a message is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _no_constant(text: str) -> NoReturn:
    raise ValueError(f"{text} is no JSON number; a missing reading is null")


def _refuse(field: str, expected: str, found: Any, **where: Any) -> NoReturn:
    place = ", ".join([field, *(f"{k} {v}" for k, v in where.items())])
    told = str(found)[:80]
    raise SchemaError(
        f"{place}: expected {expected}; found {told}", field=field, expected=expected, found=told, **where
    )


def check_robot(name: str) -> str:
    """The robot's name, if it can be one."""
    if not ROBOT.fullmatch(name):
        _refuse("robot", "1 to 64 letters, digits, '.', '_' or '-'", name)
    return name
