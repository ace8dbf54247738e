"""What a page draws of one move: paths, columns with residuals, the gap; thinned, and how much of it is said."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from app.figures.series import thin_rows, window
from app.sandbox.prepared import Prepared
from core.errors import ParameterError
from core.gap.floor import wrap
from core.gap.types import Figures
from core.robot import EffectSet
from core.run import Run
from core.sensors import STREAMS
from core.simulation.foreign import Foreign

Array = npt.NDArray[Any]
BESIDE = ThreadPoolExecutor(2, "sandbox")
"""The gap is worked out beside the streams: the kernels let go of the interpreter's lock."""


SHAPES = ("real", "patched", "residual_patched", "recorded")
"""Lines of a column whose peaks stay when it is thinned."""


@dataclass(frozen=True)
class View:
    """What of a move is drawn: seconds (None: all), points per column and path, columns (None: all).

    lines: paths and columns; gap: the gap number. A page that is in a hurry asks for the one, then for the other.
    """

    t0: float | None = None
    t1: float | None = None
    points: int = 600
    path_points: int = 1500
    streams: Sequence[str] | None = None
    lines: bool = True
    gap: bool = True


def figure(
    one: Prepared,
    effects: EffectSet,
    *,
    seed: int = 0,
    noise: bool = False,
    foreign: Foreign | None = None,
    view: View = View(),
) -> dict[str, Any]:
    """One move of the sandbox: plain data with arrays. Raises as `simulate`, ParameterError for an unknown stream."""
    unknown = [name for name in view.streams or () if name not in one.channels]
    if unknown:
        raise ParameterError(
            f"streams: {unknown[0]!r} is not among {', '.join(one.channels)}",
            parameter="streams",
            expected=list(one.channels),
            found=unknown[0],
        )
    gap = BESIDE.submit(_gap, one, effects, foreign, seed) if view.gap else None
    lines = _lines(one, effects, seed, noise, foreign, view) if view.lines else {"paths": [], "streams": []}
    return {**lines, **(gap.result() if gap else {"gap": None, "no_gap": None})}


def _lines(
    one: Prepared, effects: EffectSet, seed: int, noise: bool, foreign: Foreign | None, view: View
) -> dict[str, Any]:
    nominal = one.nominal(seed, noise, foreign)
    patched = one.made(effects, seed, noise, foreign)
    first, last = one.run.span
    inside = (first if view.t0 is None else max(view.t0, first), last if view.t1 is None else min(view.t1, last))
    paths: list[tuple[str, str, Mapping[str, Any] | None]] = [
        ("nominal", "Nominal", one.path(nominal)),
        ("patched", "Patched", one.path(patched)),
    ]
    if one.real is not None:
        method, label, columns = one.real
        paths.insert(0, ("real", label if method == "truth" else f"Real, by {label}", columns))
    if one.beside is not None:
        paths.append(("recorded", "Recorded simulation", one.path(one.beside)))
    wanted = one.channels if view.streams is None else tuple(view.streams)
    return {
        "paths": [
            _path(one, method, label, columns, inside, view.path_points)
            for method, label, columns in paths
            if columns is not None
        ],
        "streams": [_column(one, name, nominal, patched, inside, view.points) for name in wanted],
    }


def _gap(one: Prepared, effects: EffectSet, foreign: Foreign | None, seed: int) -> dict[str, Any]:
    gap = one.gap(effects, seed, foreign)
    if gap is None:
        return {"gap": None, "no_gap": one.no_gap}
    by = {name: _figures(value) for name, value in gap.by_stream.items()}
    return {"gap": {**_figures(gap.total), "shrink": gap.shrink, "streams": by}, "no_gap": None}


def _figures(value: Figures) -> dict[str, float]:
    return {"before": value.before, "now": value.after, "floor": value.floor}


def _path(
    one: Prepared, method: str, label: str, columns: Mapping[str, Array], inside: tuple[float, float], points: int
) -> dict[str, Any]:
    """A line of the map, thinned."""
    rows, picked = one.thinned(method, columns, inside, points)
    shown = {name: np.asarray(columns[name][rows][picked], np.float64) for name in ("t", "x", "y", "theta")}
    return {"method": method, "label": label, "total": len(columns["t"][rows]), "shown": len(picked), **shown}


def _column(
    one: Prepared, name: str, nominal: Run, patched: Run, inside: tuple[float, float], points: int
) -> dict[str, Any]:
    """One column at the run's own stamps: what was read, what both simulators say, and what is left of each."""
    stream, column = name.split(".")
    log = getattr(one.run, stream)
    rows = window(log.t, *inside)
    t = log.t[rows]
    lines = {"nominal": one.readings(nominal, name)[rows], "patched": one.readings(patched, name)[rows]}
    if one.recorded:
        real = np.asarray(getattr(log, column), np.float64)[rows]
        turned = wrap if column == "theta" else np.asarray
        lines |= {"real": real, "residual_nominal": turned(real - lines["nominal"])}
        lines["residual_patched"] = turned(real - lines["patched"])
    beside = one.recording(name)
    if beside is not None:
        lines["recorded"] = beside[rows]
    picked = _rows(t, [lines[key] for key in SHAPES if key in lines], points)
    told = STREAMS[stream].column(column)
    return {
        "column": name,
        "unit": told.unit,
        "label": told.label,
        "total": len(t),
        "shown": len(picked),
        "t": t[picked],
        **{key: np.asarray(values[picked], np.float64) for key, values in lines.items()},
    }


def _rows(t: Array, lines: Sequence[Array], points: int) -> Array:
    """Rows that keep the shape of every line, about `points` of them."""
    if len(t) <= points:
        return np.arange(len(t))
    each = max(points // len(lines), 10)
    known = [line for line in lines if np.isfinite(line).any()]
    return np.unique(np.concatenate([thin_rows(t, line, each) for line in known])) if known else np.arange(0)
