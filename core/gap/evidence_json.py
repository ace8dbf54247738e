"""A diagnosis' evidence as gap-evidence/1: plain lists and numbers, no NaN, thinned to what a plot can show."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from core.gap.evidence import Drive, FreeRun, Leftover, RunEvidence
from core.gap.types import Diagnosis

POINTS = 2000
"""At most so many points per curve."""
DIGITS = 5
"""Significant digits of curves."""


def evidence_json(found: Diagnosis) -> dict[str, Any]:
    """What stands behind a diagnosis, for the report page."""
    evidence = found.evidence
    return {
        "schema": "gap-evidence/1",
        "noise_floor": [_plain(one) for one in evidence.noise_floor],
        "links": [_plain(one) for one in evidence.links],
        "cells": [_plain(one) for one in evidence.cells],
        "runs": [_run(one) for one in evidence.runs],
        "signatures": {name: _plain(one) for name, one in evidence.signatures.items()},
        "sets": [list(one) for one in evidence.sets],
        "considered": [_plain(one) for one in evidence.considered],
        "cannot_see": [_plain(one) for one in evidence.cannot_see],
        "unexplained": None if evidence.unexplained is None else _leftover(evidence.unexplained),
        "next": None if evidence.next is None else _drive(evidence.next),
    }


def _run(one: RunEvidence) -> dict[str, Any]:
    return {
        "run": one.run,
        "name": one.name,
        "held_out": one.held_out,
        "path": None if one.path is None else _plain(one.path),
        "timeline": _plain(one.timeline),
        "free_run": None if one.free_run is None else _free(one.free_run),
    }


def _free(one: FreeRun) -> dict[str, Any]:
    return {
        "t": _value(one.t),
        "real": _plain(one.real),
        "shares": list(one.shares),
        "paths": [_plain(path) for path in one.paths],
    }


def _leftover(one: Leftover) -> dict[str, Any]:
    place = None if one.place is None else dict(zip(("x", "y", "radius"), one.place, strict=True))
    return {
        "stream": one.stream,
        "shapes": [_plain(shape) for shape in one.shapes],
        "period": None if one.period is None else _plain(one.period),
        "onset": None if one.onset is None else _plain(one.onset),
        "place": place,
        "nearest": [_plain(near) for near in one.nearest],
    }


def _drive(one: Drive) -> dict[str, Any]:
    return {
        "profile": one.profile,
        "minutes": _value(one.minutes),
        "commands": {"t": _value(one.t), "v": _value(one.v), "w": _value(one.w)},
        "path": {"x": _value(one.x), "y": _value(one.y)},
        "rivals": [_plain(rival) for rival in one.rivals],
        "reason": one.reason,
    }


def _plain(one: Any) -> dict[str, Any]:
    """A flat dataclass as a dictionary."""
    return {field.name: _value(getattr(one, field.name)) for field in dataclasses.fields(one)}


def _value(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return [_number(x) for x in _thin(value)]
    if isinstance(value, Mapping):
        return {name: _value(one) for name, one in value.items()}
    if isinstance(value, tuple):
        return [_value(one) for one in value]
    return _number(value) if isinstance(value, float) else value


def _thin(values: np.ndarray) -> list[float]:
    step = -(-len(values) // POINTS)
    out: list[float] = (values[::step] if step > 1 else values).tolist()
    return out


def _number(value: float) -> float | None:
    return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
