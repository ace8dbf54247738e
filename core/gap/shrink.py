"""How far: the gap before and after effects are added, and at the noise floor, window by window from the reference.

Commands in (recorded wheels where there are no commands), all effects through the whole chain, the pose set anew every
window while the drive runs on. Units are the stated noise's sigma; encoders count their increment since the window's
start. After "Effects", section on what a gap is.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.gap.floor import Floor, stated, wrap
from core.gap.types import Figures, Gap
from core.gap.whiten import windows_of
from core.gap.world import WHEELS, World
from core.robot import EffectSet
from core.simulation import params as P
from core.simulation._batch_numba import Inputs
from core.simulation.inputs import prepare
from core.simulation.simulate import simulate_sets

Array = npt.NDArray[np.float64]

BLOCK = 10.0
"""Blocks of the bootstrap [s]."""
DRAWS = 400
FALLBACK_FLOOR = 1.0
NOISES = {
    "gyro_noise": ("imu.gz",),
    "gyro_walk": ("imu.gz",),
    "vibration": ("imu.ax", "imu.ay"),
    "beacon_noise": ("beacon.x", "beacon.y", "beacon.theta", "ranges.range"),
    "beacon_outliers": ("beacon.x", "beacon.y", "ranges.range"),
    "beacon_shadow": (),
}
"""Effects that only add noise, and the channels whose level they raise."""


@dataclass(frozen=True)
class Replay:
    """Standardised residuals of one run by channel: stamps and values, for one set of effects."""

    times: Mapping[str, Array]
    values: Mapping[str, Array]


def replay_inputs(world: World) -> Inputs | None:
    """What `replay` drives: to prepare once where one run is replayed many times. None where wheels drive."""
    if world.run.commands is None:
        return None
    return prepare(world.run, world.restarts)._replace(truth=world.stamps)


def replay(world: World, sets: Sequence[EffectSet], floor: Floor, inputs: Inputs | None = None) -> list[Replay]:
    """The run against its simulator with each of these effect sets. inputs: of `replay_inputs`, if at hand."""
    run = world.run
    sheet = {**floor.sigma, **stated(run)}
    inputs = inputs or replay_inputs(world)
    if inputs is None:
        outs = world.body(sets)
    else:
        packed = np.stack([P.pack(run.meta, one) for one in sets])
        outs, _ = simulate_sets(inputs, packed)
        limit = packed[:, P.GYRO_CLIP, None]
        outs = outs._replace(gz=np.clip(outs.gz, -limit, limit))
    found = []
    for k in range(len(sets)):
        values = {}
        for name in world.channels:
            if name in WHEELS:
                far = world.readings[name] - getattr(outs, name.split(".")[1])[k, world.keep(name)]
                first = windows_of(world.times[name])
                count = np.diff(np.append(first, len(far)))
                far = far - np.repeat(far[first], count)
            else:
                far = world.readings[name] - world.channel(outs, name)[k]
                far = wrap(far) if name.endswith("theta") else far
            values[name] = far / sheet[name]
        found.append(Replay(world.times, values))
    return found


def floors(world: World, floor: Floor) -> dict[str, float]:
    """What noise alone leaves in each channel, in units of the stated noise."""
    sheet = {**floor.sigma, **stated(world.run)}
    out = {}
    for name in world.channels:
        level = floor.sigma.get(name, sheet[name]) / sheet[name]
        if name in WHEELS:
            level *= np.sqrt(2.0)
        elif name.startswith("truth"):
            level *= np.sqrt(2.0)  # the reading's noise, and the start's
        out[name] = float(level)
    return out


@dataclass(frozen=True)
class Shown:
    """A run's replays: as the simulator is, with the immaterial effects, with all, and with all but each cause."""

    bare: Replay
    base: Replay
    full: Replay
    without: tuple[Replay, ...]


def show(world: World, small: EffectSet, causes: EffectSet, floor: Floor) -> Shown:
    """Every replay that is told of a run. small: immaterial effects; causes: material ones, each left out in turn."""
    real = {name: values for name, values in causes.items() if name not in NOISES}
    whole = {**small, **real}
    alone = [{k: v for k, v in whole.items() if k != name} for name in real]
    sets: list[EffectSet] = [{}]
    for one in (small, whole, *alone):
        if one not in sets:
            sets.append(one)
    found = replay(world, sets, floor)
    return Shown(
        found[0], found[sets.index(small)], found[sets.index(whole)], tuple(found[sets.index(one)] for one in alone)
    )


def figures(
    worlds: Sequence[World], floor: Floor, shown: Sequence[Shown], noises: EffectSet, held_out: bool, seed: int
) -> Gap:
    """The gap over all runs. noises: effects that only add noise."""
    before, after = [one.bare for one in shown], [one.full for one in shown]
    names = [name for name in worlds[0].channels if all(name in w.channels for w in worlds)]
    sums = np.array([_block_sums(b, a, names) for w, (b, a) in _blocks(worlds, before, after)])
    level = floors(worlds[0], floor)
    base = np.array([level[name] for name in names])
    louder = {name for effect in noises for name in NOISES[effect]}
    total, shrink, by_stream = _gap(sums, names, base, louder, worlds, floor)
    draws = []
    rng = np.random.default_rng(seed)
    if len(sums) > 3:
        for _ in range(DRAWS):
            chosen = sums[rng.integers(0, len(sums), len(sums))]
            draws.append(_gap(chosen, names, base, louder, worlds, floor)[1])
    known = [d for d in draws if d is not None]
    ci = (float(np.quantile(known, 0.05)), float(np.quantile(known, 0.95))) if shrink is not None and known else None
    return Gap(total, shrink, ci, held_out, by_stream)


def scored(world: World, floor: Floor, before: Replay, after: Replay, effects: EffectSet) -> Gap:
    """The gap of one run between two replays of it, without an interval; effects: those of the later one."""
    names = world.channels
    level = floors(world, floor)
    louder = {name for effect in effects if effect in NOISES for name in NOISES[effect]}
    sums = _block_sums(before, after, names)[None]
    total, shrink, by = _gap(sums, names, np.array([level[name] for name in names]), louder, [world], floor)
    return Gap(total, shrink, None, False, by)


def _blocks(
    worlds: Sequence[World], before: list[Replay], after: list[Replay]
) -> list[tuple[World, tuple[Replay, Replay]]]:
    out = []
    for world, one, two in zip(worlds, before, after, strict=True):
        end = max(float(t[-1]) for t in world.times.values())
        out += [(world, (_cut(one, start), _cut(two, start))) for start in np.arange(0.0, end, BLOCK)]
    return out


def _cut(one: Replay, start: float) -> Replay:
    rows = {n: slice(*np.searchsorted(t, (start, start + BLOCK))) for n, t in one.times.items() if n in one.values}
    return dataclasses.replace(one, values={n: v[rows[n]] for n, v in one.values.items()})


def _block_sums(before: Replay, after: Replay, names: Sequence[str]) -> Array:
    """(3, C) readings, sums of squares before and after in one block."""
    return np.array(
        [
            [len(before.values[n]) for n in names],
            [_square(before.values[n]) for n in names],
            [_square(after.values[n]) for n in names],
        ]
    )


def _square(values: Array) -> float:
    """Sum of squares, without waking a pool of threads for it."""
    return float(np.einsum("i,i->", values, values))


def _gap(
    sums: Array, names: Sequence[str], base: Array, louder: set[str], worlds: Sequence[World], floor: Floor
) -> tuple[Figures, float | None, dict[str, Figures]]:
    n, before, after = sums.sum(axis=0)
    some = n > 0
    rms_before, rms_after = np.sqrt(before / np.maximum(n, 1.0)), np.sqrt(after / np.maximum(n, 1.0))
    ground = np.minimum(base, np.minimum(rms_before, rms_after))
    for i, name in enumerate(names):  # a louder sensor is told by its level: the patch brings the sheet up to it
        if name in louder:
            rms_after[i] = ground[i] = 1.0
    by = {
        name: Figures(float(rms_before[i]), float(rms_after[i]), float(ground[i]))
        for i, name in enumerate(names)
        if some[i]
    }
    total = Figures(*(float(np.sqrt(np.mean(part[some] ** 2))) for part in (rms_before, rms_after, ground)))
    explainable = total.before - total.floor
    shrink = (total.before - total.after) / explainable if explainable > 0.02 * total.floor else None
    return total, shrink, by
