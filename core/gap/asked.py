"""A drive that does less than the commands ask: forward speed and turn rate cut off before the wheels.

A controller that keeps to a top speed and a top turn rate changes the twist that is asked, not either wheel, so no
listed effect does what it does. It is looked for where the listed ones leave most: two levels, each at its best, then
the whole search again under the commands so cut. What it explains is told as unlisted; the effects are those beside it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from core.gap.candidates import Candidate
from core.gap.fit import refit
from core.gap.generic import Shape
from core.gap.linear import Model, Problem, cost_at, with_floor
from core.gap.rolling import with_past
from core.gap.selection import BRIEF, Found, search
from core.gap.world import WHEELS, World
from core.robot import EffectSet
from core.simulation.inputs import prepare

Levels = tuple[float, float]
"""Most forward speed [m/s] and turn rate [rad/s] that the drive follows."""

LOUD = 25.0
"""Mean square of what the listed effects leave, from which on no noise is meant."""
SHARES = (1.0, 0.85, 0.7, 0.6, 0.5, 0.42, 0.35, 0.3, 0.25)
"""Levels tried, as shares of the most that is asked."""
TAKES = 0.2
"""Of what the listed effects leave, the cut-off and those beside it must take this share: of squares twice as much."""
SLOW: Model = {"command_delay": {"delay": 0.1}, "motor_lag": {"tau": 0.1}}
"""Beside the levels the drive may be slow: what is late is not what is cut off."""
STEPS = (0.07, 0.03, 0.012, 0.005)
"""Steps of the levels about the best found, as shares."""


def cut_off(wheels: Found, drive: Sequence[Candidate], aside: Sequence[Candidate]) -> Found:
    """The wheels' model under commands as far as the drive follows them; the same where that is all they ask."""
    problem, left = wheels.problem, float(wheels.fit.normal.c.sum())
    if left < LOUD * float(wheels.fit.normal.n.sum()):
        return wheels
    top = _asked(problem)
    if min(top) <= 0.0:
        return wheels
    levels = _best(problem, wheels.fit.model, top)
    if all(level >= most for level, most in zip(levels, top, strict=True)):
        return wheels
    slow = refit(_cut(problem, levels), {**wheels.fit.model, **SLOW}, "wheels", BRIEF)
    levels = _polished(problem, slow.model, levels, top)
    found = search(with_floor(_cut(problem, levels), {}), drive, "wheels", aside=aside)
    taken = left - float(found.fit.normal.c.sum())
    if taken < TAKES * left:
        return wheels
    return dataclasses.replace(found, unknown=(_shape(found, levels, top), taken))


def _asked(problem: Problem) -> Levels:
    logs = [world.run.commands for world in problem.worlds]
    forward, turn = ([np.abs(getattr(log, name)).max() for log in logs if log is not None] for name in ("v", "w"))
    return float(max(forward, default=0.0)), float(max(turn, default=0.0))


def _cut(problem: Problem, levels: Levels) -> Problem:
    return dataclasses.replace(problem, worlds=tuple(_cut_world(world, *levels) for world in problem.worlds))


def _cut_world(world: World, forward: float, turn: float) -> World:
    run = world.run
    if run.commands is None or world.wheel_inputs is None:
        return world
    v, w = np.clip(run.commands.v, -forward, forward), np.clip(run.commands.w, -turn, turn)
    cut = dataclasses.replace(run, commands=dataclasses.replace(run.commands, v=v, w=w))
    inputs = prepare(dataclasses.replace(cut, imu=None, beacon=None, ranges=None, truth=None))
    return dataclasses.replace(world, wheel_inputs=with_past(inputs, cut))


def _cost(problem: Problem, model: EffectSet, levels: Levels) -> float:
    kept: Model = {name: dict(values) for name, values in model.items()}
    return cost_at(_cut(problem, levels), kept, "wheels")


def _best(problem: Problem, model: EffectSet, top: Levels) -> Levels:
    """Both levels on a grid."""
    tried = [(a * top[0], b * top[1]) for a in SHARES for b in SHARES]
    return min(tried, key=lambda levels: _cost(problem, model, levels))


def _polished(problem: Problem, model: EffectSet, levels: Levels, top: Levels) -> Levels:
    """Both levels moved one after the other while that helps."""
    best = _cost(problem, model, levels)
    for step in STEPS:
        for which in (0, 1, 0, 1):
            for factor in (1.0 - step, 1.0 + step):
                moved = [*levels]
                moved[which] = min(moved[which] * factor, top[which])
                cost = _cost(problem, model, (moved[0], moved[1]))
                if cost < best:
                    best, levels = cost, (moved[0], moved[1])
    return levels


def _shape(found: Found, levels: Levels, top: Levels) -> Shape:
    """What is told of it, by the wheel that shows it best."""
    name = min(WHEELS, key=lambda one: found.problem.floor.sigma[one])
    told = [f"{level:.2f} {unit}" for level, most, unit in zip(levels, top, UNITS, strict=True) if level < most]
    regressor = "v" if levels[0] / top[0] < levels[1] / top[1] else "w"
    return Shape(name, regressor, f"commands beyond {' and '.join(told)}, which the drive does not follow")


UNITS = ("m/s", "rad/s of turning")
