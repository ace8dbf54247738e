"""What an estimate says over time besides the path: errors against truth, deviations, gyro bias. Labels and units."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from app.figures.series import Series, series, window
from app.store import arrays
from core.errors import ParameterError


@dataclass(frozen=True)
class Quantity:
    """A column of an estimate: its SI unit, what it is, and the column that holds its stamps."""

    unit: str
    label: str
    stamps: str = "t"


COLUMNS: dict[str, Quantity] = {
    "x": Quantity("m", "position x in the map"),
    "y": Quantity("m", "position y in the map"),
    "theta": Quantity("rad", "heading, unwrapped"),
    "sd_x": Quantity("m", "claimed deviation of x"),
    "sd_y": Quantity("m", "claimed deviation of y"),
    "sd_theta": Quantity("rad", "claimed deviation of the heading"),
    "cov_xy": Quantity("m²", "claimed covariance of x and y"),
    "bias": Quantity("rad/s", "gyro bias", "bias_t"),
    "bias_sd": Quantity("rad/s", "claimed deviation of the gyro bias", "bias_t"),
    "error_xy": Quantity("m", "distance to truth", "error_t"),
    "error_along": Quantity("m", "error along truth's heading", "error_t"),
    "error_across": Quantity("m", "error across truth's heading", "error_t"),
    "error_theta": Quantity("rad", "heading error", "error_t"),
    "nees": Quantity("", "normalised estimation error squared", "nees_t"),
}
_NIS = re.compile(r"nis_(?P<sensor>[\w.]+?)")


def quantity(name: str) -> Quantity | None:
    """The quantity of that name; None if estimates have no such column."""
    if name in COLUMNS:
        return COLUMNS[name]
    sensor = _NIS.fullmatch(name)
    if sensor is None or name.endswith(("_t", "_accepted")):
        return None
    return Quantity("", f"normalised innovation squared of {sensor['sensor']}", f"{name}_t")


def estimate_series(
    data: Path,
    stored: Mapping[str, str],
    columns: str | None,
    *,
    t0: float | None = None,
    t1: float | None = None,
    points: int = 2000,
) -> list[Series]:
    """Columns of an estimate (`stored`: its arrays' keys) between t0 and t1, each thinned to `points`."""
    made = []
    for name, what in chosen(stored, columns).items():
        t = arrays.open(data, stored[what.stamps])
        rows = window(t, t0, t1)
        made.append(series(name, what.unit, what.label, t[rows], arrays.open(data, stored[name])[rows], points))
    return made


def chosen(available: Mapping[str, str], names: str | None) -> dict[str, Quantity]:
    """The asked for columns (comma separated; None: all) of those that an estimate has; ParameterError if unknown."""
    having = {name: q for name in available if (q := quantity(name)) is not None}
    if names is None:
        return having
    wanted = [name.strip() for name in names.split(",") if name.strip()]
    unknown = [name for name in wanted if quantity(name) is None]
    if unknown or not wanted:
        asked = f"unknown column {unknown[0]!r}" if unknown else "no column was asked for"
        raise ParameterError(
            f"{asked}; this estimate has {', '.join(having)}",
            parameter="columns",
            expected=list(having),
            found=unknown[:10],
        )
    return {name: having[name] for name in wanted if name in having}
