"""Paths for a map: every method, the truth and the raw fixes, at most N points each, in metres and radians."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from app.figures.series import thin_rows, window
from app.store import arrays
from core.run import Run

Column = npt.NDArray[Any]
Columns = Mapping[str, Column]

MIN_POINTS, MAX_POINTS = 10, 50_000
PLACES = {"t": 6, "x": 5, "y": 5, "theta": 6, "sd_x": 6, "sd_y": 6, "sd_theta": 7, "cov_xy": 10}


@dataclass(frozen=True)
class Source:
    """One line of the map before it is thinned: its columns as they are stored."""

    method: str
    label: str
    causal: bool
    columns: Columns
    estimate: str | None = None


def of_estimate(data: Path, estimate: Any) -> Source:
    """The path of a stored estimate (a row of the table)."""
    from core.estimation.pipeline import METHODS

    names = [name for name in PLACES if name in estimate.arrays]
    columns = {name: arrays.open(data, estimate.arrays[name]) for name in names}
    method = METHODS.get(estimate.method)
    label, causal = (method.label, method.causal) if method else (estimate.method, True)
    return Source(estimate.method, label, causal, columns, estimate.id)


def of_run(run: Run) -> list[Source]:
    """What the run itself says of the path: truth and beacon fixes, where it has positions."""
    found = []
    if run.truth is not None and run.truth.x is not None and run.truth.y is not None:
        found.append(Source("truth", "Truth", True, run.truth.columns()))
    if run.beacon is not None:
        found.append(Source("fixes", "Beacon fixes", True, run.beacon.columns()))
    return found


def figure(run: Run, sources: Sequence[Source], *, t0: float | None, t1: float | None, points: int) -> dict[str, Any]:
    """The map's data between two stamps."""
    start = run.meta.start
    return {
        "frame": "map",
        "start": {"x": start.x, "y": start.y, "theta": start.theta} if start else None,
        "beacons": [{"name": name, "x": p[0], "y": p[1], "z": p[2]} for name, p in run.meta.beacons.items()],
        "paths": [thinned(source, t0, t1, points) for source in sources],
    }


def thinned(source: Source, t0: float | None, t1: float | None, points: int) -> dict[str, Any]:
    """One line, at most `points` of its readings: those that keep its shape."""
    t = source.columns["t"]
    rows = window(t, t0, t1)
    shown = {name: column[rows] for name, column in source.columns.items() if name in PLACES}
    picked = shape_points(shown["t"], shown["x"], shown["y"], points)
    return {
        "method": source.method,
        "label": source.label,
        "causal": source.causal,
        "estimate": source.estimate,
        "total": len(shown["t"]),
        "shown": len(picked),
        **{name: plain(shown[name][picked], PLACES[name]) for name in PLACES if name in shown},
    }


def shape_points(t: Column, x: Column, y: Column, points: int) -> npt.NDArray[np.intp]:
    """Rows that draw the same line: those that keep the shape of x over time, and of y, ends included."""
    if len(t) <= points:
        return np.arange(len(t))
    each = max(points // 2, 3)
    return np.unique(np.concatenate([thin_rows(t, column, each) for column in (x, y)])).astype(np.intp)


def plain(values: Column, places: int) -> list[float | None]:
    """Rounded numbers for JSON, None where there is none."""
    rounded = np.round(np.asarray(values, np.float64), places) + 0.0  # no negative zero
    listed: list[float | None] = rounded.tolist()
    if np.isfinite(rounded).all():
        return listed
    return [v if ok else None for v, ok in zip(listed, np.isfinite(rounded), strict=True)]
