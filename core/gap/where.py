"""Where the gap lies: which streams leave their floor, what the robot does there, when, and at what place.

What is real but immaterial is taken out first. Streams, cells of stream and regime, stretches of time and cells of
the map are held under one false-discovery control (`discoveries`); neighbours are merged into intervals and a place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

from core.effects import EFFECTS
from core.gap.discoveries import hierarchical
from core.gap.energy import SPAN, Energy, colour, deviation, energies, parts
from core.gap.evidence import Cell
from core.gap.floor import Floor
from core.gap.generic import Shape
from core.gap.motion import REGIMES, Motion, motion, regimes, wider
from core.gap.regimes import INSTANT, PLACED, SIGNATURES, of_shape
from core.gap.shrink import NOISES, Shown
from core.gap.types import Place, Where
from core.gap.world import World
from core.robot import EffectSet

Array = npt.NDArray[np.float64]
Runs = Sequence[Mapping[str, Energy]]

LEAST_SHARE = 0.002
"""Streams, and causes in a stream, with less of the excess than this are left out."""
STRETCH = 2.0
"""Length of the stretches of time that are tested [s]."""
GRID = 0.5
"""Side of the map's cells that are tested [m]."""
LOCAL = 0.5
"""Stretches or cells that are more than this share of the run are no "when" or "where"."""
INSIDE = 0.85
"""A regime, stretches or cells that hold this share of the excess are named for it."""
FEW = 3
"""More intervals than this in one run are a regime, not a time."""
BUMP = 0.3
"""A bump's length [s]."""
SMALLEST = 1e-300


@dataclass(frozen=True)
class Ground:
    """What is known of the fitted runs: worlds, what they do, their energies; by: each cause's share by channel.

    parts: per channel, (E,) white energy of each cause that is more than noise.
    """

    worlds: Sequence[World]
    moved: Sequence[Motion]
    energy: Runs
    by: Mapping[str, Mapping[str, float]]
    parts: Mapping[str, Array]

    @property
    def channels(self) -> list[str]:
        """Channels that have readings."""
        return [name for name in self.worlds[0].channels if any(name in one for one in self.energy)]

    def all(self, name: str, field: str) -> Array:
        """One field of a channel's blocks, all runs end to end."""
        return np.concatenate([getattr(one[name], field) for one in self.energy if name in one])

    def mask(self, name: str, masks: Sequence[Mapping[str, npt.NDArray[np.bool_]]], regime: str) -> Array:
        """Blocks of a channel in a regime, all runs end to end."""
        return np.concatenate([m[regime] for m, one in zip(masks, self.energy, strict=True) if name in one])


@dataclass(frozen=True)
class Findings:
    """`cells`: of the heat map; `where`: rows, strongest first."""

    cells: tuple[Cell, ...]
    where: tuple[Where, ...]


def ground_of(worlds: Sequence[World], shown: Sequence[Shown], causes: EffectSet, floor: Floor) -> Ground:
    """What the replays show of the fitted runs."""
    energy = [energies(w, one.bare, one.base, one.full, floor) for w, one in zip(worlds, shown, strict=True)]
    real = [name for name in causes if name not in NOISES]
    by = {}
    own = parts(worlds, [one.full for one in shown], [one.without for one in shown])
    for name, each in own.items():
        by[name] = dict(zip(real, (each / max(float(each.sum()), 1e-9)).tolist(), strict=True))
    return Ground(worlds, [motion(world) for world in worlds], energy, by, own)


def look(ground: Ground, causes: EffectSet, shape: Shape | None) -> Findings:
    """Everything that leaves its floor.

    causes: the material effects with their parameters. shape: of what no effect explains.
    """
    louder = {name: effect for effect in causes if effect in NOISES for name in NOISES[effect]}
    masks = [regimes(one) for one in ground.moved]
    floors = {name: _sums(ground, name, name in louder) for name in ground.channels}
    families = {}
    for name in ground.channels:
        tint = colour(ground.energy, name)
        cells = [_p(ground, name, tint, ground.mask(name, masks, regime)) for regime in REGIMES]
        families[name] = np.array(
            [floors[name][2], *cells, *_stretches(ground, name, tint), *_grid(ground, name, tint)]
        )
    found = hierarchical(families)
    table = []
    for name in ground.channels:
        for k, regime in enumerate(REGIMES):
            table.append(_cell(ground, name, regime, masks, float(families[name][k + 1]), bool(found[name][k + 1])))
    weight = {name: _trust(ground, name) * max(excess, 0.0) for name, (excess, _, _) in floors.items()}
    total = max(sum(weight.values()), 1e-9)
    rows: list[Where] = []
    for name, (_, _, p) in floors.items():
        share = weight[name] / total
        if name in louder:
            rows.append(Where(name, SIGNATURES[louder[name]], share, max(p, SMALLEST)))
        elif found[name].any() and p < 0.05 and share > LEAST_SHARE:
            rows += _rows(ground, name, share, max(p, SMALLEST), causes, shape)
    if "beacon_shadow" in causes:
        if len(causes) == 1 and shape is None:
            rows = []  # nothing else is material: what leaves its floor beside it is a trifle
        rows += _shadowed(ground, causes["beacon_shadow"], 1.0 if not rows else 0.0)
    return Findings(tuple(table), tuple(sorted(rows, key=lambda one: -one.share)))


def _trust(ground: Ground, name: str) -> float:
    """What a channel's excess counts: a reference is believed to what it states, however quiet it is."""
    if not name.startswith("truth"):
        return 1.0
    return float(min(ground.all(name, "floor").sum() / max(2.0 * ground.all(name, "rows").sum(), 1.0), 1.0))


def _shadowed(ground: Ground, values: Mapping[str, float | str], share: float) -> list[Where]:
    """Rows of the streams that are missing in a shadow."""
    names = [name for name in ("beacon.x", "beacon.y", "beacon.theta", "ranges.range") if name in ground.channels]
    spans, place = _spans(ground, "beacon_shadow", values), _disc("beacon_shadow", values)
    return [Where(name, "place", share / len(names), SMALLEST, spans[0], place, spans) for name in names]


def _sums(ground: Ground, name: str, louder: bool) -> tuple[float, float, float]:
    """A channel's excess, degrees of freedom and p-value over everything. louder: its stated noise is the floor."""
    excess, dof = (float(ground.all(name, field).sum()) for field in ("excess", "dof"))
    if louder:
        excess, dof = (float(ground.all(name, field).sum()) for field in ("before", "rows"))
        excess -= dof
    sd = float(deviation(np.array(dof), colour(ground.energy, name)))
    return excess, dof, float(stats.norm.sf(excess / sd))


def _p(ground: Ground, name: str, tint: float, mask: Array) -> float:
    excess, dof = ground.all(name, "excess")[mask].sum(), ground.all(name, "dof")[mask].sum()
    return float(_tail(np.array([excess]), np.array([dof]), tint)[0])


def _tail(excess: Array, dof: Array, tint: float) -> Array:
    """p-values of sums of excess: gamma tails with the scatter that they have (few readings are skewed)."""
    some = dof > 0.5
    variance = deviation(dof, tint) ** 2
    mean = np.maximum(dof, 1e-9)
    out: Array = np.where(some, stats.gamma.sf((excess + dof) * mean / variance, mean**2 / variance), 1.0)
    return np.clip(out, SMALLEST, 1.0)


def _cell(
    ground: Ground, name: str, regime: str, masks: Sequence[Mapping[str, npt.NDArray[np.bool_]]], p: float, real: bool
) -> Cell:
    mask = ground.mask(name, masks, regime)
    rows, before, after, dof = (float(ground.all(name, f)[mask].sum()) for f in ("rows", "before", "after", "floor"))
    n = max(rows, 1.0)
    rms = [float(np.sqrt(part / n)) for part in (before, after, dof)]
    return Cell(name, regime, int(rows), rms[0], rms[1], rms[2], p, real)


def _stretches(ground: Ground, name: str, tint: float) -> Array:
    """p-values of stretches of time, run after run."""
    return np.concatenate([_stretches_of(one[name], tint) for one in ground.energy if name in one])


def _stretches_of(one: Energy, tint: float) -> Array:
    step = round(STRETCH / SPAN)
    first = np.arange(0, len(one.dof), step)
    return _tail(np.add.reduceat(one.excess, first), np.add.reduceat(one.dof, first), tint)


def _grid(ground: Ground, name: str, tint: float) -> Array:
    """p-values of the map's cells that the robot visits."""
    cell = _cell_numbers(ground, name)
    if cell is None:
        return np.empty(0)
    excess, dof = (np.bincount(cell, ground.all(name, part)).astype(np.float64) for part in ("excess", "dof"))
    return _tail(excess[dof > 0.5], dof[dof > 0.5], tint)


def _places(ground: Ground, name: str) -> tuple[Array, Array]:
    return (
        np.concatenate([m.x for m, one in zip(ground.moved, ground.energy, strict=True) if name in one]),
        np.concatenate([m.y for m, one in zip(ground.moved, ground.energy, strict=True) if name in one]),
    )


def _cell_numbers(ground: Ground, name: str) -> npt.NDArray[np.int64] | None:
    x, y = _places(ground, name)
    if not np.isfinite(x).all():
        return None
    column, row = (np.floor((part - part.min()) / GRID).astype(np.int64) for part in (x, y))
    _, number = np.unique(column * (int(row.max()) + 1) + row, return_inverse=True)
    return np.asarray(number, dtype=np.int64)


def _rows(ground: Ground, name: str, share: float, p: float, causes: EffectSet, shape: Shape | None) -> list[Where]:
    """One row per regime of a stream: as its causes act, else as the data show."""
    by = {effect: part for effect, part in ground.by.get(name, {}).items() if part > LEAST_SHARE}
    out: dict[str, Where] = {}
    for effect, part in sorted(by.items(), key=lambda item: -item[1]):
        regime = SIGNATURES[effect]
        if regime in out:
            part += out[regime].share / share
        spans = _spans(ground, effect, causes[effect])
        out[regime] = Where(name, regime, share * part, p, spans[0], _disc(effect, causes[effect]), spans)
    if out and shape is None:
        return list(out.values())
    told = of_shape(shape.channel, shape.regressor, shape.text) if shape is not None else None
    rest = max(1.0 - sum(by.values()), 0.0)
    if out and (shape is None or rest < LEAST_SHARE):
        return list(out.values())
    spans, place = _intervals(ground, name), hot_place(ground, name)
    regime = "place" if place is not None else told or _regime(ground, name)
    out.setdefault(regime, Where(name, regime, share * rest, p, spans[0] if spans else (), place, spans))
    return list(out.values())


def _spans(
    ground: Ground, effect: str, values: Mapping[str, float | str]
) -> tuple[tuple[tuple[float, float], ...], ...]:
    """Per run, when a local cause acts."""
    if effect in INSTANT:
        at = float(values["time"])
        return tuple(((at, at + BUMP),) for _ in ground.worlds)
    if effect not in PLACED:
        return tuple(() for _ in ground.worlds)
    x, y, radius = (float(values[key]) for key in ("x", "y", "radius"))
    out = []
    for one in ground.moved:
        inside = np.hypot(one.x - x, one.y - y) < radius
        out.append(_merged(one.t - 0.5 * SPAN, inside, SPAN))
    return tuple(out)


def _disc(effect: str, values: Mapping[str, float | str]) -> Place | None:
    return Place(*(float(values[key]) for key in ("x", "y", "radius"))) if effect in PLACED else None


def _merged(t: Array, inside: npt.NDArray[np.bool_], length: float) -> tuple[tuple[float, float], ...]:
    """Neighbouring blocks as intervals."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], inside.astype(int), [0]))))
    return tuple((float(t[a]), float(t[b - 1]) + length) for a, b in zip(edges[::2], edges[1::2], strict=True))


def _intervals(ground: Ground, name: str) -> tuple[tuple[tuple[float, float], ...], ...]:
    """Per run, merged stretches that hold nearly all of the excess, if they are few; else nothing."""
    out: list[tuple[tuple[float, float], ...]] = []
    held, seconds, whole = 0.0, 0.0, 0.0
    tint, step = colour(ground.energy, name), round(STRETCH / SPAN)
    for one in ground.energy:
        if name not in one:
            out.append(())
            continue
        first = np.arange(0, len(one[name].dof), step)
        excess = np.add.reduceat(one[name].excess, first)
        strong = _stretches_of(one[name], tint) < 1e-4
        held += float(excess[strong].sum())
        seconds, whole = seconds + STRETCH * float(strong.sum()), whole + STRETCH * len(first)
        out.append(_merged(first.astype(np.float64) * SPAN, strong, STRETCH))
    total = float(ground.all(name, "excess").sum())
    few = all(len(spans) <= FEW for spans in out)
    return tuple(out) if few and held > INSIDE * total and seconds < LOCAL * whole else ()


def hot_place(ground: Ground, name: str, field: str = "excess") -> Place | None:
    """The disc of the map that holds nearly all of the excess of a stream, if it is small and much passed otherwise."""
    x, y = _places(ground, name)
    if not np.isfinite(x).all():
        return None
    excess, dof = np.maximum(ground.all(name, field), 0.0), ground.all(name, "dof")
    moving = np.concatenate(
        [np.hypot(m.v, m.w) > 0.05 for m, one in zip(ground.moved, ground.energy, strict=True) if name in one]
    )
    total, spread = float(excess.sum()), max(float(np.ptp(x)), float(np.ptp(y)))
    best: tuple[float, Place] | None = None
    order = np.argsort(-excess)[:200:10]
    for radius in np.geomspace(0.2, max(0.3 * spread, 0.21), 6):
        for k in order:
            inside = np.hypot(x - x[k], y - y[k]) < radius
            share, size = (
                float(excess[inside].sum()) / total,
                float(dof[inside & moving].sum() / max(dof[moving].sum(), 1.0)),
            )
            if share > INSIDE and size < 0.25 and (best is None or share - size > best[0]):
                best = (share - size, Place(float(x[k]), float(y[k]), float(radius)))
    return best[1] if best else None


def _regime(ground: Ground, name: str) -> str:
    """The narrowest regime that holds most of the excess: by how much its density exceeds the rest's."""
    excess, dof = np.maximum(ground.all(name, "excess"), 0.0), ground.all(name, "dof")
    total = float(excess.sum())
    masks = [wider(one) for one in ground.moved]
    scores = {}
    for regime in masks[0]:
        mask = ground.mask(name, masks, regime)
        share, size = float(excess[mask].sum()) / max(total, 1e-9), float(dof[mask].sum()) / float(dof.sum())
        if share > INSIDE and 0.0 < size < 0.97:
            scores[regime] = (share - size) / (1.0 - size) - 0.25 * size
    return max(scores, key=lambda one: scores[one]) if scores else "always"


assert set(SIGNATURES) == set(EFFECTS)
