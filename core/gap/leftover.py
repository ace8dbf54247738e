"""What the search left unexplained: how much, of what shape, and which causes may only have stood in for it."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from core.effects import EFFECTS
from core.gap.explain import Search
from core.gap.fit import refit
from core.gap.generic import TRIFLE
from core.gap.linear import HUBER
from core.gap.selection import Found
from core.gap.types import Unexplained
from core.gap.unknown import CHANCE, LEFTOVER, depends_on, rest_of, strange, strangeness, stream_of, touching, words
from core.gap.world import IMU


def chance_of_unknown(found: Search) -> float:
    """Probability that something is at work that no list has."""
    best = 0.0
    for scope, one in zip(("wheels", "body")[-len(found.links) :], found.links, strict=True):
        explained = sum(one.earned.values())
        if one.unknown is not None:
            best = max(best, strange(one.unknown[1], np.inf, CHANCE, explained))
        else:
            left = strangeness(found.rests[scope], _bar(found, one), explained)
            best = max(best, left, inexact(one), coloured(one)[1])
    return best


def inexact(one: Found, streams: Collection[str] | None = None) -> float:
    """Probability that a link's model only stands in for something else: by what it leaves beside what it explains.

    streams: of these alone, and of the effects that touch them; else of all.
    """
    normal = one.fit.normal
    here = np.array([streams is None or name in streams for name in normal.channels], dtype=bool)
    n, c = float(normal.n[here].sum()), float(normal.c[here].sum())
    explained = sum(v for name, v in one.earned.items() if streams is None or set(EFFECTS[name].streams) & set(streams))
    if c < LOUD * n or explained <= 0.0:
        return 0.0
    share = (_squares(c, n) - n) / (_squares(c + explained, n) - n)
    return 1.0 / (1.0 + (HALF / max(share, 1e-9)) ** 4)


def _squares(loss: float, n: float) -> float:
    """Sum of squares of n residuals of this loss: Huber's counts far ones by their size, not its square."""
    mean = loss / max(n, 1.0)
    return loss if mean <= HUBER**2 else n * ((mean + HUBER**2) / (2.0 * HUBER)) ** 2


def coloured(one: Found) -> tuple[str, float]:
    """The axis of the IMU that keeps most beyond its noise, of no shape that is known, and the probability that this is
    something unlisted: a mount that rings, a clock that wanders. Noise itself is measured, whatever its size."""
    normal, best = one.fit.normal, ("", 0.0)
    explained = sum(one.earned.values())
    for name, n, c in zip(normal.channels, normal.n.sum(axis=1), normal.c.sum(axis=1), strict=True):
        if name in IMU and c > LOUD * n:
            size = one.problem.floor.sigma[name] * float(np.sqrt(c / n - 1.0)) / (ROUGH * TRIFLE[name])
            best = max(best, (name, strange(float(c - n), size, CHANCE, explained)), key=lambda pair: pair[1])
    return best


ROUGH = 3.0
"""So many times what is immaterial of a shape may be left of an axis in jolts and edges."""


def rivalled(one: Found) -> dict[str, float]:
    """Probability per effect that a shape of no list is what it stands for: by what both bring, refitted.

    For a pair that was found together nothing is told: no single shape is the rival of two.
    """
    out = {}
    for step in one.steps:
        name = step.action.removeprefix("add ")
        own = dict(step.gains).get(name, 0.0)
        if name in one.fit.model and step.shape > 0.0 and own > 0.0:
            lead = own * AHEAD + SHAPES - step.shape
            out[name] = float(1.0 / (1.0 + np.exp(np.clip(lead / (2.0 * (1.0 + COARSE * own)), -40.0, 40.0))))
    return out


AHEAD, COARSE, SHAPES = 1.02, 0.0025, 15.0
"""A listed effect and a shape are as likely where the shape brings two hundredths more; shapes are known to an eighth
of that, for they are linear. There are dozens in a channel: a little is theirs by chance."""


LOUD, HALF = 1.5, 0.3
"""Mean square from which a rest is no matter of noise; and its share of all, explained and not, that makes a model as
likely as not to be another's stand-in."""


def _bar(found: Search, one: Found) -> float:
    """What a rest must bring: no model is exact to more than a share of what it explains."""
    crumbs = 0.01 * max((value for link in found.links for value in link.earned.values()), default=0.0)
    return max(CHANCE, min(crumbs, 0.1 * max(one.earned.values(), default=0.0) + 400.0))


def unknown_of(found: Search, material: Sequence[str]) -> tuple[Unexplained | None, dict[str, float]]:
    """What is left, and for each material effect the probability that it only stood in for something unlisted."""
    doubt: dict[str, float] = {}
    best: tuple[float, Unexplained] | None = None
    for scope, one in zip(("wheels", "body")[-len(found.links) :], found.links, strict=True):
        doubt |= {name: inexact(one, EFFECTS[name].streams) for name in one.fit.model if name in material}
        for name, chance in rivalled(one).items():
            if name in material:
                doubt[name] = max(doubt.get(name, 0.0), chance)
        if one.unknown is not None:
            shape, gain = one.unknown
            told = Unexplained(stream_of(shape), depends_on(shape), words(shape, gain, 1.0), 1.0)
            best = (gain, told) if best is None or gain > best[0] else best
            continue
        rest_shape, gain = found.rests[scope].best
        if rest_shape is None:
            continue
        shape = rest_shape
        stream = stream_of(shape)
        suspects = [name for name in touching(shape, list(one.fit.model)) if name in material]
        if gain <= max(_bar(found, one), LEFTOVER * sum(one.earned.values())):
            continue
        if suspects:
            rest = {name: values for name, values in one.fit.model.items() if name not in suspects}
            bare = refit(one.problem, rest, scope, 3)
            again = rest_of(one.problem, bare)
            shape_again, alone = again.best
            lost = bare.cost - one.fit.cost
            heat = 2.0 * (1.0 + 0.01 * lost)
            stand_in = 1.0 / (1.0 + float(np.exp(np.clip((lost - alone - gain * 0.5) / heat, -40.0, 40.0))))
            doubt |= {name: max(stand_in, doubt[name]) for name in suspects}
            if stand_in > 0.5 and shape_again is not None:
                shape, gain, stream = shape_again, alone, stream_of(shape_again)
        excess = max(found.rests[scope].excess.get(stream, gain), gain)
        share = float(min(gain / max(excess, 1e-9), 1.0))
        told = Unexplained(stream, depends_on(shape), words(shape, gain, share), share)
        if best is None or gain > best[0]:
            best = (gain, told)
    stream, chance = max((coloured(one) for one in found.links), key=lambda pair: pair[1])
    if best is None and chance > 0.5:
        text = f"{stream} keeps far more than its noise, of no shape known here"
        best = (0.0, Unexplained(stream, ("t",), text, 1.0))
    return (best[1] if best else None), doubt
