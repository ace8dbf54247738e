"""The signals of a stored run: which columns a stream has, in words and units, and their readings to plot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from app.figures.series import Series, check_points, series, window
from app.store import arrays
from core.errors import MissingStreamError, ParameterError
from core.sensors import STREAMS


def signals(
    data: Path,
    stream: Mapping[str, Any],
    columns: Sequence[str] | None,
    *,
    t0: float | None = None,
    t1: float | None = None,
    points: int = 2000,
) -> list[Series]:
    """Columns of one stream of a manifest between t0 and t1 (None: to the end), each thinned to `points`.

    A column of `ranges` is a beacon's name: the distances to that beacon. Default: all columns.
    """
    check_points(points)
    known = column_names(stream)
    wanted = list(dict.fromkeys(columns)) if columns else known
    for name in wanted:
        if name not in known:
            raise ParameterError(
                f"stream {stream['name']!r} of this run has no column {name!r}; it has {', '.join(known)}",
                parameter="columns",
                stream=stream["name"],
                expected=known,
                found=name,
            )
    t = arrays.open(data, stream["columns"]["t"])
    rows = window(t, t0, t1)
    return [_one(data, stream, name, t[rows], rows, points) for name in wanted]


def column_names(stream: Mapping[str, Any]) -> list[str]:
    """The columns that can be plotted: beacon names for `ranges`, else all but `t`."""
    if stream["name"] == "ranges":
        return list(stream["names"])
    return [name for name in stream["columns"] if name != "t"]


def stream_of(manifest: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """The stream of that name; ParameterError if there is no such stream at all, MissingStreamError if not here."""
    if name not in STREAMS:
        raise ParameterError(
            f"unknown stream {name!r}; streams are {', '.join(STREAMS)}",
            parameter="stream",
            expected=[*STREAMS],
            found=name,
        )
    for stream in manifest["streams"]:
        if stream["name"] == name:
            found: Mapping[str, Any] = stream
            return found
    has = [s["name"] for s in manifest["streams"]]
    raise MissingStreamError(f"this run has no stream {name!r}; it has {', '.join(has)}", missing=name, found=has)


def _one(data: Path, stream: Mapping[str, Any], name: str, t: npt.NDArray[Any], rows: slice, points: int) -> Series:
    spec = STREAMS[stream["name"]]
    if stream["name"] != "ranges":
        column = spec.column(name)
        return series(name, column.unit, column.label, t, arrays.open(data, stream["columns"][name])[rows], points)
    column = spec.column("range")
    codes = arrays.open(data, stream["columns"]["beacon"])[rows]
    index = np.flatnonzero(codes == stream["names"].index(name))
    values = arrays.open(data, stream["columns"]["range"])[rows]
    return series(name, column.unit, f"{column.label} {name}", t[index], values[index], points)
