"""A run that begins in mid-drive: the wheels already turn when the first command is recorded.

The simulator starts at rest. Where the first readings show the rims turning, the drive is given a past in which they
did so, long enough for any lag to have settled; else the first window would judge a start that never was.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from core.gap.world import World
from core.run import Run
from core.simulation._batch_numba import Inputs
from core.simulation.inputs import with_drive

Array = npt.NDArray[np.float64]

PAST = 3.0
"""How long the past is [s]."""
FIRST, LEAST = 0.4, 4
"""The first readings are those of so many seconds, or so many."""
AT_REST = 0.02
"""Rims slower than this at the start are at rest [m/s]."""
STEADY = 0.1
"""A command that lies within this share of the speed was followed before as well: then it is the past."""


def rolling(world: World) -> World:
    """The world with its drive's past, where the run has commands and begins in mid-drive; else as it is."""
    if world.run.commands is None or not len(world.run.commands):
        return world
    wheels = None if world.wheel_inputs is None else with_past(world.wheel_inputs, world.run)
    return dataclasses.replace(world, body_inputs=with_past(world.body_inputs, world.run), wheel_inputs=wheels)


def with_past(inputs: Inputs, run: Run) -> Inputs:
    """Inputs of commands with the rims' speeds at the start held for PAST before it."""
    speeds = first_speeds(run)
    if speeds is None or max(abs(v) for v in speeds) < AT_REST or not len(inputs.times):
        return inputs
    begin = float(inputs.times[0])
    step = min(float(np.median(np.diff(inputs.times))), 0.1) if len(inputs.times) > 1 else 0.05
    times = np.concatenate(([begin - PAST, begin - step], inputs.times))
    sides = []
    for now, speed in zip((inputs.left[:, 0], inputs.right[:, 0]), speeds, strict=True):
        held = float(now[0]) if abs(now[0] - speed) < STEADY * abs(speed) else speed
        sides.append(np.concatenate(([held, held], now)))
    return with_drive(inputs, times, *sides)._replace(begin=begin - PAST)


def first_speeds(run: Run) -> tuple[float, float] | None:
    """Both rims' speeds as the run begins [m/s], from encoders, else from truth; None where nothing tells."""
    radius, track = run.meta.robot.wheel_radius or 0.0, run.meta.robot.track_width or 0.0
    if run.wheels is not None and len(run.wheels) >= LEAST:
        ways = radius * np.column_stack((run.wheels.left, run.wheels.right)).astype(np.float64)
        rates = _rates(run.wheels.t, ways)
        return None if rates is None else (float(rates[0]), float(rates[1]))
    truth = run.truth
    if truth is None or truth.x is None or truth.y is None or truth.theta is None or len(truth) < LEAST:
        return None
    rates = _rates(truth.t, np.column_stack((truth.x, truth.y, np.unwrap(truth.theta))).astype(np.float64))
    if rates is None:
        return None
    v = float(rates[0] * np.cos(truth.theta[0]) + rates[1] * np.sin(truth.theta[0]))
    return v - 0.5 * track * float(rates[2]), v + 0.5 * track * float(rates[2])


def _rates(t: Array, values: Array) -> Array | None:
    """(C,) rates of change at the first of (N, C) values, by a parabola through the first of them."""
    known = np.isfinite(values).all(axis=1)
    t, values = t[known], values[known]
    n = max(int(np.searchsorted(t, t[0] + FIRST)) if len(t) else 0, LEAST)
    if len(t) < n:
        return None
    since = t[:n] - t[0]
    out: Array = np.polynomial.polynomial.polyfit(since, values[:n], 2 if n > LEAST else 1)[1]
    return out
