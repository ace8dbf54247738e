"""The whole search over runs: worlds, candidates, both links; without truth, again from the path set right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from core.effects import EFFECTS
from core.gap.candidates import Candidate, Reach, candidates
from core.gap.explain import Progress, Search, explain, silent
from core.gap.floor import Floor
from core.gap.linear import Problem, with_floor
from core.gap.pace import watched
from core.gap.reference import restarts_of
from core.gap.rolling import rolling
from core.gap.thinned import thinned
from core.gap.world import World, make_world
from core.robot import EffectSet
from core.run import Run

PATH = ("kinematics", "ground", "beacons")
"""Families whose effects bend a path that was smoothed without them."""


AGAIN, BETTER = 3, 100.0
"""Without truth the path is set right at most so often, while that lowers the cost by this much."""


@dataclass(frozen=True)
class Searched:
    """What was found, on which worlds, among which candidates."""

    found: Search
    worlds: tuple[World, ...]
    tried: tuple[Candidate, ...]
    reach: Reach


def searched(runs: Sequence[Run], known: EffectSet, window: float, progress: Progress = silent) -> Searched:
    """Every effect that these runs show beside what the simulator already models."""
    worlds, fewer = _worlds(runs, window, {}, progress)
    problem = with_floor(Problem(fewer, Floor({}, {}, {}), known), {})
    reach = reach_of(worlds)
    tried = candidates(worlds[0].channels, list(runs[0].meta.beacons), reach, known, _warm(runs))
    progress(0.1, "searching")
    found = explain(problem, tried, progress, worlds)
    for _ in range(AGAIN if any(run.truth is None for run in runs) else 0):
        if not any(EFFECTS[name].family in PATH for name in found.model):
            break
        progress(0.6, "again from the path set right")
        before = found.body.fit.cost
        worlds, fewer = _worlds(runs, window, found.model, progress)
        found = explain(with_floor(Problem(fewer, Floor({}, {}, {}), known), {}), tried, whole=worlds)
        if found.body.fit.cost > before - BETTER:
            break
    return Searched(found, worlds, tuple(tried), reach)


def _worlds(
    runs: Sequence[Run], window: float, model: EffectSet, progress: Progress
) -> tuple[tuple[World, ...], tuple[World, ...]]:
    """Every run with all its readings, and as the search sees it."""
    restarts = [restarts_of(run, window, model) for run in runs]
    worlds = tuple(watched(rolling(make_world(run, at)), progress) for run, at in zip(runs, restarts, strict=True))
    fewer = thinned(runs)
    if all(a is b for a, b in zip(runs, fewer, strict=True)):
        return worlds, worlds
    return worlds, tuple(
        watched(rolling(make_world(run, at)), progress) for run, at in zip(fewer, restarts, strict=True)
    )


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
        commands = world.run.commands
        past = 0 if commands is None else int(world.body_inputs.times.searchsorted(commands.t[0]))
        own = slice(past, None)
        for side in (world.body_inputs.left[own], world.body_inputs.right[own]):
            speed = max(speed, float(np.abs(side[:, 0]).max(initial=0.0)))
            acceleration = max(acceleration, float(np.quantile(np.abs(side[:, 1]), 0.999)) if len(side) else 0.0)
        rate = world.body_inputs.right[:, 0] - world.body_inputs.left[:, 0]
        turn = max(turn, float(np.abs(rate).max(initial=0.0)) / (world.run.meta.robot.track_width or 1.0))
    return Reach(speed, acceleration, turn)
