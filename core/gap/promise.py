"""What an effect's promise must be, for it to be worth a fit: a part of what is left, more than immaterial shapes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from core.effects import EFFECTS
from core.gap.candidates import Candidate
from core.gap.fit import Fit
from core.gap.generic import TRIFLE
from core.gap.linear import HUBER, Problem
from core.gap.screen import Screen
from core.gap.world import IMU, WHEELS

Array = npt.NDArray[np.float64]

MATERIAL = 12.0
"""Drop of the cost, beyond its own tolerance, of an effect that is there beyond chance."""
LIMITS = ("speed_limit", "accel_limit", "gyro_clip")
CRUMB, TAKES = 0.25, {"wheels": 0.4, "body": 0.15}
"""A limit must bring this share of what tolerated flaws would; an effect, such a share of what its channels leave."""


def excess(fit: Fit) -> dict[str, float]:
    """What a fit leaves of each channel above its noise."""
    n, c = fit.normal.n.sum(axis=1), fit.normal.c.sum(axis=1)
    over = np.maximum(c - n - 4.0 * np.sqrt(2.0 * n), 0.0)
    over = np.where(c > HUBER**2 * n, 0.5 * over, over)  # linear there: a share of the squares is half of it
    return dict(zip(fit.normal.channels, over.tolist(), strict=True))


def crumbs_of(problem: Problem, fit: Fit) -> dict[str, float]:
    """Per IMU axis, the deviance that a shape of immaterial size brings."""
    n = dict(zip(fit.normal.channels, fit.normal.n.sum(axis=1).tolist(), strict=True))
    return {name: n[name] * (TRIFLE[name] / problem.floor.sigma[name]) ** 2 for name in IMU if name in n}


def enough(
    effect: str,
    gain: float,
    worth: float,
    tolerated: Mapping[str, float],
    left: Mapping[str, float],
    crumbs: Mapping[str, float],
) -> bool:
    """Whether an effect's promise is worth a fit.

    It must take a good part of what is left of the channels that it moves: where little is taken, something else is at
    work there. One that only the IMU sees, and not at its tolerance, must bring more than an immaterial shape that
    is a little like it. A limit must bring what tolerated flaws of its channels would.
    """
    worth = least_of(effect, worth, left, crumbs)
    if effect in LIMITS:
        worth = max(worth, CRUMB * max((tolerated.get(name, 0.0) for name in EFFECTS[effect].streams), default=0.0))
    return gain >= worth


def least_of(effect: str, worth: float, left: Mapping[str, float], crumbs: Mapping[str, float]) -> float:
    """What an effect must bring: a part of what is left of its channels; seen by the IMU alone, more than crumbs."""
    moved = [name for name in EFFECTS[effect].streams if name in left]
    part = TAKES["wheels" if moved and moved[0] in WHEELS else "body"]
    worth = max(worth, part * max((left[name] for name in moved), default=0.0))
    alone = bool(moved) and all(name in crumbs for name in moved)
    return max(worth, ALIKE * min(crumbs[name] for name in moved)) if alone else worth


ALIKE = 0.1
"""Share of its deviance that a shape may have in common with an effect by chance."""


def tolerated_of(screen: Screen, tried: Sequence[Candidate]) -> dict[str, float]:
    """Per channel, the deviance that a flaw of tolerated size brings: the median over the effects that touch it."""
    normal, at = screen.normal, screen.own
    found: dict[str, list[float]] = {name: [] for name in normal.channels}
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


def best_of(tried: Sequence[Candidate], gain: Array) -> dict[str, float]:
    """The largest gain of each effect's candidates."""
    out: dict[str, float] = {}
    for one, value in zip(tried, gain, strict=True):
        out[one.effect] = max(out.get(one.effect, 0.0), float(value))
    return out


def faint_of(
    problem: Problem, fit: Fit, screen: Screen, promised: tuple[Sequence[Candidate], Array]
) -> dict[str, float]:
    """By how much each smooth candidate's promise falls short of what it must bring."""
    gains, left, crumbs = best_of(*promised), excess(fit), crumbs_of(problem, fit)
    dim, smooth = screen.dim(promised[0]), {one.effect for one in promised[0] if one.smooth}
    least = {name: least_of(name, MATERIAL, left, crumbs if name in dim else {}) for name in smooth}
    return {name: max(least[name] - gains[name], 0.0) for name in smooth}
