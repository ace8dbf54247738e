"""Column mapping: how the columns of a foreign table become streams, with units and signs.

JSON form, also what is remembered by name:
`{"streams": {"imu": {"t": {"column": "time_ms", "unit": "ms"}, "gz": {"column": "gyro_z", "unit": "deg/s",
"sign": -1}}}, "t0": "first", "robot": {...}}`. `t0` says whether time starts at the table's first stamp or is taken as
it is; the other keys of `run.json` (name, robot, beacons, start, noise, procedure) may stand beside.
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NoReturn

from core.errors import ParameterError
from core.formats.checks import shown
from core.formats.run_json import VERSION, meta_from_json
from core.run import RunMeta
from core.sensors import STREAMS, StreamSpec

DESCRIPTION_KEYS = ("name", "robot", "beacons", "start", "noise", "procedure")
STARTS = ("first", "zero")


@dataclass(frozen=True)
class Unit:
    """SI value = value * factor / divisor + offset. `needs`: the robot dimension that the factor depends on."""

    factor: float = 1.0
    divisor: float = 1.0
    offset: float = 0.0
    needs: str | None = None


UNITS: dict[str, dict[str, Unit]] = {
    "s": {
        "s": Unit(), "ms": Unit(divisor=1e3), "us": Unit(divisor=1e6), "ns": Unit(divisor=1e9), "min": Unit(60.0),
        "h": Unit(3600.0),
    },
    "m": {
        "m": Unit(), "cm": Unit(divisor=100.0), "mm": Unit(divisor=1e3), "km": Unit(1e3), "in": Unit(0.0254),
        "ft": Unit(0.3048),
    },
    "m/s": {"m/s": Unit(), "cm/s": Unit(divisor=100.0), "mm/s": Unit(divisor=1e3), "km/h": Unit(divisor=3.6)},
    "rad": {
        "rad": Unit(), "deg": Unit(math.pi, 180.0), "rev": Unit(2 * math.pi),
        "ticks": Unit(2 * math.pi, needs="ticks_per_rev"), "m": Unit(needs="wheel_radius"),
    },
    "rad/s": {
        "rad/s": Unit(), "mrad/s": Unit(divisor=1e3), "deg/s": Unit(math.pi, 180.0),
        "deg/h": Unit(math.pi, 180.0 * 3600.0), "rpm": Unit(math.pi, 30.0),
    },
    "m/s²": {"m/s²": Unit(), "g": Unit(9.80665), "mg": Unit(9.80665, 1e3), "cm/s²": Unit(divisor=100.0)},
    "°C": {"°C": Unit(), "K": Unit(offset=-273.15), "°F": Unit(5.0, 9.0, -160.0 / 9.0)},
    "": {"": Unit()},
}  # fmt: skip
"""Accepted units by the SI unit of the column; the SI unit itself comes first. `ticks` and rolled `m` of a wheel need
the robot's ticks_per_rev and wheel_radius."""


@dataclass(frozen=True)
class ColumnSource:
    """Where a column comes from: the table's column, its unit (None: SI) and a sign."""

    column: str
    unit: str | None = None
    sign: int = 1


@dataclass(frozen=True)
class ColumnMap:
    """Streams by name, each with its columns by name; see the module's page. `description`: keys of `run.json`."""

    streams: Mapping[str, Mapping[str, ColumnSource]]
    t0: str = "first"
    description: Mapping[str, object] = field(default_factory=dict)

    @classmethod
    def from_json(cls, data: object) -> ColumnMap:
        """A mapping from its JSON form, checked. ParameterError names the key."""
        top = _mapping(data, "mapping")
        for key in top:
            if key not in ("streams", "t0", *DESCRIPTION_KEYS):
                _refuse(key, ["streams", "t0", *DESCRIPTION_KEYS], shown(key))
        streams = {
            str(stream): {str(name): _source(source, f"streams.{stream}.{name}") for name, source in columns.items()}
            for stream, value in _mapping(top.get("streams"), "streams").items()
            for columns in [_mapping(value, f"streams.{stream}")]
        }
        description = {key: value for key, value in top.items() if key in DESCRIPTION_KEYS}
        mapping = cls(streams, str(top.get("t0", "first")), description)
        mapping.check()
        return mapping

    def to_json(self) -> dict[str, Any]:
        """The JSON form."""
        streams = {
            stream: {
                name: {
                    "column": source.column,
                    "unit": source.unit or spec_unit(STREAMS[stream], name),
                    "sign": source.sign,
                }
                for name, source in columns.items()
            }
            for stream, columns in self.streams.items()
        }
        return {"streams": streams, "t0": self.t0, **self.description}

    def check(self) -> None:
        """ParameterError at the first stream, column, unit or sign that cannot be."""
        if self.t0 not in STARTS:
            _refuse("t0", STARTS, shown(self.t0))
        if not self.streams:
            _refuse("streams", "at least one stream", "none")
        meta = self.meta()
        for stream, columns in self.streams.items():
            if stream not in STREAMS:
                _refuse("streams", list(STREAMS), shown(stream))
            _check_columns(STREAMS[stream], columns)
            for name, source in columns.items():
                needs = self.unit(stream, name, source).needs
                if needs and getattr(meta.robot, needs) is None:
                    _refuse(f"robot.{needs}", f"a value, for {stream}.{name} in {source.unit}", "nothing")

    def unit(self, stream: str, name: str, source: ColumnSource) -> Unit:
        """The unit of one column, with the robot's dimension put in where it needs one."""
        units = UNITS[spec_unit(STREAMS[stream], name)]
        unit = units.get(source.unit) if source.unit is not None else next(iter(units.values()))
        if unit is None or (unit.needs and stream != "wheels"):
            _refuse(f"streams.{stream}.{name}.unit", list(units), shown(source.unit))
        if unit.needs and (value := getattr(self.meta().robot, unit.needs)) is not None:
            return dataclasses.replace(unit, divisor=value)
        return unit

    def meta(self) -> RunMeta:
        """The description that the mapping carries."""
        return meta_from_json({"format": VERSION, **self.description}, file="mapping")


def spec_unit(spec: StreamSpec, name: str) -> str:
    """SI unit of a stream's column."""
    return spec.column(name).unit


def _check_columns(spec: StreamSpec, columns: Mapping[str, ColumnSource]) -> None:
    known = [c.name for c in spec.columns]
    for name, source in columns.items():
        if name not in known:
            _refuse(f"streams.{spec.name}", known, shown(name))
        if source.sign not in (1, -1) or (name == "t" and source.sign != 1):
            _refuse(f"streams.{spec.name}.{name}.sign", "1" if name == "t" else "1 or -1", shown(source.sign))
    for column in spec.columns:
        if column.required and column.name not in columns:
            _refuse(f"streams.{spec.name}.{column.name}", "a column", "nothing")
    if spec.at_least_one_of and not set(spec.at_least_one_of) & set(columns):
        _refuse(f"streams.{spec.name}", f"at least one of {', '.join(spec.at_least_one_of)}", "none of them")


def _source(value: object, where: str) -> ColumnSource:
    data = _mapping(value, where)
    for key in data:
        if key not in ("column", "unit", "sign"):
            _refuse(f"{where}.{key}", ["column", "unit", "sign"], shown(key))
    column, unit, sign = data.get("column"), data.get("unit"), data.get("sign", 1)
    if not isinstance(column, str) or not column:
        _refuse(f"{where}.column", "a column's name", shown(column))
    if unit is not None and not isinstance(unit, str):
        _refuse(f"{where}.unit", "a unit", shown(unit))
    if isinstance(sign, bool) or not isinstance(sign, (int, float)) or sign not in (1, -1):
        _refuse(f"{where}.sign", "1 or -1", shown(sign))
    return ColumnSource(column, unit, int(sign))


def _mapping(value: object, where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        _refuse(where, "an object", shown(value))
    return value


def _refuse(parameter: str, expected: object, found: str) -> NoReturn:
    said = ", ".join(map(str, expected)) if isinstance(expected, (list, tuple)) else expected
    raise ParameterError(
        f"mapping, {parameter}: expected {'one of ' if said is not expected else ''}{said}; found {found}",
        parameter=parameter,
        expected=expected,
        found=found,
    )


TIME_NAMES = r"t|time|timestamps?|stamp|secs?|seconds|header stamp|elapsed( time)?|time stamp"
GUESSES: dict[tuple[str, str], str] = {
    ("commands", "v"): r"(cmd|command|set|target|desired)( vel)?( linear)? (v|x|vx|speed|velocity)|v (cmd|ref)",
    ("commands", "w"): r"(cmd|command|set|target|desired)( vel)?( angular)? (w|z|wz|omega|yaw rate)|w (cmd|ref)",
    ("wheels", "left"): r"((wheels?|enc|encoder|motor) )?(left|l)( (wheel|enc|encoder|motor|angle|pos|position))*",
    (
        "wheels",
        "right",
    ): r"((wheels?|enc|encoder|motor) )?(right|r)( (wheel|enc|encoder|motor|angle|pos|position))*",
    ("imu", "gz"): r"(imu )?(g|gyro|gyr|w|omega|rate|angular velocity|gyroscope) ?z|yaw ?rate",
    ("imu", "gx"): r"(imu )?(g|gyro|gyr|w|omega|rate|angular velocity|gyroscope) ?x",
    ("imu", "gy"): r"(imu )?(g|gyro|gyr|w|omega|rate|angular velocity|gyroscope) ?y",
    ("imu", "ax"): r"(imu )?(a|acc|accel|linear acceleration|accelerometer|acceleration) ?x",
    ("imu", "ay"): r"(imu )?(a|acc|accel|linear acceleration|accelerometer|acceleration) ?y",
    ("imu", "az"): r"(imu )?(a|acc|accel|linear acceleration|accelerometer|acceleration) ?z",
    ("imu", "temperature"): r"(imu )?(temp|temperature)",
    ("beacon", "x"): r"(beacon|tag|fix|uwb|gps|hedge|marvelmind) x",
    ("beacon", "y"): r"(beacon|tag|fix|uwb|gps|hedge|marvelmind) y",
    ("beacon", "theta"): r"(beacon|tag|fix|uwb|gps|hedge|marvelmind) (theta|yaw|heading)",
    ("ranges", "beacon"): r"beacon|anchor|beacon (name|id)|anchor (name|id)",
    ("ranges", "range"): r"range|distance|dist",
    ("truth", "x"): r"((truth|true|gt|ground truth|mocap|ref|reference|optitrack|vicon) )?x",
    ("truth", "y"): r"((truth|true|gt|ground truth|mocap|ref|reference|optitrack|vicon) )?y",
    ("truth", "theta"): r"((truth|true|gt|ground truth|mocap|ref|reference|optitrack|vicon) )?(theta|yaw|heading)",
}
"""Common names of each column, as patterns over lower-case words."""

SPELT: dict[str, str] = {
    "sec": "s", "secs": "s", "seconds": "s", "msec": "ms", "millis": "ms", "usec": "us", "micros": "us", "µs": "us",
    "nsec": "ns", "nanosec": "ns", "degs": "deg", "degrees": "deg", "dps": "deg/s", "deg s": "deg/s", "rads": "rad/s",
    "rad s": "rad/s", "rad sec": "rad/s", "m s2": "m/s²", "m s²": "m/s²", "mps2": "m/s²", "ms2": "m/s²", "mps": "m/s",
    "m s": "m/s", "tick": "ticks", "counts": "ticks", "count": "ticks", "degc": "°C", "c": "°C", "kelvin": "K",
}  # fmt: skip


def suggest_mapping(columns: Iterable[str]) -> ColumnMap:
    """A first guess from common names and units in them (`gyro_z [deg/s]`, `time_ms`); it may lack what it must have.

    A stream is suggested only if one of its own readings was recognised; its stamps are the first time column.
    """
    names = list(columns)
    times = [(name, unit) for name in names for words, unit in [_words(name, "s")] if re.fullmatch(TIME_NAMES, words)]
    streams: dict[str, dict[str, ColumnSource]] = {}
    for (stream, target), pattern in GUESSES.items():
        si = spec_unit(STREAMS[stream], target)
        for name in names:
            words, unit = _words(name, si)
            if re.fullmatch(pattern, words) and target not in streams.get(stream, {}):
                streams.setdefault(stream, {})[target] = ColumnSource(name, unit)
                break
    for found in streams.values():
        if times:
            found["t"] = ColumnSource(*times[0])
    ordered = {
        stream: {c.name: streams[stream][c.name] for c in spec.columns if c.name in streams[stream]}
        for stream, spec in STREAMS.items()
        if stream in streams
    }
    return ColumnMap(ordered)


def _words(name: str, si: str) -> tuple[str, str]:
    """A column's name as lower-case words without its unit, and the unit (SI where it says none)."""
    text = re.sub(r"([a-z])([A-Z])", r"\1 \2", name)
    words = [w for w in re.split(r"[^0-9a-z²°µ]+", text.lower()) if w]
    for size in (2, 1):
        said = " ".join(words[-size:])
        if len(words) > size or (si == "s" and len(words) > 1):
            for unit in (SPELT.get(said, said), said.replace(" ", "/")):
                if unit in UNITS[si]:
                    return " ".join(words[:-size]), unit
    return " ".join(words), si
