"""Exact refit of a model's parameters: Levenberg-Marquardt with bounds on white residuals, relinearised each step.

Beside the parameters stand the problem's nuisances, linear and at their best for every value of the parameters.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.effects import EFFECTS
from core.gap.candidates import STEPS, bounds, free_of
from core.gap.linear import (
    BLOCK,
    HUBER,
    LOCAL,
    Model,
    Normal,
    Problem,
    White,
    columns_of,
    far_of,
    normal_equations,
    whitened,
)
from core.gap.nuisance import DRIFT, Nuisances, bounded
from core.robot import EffectSet

Array = npt.NDArray[np.float64]

ITERATIONS = 8
SPREAD = 16.0
"""How much wider than `STEPS` the first look at an edge is."""
GAINED = 0.3
"""A step that lowers the cost by less than this ends the fit: a third of what noise does to one parameter."""
BRINGS = 0.02
"""A brief fit goes on while a step brings this share of all that it brought."""
MARGIN = 1e-3
"""Parameters stay this share of a step inside their bounds."""


@dataclass(frozen=True)
class Fit:
    """A model at its best parameters in one scope: cost = -2 log likelihood up to a constant, and its equations.

    normal: over the model's own columns, the nuisances' part taken out of the residual. g, a: sums over everything, the
    nuisances marginalised. trifles: the nuisances' sizes. joint: products, the residual's products, sd and limit over
    own columns and nuisances together: a step's problem. scores (B, P): g by block of time, where asked for.
    """

    model: Model
    cost: float
    normal: Normal
    scope: str
    g: Array
    a: Array
    trifles: Array
    joint: tuple[Array, Array, Array, Array]
    scores: Array | None = None

    @property
    def parameters(self) -> tuple[tuple[str, str], ...]:
        """(effect, parameter) of each column."""
        return parameters_of(self.model)


def parameters_of(model: EffectSet) -> tuple[tuple[str, str], ...]:
    """(effect, parameter) of every free number, in the order of the columns."""
    return tuple((effect, name) for effect, values in model.items() for name in free_of(effect, values))


def cost_of(normal: Normal) -> float:
    """-2 log likelihood up to a constant."""
    return float(normal.c.sum()) + normal.logs


def refit(problem: Problem, model: EffectSet, scope: str, iterations: int = ITERATIONS) -> Fit:
    """The model's parameters in this scope at their best; those of effects outside the scope stay.

    iterations: so many, and more while each still brings a good part (far residuals come down step by step).
    """
    inside = {name: values for name, values in problem.overlay(model, scope).items() if name not in problem.held}
    wide = any(f"{effect}.{name}" in LOCAL for effect, name in parameters_of(inside))
    spreads = [SPREAD / 2.0**k for k in range(5)] if wide else [1.0]
    best = fit_at(problem, inside, scope, spreads[0])
    if not best.parameters:
        return best
    damping, first, last = 1e-4, best.cost, 0.0
    for k in range(max(iterations, ITERATIONS) + len(spreads) - 1):
        if k >= iterations + len(spreads) - 1 and last < BRINGS * (first - best.cost):
            break
        spread = spreads[min(k + 1, len(spreads) - 1)]
        moved = _step(best, damping)
        if moved is None:
            break
        tried = fit_at(problem, moved, scope, spread)
        if not np.isfinite(tried.cost) or tried.cost > best.cost:
            damping, last = damping * 30.0, 0.0
            if damping > 1e4:
                break
            if k + 1 < len(spreads):  # look again from where we are, less wide
                best = dataclasses.replace(fit_at(problem, best.model, scope, spread), cost=best.cost)
            continue
        gained = last = best.cost - tried.cost
        best = tried
        damping = max(damping / 10.0, 1e-6)
        if gained < GAINED and k + 1 >= len(spreads):
            break
    return best


def fit_at(problem: Problem, inside: Model, scope: str, spread: float = 1.0, scores: bool = False) -> Fit:
    """A model as it stands, its nuisances at their best."""
    columns = columns_of(inside, (), spread)
    white, logs = whitened(problem, inside, columns, scope)
    nuisances = problem.nuisances
    beside = np.flatnonzero(nuisances.beside(list(inside)))
    at = np.zeros(len(nuisances.keys))
    sd, limit = nuisances.sd[beside], nuisances.limit[beside]
    if len(beside):
        pull, inner = _pull(white, nuisances), _inner(white, nuisances)
        at[beside], _ = bounded(inner[np.ix_(beside, beside)], pull[beside], sd, limit)
        white = without(white, nuisances, at)
        logs += float(np.sum((at[beside] / sd) ** 2))
    normal = normal_equations(white, [one.key for one in columns], logs, by_block=scores)
    _, g, a = normal.total
    share = np.zeros((len(columns), 0))
    aside = _cross(white, nuisances, len(columns))[:, beside] if len(beside) else np.zeros((len(columns), 0))
    product = _inner(white, nuisances, exact=scores)[np.ix_(beside, beside)]
    joint = _joint(g, a, aside, nuisances, beside, at[beside], _pull(white, nuisances)[beside], product)
    if len(beside) and len(columns):  # those at their limits too: which of them are is chance as well
        inner = product + np.diag(sd**-2.0)
        size = np.sqrt(np.diag(inner))
        share = np.linalg.solve(inner / np.outer(size, size), (aside / size).T).T / size
        a = a - share @ aside.T
    parts = normal.g.sum(axis=0) if scores else None
    if parts is not None and len(beside) and len(columns):
        parts = parts - _by_block(white, nuisances, normal)[:, beside] @ share.T
    return Fit(inside, cost_of(normal), normal, scope, g, a, at, joint, parts)


def with_trifles(problem: Problem, fit: Fit) -> Model:
    """The model together with its nuisances at their best, as effects; of moved beacons none."""
    out: Model = {name: dict(values) for name, values in fit.model.items()}
    nuisances = problem.nuisances
    for key, effect, size in zip(nuisances.keys, nuisances.effects, fit.trifles, strict=True):
        if effect in fit.model or effect == "anchor_moved" or size == 0.0 or key.startswith("~"):
            continue
        name, _, start = key.partition("@")
        values = out.setdefault(effect, {**EFFECTS[effect].neutral, **problem.known.get(effect, {})})
        parameter = name.split(".")[1]
        low, high = bounds(effect, parameter)
        values[parameter] = float(np.clip(float(values[parameter]) + size, low, high))
        if effect == "gyro_drift":
            values["tau"] = float(start or DRIFT)
    return out


def _joint(
    g: Array,
    a: Array,
    aside: Array,
    nuisances: Nuisances,
    beside: npt.NDArray[np.int64],
    at: Array,
    left: Array,
    inner: Array,
) -> tuple[Array, Array, Array, Array]:
    """Own parameters' steps and the nuisances' whole sizes as one bounded problem."""
    whole = np.block([[a, aside], [aside.T, inner]])
    pull = np.concatenate((g + aside @ at, left + inner @ at))
    far = np.full(len(g), np.inf)
    return whole, pull, np.concatenate((far, nuisances.sd[beside])), np.concatenate((far, nuisances.limit[beside]))


def lost(fit: Fit, name: str) -> float:
    """Rise of the cost without an effect, to second order: the others and the nuisances, within their limits, give way.

    0 where the effect has no neutral value to go to.
    """
    whole, pull, sd, limit = fit.joint
    mine = np.array([i for i, (effect, _) in enumerate(fit.parameters) if effect == name], dtype=np.int64)
    shift = [
        float(EFFECTS[effect].parameter(parameter).neutral) - float(fit.model[effect][parameter])
        for effect, parameter in (fit.parameters[i] for i in mine)
    ]
    if not np.isfinite(shift).all():
        return 0.0
    rest, far = np.setdiff1d(np.arange(len(pull)), mine), np.array(shift)
    cross = whole[np.ix_(rest, mine)] @ far
    without = bounded(whole[np.ix_(rest, rest)], pull[rest] - cross, sd[rest], limit[rest])[1]
    there = float(2.0 * pull[mine] @ far - far @ whole[np.ix_(mine, mine)] @ far)
    return max(bounded(whole, pull, sd, limit)[1] - without - there, 0.0)


CLEAR = 3.0
"""A nuisance this many standard deviations from nothing is told, as immaterial."""


def trifles_of(problem: Problem, fit: Fit) -> dict[str, dict[str, tuple[float, float]]]:
    """Effects that are real but within their tolerance: parameters with standard deviations."""
    nuisances = problem.nuisances
    beside = np.flatnonzero(nuisances.beside(list(fit.model)))
    if not len(beside):
        return {}
    sd = _spread(nuisances, beside)
    clear = {nuisances.effects[i] for i, s in zip(beside, sd, strict=True) if abs(fit.trifles[i]) > CLEAR * s}
    out: dict[str, dict[str, tuple[float, float]]] = {}
    whole = with_trifles(problem, fit)
    for i, s in zip(beside, sd, strict=True):
        effect, name = nuisances.effects[i], nuisances.keys[i].split("@")[0].split(".")[1]
        if effect in clear and effect in whole and effect not in CROWDED:
            out.setdefault(effect, {})[name] = (float(whole[effect][name]), float(s))
    return out


def flaws_seen(problem: Problem, fit: Fit) -> list[tuple[float, float]]:
    """Size and standard deviation of every flaw of no effect, in units of what is immaterial."""
    nuisances = problem.nuisances
    beside = np.flatnonzero(nuisances.beside(list(fit.model)))
    pairs = zip(beside, _spread(nuisances, beside), strict=True)
    return [(float(fit.trifles[i]), float(s)) for i, s in pairs if nuisances.keys[i].startswith("~")]


def flaws_of(problem: Problem, fit: Fit) -> dict[str, float]:
    """Sizes of those flaws of no effect that are clear of nothing, by key."""
    nuisances = problem.nuisances
    beside = np.flatnonzero(nuisances.beside(list(fit.model)))
    pairs = zip(beside, _spread(nuisances, beside), strict=True)
    clear = [i for i, s in pairs if nuisances.keys[i].startswith("~") and abs(fit.trifles[i]) > CLEAR * s]
    return {nuisances.keys[i]: float(fit.trifles[i]) for i in clear}


def _spread(nuisances: Nuisances, beside: npt.NDArray[np.int64]) -> Array:
    """Standard deviations of these nuisances beside each other."""
    if not len(beside):
        return np.zeros(0)
    inner = nuisances.a[np.ix_(beside, beside)] + np.diag(nuisances.sd[beside] ** -2.0)
    size = np.sqrt(np.diag(inner))
    out: Array = np.sqrt(np.diag(np.linalg.inv(inner / np.outer(size, size)))) / size
    return out


CROWDED = ("gyro_drift", "anchor_moved")
"""Nuisances of many columns, of which no one is told."""


def _weight(residual: Array) -> Array:
    out: Array = HUBER / np.maximum(np.abs(residual), HUBER)
    return out


def _pull(white: Sequence[Mapping[str, White]], nuisances: Nuisances) -> Array:
    """(M,) products of the nuisances' columns and the residual."""
    out = np.zeros(len(nuisances.keys))
    for one, rows in zip(white, nuisances.rows, strict=False):  # no rows where there are no nuisances
        for name, (columns, index) in rows.items():
            if name in one:
                residual = one[name].residual
                out[index] += columns @ (residual * _weight(residual))
    return out


FAR = 0.01
"""Where more than this share of the readings lies far off, or did, products are taken with today's weights."""


def _inner(white: Sequence[Mapping[str, White]], nuisances: Nuisances, exact: bool = False) -> Array:
    """(M, M) products of the nuisances' columns, weighted as the residual asks for; exact: whatever that brings."""
    if not exact and max(nuisances.far, far_of(white)) < FAR:
        return nuisances.a
    out = np.zeros_like(nuisances.a)
    for one, rows in zip(white, nuisances.rows, strict=False):
        for name, (columns, index) in rows.items():
            if name in one:
                out[np.ix_(index, index)] += (columns * _weight(one[name].residual)) @ columns.T
    return out


def without(white: Sequence[Mapping[str, White]], nuisances: Nuisances, at: Array) -> list[dict[str, White]]:
    """The same with the nuisances' part taken out of the residual."""
    out = []
    for one, rows in zip(white, nuisances.rows, strict=True):
        kept = dict(one)
        for name, (columns, index) in rows.items():
            if name in one:
                kept[name] = dataclasses.replace(one[name], residual=one[name].residual - at[index] @ columns)
        out.append(kept)
    return out


def _cross(white: Sequence[Mapping[str, White]], nuisances: Nuisances, own: int) -> Array:
    """(own, M) products of own columns and the nuisances'."""
    out = np.zeros((own, len(nuisances.keys)))
    for one, rows in zip(white, nuisances.rows, strict=True):
        for name, (columns, index) in rows.items():
            if name in one and len(one[name].index):
                w = one[name]
                out[np.ix_(w.index, index)] += (w.columns * _weight(w.residual)) @ columns.T
    return out


def _by_block(white: Sequence[Mapping[str, White]], nuisances: Nuisances, normal: Normal) -> Array:
    """(B, M) products of the nuisances' columns and the residual in each block of time."""
    place = {(int(run), float(start)): k for k, (run, start) in enumerate(normal.blocks)}
    out = np.zeros((len(normal.blocks), len(nuisances.keys)))
    for k, (one, rows) in enumerate(zip(white, nuisances.rows, strict=True)):
        for name, (columns, index) in rows.items():
            if name not in one or not len(one[name].t):
                continue
            w = one[name]
            number = np.floor(np.maximum(w.t, 0.0) / BLOCK)
            cuts = np.flatnonzero(np.diff(number, prepend=-1.0))
            sums = np.add.reduceat(columns * (w.residual * _weight(w.residual)), cuts, axis=1)
            for j, cut in enumerate(cuts):
                out[place[(k, float(number[cut] * BLOCK))], index] += sums[:, j]
    return out


def _step(fit: Fit, damping: float) -> Model | None:
    """Parameters after one damped step, inside their bounds."""
    whole, pull, sd, limit = fit.joint
    own = np.arange(len(fit.parameters))
    damped = whole.copy()
    damped[own, own] *= 1.0 + damping
    step = bounded(damped, pull, sd, limit)[0][own]
    if not np.isfinite(step).all():
        return None
    moved: Model = {name: dict(values) for name, values in fit.model.items()}
    changed = False
    for (effect, name), change in zip(fit.parameters, step, strict=True):
        low, high = bounds(effect, name)
        inside = MARGIN * STEPS[f"{effect}.{name}"]
        old = float(moved[effect][name])
        new = float(
            np.clip(
                old + _bounded(effect, name, change),
                low if EFFECTS[effect].parameter(name).neutral == low else low + inside,
                high - inside,
            )
        )
        changed |= new != old
        moved[effect][name] = new
    return moved if changed else None


LEAP = {
    "slip_patch.x": 0.3,
    "slip_patch.y": 0.3,
    "slip_patch.radius": 0.3,
    "bump.time": 0.1,
    "gyro_drift.tau": 60.0,
    "command_delay.delay": 0.1,
    "motor_lag.tau": 0.1,
    "beacon_delay.delay": 0.3,
    "imu_clock.offset": 0.05,
    "deadband.width": 0.02,
}
"""Longest step of parameters whose response bends."""


def _bounded(effect: str, name: str, change: float) -> float:
    longest = LEAP.get(f"{effect}.{name}", np.inf)
    return float(np.clip(change, -longest, longest))
