"""A viewer's cursor: where in the run it is, whether it plays, what it shows. Plain data, checked at the door."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from app.scene.style import THEMES, TRAILS
from core.errors import ParameterError

MAX_SPEED = 1000.0
MAX_METHODS = 64


@dataclass(frozen=True)
class Cursor:
    """t [s] was right at `stamp` [s, monotonic clock]; while playing, time runs on from there at `speed`.

    `methods` are those shown, None for all; `follow` keeps the camera with the leading robot; `trail`, of a live run:
    what the leading path is coloured by.
    """

    t: float
    stamp: float
    playing: bool = False
    speed: float = 1.0
    follow: bool = False
    methods: tuple[str, ...] | None = None
    theme: str = "light"
    trail: str = "method"

    def now(self, clock: float, t0: float, t1: float) -> float:
        """The run's time at the monotonic `clock`, held within the run."""
        t = self.t + (self.speed * (clock - self.stamp) if self.playing else 0.0)
        return min(max(t, t0), t1)

    def shows(self, method: str) -> bool:
        """Whether the viewer wants to see the method."""
        return self.methods is None or method in self.methods

    def moved(self, change: Mapping[str, Any], clock: float, t0: float, t1: float) -> Cursor:
        """The cursor after a checked change, its time re-anchored at `clock`."""
        given = {"t": self.now(clock, t0, t1), **change}
        given["t"] = min(max(given["t"], t0), t1)
        return dataclasses.replace(self, stamp=clock, **given)


def check_change(message: object) -> dict[str, Any]:
    """A change as it came over the wire, any of t, playing, speed, follow, methods, theme, trail; else
    ParameterError."""
    if not isinstance(message, dict):
        raise ParameterError("a cursor message is an object", expected="object", found=type(message).__name__)
    checks = {
        "t": _number, "speed": _speed, "playing": _flag, "follow": _flag, "methods": _methods, "theme": _theme,
        "trail": _trail,
    }  # fmt: skip
    unknown = sorted(set(message) - set(checks))
    if unknown:
        raise ParameterError(
            f"unknown key {unknown[0]!r} in a cursor message", parameter=unknown[0], expected=sorted(checks)
        )
    return {key: checks[key](key, value) for key, value in message.items()}


def _wrong(key: str, expected: str, found: object) -> ParameterError:
    return ParameterError(
        f"{key} must be {expected}, found {str(found)[:60]!r}", parameter=key, expected=expected, found=str(found)[:60]
    )


def _number(key: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise _wrong(key, "a finite number", value)
    return float(value)


def _speed(key: str, value: object) -> float:
    speed = _number(key, value)
    if not 0 < speed <= MAX_SPEED:
        raise _wrong(key, f"above 0 and at most {MAX_SPEED:g}", value)
    return speed


def _flag(key: str, value: object) -> bool:
    if not isinstance(value, bool):
        raise _wrong(key, "true or false", value)
    return value


def _theme(key: str, value: object) -> str:
    if value not in THEMES:
        raise _wrong(key, f"one of {', '.join(THEMES)}", value)
    return str(value)


def _trail(key: str, value: object) -> str:
    if value not in ("method", *TRAILS):
        raise _wrong(key, f"one of method, {', '.join(TRAILS)}", value)
    return str(value)


def _methods(key: str, value: object) -> tuple[str, ...] | None:
    if value is None:
        return None
    if not isinstance(value, list) or len(value) > MAX_METHODS or not all(isinstance(m, str) for m in value):
        raise _wrong(key, "null or a short list of method names", value)
    return tuple(dict.fromkeys(value))
