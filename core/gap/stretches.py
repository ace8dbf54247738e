"""Held-out stretches, where no run is held out: parts of the runs that take no part in choice or fit, to score it.

Every run gives up a stretch of HELD in the middle of each PERIOD, with a gap on both sides that is used for neither.
The effects are chosen and fitted anew without them, among those that were in question on the whole.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from core.gap.candidates import Candidate
from core.gap.explain import Progress, Search, explain, silent
from core.gap.floor import Floor
from core.gap.linear import Problem, with_floor
from core.gap.pace import watched
from core.gap.reference import restarts_of
from core.gap.rolling import rolling
from core.gap.thinned import thinned
from core.gap.types import Config
from core.gap.world import World, make_world
from core.robot import EffectSet
from core.run import Run

Span = tuple[float, float]

HELD, GAP, PERIOD = 20.0, 3.0, 80.0
"""Length of a held-out stretch, of the gap beside it, and how often one comes [s]."""
SHORTEST = 70.0
"""A run shorter than this gives up nothing [s]."""


@dataclass(frozen=True)
class Part:
    """What was found without the stretches; the runs, replayed from its model, and the stretches of each."""

    found: Search
    worlds: tuple[World, ...]
    spans: tuple[tuple[Span, ...], ...]


def spans_of(run: Run) -> tuple[Span, ...]:
    """The stretches that a run gives up."""
    first, last = run.span
    if last - first < SHORTEST:
        return ()
    count = max(int((last - first) // PERIOD), 1)
    middles = first + (np.arange(count) + 0.5) * (last - first) / count
    return tuple((float(m) - 0.5 * HELD, float(m) + 0.5 * HELD) for m in middles)


def without(run: Run, spans: Sequence[Span]) -> Run:
    """The run without its readings in the stretches and in the gaps beside them; what drives it stays."""
    kept: dict[str, Any] = {}
    for name in ("wheels", "imu", "beacon", "ranges", "truth"):
        log = getattr(run, name)
        if log is None or (name == "wheels" and run.commands is None):
            continue
        inside = np.zeros(len(log), dtype=bool)
        for a, b in spans:
            inside |= (log.t > a - GAP) & (log.t < b + GAP)
        kept[name] = _rows(log, ~inside)
    return dataclasses.replace(run, **kept)


def _rows(log: Any, keep: npt.NDArray[np.bool_]) -> Any:
    columns = {
        field.name: value[keep]
        for field in dataclasses.fields(log)
        if isinstance(value := getattr(log, field.name), np.ndarray)
    }
    return dataclasses.replace(log, **columns)


def on_a_part(
    runs: Sequence[Run],
    found: Search,
    tried: Sequence[Candidate],
    known: EffectSet,
    config: Config,
    progress: Progress = silent,
) -> Part | None:
    """The search again without the stretches. None where the runs are too short to give any up."""
    spans = tuple(spans_of(run) for run in runs)
    if not any(spans):
        return None
    fewer = [without(run, cut) for run, cut in zip(thinned(runs), spans, strict=True)]
    made = (rolling(make_world(run, restarts_of(run, config.window, found.model))) for run in fewer)
    worlds = tuple(watched(world, progress) for world in made)
    problem = with_floor(Problem(worlds, Floor({}, {}, {}), known), {})
    asked = in_question(found)
    again = explain(problem, [one for one in tried if one.effect in asked], start=found.model)
    whole = tuple(rolling(make_world(run, restarts_of(run, config.window, again.model))) for run in runs)
    return Part(again, whole, spans)


def in_question(found: Search) -> set[str]:
    """Effects that the search on the whole ever fitted, with those that the biases and trifles need."""
    out = {"gyro_bias", "accel_bias", "motor_lag", "drive_gain"}
    for link in found.links:
        out |= set(link.fit.model)
        for step in link.steps:
            out |= {name for name, _ in step.gains}
    return out
