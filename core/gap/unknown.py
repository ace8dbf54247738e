"""What no listed effect explains: the generic shape that explains most of the rest, against the effects it rivals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from core.effects import EFFECTS
from core.effects.base import BODY_STREAMS
from core.gap.fit import Fit, without
from core.gap.generic import TRIFLE, Shape, generic_columns
from core.gap.linear import HUBER, Problem, White, columns_of, loss, whitened
from core.gap.nuisance import Nuisances, bounded

Array = npt.NDArray[np.float64]


CHANCE = 45.0
"""Drop of deviance that the best of two hundred shapes may bring by chance and small flaws."""


@dataclass(frozen=True)
class Rest:
    """Shapes by the drop of the cost that each would bring beside a model, best first; excess by channel.

    sizes: root mean square of each shape over what is immaterial on its channel, by its key.
    """

    shapes: tuple[tuple[Shape, float], ...]
    excess: dict[str, float]
    sizes: dict[str, float] = field(default_factory=dict)

    @property
    def best(self) -> tuple[Shape | None, float]:
        """The best shape of material size, and its drop."""
        for shape, gain in self.shapes:
            if self.sizes.get(shape.key, 0.0) > 1.0:
                return shape, gain
        return None, 0.0

    def rival(self, effect: str, pair: float) -> float:
        """What the best shape of material size brings in an effect's channels; 0 where two listed effects bring more.

        pair: what those bring.
        """
        mine = set(EFFECTS[effect].streams)
        shapes = [(v, s) for s, v in self.shapes if blocked_by(s) & mine and self.sizes.get(s.key, 0.0) > 1.0]
        brings = max((value for value, _ in shapes), default=0.0)
        return brings if brings > pair else 0.0


def rest_of(problem: Problem, fit: Fit) -> Rest:
    """All shapes beside a fitted model, the model's own parameters and the nuisances free to give way."""
    own = columns_of(fit.model, ())
    white, _ = whitened(problem, fit.model, own, fit.scope)
    nuisances = problem.nuisances
    beside = np.flatnonzero(nuisances.beside(list(fit.model)))
    beside = beside[np.abs(fit.trifles[beside]) < nuisances.limit[beside] * (1.0 - 1e-9)]
    white = without(white, nuisances, fit.trifles)
    shapes, generic, sizes = generic_columns(problem, fit.model, fit.scope)
    m, count, more = len(own), len(shapes), len(nuisances.keys)
    score, info = np.zeros(count), np.zeros(count)
    cross, aside = np.zeros((count, m + more)), np.zeros((m, more))
    base, inside, left_over = np.zeros(m), np.zeros((m, m)), np.zeros(more)
    for mine, theirs, flaws in zip(white, generic, nuisances.rows or ({},) * len(white), strict=True):
        for name, one in mine.items():
            weight = HUBER / np.maximum(np.abs(one.residual), HUBER)
            flaw, place = flaws.get(name, (np.zeros((0, len(weight))), np.zeros(0, dtype=np.int64)))
            left_over[place] += flaw @ (weight * one.residual)
            if len(one.index):
                weighted = one.columns * weight
                base[one.index] += weighted @ one.residual
                inside[np.ix_(one.index, one.index)] += weighted @ one.columns.T
                if len(place):
                    aside[np.ix_(one.index, place)] += weighted @ flaw.T
            if name in theirs:
                other = theirs[name]
                weighted = other.columns * weight
                score[other.index] += weighted @ one.residual
                info[other.index] += np.einsum("ij,ij->i", weighted, other.columns)
                if len(one.index):
                    cross[np.ix_(other.index, one.index)] += weighted @ one.columns.T
                if len(place):
                    cross[np.ix_(other.index, m + place)] += weighted @ flaw.T
    kept = np.concatenate((np.arange(m), m + beside)).astype(int)
    alone, _, _ = _taken(score, info, cross[:, :m], inside, base)
    whole = np.zeros((len(kept), len(kept)))
    whole[:m, :m], whole[:m, m:], whole[m:, :m] = inside, aside[:, beside], aside[:, beside].T
    whole[m:, m:] = nuisances.a[np.ix_(beside, beside)] + np.diag(nuisances.sd[beside] ** -2.0)
    pull = np.concatenate((base, np.zeros(len(beside))))
    gain, weight_of, left = _taken(score, info, cross[:, kept], whole, pull)
    part = np.sqrt(np.clip(left, 0.0, None) / np.maximum(info, 1e-12))  # what listed effects cannot do in its stead
    size = np.abs(weight_of) * part * np.array([sizes.get(shape.key, np.inf) for shape in shapes])
    limit = np.array([TRIFLE.get(shape.channel, 0.0) for shape in shapes])
    order = np.argsort(-gain)[:12]
    gain[order] = np.minimum(
        gain[order], _within(nuisances, fit, (base, left_over, inside, aside), score, info, cross, order)
    )
    exact = [
        gain[i] if k >= REFITTED else gain[i] * min(_exact(white, generic, int(i), m) / max(alone[i], 1e-9), 50.0)
        for k, i in enumerate(order)
    ]
    n, c = float(fit.normal.n.sum()), float(fit.normal.c.sum())
    if c > 2.0 * n:  # far residuals, little weighed, promise more than there is
        exact = [min(value, c - LEAST * n) for value in exact]
        for k in np.argsort(-np.array(exact))[:REFITTED]:
            exact[k] = min(exact[k], _among(white, generic, int(order[k]), m, fit, nuisances))
    ranked = sorted(zip(order.tolist(), exact, strict=True), key=lambda pair: -pair[1])
    excess = {name: float(sum(fit.normal.c[i]) - sum(fit.normal.n[i])) for i, name in enumerate(fit.normal.channels)}
    told = tuple((shapes[i], float(value)) for i, value in ranked if value > 0.0)
    return Rest(told, excess, {shapes[i].key: float(size[i] / max(limit[i], 1e-12)) for i in order})


def _within(
    nuisances: Nuisances, fit: Fit, known: tuple[Array, Array, Array, Array], score: Array, info: Array, cross: Array,
    chosen: npt.NDArray[np.int64],
) -> Array:  # fmt: skip
    """What nuisances within their tolerances leave to the chosen shapes. known: own and nuisances' pulls, products."""
    base, left, inside, aside = known
    m, every = len(base), np.flatnonzero(nuisances.beside(list(fit.model)))
    at = fit.trifles[every]
    rest = np.block([[inside, aside[:, every]], [aside[:, every].T, nuisances.a[np.ix_(every, every)]]])
    far = np.concatenate((base + aside[:, every] @ at, left[every] + rest[m:, m:] @ at))
    sd, top = (np.concatenate((np.full(m, np.inf), one[every])) for one in (nuisances.sd, nuisances.limit))
    before = bounded(rest, far, sd, top)[1]
    out = []
    for i in chosen:
        side = cross[i, np.concatenate((np.arange(m), m + every)).astype(int)]
        both = np.block([[rest, side[:, None]], [side[None, :], np.array([[info[i]]])]])
        pulls = np.append(far, score[i] + side[m:] @ at)
        out.append(max(bounded(both, pulls, np.append(sd, np.inf), np.append(top, np.inf))[1] - before, 0.0))
    return np.array(out)


def _taken(score: Array, info: Array, cross: Array, inside: Array, pull: Array) -> tuple[Array, Array, Array]:
    """Per shape the drop of the cost, its weight, and its information, all others free to give way."""
    left = info.copy()
    if len(pull):
        size = np.sqrt(np.maximum(np.diag(inside), 1e-30))
        inverse = np.linalg.pinv(inside / np.outer(size, size), rcond=1e-12) / np.outer(size, size)
        score = score - cross @ (inverse @ pull)
        left = info - np.einsum("ij,ij->i", cross @ inverse, cross)
    fine = left > 1e-4 * np.maximum(info, 1e-12)
    weight = np.where(fine, score / np.maximum(left, 1e-12), 0.0)
    return np.where(fine, score * weight, 0.0), weight, left


LEAST = 0.8
"""No model leaves less than this mean square: encoders' rounding is a little less than their noise."""
REFITTED, ROUNDS = 3, 6
"""So many of the best shapes are fitted to Huber's loss itself, by so many rounds of reweighted least squares."""


def _exact(white: Sequence[Mapping[str, White]], generic: Sequence[Mapping[str, White]], shape: int, own: int) -> float:
    """Drop of the loss by one shape and the model's own parameters together."""
    parts = []
    for mine, theirs in zip(white, generic, strict=True):
        for name, one in mine.items():
            columns = np.zeros((own + 1, len(one.t)))
            columns[one.index] = one.columns
            if name in theirs and (theirs[name].index == shape).any():
                columns[own] = theirs[name].columns[theirs[name].index == shape].sum(axis=0)
            if len(one.index) or columns[own].any():
                parts.append((one.residual, columns))
    at, best = np.zeros(own + 1), 0.0
    before = sum(float(np.sum(loss(r))) for r, _ in parts)
    for _ in range(ROUNDS):
        a, g = np.zeros((own + 1, own + 1)), np.zeros(own + 1)
        for r, e in parts:
            weighted = e * (HUBER / np.maximum(np.abs(r - at @ e), HUBER))
            a += weighted @ e.T
            g += weighted @ r
        size = np.sqrt(np.maximum(np.diag(a), 1e-30))
        at = np.linalg.lstsq(a / np.outer(size, size), g / size, rcond=1e-12)[0] / size
        best = max(best, before - sum(float(np.sum(loss(r - at @ e))) for r, e in parts))
    return best


def _among(
    white: Sequence[Mapping[str, White]],
    generic: Sequence[Mapping[str, White]],
    shape: int,
    own: int,
    fit: Fit,
    nuisances: Nuisances,
) -> float:
    """Drop of the cost by one shape with all that stands beside it, nuisances within their limits.

    white: the residual beside the nuisances as fitted, which is where this begins.
    """
    beside = np.flatnonzero(nuisances.beside(list(fit.model)))
    count, place = own + len(beside) + 1, np.full(len(nuisances.keys), -1)
    place[beside] = own + np.arange(len(beside))
    at = np.concatenate((np.zeros(own), fit.trifles[beside], [0.0]))
    sd, limit = (np.concatenate((np.full(own, np.inf), v[beside], [np.inf])) for v in (nuisances.sd, nuisances.limit))
    parts = []
    for mine, theirs, flaws in zip(white, generic, nuisances.rows or ({},) * len(white), strict=True):
        for name, one in mine.items():
            index, columns = [one.index], [one.columns]
            if name in flaws:
                kept = place[flaws[name][1]] >= 0
                index.append(place[flaws[name][1]][kept])
                columns.append(flaws[name][0][kept])
            if name in theirs and (theirs[name].index == shape).any():
                index.append(np.array([count - 1]))
                columns.append(theirs[name].columns[theirs[name].index == shape].sum(axis=0, keepdims=True))
            every, rows = np.concatenate(index).astype(int), np.concatenate(columns)
            parts.append((one.residual + at[every] @ rows, every, rows))

    def cost(x: Array) -> float:
        lost = sum(float(np.sum(loss(r - x[i] @ e))) for r, i, e in parts)
        return lost + float(np.sum((x / sd) ** 2))

    before = best = cost(at)
    for _ in range(ROUNDS):
        a, g = np.zeros((count, count)), np.zeros(count)
        for r, i, e in parts:
            weighted = e * (HUBER / np.maximum(np.abs(r - at[i] @ e), HUBER))
            a[np.ix_(i, i)] += weighted @ e.T
            g[i] += weighted @ r
        at = bounded(a, g, sd, limit)[0]
        best = min(best, cost(at))
    return before - best


STEEP = 2.0
"""How fast doubt turns into belief, per e-fold of what a shape brings over what it must."""


LEFTOVER = 0.03
"""Of what listed effects explain of a link, a rest below this share is how inexact they are: a sixth of their size."""


def strange(gain: float, size: float, bar: float, explained: float) -> float:
    """Probability that a shape is something unlisted: by its drop of deviance over what it must bring, by its size over
    what is immaterial, and by its share of what listed effects explain beside it.
    """
    share = gain / max(gain + explained, 1e-9)
    over = min(np.log(max(gain, 1e-9) / bar), 2.0 * np.log(max(size, 1e-9)), np.log(max(share, 1e-9) / LEFTOVER))
    return float(SURELY / (1.0 + np.exp(-STEEP * np.clip(over, -10.0, 10.0))))


def strangeness(rest: Rest, bar: float = CHANCE, explained: float = 0.0) -> float:
    """Probability that something unlisted of material size is left. bar: drop of deviance that a shape must bring;
    explained: what listed effects have taken."""
    every = [strange(gain, rest.sizes.get(shape.key, 0.0), bar, explained) for shape, gain in rest.shapes]
    return max(every, default=0.0)


SURELY = 0.98
"""No probability of an unknown is higher."""


def touching(shape: Shape, model: Sequence[str]) -> list[str]:
    """Effects of a model that could have taken what is the shape's."""
    streams = {"body.w": "imu.gz", "body.v": "truth.x", "body.vy": "imu.ay"}
    stream = streams.get(shape.channel, shape.channel)
    return [name for name in model if stream in EFFECTS[name].streams]


def blocked_by(shape: Shape) -> frozenset[str]:
    """Channels in which an unknown cause of this shape is at work: nothing listed is named for them."""
    if not shape.channel.startswith("body"):
        return frozenset((shape.channel,))
    return frozenset(BODY_STREAMS)


def words(shape: Shape, gain: float, share: float) -> str:
    """One sentence about a shape."""
    part = {
        "body.w": "the body turns other than its wheels say",
        "body.v": "the body drives other than its wheels say",
        "body.vy": "the body slides sideways",
    }.get(shape.channel, f"{shape.channel} is off")
    return (
        f"{part}, like {shape.text}; that shape takes {share:.0%} of what is left there (drop of deviance {gain:.0f})"
    )


def stream_of(shape: Shape) -> str:
    """The stream that shows a shape best."""
    return {"body.w": "imu.gz", "body.v": "truth.x", "body.vy": "imu.ay"}.get(shape.channel, shape.channel)


REGRESSORS = {
    "w": "truth.w", "v": "truth.v", "a": "truth.a", "alpha": "truth.alpha", "t": "t", "temperature": "imu.temperature",
    "theta": "truth.theta", "x": "truth.x", "y": "truth.y", "range": "ranges.range",
}  # fmt: skip


def depends_on(shape: Shape) -> tuple[str, ...]:
    """Regressors in the words of gap/1."""
    found = [REGRESSORS.get(shape.regressor, shape.regressor)]
    for token, name in (
        ("·t", "t"),
        ("t²", "t"),
        ("place", "truth.y"),
        ("temperature", "imu.temperature"),
        ("w", "truth.w"),
        ("v", "truth.v"),
    ):
        if token in shape.text and name not in found:
            found.append(name)
    return tuple(found)
