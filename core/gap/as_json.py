"""A diagnosis as gap/1: plain lists and numbers, no NaN."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from core.gap.types import Cause, Diagnosis, Figures, Value, Where

LISTED = 0.01
"""Causes below this probability are left out."""


def as_json(found: Diagnosis) -> dict[str, Any]:
    """The published form; keys beyond the contract follow after its own."""
    return {
        "schema": "gap/1",
        "verdict": found.verdict,
        "where": [_where(one) for one in found.where],
        "causes": [_cause(one) for one in found.causes if one.probability > LISTED],
        "gap": {
            **_figures(found.gap.total),
            "shrink": _finite(found.gap.shrink),
            "shrink_ci": None if found.gap.shrink_ci is None else [_finite(x) for x in found.gap.shrink_ci],
            "held_out": found.gap.held_out,
            "by_stream": {name: _figures(one) for name, one in found.gap.by_stream.items()},
            "without": {name: _finite(value) for name, value in found.gap.without.items()},
        },
        "immaterial": [{"effect": one.effect, "parameters": _values(one.parameters)} for one in found.immaterial],
        "unexplained": None
        if found.unexplained is None
        else {
            "stream": found.unexplained.stream,
            "depends_on": list(found.unexplained.depends_on),
            "description": found.unexplained.description,
        },
        "next_experiment": None
        if found.next_experiment is None
        else {
            "profile": found.next_experiment.profile,
            "separates": [list(pair) for pair in found.next_experiment.separates],
            "reason": found.next_experiment.reason,
            "chance": _finite(found.next_experiment.chance),
        },
        "runtime_s": found.runtime_s,
        "probabilities": {name: _finite(p) for name, p in found.probabilities.items() if p > LISTED},
        "link": found.link,
        "rejected": [{"effect": one.effect, "reason": one.reason} for one in found.rejected],
        "unseen": [
            {"effect": one.effect, "parameter": one.parameter, "visible_from": _finite(one.visible_from)}
            for one in found.unseen
        ],
        "noise": {name: _finite(value) for name, value in found.noise.items()},
        "notes": list(found.notes),
    }


def _where(one: Where) -> dict[str, Any]:
    out: dict[str, Any] = {
        "stream": one.stream,
        "regime": one.regime,
        "share": _finite(one.share),
        "p_value": _finite(one.p_value),
    }
    if one.intervals:
        out["intervals"] = [[round(a, 2), round(b, 2)] for a, b in one.intervals]
    if one.place is not None:
        out["place"] = {"x": one.place.x, "y": one.place.y, "radius": one.place.radius}
    if len(one.by_run) > 1 and any(one.by_run):
        out["intervals_by_run"] = [[[round(a, 2), round(b, 2)] for a, b in spans] for spans in one.by_run]
    return out


def _cause(one: Cause) -> dict[str, Any]:
    return {
        "effect": one.effect,
        "probability": _finite(one.probability),
        "share": _finite(one.share),
        "parameters": _values(one.parameters),
        "confusable_with": list(one.confusable_with),
    }


def _values(parameters: Mapping[str, Value]) -> dict[str, Any]:
    return {
        name: {"value": v.value if isinstance(v.value, str) else _finite(v.value), "std": _finite(v.std)}
        for name, v in parameters.items()
    }


def _figures(one: Figures) -> dict[str, Any]:
    return {"before": _finite(one.before), "after": _finite(one.after), "floor": _finite(one.floor)}


def _finite(value: float | None) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None
