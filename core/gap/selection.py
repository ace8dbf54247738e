"""Which effects: forward by exact refit, with swaps and drops, so that a wrong first step can be undone."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from core.effects import EFFECTS
from core.gap.candidates import SEARCHED, Candidate
from core.gap.discrepancy import flaws
from core.gap.fit import FAR, Fit, fit_at, lost, parameters_of, refit, with_trifles, without
from core.gap.generic import Shape
from core.gap.linear import (
    HUBER,
    Model,
    Problem,
    cost_at,
    far_of,
    linearised,
    normal_equations,
    nuisances_of,
    secants_of,
    with_floor,
)
from core.gap.places import placed, polish, possible
from core.gap.promise import MATERIAL, best_of, crumbs_of, enough, excess, faint_of, least_of, tolerated_of
from core.gap.scatter import gyro_left, gyro_walk
from core.gap.screen import Screen
from core.gap.unknown import Rest, blocked_by, rest_of
from core.gap.visible import Sight
from core.robot import EffectSet

Array = npt.NDArray[np.float64]

MOST = 9
"""At most so many effects in one link's model."""
TRIED, ROUGH = 3, 2
"""So many of the best candidates are refitted at each step: smooth ones, and whole changes (a clip, a patch)."""
BRIEF = 3
"""Iterations of a fit that is only compared."""
WORTH = 24.0
"""Drop of the cost that an effect must bring: noise on fifty candidates stays below (see tests/bench/bench_gap.py)."""
WHEELS_WORTH = 120.0
"""The same of encoders: rounding at slow speed is no white noise."""
PRICE = 8.0
"""What a further parameter must bring (about the logarithm of the readings that say something of it)."""
PLACED = WORTH + 3.0 * PRICE
"""Drop that a patch or a bump must bring: its place was searched."""
POLISHED = 0.05
"""A patch that brings less than this per reading is not worth the search for its last centimetre."""


@dataclass(frozen=True)
class Step:
    """One step of the search: what was compared, best first (effect, drop of cost), and what was done.

    shape: what the best shape of no listed effect would have brought in the channels of the effect that was added.
    """

    action: str
    gains: tuple[tuple[str, float], ...] = ()
    shape: float = 0.0


@dataclass(frozen=True)
class Found:
    """The model of one link: its fit, the problem with the floor it left, the search's steps, the rivals' screening.

    unknown: a shape of no listed effect that took more than any of them, where the search met one. earned: rise of the
    cost without each effect, the rest refitted. tolerated: per channel, the deviance that a flaw of tolerated size
    brings (median over the effects that touch it). faint: by how much smooth effects that are not in the model promise
    less than they must bring.
    """

    fit: Fit
    problem: Problem
    steps: tuple[Step, ...] = ()
    gains: dict[str, float] = field(default_factory=dict)
    earned: dict[str, float] = field(default_factory=dict)
    unknown: tuple[Shape, float] | None = None
    tolerated: dict[str, float] = field(default_factory=dict)
    screen: Sight | None = None
    faint: dict[str, float] = field(default_factory=dict)


def search(
    problem: Problem,
    tried: Sequence[Candidate],
    scope: str,
    start: EffectSet | None = None,
    aside: Sequence[Candidate] = (),
) -> Found:
    """Add the effect that explains most, refit exactly, drop what is not needed; until nothing is worth it.

    aside: effects that are no candidates here, but may act within their tolerance.
    """
    worth = WHEELS_WORTH if scope == "wheels" else WORTH
    problem, fit = _begun(problem, tried, scope, start or {}, aside)
    steps, gains, tolerated = list[Step](), dict[str, float](), dict[str, float]()
    unknown: tuple[Shape, float] | None = None
    sight, clear, faint = None, frozenset[str](), dict[str, float]()
    for _ in range(MOST):
        fresh = _fresh(tried, fit, unknown)
        problem, fit, screen = screened(problem, fit, [*fresh, *aside], scope)
        sight = Sight(screen.a, screen.own, tuple(fresh))
        tolerated = tolerated or tolerated_of(screen, fresh)
        gain = screen.gains(fresh)
        paired = screen.pair(fresh, gain, PAIRED)
        if unknown is None and scope != "wheels":
            local, brings = _put(problem, fit, scope)
            fresh, gain = [*fresh, *local], np.concatenate((gain, brings))
        gains = best_of(fresh, gain)
        worth = max(worth, BESIDE * unknown[1]) if unknown is not None else worth
        clear |= screen.clear(fresh) if worth == WORTH else frozenset()
        needed = {name: MATERIAL if name in clear else PLACED if name in SEARCHED else worth for name in gains}
        chosen = _worthy(problem, fit, screen, (fresh, gain), needed, tolerated)
        faint = faint_of(problem, fit, screen, (fresh, gain)) if worth == WORTH else {}
        fits = _compared(problem, fit, chosen, scope) or _masked(problem, fit, fresh, paired, worth, scope)
        fits = fits or _late(problem, fit, fresh, worth, scope)
        name, best = min(fits, key=lambda item: _priced(item[1]), default=("", fit))
        if not fits or fit.cost - best.cost < min(needed[one] for one in name.split("+")):
            break
        weighed = tuple((n, _priced(fit) + PRICE - _priced(one)) for both, one in fits for n in both.split("+"))
        rest = rest_of(problem, fit) if unknown is None else None
        if rest is not None:
            unknown = _stranger(problem, rest, fit, best, paired[0])
            if unknown is None and _drowned(rest, name.split("+"), fit.cost - best.cost):
                break
            if unknown is not None:
                before = fit.model
                fit, unknown = _stood_in(problem, fit, unknown, scope)
                gone = {f"add {name}" for name in before if name not in fit.model}
                weighed = (*(pair for step in steps if step.action in gone for pair in step.gains), *weighed)
                steps.append(Step(f"unknown {unknown[0].key}", weighed))
                continue
        added = name.split("+")  # the two of a pair are no rivals of each other
        steps += [_added(one, added, weighed, 0.0 if rest is None else rest.rival(one, paired[0])) for one in added]
        best, dropped = _drop(problem, best, scope, worth, clear)
        steps += [Step(f"drop {one}") for one in dropped]
        best = _polished(problem, best, scope) if name == "slip_patch" else best
        problem = with_floor(problem, best.model)
        fit = refit(problem, best.model, scope)
    problem, fit = _ended(problem, fit, [*tried, *aside], scope)
    earned = _earned(problem, fit, scope, steps)
    return Found(fit, problem, tuple(steps), gains, earned, unknown, tolerated, sight, faint)


def _added(name: str, added: Sequence[str], weighed: Sequence[tuple[str, float]], shape: float) -> Step:
    return Step(f"add {name}", tuple(pair for pair in weighed if pair[0] == name or pair[0] not in added), shape)


def _begun(
    problem: Problem, tried: Sequence[Candidate], scope: str, start: EffectSet, aside: Sequence[Candidate]
) -> tuple[Problem, Fit]:
    """The problem with a model to begin with, of which only what is worth it is left."""
    names = {one.effect for one in tried} | (set() if scope == "wheels" else set(SEARCHED))
    fit = refit(problem, {name: dict(one) for name, one in start.items() if name in names}, scope)
    if fit.model:
        problem, fit, _ = screened(problem, fit, [*_fresh(tried, fit, None), *aside], scope)
        fit, _ = _drop(problem, fit, scope, WHEELS_WORTH if scope == "wheels" else WORTH, least=1)
    return problem, fit


def _compared(problem: Problem, fit: Fit, chosen: Sequence[Candidate], scope: str) -> list[tuple[str, Fit]]:
    """Each of the chosen, fitted beside the model."""
    fits = [(one.effect, refit(problem, {**fit.model, one.effect: dict(one.start)}, scope, BRIEF)) for one in chosen]
    return [(name, one) for name, one in fits if possible(problem, name, one.model)]


def _fresh(tried: Sequence[Candidate], fit: Fit, unknown: tuple[Shape, float] | None) -> list[Candidate]:
    """Candidates that are not in the model, nor in channels where an unknown cause is at work."""
    blocked = blocked_by(unknown[0]) if unknown is not None else frozenset()
    return [one for one in tried if one.effect not in fit.model and not blocked & set(EFFECTS[one.effect].streams)]


def _ended(problem: Problem, fit: Fit, tried: Sequence[Candidate], scope: str) -> tuple[Problem, Fit]:
    """A patch's last centimetre, the nuisances beside the last model, and the scatter between its blocks."""
    if "slip_patch" in fit.model and lost(fit, "slip_patch") > POLISHED * fit.normal.n.sum():
        fit = _polished(problem, fit, scope, (0.01, 0.005, 0.002))
    if not problem.nuisances.keys:
        problem, fit, _ = screened(problem, fit, [one for one in tried if one.effect not in fit.model], scope)
    return problem, fit_at(problem, fit.model, scope, scores=True)


def _worthy(
    problem: Problem,
    fit: Fit,
    screen: Screen,
    promised: tuple[Sequence[Candidate], Array],
    worth: Mapping[str, float],
    tolerated: Mapping[str, float],
) -> list[Candidate]:
    """Of candidates and their promised gains, those that are worth a fit."""
    fresh, gain = promised
    gains, left, crumbs, dim = best_of(fresh, gain), excess(fit), crumbs_of(problem, fit), screen.dim(fresh)
    return [
        one
        for one in _starts(fresh, gain, min(worth.values(), default=WORTH))
        if enough(
            one.effect, gains[one.effect], worth[one.effect], tolerated, left, crumbs if one.effect in dim else {}
        )
    ]


def screened(problem: Problem, fit: Fit, fresh: Sequence[Candidate], scope: str) -> tuple[Problem, Fit, Screen]:
    """All candidates about a fit; the problem with what is immaterial of them beside it, and the fit beside that."""
    white, normal = linearised(problem, fit.model, fresh, scope, more=flaws(problem, fit.model, scope))
    problem = dataclasses.replace(problem, nuisances=nuisances_of(white, normal))
    fit = refit(problem, fit.model, scope)
    if problem.nuisances.keys and far_of(white) > FAR:  # what trifles explain lies far off no more
        kept = without(white, problem.nuisances, fit.trifles)
        normal = normal_equations(white, normal.keys, normal.logs, judged=kept)
    whole = [i for i, key in enumerate(normal.keys) if "*" in key]
    secants = {}
    if whole:
        kept = [
            {n: dataclasses.replace(w, columns=w.columns[m], index=w.index[m]) for n, w in one.items() for m in
             [np.isin(w.index, whole)]}
            for one in without(white, problem.nuisances, fit.trifles)
        ]  # fmt: skip
        brings = secants_of(kept, len(normal.keys))
        secants = {i: float(brings[i]) for i in whole}
    return problem, fit, Screen.of(normal, len(parameters_of(fit.model)), fresh, secants)


def _put(problem: Problem, fit: Fit, scope: str) -> tuple[list[Candidate], Array]:
    """Patches and bumps that what is left speaks for, and what each would bring as it stands."""
    found = placed(problem, with_trifles(problem, fit))
    white, normal = linearised(problem, fit.model, found, scope, own=False)
    own = len(parameters_of(fit.model))
    return found, secants_of(without(white, problem.nuisances, fit.trifles), len(normal.keys))[own:]


BESIDE = 0.25
"""Beside an unknown cause an effect must bring this share of what its shape takes: no shape is the whole of a cause."""


def _priced(fit: Fit) -> float:
    return fit.cost + PRICE * len(fit.parameters)


def _masked(
    problem: Problem,
    fit: Fit,
    fresh: Sequence[Candidate],
    paired: tuple[float, tuple[str, str] | None],
    worth: float,
    scope: str,
) -> list[tuple[str, Fit]]:
    """Two effects that hide each other: worth it only together; none where there are no such."""
    gain, names = paired
    if names is None or gain < sum(least_of(name, worth, excess(fit), crumbs_of(problem, fit)) for name in names):
        return []
    starts = {one.effect: dict(one.start) for one in reversed(fresh) if one.effect in names}
    return [("+".join(names), refit(problem, {**fit.model, **starts}, scope, BRIEF))]


def _late(problem: Problem, fit: Fit, fresh: Sequence[Candidate], worth: float, scope: str) -> list[tuple[str, Fit]]:
    """A drive that is late by a good part of its moves: delay and lag together, from several starts.

    Far from neutral neither's derivative promises what it brings, and of what is late each takes but its part.
    """
    n, c = (float(part.sum()) for part in (fit.normal.n, fit.normal.c))
    if scope != "wheels" or c < HUBER**2 * n or not {one.effect for one in fresh} >= set(LATE):
        return []
    tried = [{name: {LATE[name]: by} for name in LATE} for by in (0.05, 0.3)]
    best = min((refit(problem, {**fit.model, **late}, scope, BRIEF) for late in tried), key=_priced)
    left = excess(fit)
    if fit.cost - best.cost < max(least_of(name, worth, left, {}) for name in LATE):
        return []
    return [("+".join(LATE), best)]


LATE = {"command_delay": "delay", "motor_lag": "tau"}


def _earned(problem: Problem, fit: Fit, scope: str, steps: Sequence[Step]) -> dict[str, float]:
    """Leaving each effect out in turn, of a smooth one by the fit's own equations; at most what it brought.

    Without it the whole may miss by far more: what is trusted now was not when the effect was added.
    """
    out = {}
    for name in fit.model:
        brought = [dict(step.gains)[name] for step in steps if step.action == f"add {name}"]
        without = lost(fit, name) if EFFECTS[name].smooth else 0.0
        if without < BENT * max(brought, default=0.0) or not EFFECTS[name].smooth:  # far from neutral the way bends
            rest = {k: v for k, v in fit.model.items() if k != name}
            without = max(refit(problem, rest, scope, 2).cost - fit.cost, 0.0)
        out[name] = min([without, *(gain for gain in brought if gain > 0.0)])
    return out


BENT = 0.5
"""An effect whose equations promise less than this share of what it brought is left out exactly."""


def _polished(problem: Problem, fit: Fit, scope: str, steps: Sequence[float] = (0.06, 0.03, 0.015)) -> Fit:
    """A slip patch whose edges have been moved one by one, then refitted."""

    def cost(values: Mapping[str, float | str]) -> float:
        return cost_at(problem, {**fit.model, "slip_patch": dict(values)}, scope)

    moved = polish(cost, fit.model["slip_patch"], steps)
    again = refit(problem, {**fit.model, "slip_patch": dict(moved)}, scope, BRIEF)
    return again if again.cost < fit.cost and possible(problem, "slip_patch", again.model) else fit


BEYOND, MARGIN = 1.02, 60.0
"""A shape that no listed effect has must beat the best of them by this factor and drop of deviance."""
PAIRED = 8
"""So many of the best candidates are also tried in pairs."""


def _drowned(rest: Rest, added: Sequence[str], gain: float) -> bool:
    """Whether a shape of no listed effect, though immaterial, does clearly more than effects that bring little."""
    streams = {stream for name in added for stream in EFFECTS[name].streams}
    more = max((value for shape, value in rest.shapes if blocked_by(shape) & streams), default=0.0)
    return gain < min(DROWNED * more, LITTLE)


DROWNED, LITTLE = 0.7, 10.0 * WORTH
"""An effect must bring this share of what the best shape in its channels does, unless it brings more than a little."""


def _stranger(problem: Problem, rest: Rest, fit: Fit, best: Fit, pair: float) -> tuple[Shape, float] | None:
    """A shape that takes more than the best listed effect, the best two, and a walking gyro bias; else None."""
    listed = max(fit.cost - best.cost, pair)
    shape, gain = rest.best
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


def _starts(tried: Sequence[Candidate], gain: Array, worth: float) -> list[Candidate]:
    """The best start of each of the best effects: some that are smooth, some whose promise is rough."""
    order = [int(k) for k in np.argsort(-gain)]
    out: list[Candidate] = []
    for rough, most in ((False, TRIED), (True, ROUGH)):
        kind = [k for k in order if tried[k].secant == rough]
        for k in kind:
            if gain[k] < max(min(WORTH, worth), 0.2 * gain[kind[0]]) or sum(one.secant == rough for one in out) >= most:
                break
            if all(one.effect != tried[k].effect for one in out):
                out.append(tried[k])
    return out


def _drop(
    problem: Problem, fit: Fit, scope: str, worth: float, clear: Collection[str] = (), least: int = 2
) -> tuple[Fit, list[str]]:
    """Without every effect that the others can do without; a model of fewer than `least` stays.

    clear: effects that need only be material.
    """
    dropped: list[str] = []
    for name in list(fit.model):
        if len(fit.model) < least:
            break
        rest: Model = {k: v for k, v in fit.model.items() if k != name}
        if lost(fit, name) > 50.0 * WORTH:
            continue
        without = refit(problem, rest, scope)
        if without.cost - fit.cost < (MATERIAL if name in clear else worth):
            fit = without
            dropped.append(name)
    return fit, dropped
