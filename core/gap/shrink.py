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
from core.gap.reference import WINDOW
from core.gap.rolling import with_past
from core.gap.types import Figures, Gap
from core.gap.whiten import windows_of
from core.gap.world import WHEELS, World
from core.robot import EffectSet
from core.simulation import params as P
from core.simulation._batch_numba import Inputs
from core.simulation.inputs import prepare
from core.simulation.simulate import simulate_sets

Array = npt.NDArray[np.float64]

BLOCK, BLOCKS = 10.0, 10
"""Blocks of the bootstrap [s]; shorter, down to a window, where there would be fewer than so many."""
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
    return with_past(prepare(world.run, world.restarts)._replace(truth=world.stamps), world.run)


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
    inputs, found = replay_inputs(world), []
    for batch in world.batches(len(sets)):
        found += replay(world, [sets[k] for k in batch], floor, inputs)
    return Shown(
        found[0], found[sets.index(small)], found[sets.index(whole)], tuple(found[sets.index(one)] for one in alone)
    )


Spans = Sequence[tuple[float, float]]


@dataclass(frozen=True)
class Scored:
    """What is scored: worlds with their replays; spans: of each, the stretches that count (None: all of it)."""

    worlds: Sequence[World]
    shown: Sequence[Shown]
    causes: tuple[str, ...]
    held_out: bool
    spans: Sequence[Spans] | None = None


def figures(scored: Scored, floor: Floor, noises: EffectSet, seed: int) -> tuple[Gap, tuple[str, ...]]:
    """The gap over all that is scored; and causes whose leaving out surely makes it smaller. noises: only add noise."""
    worlds = scored.worlds
    names = [name for name in worlds[0].channels if all(name in w.channels for w in worlds)]
    sums = np.array(_blocks(scored, names))
    level = floors(worlds[0], floor)
    base = np.array([level[name] for name in names])
    louder = {name for effect in noises for name in NOISES[effect]}
    total, shrink, by_stream = _gap(sums[:, :3], names, base, louder)
    real = [name for name in scored.causes if name not in NOISES]
    alone = {name: _gap(sums[:, [0, 1, 3 + k]], names, base, louder)[0].after for k, name in enumerate(real)}
    ci: tuple[float, float] | None = None
    harm: tuple[str, ...] = ()
    if len(sums) > 3:
        count = np.random.default_rng(seed).multinomial(len(sums), np.full(len(sums), 1.0 / len(sums)), DRAWS)
        drawn = np.tensordot(count.astype(np.float64), sums, axes=1)
        before, after, ground, *others = _totals(drawn, base, np.array([name in louder for name in names]))
        ratio = (before - after) / np.maximum(before - ground, 1e-9)
        if shrink is not None:
            ci = (float(np.quantile(ratio, 0.05)), float(np.quantile(ratio, 0.95)))
        worse = [float(np.mean(other < after)) > SURELY for other in others]
        harm = tuple(
            name
            for name, surely in zip(real, worse, strict=True)
            if scored.held_out and surely and alone[name] < (1.0 - HARM) * total.after
        )
    return Gap(total, shrink, ci, scored.held_out, by_stream, alone), harm


def _totals(sums: Array, base: Array, louder: npt.NDArray[np.bool_]) -> list[Array]:
    """(D,) totals of draws (D, 1 + R, C): before, after, floor, then after without each cause."""
    n = sums[:, :1]
    rms = np.sqrt(sums[:, 1:] / np.maximum(n, 1.0))
    ground = np.minimum(base, np.minimum(rms[:, 0], rms[:, 1]))
    rms[:, 1:] = np.where(louder, 1.0, rms[:, 1:])
    ground = np.where(louder, 1.0, ground)
    some = n[:, 0] > 0.0
    rows = [rms[:, 0], rms[:, 1], ground, *(rms[:, k] for k in range(2, rms.shape[1]))]
    return [np.sqrt(np.sum(row**2 * some, axis=1) / np.maximum(some.sum(axis=1), 1)) for row in rows]


SURELY, HARM = 0.9, 0.005
"""An effect does harm if leaving it out lowers the held-out gap by this share, in this share of the draws."""


def scored(world: World, floor: Floor, before: Replay, after: Replay, effects: EffectSet) -> Gap:
    """The gap of one run between two replays of it, without an interval; effects: those of the later one."""
    names = world.channels
    level = floors(world, floor)
    louder = {name for effect in effects if effect in NOISES for name in NOISES[effect]}
    sums = _block_sums([before, after], names)[None]
    total, shrink, by = _gap(sums, names, np.array([level[name] for name in names]), louder)
    return Gap(total, shrink, None, False, by)


def _blocks(scored: Scored, names: Sequence[str]) -> list[Array]:
    """Sums of each block of BLOCK of all that counts."""
    ends = [max(float(t[-1]) for t in world.times.values()) + 1e-6 for world in scored.worlds]
    spans = scored.spans or [((0.0, end),) for end in ends]
    whole = sum(b - a for each in spans for a, b in each)
    length = float(np.clip(whole / BLOCKS, WINDOW, BLOCK))
    out = []
    for one, each in zip(scored.shown, spans, strict=True):
        replays = [one.bare, one.full, *one.without]
        for first, last in each:
            starts = np.arange(first, last, length)
            out += [_block_sums([_cut(r, a, min(a + length, last)) for r in replays], names) for a in starts]
    return out


def _cut(one: Replay, start: float, end: float) -> Replay:
    rows = {n: slice(*np.searchsorted(t, (start, end))) for n, t in one.times.items() if n in one.values}
    return dataclasses.replace(one, values={n: v[rows[n]] for n, v in one.values.items()})


def _block_sums(replays: Sequence[Replay], names: Sequence[str]) -> Array:
    """(1 + R, C) readings, and the sum of squares of each replay in one block."""
    counts = [len(replays[0].values[n]) for n in names]
    return np.array([counts, *([_square(one.values[n]) for n in names] for one in replays)], dtype=np.float64)


def _square(values: Array) -> float:
    """Sum of squares, without waking a pool of threads for it."""
    return float(np.einsum("i,i->", values, values))


def _gap(
    sums: Array, names: Sequence[str], base: Array, louder: set[str]
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
