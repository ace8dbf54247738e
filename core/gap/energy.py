"""How far each channel of a run is from its simulator, in short blocks of time: the ground of every "where".

The whole chain is replayed, the pose set anew each window. A window's own offset (a pose's start, an encoder's angle)
says nothing and is taken out, so that what is left is white where only noise is left: its squares over their
expectation are a chi-squared. By how much more they scatter, the run's own windows tell.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.gap.floor import Floor, stated
from core.gap.reference import WINDOW
from core.gap.shrink import Replay, floors
from core.gap.world import WHEELS, World

Array = npt.NDArray[np.float64]

SPAN = 0.25
"""Length of a block [s]."""
FLOOR_SD = 0.02
"""A channel's noise is known to no better than this share."""
COLOUR = (1.0, 12.0)
"""Bounds of how much more a channel scatters than white noise."""


@dataclass(frozen=True)
class Energy:
    """One channel of one run, (B,) blocks of SPAN from t = 0.

    rows: readings. before, after, floor: sums of squares in units of the stated noise. excess, left: before (but for
    what is immaterial) and after, whitened and less what noise alone gives, in units of the floor. dof: what noise
    alone gives.
    """

    rows: Array
    before: Array
    after: Array
    floor: Array
    excess: Array
    left: Array
    dof: Array


def energies(world: World, before: Replay, base: Replay, after: Replay, floor: Floor) -> dict[str, Energy]:
    """Every channel of a run; `base` with the immaterial effects, `after` with all."""
    size = block_count(world)
    sheet, levels = {**floor.sigma, **stated(world.run)}, floors(world, floor)
    out = {}
    for name in world.channels:
        if name not in before.values or not len(world.times[name]):
            continue
        t = world.times[name]
        block = np.minimum((np.maximum(t, 0.0) / SPAN).astype(np.int64), size - 1)
        level = (floor.sigma.get(name, sheet[name]) / sheet[name]) ** 2
        noise = expected(world, name, floor)
        sums: list[Array] = [
            np.bincount(block, values**2, size).astype(np.float64)
            for values in (
                before.values[name],
                after.values[name],
                white(world, name, base.values[name]),
                white(world, name, after.values[name]),
            )
        ]
        dof: Array = np.bincount(block, noise, size).astype(np.float64)
        rows = np.bincount(block, minlength=size).astype(float)
        out[name] = Energy(
            rows, sums[0], sums[1], levels[name] ** 2 * rows, sums[2] / level - dof, sums[3] / level - dof, dof
        )
    return out


def block_count(world: World) -> int:
    """Blocks that cover a run."""
    end = max((float(t[-1]) for t in world.times.values() if len(t)), default=0.0)
    return int(end / SPAN) + 1


def window_of(world: World, name: str) -> npt.NDArray[np.int64]:
    """(N,) number of the window in which each reading lies, from 0."""
    t = world.times[name]
    if name in WHEELS:
        return np.floor(t / WINDOW).astype(np.int64)
    return np.searchsorted(world.restarts[:, 0], t + 1e-9, "right")


def white(world: World, name: str, values: Array) -> Array:
    """Without the offset that a window's readings share."""
    if not name.startswith(("wheels", "truth")):
        return values
    window = window_of(world, name)
    count = np.maximum(np.bincount(window), 1)
    return values - (np.bincount(window, values) / count)[window]


def expected(world: World, name: str, floor: Floor) -> Array:
    """(N,) mean square of each reading that noise alone gives, in units of the floor's variance."""
    n = len(world.times[name])
    if not name.startswith(("wheels", "truth")):
        return np.ones(n)
    window = window_of(world, name)
    count = np.maximum(np.bincount(window), 1)[window]
    out = 1.0 - 1.0 / count
    cross = {"truth.x": "truth.y", "truth.y": "truth.x"}.get(name, "")
    if cross in world.readings and "truth.theta" in floor.sigma and len(world.readings[cross]) == n:
        far = white(world, cross, world.readings[cross])  # the start's heading error swings the window's path
        out = out + (far * floor.sigma["truth.theta"] / floor.sigma[name]) ** 2
    return out


def parts(worlds: Sequence[World], whole: Sequence[Replay], without: Sequence[Sequence[Replay]]) -> dict[str, Array]:
    """Per channel, (E,) white energy of each effect: what the replay without it differs by from the whole one."""
    out: dict[str, Array] = {}
    for world, one, others in zip(worlds, whole, without, strict=True):
        for name in one.values:
            far = [white(world, name, one.values[name] - other.values[name]) for other in others]
            out[name] = out.get(name, np.zeros(len(others))) + np.array([np.einsum("i,i->", v, v) for v in far])
    return out


def colour(runs: Sequence[Mapping[str, Energy]], name: str) -> float:
    """By how much more the mean square of a channel varies than that of white noise, from the windows after the fit."""
    rows = []
    step = round(WINDOW / SPAN)
    for one in runs:
        if name in one:
            n = len(one[name].left) // step * step
            left, dof = (part[:n].reshape(-1, step).sum(axis=1) for part in (one[name].left, one[name].dof))
            rows.append((left / np.sqrt(2.0 * np.maximum(dof, 1e-9)))[dof > 0.5])
    values = np.concatenate(rows) if rows else np.empty(0)
    if len(values) < 8:
        return COLOUR[1]
    spread = float(np.median(np.abs(values - np.median(values)))) / 0.6745
    return float(np.clip(spread**2, *COLOUR))


def deviation(dof: Array, colours: Array | float) -> Array:
    """Standard deviation of a sum of excess over blocks with so many degrees of freedom in all."""
    out: Array = np.sqrt(2.0 * colours * dof + (2.0 * FLOOR_SD * dof) ** 2)
    return np.maximum(out, 1e-9)
