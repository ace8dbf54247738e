"""What every robot has a little of: each effect within its tolerance, beside whatever is fitted.

A real robot differs from its simulator a little in everything. Left out, those trifles are given to whatever can mimic
them, and make every deviation too small. So each smooth effect that is not in the model stands beside it as a nuisance:
linear, its size normal with half its tolerance for a standard deviation, and never more than the tolerance.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.effects import EFFECTS

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

SPREAD = 0.5
"""Standard deviation of a nuisance, as a share of its effect's tolerance."""
ROUNDS = 12
"""At most so many changes of which bounds are met."""
DRIFT = 45.0
"""Of the warm-up times tried, the one whose drift stands for all that is immaterial [s]."""


@dataclass(frozen=True)
class Nuisances:
    """Columns of all smooth effects: keys "effect.parameter...", the effect of each, sd and limit (M,).

    a (M, M): their white columns' products; `rows`: per run and channel (columns (m, N), index (m,)). far: share
    of readings that counted less than fully in `a`.
    """

    keys: tuple[str, ...] = ()
    effects: tuple[str, ...] = ()
    sd: Array = dataclasses.field(default_factory=lambda: np.zeros(0))
    limit: Array = dataclasses.field(default_factory=lambda: np.zeros(0))
    a: Array = dataclasses.field(default_factory=lambda: np.zeros((0, 0)))
    rows: tuple[Mapping[str, tuple[Array, Indices]], ...] = ()
    far: float = 0.0

    def beside(self, model: Sequence[str]) -> npt.NDArray[np.bool_]:
        """(M,) which of them stand beside a model: all but those of its own effects."""
        return np.array([effect not in model for effect in self.effects], dtype=bool)


def limits(keys: Sequence[str]) -> Array:
    """(P,) tolerance of each column "effect.parameter[@...]"; 0 where a column is no nuisance."""
    out = np.zeros(len(keys))
    for i, key in enumerate(keys):
        if key.startswith("~"):
            out[i] = 1.0  # a flaw of no effect (`discrepancy.py`), in units of what is immaterial
        if "*" in key or key.startswith("~"):
            continue
        name, _, start = key.partition("@")
        effect, parameter = name.split(".")
        small = EFFECTS[effect].parameter(parameter).small
        if small is None or EFFECTS[effect].parameter(parameter).small_of_reach or not EFFECTS[effect].smooth:
            continue
        if effect == "gyro_drift" and start and float(start) != DRIFT:
            continue
        out[i] = small
    return out


def bounded(a: Array, g: Array, sd: Array, limit: Array) -> tuple[Array, float]:
    """x that minimises x'Ax - 2g'x + sum (x/sd)² with abs(x) <= limit, and by how much that lies below x = 0.

    sd, limit: infinite for what is free. Bounds are met all at once and let go of again, mostly right within a few
    rounds; else one after the other, which is slower and always right.
    """
    n = len(g)
    if n == 0:
        return np.zeros(0), 0.0
    size = np.sqrt(np.maximum(np.diag(a), 1e-30))
    scaled = a / np.outer(size, size) + np.diag(1.0 / np.maximum(sd * size, 1e-12) ** 2) + 1e-9 * np.eye(n)
    target, top = g / size, limit * size
    at = np.zeros(n)
    held = np.zeros(n, dtype=bool)
    for _ in range(ROUNDS):
        free = ~held
        at[free] = np.linalg.solve(scaled[np.ix_(free, free)], target[free] - scaled[np.ix_(free, held)] @ at[held])
        beyond = free & (np.abs(at) > top)
        if beyond.any():
            at[beyond] = np.sign(at[beyond]) * top[beyond]
            held |= beyond
            continue
        pull = target - scaled @ at
        loose = held & (pull * at < 0.0)
        if not loose.any():
            break
        held &= ~loose
    else:
        at = _one_by_one(scaled, target, top, np.clip(at, -top, top))
    at = np.clip(at, -top, top)
    return at / size, float(2.0 * target @ at - at @ scaled @ at)


def _one_by_one(a: Array, g: Array, top: Array, at: Array) -> Array:
    """x that minimises x'Ax - 2g'x with abs(x) <= top, from a point inside: primal active set, one bound at a time."""
    held = np.abs(at) >= top
    for _ in range(10 * len(g)):
        free = np.flatnonzero(~held)
        step = np.linalg.solve(a[np.ix_(free, free)], g[free] - a[free] @ at) if len(free) else np.zeros(0)
        room = np.where(step > 0.0, top[free] - at[free], top[free] + at[free])
        share = np.where(np.abs(step) > 0.0, room / np.maximum(np.abs(step), 1e-300), np.inf)
        nearest = int(np.argmin(share)) if len(free) else -1
        if nearest >= 0 and share[nearest] < 1.0:
            at[free] += share[nearest] * step
            at[free[nearest]] = np.sign(step[nearest]) * top[free[nearest]]
            held[free[nearest]] = True
            continue
        at[free] += step
        inwards = np.where(held, -(g - a @ at) * np.sign(at), -np.inf)
        loosest = int(np.argmax(inwards))
        if inwards[loosest] <= 1e-9 * (1.0 + np.abs(g[loosest])):
            break
        held[loosest] = False
    return at
