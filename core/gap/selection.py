"""Which effects: forward by exact refit, with swaps and drops, so that a wrong first step can be undone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from core.effects import EFFECTS
from core.gap.candidates import Candidate
from core.gap.fit import Fit, cost_of, parameters_of, refit
from core.gap.linear import Model, Normal, Problem, linearise, with_floor
from core.gap.places import placed, polish
from core.robot import EffectSet

Array = npt.NDArray[np.float64]

MOST = 6
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
SHARE = 0.1
"""An effect beyond the first must explain this share of what is left in some channel it touches, or noise would do."""


@dataclass(frozen=True)
class Step:
    """One step of the search: what was compared, best first (effect, drop of cost), and what was done."""

    action: str
    gains: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class Found:
    """The model of one link: its fit, the problem with the floor it left, the search's steps, the rivals' screening.

    earned: rise of the cost without each effect, the rest refitted. tolerated: per channel, the deviance that a flaw of
    tolerated size brings (median over the effects that touch it).
    """

    fit: Fit
    problem: Problem
    steps: tuple[Step, ...] = ()
    gains: dict[str, float] = field(default_factory=dict)
    earned: dict[str, float] = field(default_factory=dict)
    tolerated: dict[str, float] = field(default_factory=dict)


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
    for _ in range(MOST):
        fresh = [one for one in tried if one.effect not in fit.model]
        if scope != "wheels":
            fresh += placed(problem, fit.model)
        normal = linearise(problem, fit.model, fresh, scope)
        own = len(parameters_of(fit.model))
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
        steps.append(Step(f"add {name}", tuple((e, fit.cost - f.cost) for e, f in fits)))
        best, dropped = _drop(problem, best, scope)
        steps += [Step(f"drop {one}") for one in dropped]
        if "slip_patch" in best.model:
            best = _polished(problem, best, scope)
        problem = with_floor(problem, best.model)
        fit = refit(problem, best.model, scope)
    if "slip_patch" in fit.model:
        fit = _polished(problem, fit, scope, (0.04, 0.02, 0.01, 0.005, 0.002))
    return Found(fit, problem, tuple(steps), gains, _earned(problem, fit, scope), tolerated)


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
