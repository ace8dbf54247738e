"""Which effects: forward by exact refit, with swaps and drops, so that a wrong first step can be undone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from core.effects import EFFECTS
from core.gap.candidates import Candidate
from core.gap.fit import Fit, cost_of, parameters_of, refit
from core.gap.generic import Shape
from core.gap.linear import Model, Normal, Problem, linearise, with_floor
from core.gap.places import placed, polish
from core.gap.scatter import gyro_left, gyro_walk
from core.gap.unknown import blocked_by, rest_of
from core.robot import EffectSet

Array = npt.NDArray[np.float64]

MOST = 5
"""At most so many effects in one link's model."""
TRIED = 4
"""So many of the best candidates are refitted at each step."""
BRIEF = 3
"""Iterations of a fit that is only compared."""
WORTH = 30.0
"""Drop of the cost that an effect must bring: noise on fifty candidates stays below (see tests/bench/bench_gap.py)."""
WHEELS_WORTH = 120.0
"""The same of encoders: rounding at slow speed is no white noise."""
SECANT = (0.25, 4.0)
"""Weights that a secant may have: its shape holds near its start only."""
POLISHED = 0.05
"""A patch that brings less than this per reading is not worth the search for its last centimetre."""


@dataclass(frozen=True)
class Step:
    """One step of the search: what was compared, best first (effect, drop of cost), and what was done."""

    action: str
    gains: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class Screen:
    """The last screening: information about the model's own parameters (the first `own`) and the candidates'."""

    information: Array
    own: int
    tried: tuple[Candidate, ...]


@dataclass(frozen=True)
class Found:
    """The model of one link: its fit, the problem with the floor it left, the search's steps, the rivals' screening.

    unknown: a shape of no listed effect that took more than any of them, where the search met one. earned: rise of the
    cost without each effect, the rest refitted. tolerated: per channel, the deviance that a flaw of tolerated size
    brings (median over the effects that touch it).
    """

    fit: Fit
    problem: Problem
    steps: tuple[Step, ...] = ()
    gains: dict[str, float] = field(default_factory=dict)
    earned: dict[str, float] = field(default_factory=dict)
    unknown: tuple[Shape, float] | None = None
    tolerated: dict[str, float] = field(default_factory=dict)
    screen: Screen | None = None


def gains_of(normal: Normal, own: int, tried: Sequence[Candidate]) -> Array:
    """(len(tried),) drop of the cost that each candidate promises, the model's own parameters refitted with it."""
    _, g, a = normal.total
    out = np.zeros(len(tried))
    ridge = 1e-9
    at = own
    base, solve = _projector(a[:own, :own], g[:own])
    for k, one in enumerate(tried):
        mine = np.arange(at, at + len(one.keys))
        at += len(one.keys)
        cross = a[np.ix_(mine, np.arange(own))]
        info = a[np.ix_(mine, mine)] - cross @ solve(cross.T)
        score = g[mine] - cross @ base
        diag = np.diag(a)[mine]
        if (np.diag(info) <= 1e-6 * np.maximum(diag, 1e-12)).all():
            continue
        if one.secant:
            weight = float(np.clip(score[0] / max(info[0, 0], 1e-12), *SECANT))
            out[k] = max(2.0 * weight * score[0] - weight**2 * info[0, 0], float(normal.secant[mine[0]]))
        else:
            size = np.sqrt(np.maximum(diag, 1e-12))
            scaled = info / np.outer(size, size) + ridge * np.eye(len(mine))
            out[k] = float((score / size) @ np.linalg.solve(scaled, score / size))
    return out


def _projector(a: Array, g: Array) -> tuple[Array, Callable[[Array], Array]]:
    if not len(g):
        return np.zeros(0), lambda x: np.zeros((0, np.shape(x)[1]))
    size = np.sqrt(np.maximum(np.diag(a), 1e-12))
    inverse = np.linalg.pinv(a / np.outer(size, size), rcond=1e-10) / np.outer(size, size)
    return inverse @ g, lambda x: inverse @ x


def search(problem: Problem, tried: Sequence[Candidate], scope: str, start: EffectSet | None = None) -> Found:
    """Add the effect that explains most, refit exactly, drop what is no longer needed; until nothing is worth it."""
    fit = refit(problem, start or {}, scope)
    worth = WHEELS_WORTH if scope == "wheels" else WORTH
    steps: list[Step] = []
    gains: dict[str, float] = {}
    tolerated: dict[str, float] = {}
    unknown: tuple[Shape, float] | None = None
    screen: Screen | None = None
    for _ in range(MOST):
        fresh = [one for one in tried if one.effect not in fit.model]
        if unknown is not None:
            fresh = [one for one in fresh if not blocked_by(unknown[0]) & set(EFFECTS[one.effect].streams)]
        elif scope != "wheels":
            fresh += placed(problem, fit.model)
        normal = linearise(problem, fit.model, fresh, scope)
        own = len(parameters_of(fit.model))
        screen = Screen(normal.total[2], own, tuple(fresh))
        tolerated = tolerated or _tolerated(normal, fresh)
        gain = gains_of(normal, own, fresh)
        gains = _best_of(fresh, gain)
        ranked = sorted(gains.items(), key=lambda item: -item[1])
        if not ranked or ranked[0][1] < worth:
            break
        chosen = _starts(fresh, gain)
        fits = [
            (one.effect, refit(problem, {**fit.model, one.effect: dict(one.start)}, scope, BRIEF)) for one in chosen
        ]
        name, best = min(fits, key=lambda item: item[1].cost)
        if fit.cost - best.cost < worth:
            break
        if unknown is None:
            unknown = _stranger(problem, fit, best, pairs_of(normal, own, fresh))
            if unknown is not None:
                fit, unknown = _stood_in(problem, fit, unknown, scope)
                steps.append(Step(f"unknown {unknown[0].key}", tuple((e, fit.cost - f.cost) for e, f in fits)))
                continue
        steps.append(Step(f"add {name}", tuple((e, fit.cost - f.cost) for e, f in fits)))
        best, dropped = _drop(problem, best, scope)
        steps += [Step(f"drop {one}") for one in dropped]
        if name == "slip_patch":
            best = _polished(problem, best, scope)
        problem = with_floor(problem, best.model)
        fit = refit(problem, best.model, scope)
    if "slip_patch" in fit.model and _loss(fit, "slip_patch") > POLISHED * fit.normal.n.sum():
        fit = _polished(problem, fit, scope, (0.04, 0.02, 0.01, 0.005, 0.002))
    return Found(fit, problem, tuple(steps), gains, _earned(problem, fit, scope), unknown, tolerated, screen)


def _earned(problem: Problem, fit: Fit, scope: str) -> dict[str, float]:
    """Leaving each effect out in turn."""
    out = {}
    for name in fit.model:
        rest = {k: v for k, v in fit.model.items() if k != name}
        out[name] = max(refit(problem, rest, scope, 2).cost - fit.cost, 0.0)
    return out


def _tolerated(normal: Normal, tried: Sequence[Candidate]) -> dict[str, float]:
    found: dict[str, list[float]] = {name: [] for name in normal.channels}
    at = len(normal.keys) - sum(len(one.keys) for one in tried)
    for one in tried:
        for name in one.keys:
            parameter = name.split(".")[-1]
            small = None if one.secant else EFFECTS[one.effect].parameter(parameter).small
            if small is not None:
                energy = np.einsum("ij->i", normal.a[:, :, at, at]) * small**2
                for channel, value in zip(normal.channels, energy, strict=True):
                    if value > 0.0:
                        found[channel].append(float(value))
            at += 1
    return {name: float(np.median(values)) if values else 0.0 for name, values in found.items()}


def _polished(problem: Problem, fit: Fit, scope: str, steps: Sequence[float] = (0.12, 0.06, 0.03, 0.015)) -> Fit:
    """A slip patch whose edges have been moved one by one, then refitted."""

    def cost(values: Mapping[str, float | str]) -> float:
        return cost_of(linearise(problem, {**fit.model, "slip_patch": dict(values)}, (), scope, own=False))

    moved = polish(cost, fit.model["slip_patch"], steps)
    again = refit(problem, {**fit.model, "slip_patch": dict(moved)}, scope, BRIEF)
    return again if again.cost < fit.cost else fit


BEYOND, MARGIN = 1.02, 60.0
"""A shape that no listed effect has must beat the best of them by this factor and drop of deviance."""
PAIRED = 8
"""So many of the best candidates are also tried in pairs."""


def _stranger(problem: Problem, fit: Fit, best: Fit, pair: float) -> tuple[Shape, float] | None:
    """A shape that takes more than the best listed effect, the best two, and a walking gyro bias; else None."""
    listed = max(fit.cost - best.cost, pair)
    shape, gain = rest_of(problem, fit).best
    if shape is None or gain < BEYOND * listed + MARGIN:
        return None
    if "imu.gz" in blocked_by(shape) and "imu.gz" in problem.floor.sigma and problem.floor.gyro_walk == 0.0:
        _, walked = gyro_walk(problem, gyro_left(problem, fit))
        if walked > gain:
            return None
    return shape, gain


def _stood_in(problem: Problem, fit: Fit, unknown: tuple[Shape, float], scope: str) -> tuple[Fit, tuple[Shape, float]]:
    """Without the effects that had only stood in for the unknown cause: a shape alone does what they did with it."""
    shared = [name for name in fit.model if blocked_by(unknown[0]) & set(EFFECTS[name].streams)]
    if not shared:
        return fit, unknown
    bare = refit(problem, {k: v for k, v in fit.model.items() if k not in shared}, scope, BRIEF)
    shape, gain = rest_of(problem, bare).best
    if shape is None or gain < STANDS * (bare.cost - fit.cost + unknown[1]):
        return fit, unknown
    return bare, (shape, gain)


STANDS = 0.9
"""Share of what effects and shape took together that the shape alone must take, for the effects to be dropped."""


def pairs_of(normal: Normal, own: int, tried: Sequence[Candidate]) -> float:
    """The most that two smooth candidates bring together, the model's own parameters refitted."""
    _, g, a = normal.total
    base, solve = _projector(a[:own, :own], g[:own])
    cross = a[own:, :own]
    info, score = a[own:, own:] - cross @ solve(cross.T), g[own:] - cross @ base
    at, parts = 0, []
    gain = gains_of(normal, own, tried)
    for k, one in enumerate(tried):
        mine = list(range(at, at + len(one.keys)))
        at += len(one.keys)
        if not one.secant:
            parts.append((gain[k], one.effect, mine))
    parts.sort(key=lambda part: -part[0])
    best = 0.0
    for i, (_, first, mine) in enumerate(parts[:PAIRED]):
        for _, second, theirs in parts[i + 1 : PAIRED]:
            if first != second:
                both = mine + theirs
                size = np.sqrt(np.maximum(np.diag(a)[[own + j for j in both]], 1e-12))
                scaled = info[np.ix_(both, both)] / np.outer(size, size) + 1e-6 * np.eye(len(both))
                best = max(best, float((score[both] / size) @ np.linalg.solve(scaled, score[both] / size)))
    return best


def _best_of(tried: Sequence[Candidate], gain: Array) -> dict[str, float]:
    out: dict[str, float] = {}
    for one, value in zip(tried, gain, strict=True):
        out[one.effect] = max(out.get(one.effect, 0.0), float(value))
    return out


def _starts(tried: Sequence[Candidate], gain: Array) -> list[Candidate]:
    """The best start of each of the best effects."""
    order = np.argsort(-gain)
    out: list[Candidate] = []
    for k in order:
        if gain[k] < max(WORTH, 0.2 * gain[order[0]]) or len(out) >= TRIED:
            break
        if all(one.effect != tried[k].effect for one in out):
            out.append(tried[k])
    return out


def _drop(problem: Problem, fit: Fit, scope: str) -> tuple[Fit, list[str]]:
    """Without every effect that the others can do without."""
    dropped: list[str] = []
    for name in list(fit.model):
        if len(fit.model) < 2:
            break
        rest: Model = {k: v for k, v in fit.model.items() if k != name}
        if _loss(fit, name) > 50.0 * WORTH:
            continue
        without = refit(problem, rest, scope)
        if without.cost - fit.cost < WORTH:
            fit = without
            dropped.append(name)
    return fit, dropped


def _loss(fit: Fit, name: str) -> float:
    """Rise of the cost without an effect, its parameters at neutral, to second order: a lower bound for most."""
    _, _, a = fit.normal.total
    mine = [i for i, (effect, _) in enumerate(fit.parameters) if effect == name]
    rest = [i for i in range(len(a)) if i not in mine]
    info = a[np.ix_(mine, mine)]
    if rest:
        cross = a[np.ix_(mine, rest)]
        info = info - cross @ np.linalg.pinv(a[np.ix_(rest, rest)], rcond=1e-10) @ cross.T
    shift = []
    for i in mine:
        effect, parameter = fit.parameters[i]
        neutral = float(EFFECTS[effect].parameter(parameter).neutral)
        if not np.isfinite(neutral):
            return 0.0
        shift.append(float(fit.model[effect][parameter]) - neutral)
    return float(np.array(shift) @ info @ np.array(shift))
