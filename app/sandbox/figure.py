"""What a page draws of one move: paths, columns with residuals, the gap; thinned, and how much of it is said."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import numpy.typing as npt

from app.figures.path import Source, plain, thinned
from app.figures.series import thin_rows, window
from app.sandbox.prepared import FOREIGN, Prepared
from core.errors import ParameterError
from core.gap.floor import wrap
from core.gap.types import Figures, Gap
from core.robot import EffectSet
from core.run import Run
from core.sensors import STREAMS
from core.simulation.foreign import Foreign

Array = npt.NDArray[Any]
BESIDE = ThreadPoolExecutor(2, "sandbox")
"""The gap is worked out beside the streams: the kernels let go of the interpreter's lock."""
PLACES = 7  # rad/s: a tenth of a degree per hour


def figure(
    one: Prepared,
    effects: EffectSet,
    *,
    seed: int = 0,
    noise: bool = False,
    foreign: Foreign | None = None,
    t0: float | None = None,
    t1: float | None = None,
    points: int = 600,
    path_points: int = 1500,
    streams: Sequence[str] | None = None,
) -> dict[str, Any]:
    """One move of the sandbox as plain data. Raises as `simulate`, and ParameterError for an unknown stream."""
    unknown = [name for name in streams or () if name not in one.channels]
    if unknown:
        raise ParameterError(
            f"streams: {unknown[0]!r} is not among {', '.join(one.channels)}",
            parameter="streams",
            expected=list(one.channels),
            found=unknown[0],
        )
    gap = BESIDE.submit(_gap, one, effects, foreign)
    nominal = one.nominal(seed, noise, foreign)
    patched = one.made(effects, seed, noise, foreign)
    paths = [Source("nominal", "Nominal", True, _path(nominal)), Source("patched", "Patched", True, _path(patched))]
    if one.real is not None:
        method, label, columns = one.real
        paths.insert(0, Source("real", label if method == "truth" else f"Real, by {label}", True, columns))
    first, last = one.run.span
    inside = (first if t0 is None else max(t0, first), last if t1 is None else min(t1, last))
    wanted = one.channels if streams is None else tuple(streams)
    return {
        "paths": [thinned(source, *inside, path_points) for source in paths],
        "streams": [_column(one, name, nominal, patched, inside, points) for name in wanted],
        **gap.result(),
    }


def _gap(one: Prepared, effects: EffectSet, foreign: Foreign | None) -> dict[str, Any]:
    if foreign is not None or one.yardstick is None:
        return {"gap": None, "no_gap": FOREIGN if foreign is not None else one.no_gap}
    gap: Gap = one.yardstick.gap(effects)
    by = {name: _figures(value) for name, value in gap.by_stream.items()}
    return {"gap": {**_figures(gap.total), "shrink": gap.shrink, "streams": by}, "no_gap": None}


def _figures(value: Figures) -> dict[str, float]:
    return {"before": value.before, "now": value.after, "floor": value.floor}


def _path(made: Run) -> Mapping[str, Array]:
    truth = made.truth
    assert truth is not None and truth.x is not None and truth.y is not None and truth.theta is not None
    return {"t": truth.t, "x": truth.x, "y": truth.y, "theta": truth.theta}


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
    picked = _rows(t, [lines[key] for key in ("real", "patched", "residual_patched") if key in lines], points)
    told = STREAMS[stream].column(column)
    return {
        "column": name,
        "unit": told.unit,
        "label": told.label,
        "total": len(t),
        "shown": len(picked),
        "t": plain(t[picked], 6),
        **{key: plain(values[picked], PLACES) for key, values in lines.items()},
    }


def _rows(t: Array, lines: Sequence[Array], points: int) -> Array:
    """Rows that keep the shape of every line, about `points` of them."""
    if len(t) <= points:
        return np.arange(len(t))
    each = max(points // len(lines), 10)
    known = [line for line in lines if np.isfinite(line).any()]
    return np.unique(np.concatenate([thin_rows(t, line, each) for line in known])) if known else np.arange(0)
