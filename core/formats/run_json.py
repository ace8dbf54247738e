"""`run.json`: the description of a run. Read strictly, written back without loss.

A known key must have its type and range; an unknown key is kept in `RunMeta.extra`, at the same place in the tree,
and reported as a warning. A missing number is None: unknown, not zero.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NoReturn

from core.errors import FormatError, TooLargeError
from core.formats.checks import MAX_NAME_CHARS, shown
from core.formats.limits import Limits
from core.robot import PROCEDURES, ImuMount, Noise, Pose, Procedure, RobotParams, Segment, TagMount
from core.run import RunMeta

VERSION = "run/1"
Json = Mapping[str, object]
Vector = tuple[float, float, float]


def read_run_json(path: Path, file: str, limits: Limits) -> tuple[RunMeta, list[str]]:
    """The description in a file, and warnings. FormatError names the key; TooLargeError beyond `limits`."""
    size = path.stat().st_size
    if size > limits.max_json_bytes:
        _too_large(file, f"at most {limits.max_json_bytes:,} bytes", f"{size:,} bytes")
    meta = meta_from_json(parse_json(path.read_bytes(), file, limits), file=file)
    return meta, [f"{file}: unknown key {key!r} is kept and not used" for key in _paths(meta.extra, TREE)]


def parse_json(data: bytes, file: str, limits: Limits | None = None) -> Json:
    """A JSON object from UTF-8 bytes: finite numbers, no duplicate keys, bounded depth."""
    limits = limits or Limits()
    if len(data) > limits.max_json_bytes:
        _too_large(file, f"at most {limits.max_json_bytes:,} bytes", f"{len(data):,} bytes")
    try:
        text = data.decode("utf-8-sig")
        value = json.loads(
            text, object_pairs_hook=_Pairs(file), parse_constant=_Constant(file), parse_float=_Float(file)
        )
        json.dumps(value, ensure_ascii=False).encode()  # lone surrogates cannot be stored
    except UnicodeDecodeError as error:
        _refuse(file, "", "UTF-8 text", f"byte 0x{data[error.start]:02x} at offset {error.start}")
    except json.JSONDecodeError as error:
        _refuse(file, "", "JSON", f"{error.msg} at line {error.lineno}, column {error.colno}")
    except RecursionError:
        _too_large(file, f"at most {limits.max_json_depth} levels", "far deeper nesting")
    except UnicodeEncodeError:
        _refuse(file, "", "Unicode text", "half a surrogate pair")
    except FormatError:
        raise
    except ValueError as error:  # integers of thousands of digits
        _refuse(file, "", "finite numbers", str(error).split(":")[0])
    if not isinstance(value, dict):
        _refuse(file, "", "an object", shown(value))
    if _depth(value) > limits.max_json_depth:
        _too_large(file, f"at most {limits.max_json_depth} levels", f"{_depth(value)} levels")
    return value


def meta_from_json(data: object, *, file: str = "run.json") -> RunMeta:
    """The description from parsed JSON; keys that are not understood go to `extra`. FormatError names the key."""
    top = _Object(data, "", file)
    version = top.take("format", _text)
    if version != VERSION:
        top.refuse("format", f"{VERSION!r}", "nothing" if version is None else shown(version))
    simulator = top.child("simulator")
    return RunMeta(
        name=top.take("name", _name) or "",
        robot=_robot(top.child("robot")),
        beacons=_beacons(top.child("beacons")),
        start=_start(top.child("start")),
        noise=_noise(top.child("noise")),
        effects=_effects(simulator.child("effects")),
        procedure=_procedure(top.child("procedure")),
        extra=top.rest(),
    )


def meta_to_json(meta: RunMeta) -> dict[str, Any]:
    """Plain data for `run.json`; `meta_from_json` gives the same description again."""
    robot = _known(
        wheel_radius=meta.robot.wheel_radius,
        track_width=meta.robot.track_width,
        ticks_per_rev=meta.robot.ticks_per_rev,
        imu=None if meta.robot.imu == ImuMount() else vars(meta.robot.imu),
        tag=None if meta.robot.tag == TagMount() else vars(meta.robot.tag),
    )
    effects = {name: dict(parameters) for name, parameters in meta.effects.items()}
    known = {
        "format": VERSION,
        "name": meta.name,
        "robot": robot,
        "beacons": {name: list(position) for name, position in meta.beacons.items()},
        "start": None if meta.start is None else vars(meta.start),
        "noise": _known(**vars(meta.noise)),
        "simulator": {"effects": effects} if effects else {},
        "procedure": None if meta.procedure is None else _procedure_json(meta.procedure),
    }
    kept = {key: value for key, value in known.items() if value not in (None, "", {})}
    return _merged(kept, meta.extra)


def write_run_json(meta: RunMeta, path: Path) -> None:
    """Write `run.json`, UTF-8, two spaces."""
    text = json.dumps(meta_to_json(meta), ensure_ascii=False, indent=2, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")


class _Object:
    """A JSON object being read: what is taken is known, the rest is `extra`."""

    def __init__(self, data: object, path: str, file: str) -> None:
        self.path, self.file = path, file
        self.present = data is not None
        if data is not None and not isinstance(data, Mapping):
            _refuse(file, path, "an object", shown(data))
        self.data: Json = data if isinstance(data, Mapping) else {}
        self.left = dict(self.data)
        self.children: dict[str, _Object | list[_Object]] = {}

    def key(self, name: str) -> str:
        return f"{self.path}.{name}" if self.path else name

    def refuse(self, name: str, expected: str, found: str) -> NoReturn:
        _refuse(self.file, self.key(name), expected, found)

    def take(self, name: str, check: Callable[[object], Any]) -> Any:
        """The value, checked; None where absent or null. `check` raises _Wrong with what it expected."""
        value = self.left.pop(name, None)
        if value is None:
            return None
        try:
            return check(value)
        except _Wrong as wrong:
            self.refuse(name, str(wrong), shown(value))

    def need(self, name: str, check: Callable[[object], Any]) -> Any:
        value = self.take(name, check)
        if value is None:
            self.refuse(name, "a value", "nothing")
        return value

    def child(self, name: str) -> _Object:
        child = _Object(self.left.pop(name, None), self.key(name), self.file)
        self.children[name] = child
        return child

    def items(self, name: str) -> list[_Object]:
        value = self.left.pop(name, None)
        if value is not None and not isinstance(value, list):
            self.refuse(name, "a list of objects", shown(value))
        listed = [_Object(v, f"{self.key(name)}[{i}]", self.file) for i, v in enumerate(value or [])]
        self.children[name] = listed
        return listed

    def rest(self) -> dict[str, object]:
        """What nobody took, in its place; lists become objects by index."""
        rest: dict[str, object] = dict(self.left)
        for name, child in self.children.items():
            inner = (
                child.rest()
                if isinstance(child, _Object)
                else {str(i): r for i, item in enumerate(child) if (r := item.rest())}
            )
            if inner:
                rest[name] = inner
        return rest


class _Wrong(Exception):
    """A value is not what its key expects."""


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise _Wrong("text")
    return value


def _name(value: object) -> str:
    if not isinstance(value, str) or len(value) > MAX_NAME_CHARS or not (value == "" or value.isprintable()):
        raise _Wrong(f"a name of at most {MAX_NAME_CHARS} printable characters")
    return value


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise _Wrong("a number")
    try:
        number = float(value)
    except OverflowError:
        raise _Wrong("a finite number") from None
    if not math.isfinite(number):
        raise _Wrong("a finite number")
    return number


def _positive(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not _number(value) > 0:
        raise _Wrong("a number over 0")
    return _number(value)


def _not_negative(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not _number(value) >= 0:
        raise _Wrong("a number of at least 0")
    return _number(value)


def _vector(value: object) -> Vector:
    if not isinstance(value, list) or len(value) != 3:
        raise _Wrong("a list of 3 numbers")
    x, y, z = (_number(v) for v in value)
    return x, y, z


def _parameter(value: object) -> float | str:
    if isinstance(value, str):
        return value
    try:
        return _number(value)
    except _Wrong:
        raise _Wrong("a finite number or a name") from None


def _kind(value: object) -> str:
    if value not in PROCEDURES:
        raise _Wrong(f"one of {', '.join(PROCEDURES)}")
    return str(value)


def _robot(data: _Object) -> RobotParams:
    imu, tag = data.child("imu"), data.child("tag")
    return RobotParams(
        wheel_radius=data.take("wheel_radius", _positive),
        track_width=data.take("track_width", _positive),
        ticks_per_rev=data.take("ticks_per_rev", _positive),
        imu=ImuMount(*(imu.take(k, _number) or 0.0 for k in ("x", "y", "yaw"))),
        tag=TagMount(*(tag.take(k, _number) or 0.0 for k in ("x", "y", "z"))),
    )


def _beacons(data: _Object) -> dict[str, Vector]:
    names = list(data.left)
    for name in names:
        if not name.strip() or len(name) > MAX_NAME_CHARS or not name.isprintable():
            data.refuse(name, f"a beacon name of at most {MAX_NAME_CHARS} printable characters", shown(name))
    return {name: data.need(name, _vector) for name in names}


def _start(data: _Object) -> Pose | None:
    return Pose(*(data.need(k, _number) for k in ("x", "y", "theta"))) if data.present else None


def _noise(data: _Object) -> Noise:
    return Noise(**{key: data.take(key, _not_negative) for key in Noise.__dataclass_fields__})


def _effects(data: _Object) -> dict[str, dict[str, float | str]]:
    effects = {}
    for name in list(data.left):
        parameters = data.child(name)
        effects[name] = {key: parameters.need(key, _parameter) for key in list(parameters.left)}
    return effects


def _procedure(data: _Object) -> Procedure | None:
    if not data.present:
        return None
    segments = tuple(_segment(item) for item in data.items("segments"))
    return Procedure(kind=data.take("kind", _kind) or "drive", segments=segments)


def _segment(data: _Object) -> Segment:
    t0, t1 = data.need("t0", _number), data.need("t1", _number)
    if t1 < t0:
        data.refuse("t1", f"at least t0 = {t0!r}", repr(t1))
    return Segment(t0, t1, gravity=data.take("gravity", _vector), rate=data.take("rate", _vector))


def _procedure_json(procedure: Procedure) -> dict[str, object]:
    segments = [
        _known(t0=s.t0, t1=s.t1, gravity=s.gravity and list(s.gravity), rate=s.rate and list(s.rate))
        for s in procedure.segments
    ]
    return {"kind": procedure.kind, **({"segments": segments} if segments else {})}


def _known(**values: object) -> dict[str, Any]:
    return {key: value for key, value in values.items() if value is not None}


def _merged(known: Any, extra: Any) -> Any:
    if isinstance(known, dict) and isinstance(extra, Mapping):
        return known | {key: _merged(known[key], value) if key in known else value for key, value in extra.items()}
    if isinstance(known, list) and isinstance(extra, Mapping):
        return [_merged(item, extra[str(i)]) if str(i) in extra else item for i, item in enumerate(known)]
    return known


def _paths(extra: Mapping[str, object], known: Mapping[str, object]) -> list[str]:
    paths: list[str] = []
    for key, value in extra.items():
        inside = known.get(key, known.get("*"))
        if isinstance(inside, Mapping) and isinstance(value, Mapping):
            paths += [f"{key}.{path}" for path in _paths(value, inside)]
        else:
            paths.append(key)
    return paths


TREE: Mapping[str, Any] = {
    "robot": {"imu": {}, "tag": {}},
    "start": {},
    "noise": {},
    "simulator": {},
    "procedure": {"segments": {"*": {}}},
}
"""Objects inside which an unknown key is named by its path."""


def _depth(value: object) -> int:
    """Levels of nesting, counted level by level."""
    levels, layer = 0, [value]
    while layer:
        inner: list[object] = []
        for item in layer:
            inner += item.values() if isinstance(item, Mapping) else item if isinstance(item, list) else ()
        levels, layer = levels + 1, inner
    return levels - 1


class _Pairs:
    """json's object hook: refuses a key that is there twice."""

    def __init__(self, file: str) -> None:
        self.file = file

    def __call__(self, pairs: list[tuple[str, object]]) -> dict[str, object]:
        data = dict(pairs)
        if len(data) != len(pairs):
            twice, times = Counter(key for key, _ in pairs).most_common(1)[0]
            _refuse(self.file, shown(twice), "each key once", f"{times} times")
        return data


class _Constant:
    """json's hook for NaN and Infinity."""

    def __init__(self, file: str) -> None:
        self.file = file

    def __call__(self, text: str) -> NoReturn:
        _refuse(self.file, "", "finite numbers", text)


class _Float:
    """json's hook for floats: 1e999 would silently become infinite."""

    def __init__(self, file: str) -> None:
        self.file = file

    def __call__(self, text: str) -> float:
        number = float(text)
        if not math.isfinite(number):
            _refuse(self.file, "", "finite numbers", shown(text))
        return number


def _refuse(file: str, key: str, expected: str, found: str) -> NoReturn:
    place = f"{file}, {key}" if key else file
    raise FormatError(
        f"{place}: expected {expected}; found {found}", file=file, key=key or None, expected=expected, found=found
    )


def _too_large(file: str, expected: str, found: str) -> NoReturn:
    raise TooLargeError(f"{file}: expected {expected}; found {found}", file=file, expected=expected, found=found)
