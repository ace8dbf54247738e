"""Readings over time, thinned to what a plot can show: minima and maxima stay, and how much is shown is said."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from tsdownsample import MinMaxDownsampler, MinMaxLTTBDownsampler

from core.errors import ParameterError

MIN_POINTS, MAX_POINTS = 10, 20_000
_THIN: Any = MinMaxLTTBDownsampler()  # type: ignore[no-untyped-call]  # tsdownsample has no types
_EXTREMES: Any = MinMaxDownsampler()  # type: ignore[no-untyped-call]  # tsdownsample has no types
Array = npt.NDArray[Any]


@dataclass(frozen=True)
class Series:
    """One column in a window of time: t, y (shown,), of `total` readings there. Unit and label are the column's."""

    column: str
    unit: str
    label: str
    t: npt.NDArray[np.float64]
    y: Array
    total: int

    @property
    def shown(self) -> int:
        """How many readings are left."""
        return int(self.t.shape[0])


def window(t: Array, t0: float | None, t1: float | None) -> slice:
    """The rows to draw for t0 <= t <= t1: those inside, and one beyond each end so that lines reach the edges.

    Two binary searches: of a mapped column only a few pages are read. ParameterError where the window is none.
    """
    for name, value in (("t0", t0), ("t1", t1)):
        if value is not None and not math.isfinite(value):
            raise ParameterError(f"{name} is {value}, expected a time in seconds", parameter=name, found=value)
    if t0 is not None and t1 is not None and t1 < t0:
        raise ParameterError(f"t1 = {t1} lies before t0 = {t0}", parameter="t1", expected=f">= {t0}", found=t1)
    first = 0 if t0 is None else int(np.searchsorted(t, t0, "left"))
    last = len(t) if t1 is None else int(np.searchsorted(t, t1, "right"))
    return slice(max(first - 1, 0), min(last + 1, len(t)))


def thin(t: Array, y: Array, points: int) -> tuple[npt.NDArray[np.float64], Array]:
    """At most `points` readings that look like all of them (min-max, then largest triangles). NaN is never chosen."""
    if len(t) <= points:
        return np.asarray(t, np.float64), np.asarray(y)
    index = thin_rows(t, y, points)
    return np.asarray(t[index], np.float64), np.asarray(y[index])


def thin_rows(t: Array, y: Array, points: int) -> npt.NDArray[Any]:
    """Which readings `thin` keeps."""
    # time as x: bins of equal duration, so that a burst of readings doesn't starve the rest
    rows: npt.NDArray[Any] = _THIN.downsample(t, y, n_out=points - 2)
    # triangles may pass over the largest reading beside a smallest one; the window's own extremes always stay
    return np.union1d(rows, _EXTREMES.downsample(y, n_out=2))


def series(column: str, unit: str, label: str, t: Array, y: Array, points: int) -> Series:
    """One column of a window, thinned."""
    check_points(points)
    thin_t, thin_y = thin(t, y, points)
    return Series(column, unit, label, thin_t, thin_y, len(t))


def check_points(points: int) -> None:
    """ParameterError unless so many points can be asked for."""
    if not MIN_POINTS <= points <= MAX_POINTS:
        raise ParameterError(
            f"points is {points}, expected {MIN_POINTS} to {MAX_POINTS}",
            parameter="points",
            expected=[MIN_POINTS, MAX_POINTS],
            found=points,
        )


def plain(one: Series) -> dict[str, Any]:
    """A series as JSON has it: null where there is no value."""
    return {
        "column": one.column,
        "unit": one.unit,
        "label": one.label,
        "t": one.t.tolist(),
        "y": numbers(one.y),
        "total": one.total,
        "shown": one.shown,
    }


def numbers(values: Array) -> list[float | None]:
    """Values as JSON numbers; null for NaN and infinities."""
    listed: list[float | None] = values.tolist()
    bad = np.flatnonzero(~np.isfinite(values)) if values.dtype.kind == "f" else ()
    for i in bad:
        listed[i] = None
    return listed


def table(many: Iterable[Series]) -> bytes:
    """Series as an Arrow IPC stream with the columns `column`, `t`, `y`, one after the other."""
    import polars as pl

    frames = [
        pl.DataFrame({"t": s.t, "y": np.asarray(s.y, np.float64)}).select(
            pl.lit(s.column, dtype=pl.String).alias("column"), "t", pl.col("y").fill_nan(None)
        )
        for s in many
    ]
    schema = {"column": pl.String, "t": pl.Float64, "y": pl.Float64}
    whole = pl.concat(frames) if frames else pl.DataFrame(schema=schema)
    sink = whole.write_ipc_stream(None)
    return bytes(sink.getvalue())
