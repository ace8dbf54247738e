"""Series and tables of a run's IMU analysis: labels, SI units, thinned to what a plot can show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from app.figures.imu_units import unit_of
from app.figures.series import Series, check_points, numbers, series, window
from app.store import arrays
from core.errors import ParameterError

ALLAN = ("tau", "deviation", "lo", "hi", "pairs", "edf", "alpha", "model")
SEGMENTS = (
    "t0", "t1", "count", "minimum", "quartile_1", "median", "quartile_3", "maximum", "mean", "sd", "skewness",
    "kurtosis",
)  # fmt: skip
SEGMENT_SERIES = ("mean", "sd", "minimum", "quartile_1", "median", "quartile_3", "maximum", "skewness", "kurtosis")


@dataclass(frozen=True)
class Column:
    """A curve of a bias method: its SI unit, what it is, the array of its stamps, and which verdict it is of."""

    unit: str
    label: str
    stamps: str = "t"
    array: str = ""
    verdict: int | None = None


BIAS: dict[str, Column] = {
    "bias": Column("rad/s", "gyro bias"),
    "sd": Column("rad/s", "claimed deviation of the bias"),
    "theta": Column("rad", "heading, unwrapped, 0 at the start"),
    "theta_sd": Column("rad", "claimed deviation of the heading"),
    "error": Column("rad", "heading error, reference minus estimate", "error_t"),
    "reference": Column("rad", "reference heading on the method's zero", "error_t"),
    "accepted": Column("rad/s", "mean of an accepted segment", "segment_t", "segment_mean", 1),
    "rejected_by_range": Column("rad/s", "mean of a segment rejected by its range", "segment_t", "segment_mean", 2),
    "rejected_by_average": Column(
        "rad/s", "mean of a segment rejected by the average before it", "segment_t", "segment_mean", 3
    ),
}


def bias_series(
    data: Path,
    stored: Mapping[str, str],
    columns: Sequence[str] | None,
    *,
    t0: float | None = None,
    t1: float | None = None,
    points: int = 2000,
) -> list[Series]:
    """Curves and segments of one bias method between t0 and t1, each thinned by itself.

    One that the method or the run does not give (an error without truth) is left out; ParameterError if unknown.
    """
    check_points(points)
    made = []
    for name in _known(columns, BIAS):
        what = BIAS[name]
        array = what.array or name
        if array not in stored:
            continue
        t = arrays.open(data, stored[what.stamps])
        rows = window(t, t0, t1)
        x, y = np.asarray(t[rows]), np.asarray(arrays.open(data, stored[array])[rows])
        if what.verdict is not None:
            kept = np.asarray(arrays.open(data, stored["segment_verdict"])[rows]) == what.verdict
            x, y = x[kept], y[kept]
            made.append(_scatter(name, what, x, y, points))
        else:
            made.append(series(name, what.unit, what.label, x, y, points))
    return made


def _scatter(name: str, what: Column, t: npt.NDArray[Any], y: npt.NDArray[Any], points: int) -> Series:
    """Single readings, thinned evenly: keeping their extremes would make a cloud look hollow."""
    kept = np.unique(np.linspace(0, len(t) - 1, min(points, len(t))).astype(np.int64)) if len(t) else slice(0)
    return Series(name, what.unit, what.label, np.asarray(t[kept], np.float64), y[kept], len(t))


def segment_series(
    data: Path,
    stored: Mapping[str, str],
    axis: str,
    columns: Sequence[str] | None,
    *,
    t0: float | None = None,
    t1: float | None = None,
    points: int = 2000,
) -> list[Series]:
    """Statistics of the segments of an axis over time, stamped at each segment's middle."""
    check_points(points)
    table = arrays.open(data, stored["segments"])
    middle = (table[:, 0] + table[:, 1]) / 2
    rows = window(middle, t0, t1)
    made = []
    for name in _known(columns, SEGMENT_SERIES):
        unit = "" if name in ("skewness", "kurtosis") else unit_of(axis)
        values = np.ascontiguousarray(table[rows, SEGMENTS.index(name)])
        made.append(series(name, unit, f"{name.replace('_', ' ')} of each segment", middle[rows], values, points))
    return made


def _known(columns: Sequence[str] | None, known: Mapping[str, Any] | Sequence[str]) -> list[str]:
    wanted = list(dict.fromkeys(columns)) if columns else list(known)
    for name in wanted:
        if name not in known:
            raise ParameterError(
                f"unknown column {name!r}; there are {', '.join(known)}",
                parameter="columns",
                expected=list(known),
                found=name,
            )
    return wanted


def allan_curve(data: Path, key: str) -> dict[str, list[float | None]]:
    """A stored curve by column: tau [s], deviation, lo, hi, model in the axis' unit, pairs, edf, alpha."""
    table = np.asarray(arrays.open(data, key))
    return {name: numbers(np.ascontiguousarray(table[:, i])) for i, name in enumerate(ALLAN)}


def temperature_points(data: Path, key: str, points: int) -> tuple[dict[str, list[float | None]], int]:
    """Segments at rest by temperature: {t, temperature, bias}, evenly thinned to `points`; how many there are."""
    table = np.asarray(arrays.open(data, key))
    kept = np.unique(np.linspace(0, len(table) - 1, min(points, len(table))).astype(int))
    shown = table[kept][np.argsort(table[kept, 1], kind="stable")]
    columns = {name: numbers(np.ascontiguousarray(shown[:, i])) for i, name in enumerate(("t", "temperature", "bias"))}
    return columns, len(table)


def readings(
    data: Path, stream: Mapping[str, Any], axis: str, t0: float | None, t1: float | None, most: int
) -> npt.NDArray[Any]:
    """The readings of an axis for t0 <= t <= t1; ParameterError for over `most`, with the seconds that would do."""
    t = arrays.open(data, stream["columns"]["t"])
    window(t, t0, t1)  # refuses what is no window
    first = 0 if t0 is None else int(np.searchsorted(t, t0, "left"))
    last = len(t) if t1 is None else int(np.searchsorted(t, t1, "right"))
    if last - first > most:
        raise ParameterError(
            f"this stretch holds {last - first:,} readings; statistics are made of at most {most:,}: "
            f"choose one of {most / stream['rate_hz']:,.0f} s or less",
            parameter="t1",
            expected=f"<= {most} readings",
            found=last - first,
        )
    return np.asarray(arrays.open(data, stream["columns"][axis])[first:last], np.float64)
