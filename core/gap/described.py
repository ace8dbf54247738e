"""What no listed effect explains, described from the data: by which regressor, how often, since when, at what place."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from core.effects import EFFECTS
from core.gap.curves import ROUND, UNITS, Samples, band, bins_of, edges_of, means, rated, samples, told_by
from core.gap.energy import SPAN, Energy
from core.gap.evidence import Leftover, Nearest, Onset, Period, ShapeCurve
from core.gap.explain import Search
from core.gap.floor import Floor
from core.gap.shrink import Shown
from core.gap.types import Unexplained
from core.gap.where import Ground, hot_place

Array = npt.NDArray[np.float64]

SHAPES, NAMED = 3, 0.1
"""At most so many curves; a regressor that takes less of the rest than this is not shown."""
HARMONICS = range(1, 7)
PERIODIC = 0.4
"""Share of the rest that a period must take."""
SLOWEST, FASTEST, PERIODS = 40.0, 0.6, 240
"""Periods of time that are tried [s], and how many."""
SUDDEN, BEFORE = 30.0, 3.0
"""Drop of chi-squared that an onset must bring; deviations that the time before it may be off by."""
STEP = 2.0
"""Resolution of an onset [s]."""
NEAREST = 5


def described(
    ground: Ground, shown: Sequence[Shown], left: Unexplained, found: Search, floor: Floor, seed: int
) -> Leftover:
    """What is left in the stream that shows it best."""
    rows = samples(ground.worlds, ground.moved, [(one.full,) for one in shown], left.stream, floor)
    nearest = _nearest(found, left.stream)
    if rows is None:
        return Leftover(left.stream, (), None, None, None, nearest)
    values = rows.values[0]
    excess = max(float(np.sum(values**2)) - len(values) * _noise(values, rated(left.stream)), 1e-30)
    whole = float(np.var(values)) * len(values)
    takes = {name: min(share * whole / excess, 1.0) for name, share in told_by(rows, values)}
    shapes = []
    for name, share in sorted(takes.items(), key=lambda pair: -pair[1])[:SHAPES]:
        if share > NAMED:
            x, y, lo, hi = band(rows, name, values, seed)
            shapes.append(ShapeCurve(name, UNITS[name], x, y, lo, hi, share))
    best = shapes[0].regressor if shapes else None
    place = hot_place(ground, left.stream, "left")
    return Leftover(
        left.stream,
        tuple(shapes),
        _period(rows, values, excess) or _rhythm(ground, left.stream),
        _onset(rows, values, best, _noise(values, rated(left.stream)), ground, left.stream),
        None if place is None else (place.x, place.y, place.radius),
        nearest,
    )


def _noise(values: Array, rate: bool) -> float:
    """Variance of the white noise in samples, or in rates of white readings: from third differences."""
    if len(values) < 8:
        return float(np.var(values))
    size = float(np.median(np.abs(np.diff(values, 3)))) / 0.67449
    return size**2 / (35.0 if rate else 20.0)


def _period(rows: Samples, values: Array, excess: float) -> Period | None:
    """The harmonic of heading or of a wheel's angle that takes most of the rest."""
    best: tuple[float, Period] | None = None
    for name, k in itertools.product((n for n in ROUND if n in rows.regressors), HARMONICS):
        angle = k * rows.regressors[name]
        waves = np.stack((np.cos(angle), np.sin(angle), np.ones(len(angle))))
        a, b = waves @ waves.T, waves @ values
        flat = float(values.sum()) ** 2 / len(values)
        share = (float(b @ np.linalg.lstsq(a, b, rcond=1e-9)[0]) - flat) / excess
        if share > PERIODIC and (best is None or share > best[0]):
            best = share, Period(name, 2.0 * np.pi / k, "rad")
    return best[1] if best else None


def _rhythm(ground: Ground, stream: str) -> Period | None:
    """The period of time at which the energy of the rest comes back, if one stands out."""
    periods = np.geomspace(FASTEST, SLOWEST, PERIODS)
    power, count, total = np.zeros(PERIODS), 0, 0.0
    for one in ground.energy:
        if stream in one and len(one[stream].left) * SPAN > 2.0 * SLOWEST:
            energy = np.sqrt(np.maximum(one[stream].left + one[stream].dof, 0.0))
            energy = energy - energy.mean()
            t = np.arange(len(energy)) * SPAN
            wave = np.exp(-2j * np.pi * t[None, :] / periods[:, None])
            power += np.abs(wave @ energy) ** 2 / len(energy)
            total, count = total + float(energy @ energy), count + 1
    if not count or total <= 0.0:
        return None
    k = int(np.argmax(power))
    share = 2.0 * power[k] / total
    inner = 0 < k < PERIODS - 1
    return Period("time", float(periods[k]), "s") if inner and share > PERIODIC else None


def _onset(rows: Samples, values: Array, name: str | None, noise: float, ground: Ground, stream: str) -> Onset | None:
    """When the rest begins: the split of a run before which it is not there, by how much of its curve each block shows.

    Without a curve, by the blocks' energy. The first run in which one is found tells.
    """
    for size, weight in _strengths(rows, values, name, noise, ground, stream):
        total, spread = np.cumsum(size * weight), np.cumsum(weight)
        if len(size) < 10 or spread[-1] <= 0.0:
            continue
        k = np.arange(2, len(size) - 2)
        before, after = (
            total[k] / np.maximum(spread[k], 1e-12),
            (total[-1] - total[k]) / np.maximum(spread[-1] - spread[k], 1e-12),
        )
        gain = spread[k] * (spread[-1] - spread[k]) / spread[-1] * (after - before) ** 2
        quiet = (np.abs(before) * np.sqrt(spread[k]) < BEFORE) & (spread[k] > 0.05 * spread[-1])
        gain = np.where(quiet & (after > 0.0), gain, 0.0)
        best = int(np.argmax(gain))
        if gain[best] > SUDDEN:
            near = np.exp(-0.5 * np.minimum(gain[best] - gain, 60.0)) * (gain > 0.0)
            at = (k + 1.0) * STEP
            mean = float(near @ at / near.sum())
            sd = float(np.sqrt(near @ (at - mean) ** 2 / near.sum() + STEP**2 / 12.0))
            return Onset(mean, sd)
    return None


def _strengths(
    rows: Samples, values: Array, name: str | None, noise: float, ground: Ground, stream: str
) -> list[tuple[Array, Array]]:
    """Per run, blocks of STEP: how strong the rest is there (1 on average where it acts), and its weight."""
    if name is None or name == "time":
        return [_energies(one[stream]) for one in ground.energy if stream in one]
    out = []
    x = rows.regressors[name]
    edges = edges_of(name, x)
    number = bins_of(x, edges)
    curve = means(number, values, len(edges) - 1)[1][number]
    t, run = rows.regressors["time"], rows.run
    for k in range(int(run.max()) + 1):
        here = run == k
        block = (t[here] / STEP).astype(np.int64)
        info = np.bincount(block, curve[here] ** 2) / noise
        score = np.bincount(block, curve[here] * values[here]) / noise
        out.append((score / np.maximum(info, 1e-12), info))
    return out


def _energies(one: Energy) -> tuple[Array, Array]:
    step = round(STEP / SPAN)
    first = np.arange(0, len(one.left), step)
    left, dof = np.add.reduceat(one.left, first), np.add.reduceat(one.dof, first)
    return left / np.maximum(dof, 1e-9), dof / 2.0


def _nearest(found: Search, stream: str) -> tuple[Nearest, ...]:
    """Listed effects that come closest to the rest, with what they take of it."""
    takes: dict[str, float] = {}
    for scope, one in zip(("wheels", "body")[-len(found.links) :], found.links, strict=True):
        shape = one.unknown[1] if one.unknown is not None else found.rests[scope].best[1]
        if shape <= 0.0:
            continue
        strange = [step for step in one.steps if step.action.startswith("unknown")]
        gains: Mapping[str, float] = {**one.gains, **(dict(strange[-1].gains) if strange else {})}
        for name, gain in gains.items():
            if stream in EFFECTS[name].streams and name not in one.fit.model:
                takes[name] = max(takes.get(name, 0.0), min(max(gain, 0.0) / shape, 1.0))
    ranked = sorted(takes.items(), key=lambda pair: -pair[1])[:NEAREST]
    return tuple(
        Nearest(name, share, f"takes {share:.0%} of what the shape takes, its parameters fitted")
        for name, share in ranked
        if share > 0.0
    )
