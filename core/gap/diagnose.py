"""`diagnose(runs) -> Diagnosis`: where the gap lies, which effect causes it, how far it shrinks. The story, one screen.

Given: runs of a robot and what its simulator models. Done: each link of the chain is predicted from the recorded stream
before it; its residuals, in units of the noise that they themselves show, are searched for effects by exact refit; what
no listed effect explains is held against generic shapes; size is judged before significance; the gap is scored on runs
that took no part.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping, Sequence

from core.gap.aligned import aligned
from core.gap.beside import against
from core.gap.checks import check_runs, check_tolerances, simulator_of
from core.gap.conclude import conclude
from core.gap.explain import Progress, silent
from core.gap.faced import faced
from core.gap.pace import Pace
from core.gap.reference import restarts_of
from core.gap.righted import righted
from core.gap.rolling import rolling
from core.gap.searched import searched
from core.gap.stretches import on_a_part
from core.gap.types import Config, Diagnosis
from core.gap.world import make_world
from core.robot import EffectSet
from core.run import Run
from core.simulation.foreign import Foreign


def diagnose(
    runs: Sequence[Run],
    simulator: EffectSet | Foreign | Sequence[Foreign] | None = None,
    held_out: Sequence[Run] = (),
    config: Config | None = None,
    progress: Progress = silent,
) -> Diagnosis:
    """The gap between runs of one robot and its simulator.

    simulator: effects it already models (default: as the runs' `simulator.effects` say), or the user's own simulator
    (`core.simulation.foreign`; recordings: one per run, held-out runs last). held_out: runs that take no part in the
    fit. Raises ParameterError, MissingStreamError, NotEnoughDataError; whatever `progress` raises.
    """
    began = time.perf_counter()
    config = config or Config()
    check_tolerances(config.tolerances)
    check_runs(runs, held_out)
    progress = Pace(progress)
    progress(0.0, "aligning")
    every, wrong = righted([*runs, *held_out])
    every, told = aligned(every)
    every, more = faced(every)
    runs, held_out, known = _seen(every[: len(runs)], every[len(runs) :], simulator, config.seed, progress)
    one = searched(runs, known, config.window, progress)
    progress(0.7, "scoring on what took no part")
    kept = tuple(rolling(make_world(run, restarts_of(run, config.window, one.found.model))) for run in held_out)
    part = None if kept else on_a_part(runs, one.found, one.tried, known, config, progress)
    progress(0.9, "telling")
    out = conclude(one.found, one.worlds, kept, one.reach, known, config, part, progress)
    return dataclasses.replace(out, notes=(*wrong, *told, *more, *out.notes), runtime_s=time.perf_counter() - began)


def _seen(
    runs: Sequence[Run],
    held_out: Sequence[Run],
    simulator: EffectSet | Foreign | Sequence[Foreign] | None,
    seed: int,
    progress: Progress = silent,
) -> tuple[list[Run], list[Run], EffectSet]:
    """The runs as their simulator's own figures of them are, or as seen from the user's; what it models already."""
    if simulator is None or isinstance(simulator, Mapping):
        known = simulator_of(runs, simulator)
        return [_with_known(run, known) for run in runs], [_with_known(run, known) for run in held_out], known
    every, known = against([*runs, *held_out], simulator, seed, progress)
    return every[: len(runs)], every[len(runs) :], known


def _with_known(run: Run, known: EffectSet) -> Run:
    return dataclasses.replace(run, meta=dataclasses.replace(run.meta, effects=known))
