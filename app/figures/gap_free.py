"""The whole drive in one go: real, simulated, and with the effects added. From a run of gap-evidence/1."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from app.figures.plot import Curve, Plot, plot
from app.figures.units import length

Path = Mapping[str, Sequence[float | None]]


def overlay_plot(run: Mapping[str, Any]) -> Plot | None:
    """Real path, simulated and patched ones driven from the start in one go."""
    free = run.get("free_run")
    if not free or not free["paths"]:
        return None
    named = (("real", "g-real", free["real"]), ("simulated", "g-nominal", free["paths"][0]))
    curves = [
        Curve(name, style, p["x"], p["y"]) for name, style, p in (*named, ("patched", "g-patched", free["paths"][-1]))
    ]
    return plot(curves, x_label="x, m", y_label="y, m", width=440, height=340, equal=True)


def told(run: Mapping[str, Any]) -> str:
    """How far the paths are from the real one, whole drives long; empty where there is nothing to compare."""
    free = run.get("free_run")
    if not free or len(free["paths"]) < 2:
        return ""
    names = ("simulated", "patched")
    parts = [_apart(free["real"], path) for path in (free["paths"][0], free["paths"][-1])]
    if None in parts:
        return ""
    ends, means = zip(*(part for part in parts if part), strict=True)
    listed = [" and ".join(f"{name} {length(v)}" for name, v in zip(names, vs, strict=True)) for vs in (ends, means)]
    return f"Distance from the real path at the end: {listed[0]}; on the whole (rms): {listed[1]}."


def _apart(real: Path, other: Path) -> tuple[float, float] | None:
    """At the last common point and root mean square [m]."""
    pairs = zip(real["x"], real["y"], other["x"], other["y"], strict=True)
    known = [math.hypot(c - a, d - b) for a, b, c, d in pairs
             if a is not None and b is not None and c is not None and d is not None]  # fmt: skip
    return (known[-1], math.sqrt(sum(v * v for v in known) / len(known))) if known else None
