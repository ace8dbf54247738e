"""The runs as one least-squares problem, linear about a model: white residuals, columns, normal equations by block.

Normal equations are kept per channel and per block of time: channels tell which stream an effect explains, blocks
give variances that hold for coloured residuals too, and held-out scores without another simulation.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.effects import EFFECTS
from core.gap.candidates import STEPS, Candidate, bounds, free_of
from core.gap.floor import Floor, measure
from core.gap.nuisance import SPREAD as SHARE
from core.gap.nuisance import Nuisances, limits
from core.gap.sway import sway_of
from core.gap.whiten import (
    Events,
    all_jumps,
    best_walk,
    events_of,
    imu_sigma,
    jumps_of,
    residuals_of,
    white_imu,
    white_poses,
    white_wheels,
)
from core.gap.world import IMU, POSES, WHEELS, World, drive_effects, without_drive
from core.robot import EffectSet
from core.simulation._batch_numba import Outputs

Array = npt.NDArray[np.float64]
Model = dict[str, dict[str, float | str]]

BLOCK = 5.0
"""Length of a block of time [s]: longer than a window, which nothing of the pose outlasts."""
HUBER = 5.0
"""A residual beyond so many sigma counts linearly: edges and outliers must not outweigh everything else."""


@dataclass(frozen=True)
class Normal:
    """Normal equations over columns `keys` (P): per channel (C) and per block (B); residual r, columns E, all white.

    n: readings; c: Huber's loss of r (r.r where all are small); g: E.r; a: E.E, both with Huber's weights.
    blocks (B, 2): run and first second.
    """

    keys: tuple[str, ...]
    channels: tuple[str, ...]
    blocks: Array
    n: Array
    c: Array
    g: Array
    a: Array
    logs: float

    @property
    def total(self) -> tuple[float, Array, Array]:
        """r.r, E.r (P,), E.E (P, P) over everything."""
        return float(self.c.sum()), self.g.sum(axis=(0, 1)), self.a.sum(axis=(0, 1))


@dataclass(frozen=True)
class Column:
    """One column: its key, the effects that make it, and the step that it is divided by."""

    key: str
    effects: Model
    step: float
    streams: frozenset[str]


@dataclass(frozen=True)
class White:
    """White residual (N,) and columns (M, N) of one channel of one run; `index` (M,) says which columns they are."""

    t: Array
    residual: Array
    columns: Array
    index: npt.NDArray[np.int64]


@dataclass(frozen=True)
class Problem:
    """All runs that are fitted together, and the noise floor that they share.

    held: effects taken as given. nuisances: what stands beside every model, of one scope.
    """

    worlds: tuple[World, ...]
    floor: Floor
    known: EffectSet
    held: EffectSet = dataclasses.field(default_factory=dict)
    nuisances: Nuisances = dataclasses.field(default_factory=Nuisances)

    @property
    def leads(self) -> bool:
        """Whether recorded wheels stand between commands and body."""
        return self.worlds[0].wheels_lead

    def overlay(self, model: EffectSet, scope: str) -> Model:
        """The part of a model that acts in a scope: "wheels", "body" (the drive then is as recorded) or both in one."""
        if scope == "body" and self.leads:
            return {name: dict(values) for name, values in without_drive({**self.held, **model}).items()}
        if scope == "wheels":
            kept = {**drive_effects(model), **{k: v for k, v in model.items() if k == "missed_ticks"}}
            return {name: dict(values) for name, values in kept.items()}
        return {name: dict(values) for name, values in model.items()}


FIRST = 3e-3
"""The most that a path without truth may walk before anything is explained [rad per root of m]."""


def with_floor(problem: Problem, model: EffectSet) -> Problem:
    """The same with the floor measured on the residuals of a model, and the walk that suits it."""
    residuals: list[Mapping[str, Array]] = []
    speeds, parts = [], []
    for world in problem.worlds:
        body = world.body([problem.overlay(model, "body")])
        wheels = world.wheels([problem.overlay(model, "wheels")]) if world.wheel_inputs is not None else {}
        residuals.append(residuals_of(world, wheels, body))
        speeds.append(body.speed[0] if len(body.speed[0]) else None)
        parts.append((world, body))
    floor = measure(list(problem.worlds), residuals, speeds)
    events: list[tuple[Events, Mapping[str, Array], Array]] = []
    for (world, body), residual in zip(parts, residuals, strict=True):
        found = events_of(world, body, floor, residual)
        if found is not None:
            events.append((found, residual, jumps_of(world, body)))
    walk, side = best_walk(events) if events else (floor.walk, floor.side)
    if not model and any(world.run.truth is None for world in problem.worlds):
        walk = min(walk, FIRST)  # a strong walk would take for chance what an effect does to the path
    kept = problem.floor.gyro_walk
    floor = dataclasses.replace(floor, walk=walk, side=side, gyro_walk=kept)
    swayed = [(world, body, residual) for (world, body), residual in zip(parts, residuals, strict=True)]
    floor = dataclasses.replace(floor, sway=sway_of(swayed, floor))
    return dataclasses.replace(problem, floor=floor, nuisances=Nuisances())


def columns_of(model: EffectSet, tried: Sequence[Candidate], spread: float = 1.0) -> list[Column]:
    """Columns of a model's own parameters, then of the candidates. spread: widens the steps of local parameters."""
    out: list[Column] = []
    for effect, values in model.items():
        out += [_derivative(model, effect, dict(values), name, spread) for name in free_of(effect, values)]
    for one in tried:
        if one.secant:
            effects = {**_copy(model), one.effect: dict(one.start)}
            out.append(Column(f"{one.effect}*{one.start}", effects, 1.0, frozenset(EFFECTS[one.effect].streams)))
        else:
            out += [_derivative(model, one.effect, dict(one.start), name) for name in one.free]
    return out


def _derivative(
    model: EffectSet, effect: str, values: dict[str, float | str], name: str, spread: float = 1.0
) -> Column:
    _low, high = bounds(effect, name)
    step, value = STEPS[f"{effect}.{name}"], float(values[name])
    if f"{effect}.{name}" in LOCAL:
        step *= spread
    if value + step > high:
        step = -step
    label = f"{effect}.{name}" + (
        f"@{_place(values)}" if effect in ("gyro_drift", "anchor_moved") and effect not in model else ""
    )
    moved = {**values, name: value + step}
    return Column(label, {**_copy(model), effect: moved}, step, frozenset(EFFECTS[effect].streams))


def _place(values: Mapping[str, float | str]) -> str:
    return f"{values['beacon']}" if "beacon" in values else f"{values['tau']}"


def _copy(model: EffectSet) -> Model:
    return {name: dict(values) for name, values in model.items()}


def whitened(
    problem: Problem, model: EffectSet, columns: Sequence[Column], scope: str
) -> tuple[list[dict[str, White]], float]:
    """Per run and channel the white residual of a model with its columns; and the sum of log variances."""
    out, logs = [], 0.0
    for world in problem.worlds:
        white: dict[str, White] = {}
        if scope in ("wheels", "all") and world.wheel_inputs is not None:
            white |= _white_wheels(problem, world, model, columns)
        if scope in ("body", "all"):
            found, more = _white_body(problem, world, model, columns)
            white |= found
            logs += more
        out.append(white)
    return out, logs


def _white_wheels(problem: Problem, world: World, model: EffectSet, columns: Sequence[Column]) -> dict[str, White]:
    index = [i for i, one in enumerate(columns) if one.streams & set(WHEELS)]
    sets = [problem.overlay(model, "wheels"), *(problem.overlay(columns[i].effects, "wheels") for i in index)]
    predicted = world.wheels(sets)
    steps = np.array([columns[i].step for i in index])[:, None]
    out = {}
    for name in WHEELS:
        rows = predicted[name][:, world.keep(name)]
        values = np.vstack((world.readings[name] - rows[:1], (rows[1:] - rows[:1]) / steps))
        white = white_wheels(world, name, values, problem.floor)
        out[name] = White(world.times[name], white[0], white[1:], np.array(index, dtype=np.int64))
    return out


def _white_body(
    problem: Problem, world: World, model: EffectSet, columns: Sequence[Column]
) -> tuple[dict[str, White], float]:
    names = [name for name in world.channels if name not in WHEELS]
    acting = [
        i
        for i, one in enumerate(columns)
        if (one.streams & set(names) and not (problem.leads and _is_drive(one, model)))
        or (problem.leads and one.key.startswith("missed_ticks"))
    ]
    seen = [name for name in names if name in POSES]
    parts: dict[str, list[Array]] = {name: [] for name in names}
    jump_rows: list[Array] = []
    index: dict[str, list[int]] = {name: [] for name in (*IMU, "poses")}
    for batch in world.batches(len(acting)) or [range(0)]:
        chosen = [acting[k] for k in batch]
        out = world.body([problem.overlay(one, "body") for one in (model, *(columns[i].effects for i in chosen))])
        streams = [_streams(columns[i]) for i in chosen]
        for kind in index:
            here = seen if kind == "poses" else [kind] if kind in names else []
            mine = [k for k, one in enumerate(streams) if one & (set(POSES) if kind == "poses" else {kind})]
            index[kind] += [chosen[k] for k in mine]
            rows, steps = [k + 1 for k in mine], np.array([columns[chosen[k]].step for k in mine])
            for name in here:
                far = world.channel(out, name)
                parts[name].append(np.nan_to_num(far[rows] - far[:1], copy=False) / steps[:, None])
            if kind == "poses" and here:
                jumps = all_jumps(world, out)
                jump_rows.append((jumps[:1] - jumps[rows]) / steps[:, None, None])
    base = Outputs(*(column[:1] for column in out))
    residuals = residuals_of(world, {name: np.zeros((1, len(_full(world, name)))) for name in WHEELS}, base)
    events, white, logs = events_of(world, base, problem.floor, residuals), {}, 0.0
    stacked = {name: np.concatenate([residuals[name][None, :], *parts[name]]) for name in names}
    for name in (name for name in names if name in IMU):
        sigma = imu_sigma(world, name, base, problem.floor)
        one = white_imu(world, name, stacked[name], sigma, problem.floor)
        white[name] = White(world.times[name], one[0], one[1:], np.array(index[name], dtype=np.int64))
    if events is not None:
        every = np.concatenate([jumps_of(world, base)[None], *jump_rows])
        posed = {name: stacked[name] for name in events.names}
        found, logs = white_poses(events, posed, every, problem.floor.walk, problem.floor.side)
        for name, one in found.items():
            white[name] = White(world.times[name], one[0], one[1:], np.array(index["poses"], dtype=np.int64))
    return white, logs


def _streams(one: Column) -> frozenset[str]:
    """What a column can move: missed ticks move the body as wheels of another size."""
    return frozenset(EFFECTS["wheel_radius"].streams) if one.key.startswith("missed_ticks") else one.streams


def _is_drive(one: Column, model: EffectSet) -> bool:
    return EFFECTS[one.key.split(".")[0].split("*")[0]].family == "drive"


def _full(world: World, name: str) -> Array:
    log = world.run.wheels
    return np.asarray(log.t) if log is not None else np.empty(0)


def loss(residual: Array) -> Array:
    """Huber's loss of white residuals, on the scale of squares."""
    size = np.abs(residual)
    out: Array = np.where(size > HUBER, 2.0 * HUBER * size - HUBER**2, size * size)
    return out


def normal_equations(
    white: Sequence[Mapping[str, White]],
    keys: Sequence[str],
    logs: float = 0.0,
    by_block: bool = False,
    judged: Sequence[Mapping[str, White]] = (),
) -> Normal:
    """Sums over readings, by channel; and by block of BLOCK, where asked for, else over each run.

    judged: the same with the residuals by which readings are told to lie far off, where those are others.
    """
    names = tuple(name for name in (*WHEELS, *IMU, *POSES) if any(name in one for one in white))
    length = BLOCK if by_block else np.inf
    blocks = [
        (k, b)
        for k, one in enumerate(white)
        for b in range(int(max((w.t[-1] for w in one.values() if len(w.t)), default=0.0) // length) + 1)
    ]
    place = {block: i for i, block in enumerate(blocks)}
    p, shape = len(keys), (len(names), len(blocks))
    n, c, g, a = np.zeros(shape), np.zeros(shape), np.zeros((*shape, p)), np.zeros((*shape, p, p))
    for k, one in enumerate(white):
        for i, name in enumerate(names):
            if name not in one or not len(one[name].t):
                continue
            w = one[name]
            far = judged[k][name].residual if judged else w.residual
            weight = HUBER / np.maximum(np.abs(far), HUBER)
            pull, losses, weighted = w.residual * weight, loss(w.residual), w.columns * weight
            number = np.floor(np.maximum(w.t, 0.0) / length).astype(int)
            cuts = np.append(np.flatnonzero(np.diff(number, prepend=-1)), len(w.t)) if by_block else [0, len(w.t)]
            for first, last in itertools.pairwise(cuts):
                j = place[(k, int(number[first]))]
                n[i, j], c[i, j] = last - first, float(losses[first:last].sum())
                if len(w.index):
                    g[i, j, w.index] = w.columns[:, first:last] @ pull[first:last]
                    a[i, j][np.ix_(w.index, w.index)] = weighted[:, first:last] @ w.columns[:, first:last].T
    at = np.array([(k, b * BLOCK) for k, b in blocks], dtype=float).reshape(-1, 2)
    return Normal(tuple(keys), names, at, n, c, g, a, logs)


def cost_at(problem: Problem, model: EffectSet, scope: str) -> float:
    """-2 log likelihood of a model as it stands, up to a constant, nothing free beside it."""
    white, logs = whitened(problem, model, (), scope)
    return logs + sum(float(np.sum(loss(w.residual))) for one in white for w in one.values())


def secants_of(white: Sequence[Mapping[str, White]], count: int) -> Array:
    """(P,) by how much the loss drops if each whole column is taken."""
    out = np.zeros(count)
    for one in white:
        for w in one.values():
            base = float(np.sum(loss(w.residual))) if len(w.index) else 0.0
            for row, i in enumerate(w.index):
                out[i] += base - float(np.sum(loss(w.residual - w.columns[row])))
    return out


def nuisances_of(white: Sequence[Mapping[str, White]], normal: Normal) -> Nuisances:
    """Of the columns of an effect table's linearisation, those that stand for immaterial flaws."""
    limit = limits(normal.keys)
    chosen = np.flatnonzero(limit)
    if not len(chosen):
        return Nuisances()
    place = np.full(len(limit), -1)
    place[chosen] = np.arange(len(chosen))
    rows = []
    for one in white:
        kept = {}
        for name, w in one.items():
            mine = np.flatnonzero(place[w.index] >= 0)
            if len(mine):
                kept[name] = (w.columns[mine], place[w.index[mine]])
        rows.append(kept)
    keys = tuple(normal.keys[i] for i in chosen)
    a = normal.total[2][np.ix_(chosen, chosen)]
    effects = tuple(key.split(".")[0] for key in keys)
    return Nuisances(keys, effects, SHARE * limit[chosen], limit[chosen], a, tuple(rows), far_of(white))


def far_of(white: Sequence[Mapping[str, White]]) -> float:
    """Share of readings whose residual counts less than fully."""
    sizes = [np.abs(w.residual) > HUBER for one in white for w in one.values() if len(w.residual)]
    return float(np.mean(np.concatenate(sizes))) if sizes else 0.0


LOCAL = frozenset(("slip_patch.x", "slip_patch.y", "slip_patch.radius", "bump.time", "deadband.width"))
"""Parameters that move an edge: a small step sees only the readings at the edge, a wide one the way to go."""


def linearise(
    problem: Problem, model: EffectSet, tried: Sequence[Candidate], scope: str, spread: float = 1.0, own: bool = True
) -> Normal:
    """Normal equations about a model: its own parameters first (if `own`), then the candidates' columns."""
    inside = {name: values for name, values in problem.overlay(model, scope).items() if name not in problem.held}
    return linearised(problem, inside, tried, scope, spread, own)[1]


def linearised(
    problem: Problem,
    inside: Model,
    tried: Sequence[Candidate],
    scope: str,
    spread: float = 1.0,
    own: bool = True,
    more: tuple[Sequence[str], Sequence[Mapping[str, White]]] = ((), ()),
) -> tuple[list[dict[str, White]], Normal]:
    """White residual and columns about a model of this scope, and their normal equations. more: further columns."""
    columns = columns_of(inside, tried, spread) if own or tried else []
    white, logs = whitened(problem, inside, columns, scope)
    keys = [one.key for one in columns]
    for mine, theirs in zip(white, more[1], strict=False):
        for name, one in theirs.items():
            index = np.concatenate((mine[name].index, len(keys) + one.index))
            mine[name] = dataclasses.replace(
                mine[name], columns=np.concatenate((mine[name].columns, one.columns)), index=index
            )
    keys += more[0]
    return white, normal_equations(white, keys, logs)
