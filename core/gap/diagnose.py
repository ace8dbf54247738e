"""`diagnose(runs) -> Diagnosis`: where the gap lies, which effect causes it, how far it shrinks. The story, one screen.

Given: runs of a robot and what its simulator models. Done: each link of the chain is predicted from the recorded stream
before it; its residuals, in units of the noise that they themselves show, are searched for effects by exact refit; what
no listed effect explains is held against generic shapes; size is judged before significance; the gap is scored on runs
that took no part.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence

import numpy as np

from core.effects import EFFECTS
from core.gap.candidates import Reach, candidates
from core.gap.checks import check_runs, simulator_of
from core.gap.conclude import conclude
from core.gap.explain import Progress, explain, silent
from core.gap.floor import Floor
from core.gap.linear import Problem, with_floor
from core.gap.reference import restarts_of
from core.gap.stretches import on_a_part
from core.gap.types import Config, Diagnosis
from core.gap.world import World, make_world
from core.robot import EffectSet
from core.run import Run


def diagnose(
    runs: Sequence[Run],
    simulator: EffectSet | None = None,
    held_out: Sequence[Run] = (),
    config: Config | None = None,
    progress: Progress = silent,
) -> Diagnosis:
    """The gap between runs of one robot and its simulator.

    simulator: effects it already models (default: as the runs' `simulator.effects` say). held_out: runs that take no
    part in the fit. Raises ParameterError, MissingStreamError, NotEnoughDataError; whatever `progress` raises.
    """
    began = time.perf_counter()
    config = config or Config()
    check_runs(runs, held_out)
    known = simulator_of(runs, simulator)
    runs = [_with_known(run, known) for run in runs]
    held_out = [_with_known(run, known) for run in held_out]
    progress(0.0, "aligning")
    worlds = tuple(make_world(run, restarts_of(run, config.window)) for run in runs)
    problem = with_floor(Problem(worlds, Floor({}, {}, {}), known), {})
    reach = reach_of(worlds)
    tried = candidates(worlds[0].channels, list(runs[0].meta.beacons), reach, known, _warm(runs))
    progress(0.1, "searching")
    found = explain(problem, tried, progress)
    if any(run.truth is None for run in runs) and any(EFFECTS[name].family in PATH for name in found.model):
        progress(0.6, "again from the path set right")
        worlds = tuple(make_world(run, restarts_of(run, config.window, found.model)) for run in runs)
        found = explain(with_floor(Problem(worlds, Floor({}, {}, {}), known), {}), tried)
    progress(0.7, "scoring")
    kept = tuple(make_world(run, restarts_of(run, config.window, found.model)) for run in held_out)
    part = None if kept else on_a_part(runs, found, tried, known, config)
    out = conclude(found, worlds, kept, reach, known, config, part)
    return dataclasses.replace(out, runtime_s=time.perf_counter() - began)


PATH = ("kinematics", "ground", "beacons")
"""Families whose effects bend a path that was smoothed without them."""


def _with_known(run: Run, known: EffectSet) -> Run:
    return dataclasses.replace(run, meta=dataclasses.replace(run.meta, effects=known))


def _warm(runs: Sequence[Run]) -> bool:
    """Whether a temperature was recorded that changes."""
    logs = [run.imu.temperature for run in runs if run.imu is not None and run.imu.temperature is not None]
    return (
        bool(logs)
        and len(logs) == len([r for r in runs if r.imu is not None])
        and any(float(np.nanmax(log) - np.nanmin(log)) > 0.0 for log in logs if len(log))
    )


def reach_of(worlds: Sequence[World]) -> Reach:
    """What the runs reach, from what drives them."""
    speed = acceleration = turn = 0.0
    for world in worlds:
        for side in (world.body_inputs.left, world.body_inputs.right):
            speed = max(speed, float(np.abs(side[:, 0]).max(initial=0.0)))
            acceleration = max(acceleration, float(np.quantile(np.abs(side[:, 1]), 0.999)) if len(side) else 0.0)
        rate = world.body_inputs.right[:, 0] - world.body_inputs.left[:, 0]
        turn = max(turn, float(np.abs(rate).max(initial=0.0)) / (world.run.meta.robot.track_width or 1.0))
    return Reach(speed, acceleration, turn)
