"""All candidates beside a model and all nuisances as one linear problem, in which any set of them can be weighed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.gap.candidates import Candidate, bounds
from core.gap.linear import Normal
from core.gap.nuisance import SPREAD, bounded, limits

Array = npt.NDArray[np.float64]

CLEAR = 36.0
"""Drop of the cost that is beyond chance on fifty candidates, six deviations."""
SECANT = (0.25, 4.0)
"""Weights that a secant may have: its shape holds near its start only."""


def gains_of(normal: Normal, own: int, tried: Sequence[Candidate]) -> Array:
    """(len(tried),) drop of the cost that each candidate promises beside the model's own parameters and all nuisances.

    own: so many columns are the model's; the rest are the candidates', in their order.
    """
    return Screen.of(normal, own, tried).gains(tried)


@dataclass(frozen=True)
class Screen:
    """A model and all candidates as one linear problem, in which any set of them can be weighed at once.

    g, a: sums over all columns; sd, limit: of each column as a nuisance (0: it is none); effects: whose it is.
    """

    normal: Normal
    g: Array
    a: Array
    sd: Array
    limit: Array
    effects: tuple[str, ...]
    own: int
    places: tuple[tuple[int, ...], ...]
    secants: Mapping[int, float]

    @classmethod
    def of(
        cls, normal: Normal, own: int, tried: Sequence[Candidate], secants: Mapping[int, float] | None = None
    ) -> Screen:
        """From normal equations over the model's columns and the candidates'. secants: what whole columns bring."""
        _, g, a = normal.total
        limit = limits(normal.keys)
        places, at = [], own
        for one in tried:
            places.append(tuple(range(at, at + len(one.keys))))
            at += len(one.keys)
        effects = tuple(key.split(".")[0].split("*")[0] for key in normal.keys)
        return cls(normal, g, a, SPREAD * limit, limit, effects, own, tuple(places), secants or {})

    def drop(self, columns: Sequence[int], model: Sequence[str]) -> float:
        """By how much the cost falls if these columns are free; beside them the nuisances, but for a model's own."""
        free = np.zeros(len(self.g), dtype=bool)
        free[list(columns)] = True
        kept = np.flatnonzero(
            free | ((self.limit > 0.0) & np.array([e not in model for e in self.effects], dtype=bool))
        )
        sd = np.where(free, np.inf, self.sd)[kept]
        limit = np.where(free, np.inf, self.limit)[kept]
        return bounded(self.a[np.ix_(kept, kept)], self.g[kept], sd, limit)[1]

    def gains(self, tried: Sequence[Candidate]) -> Array:
        """(len(tried),) what each candidate brings beyond the model with its nuisances."""
        own = list(range(self.own))
        named = sorted(set(self.effects[: self.own]))
        base = self.drop(own, named)
        out = np.zeros(len(tried))
        for k, (one, mine) in enumerate(zip(tried, self.places, strict=False)):
            if one.secant:
                at = mine[0]
                weight = float(np.clip(self._weight(at, named), *SECANT))
                score, info = self._beside(at, named)
                out[k] = max(2.0 * weight * score - weight**2 * info, self.secants.get(at, 0.0))
            else:
                out[k] = (
                    0.0 if self._negative(one, mine, named) else self.drop([*own, *mine], [*named, one.effect]) - base
                )
        return out

    def _negative(self, one: Candidate, mine: Sequence[int], named: Sequence[str]) -> bool:
        """Whether the data ask for less of an effect than none at all, as of slip in speeding up."""
        if len(mine) != 1:
            return False
        least = bounds(one.effect, one.free[0])[0]
        return float(one.start[one.free[0]]) <= least and self._beside(mine[0], named)[0] < 0.0

    def _beside(self, at: int, named: Sequence[str]) -> tuple[float, float]:
        """Score and information of one column, the model's own parameters and the nuisances marginalised."""
        kept = np.flatnonzero(self.limit > 0.0)
        kept = kept[
            np.array([self.effects[i] not in named and self.effects[i] != self.effects[at] for i in kept], dtype=bool)
        ]
        kept = np.concatenate((np.arange(self.own), kept)).astype(int)
        ridge = np.where(kept < self.own, 0.0, 1.0 / np.maximum(self.sd[kept], 1e-12) ** 2)
        inner = self.a[np.ix_(kept, kept)] + np.diag(ridge)
        size = np.sqrt(np.maximum(np.diag(inner), 1e-30))
        part = np.linalg.lstsq(inner / np.outer(size, size), np.column_stack((self.g[kept], self.a[kept, at])) /
                               size[:, None], rcond=1e-12)[0] / size[:, None]  # fmt: skip
        cross = self.a[at, kept]
        return float(self.g[at] - cross @ part[:, 0]), float(self.a[at, at] - cross @ part[:, 1])

    def dim(self, tried: Sequence[Candidate]) -> frozenset[str]:
        """Effects of one parameter of which these runs could not see as much as their tolerance."""
        named = sorted(set(self.effects[: self.own]))
        pairs = [(one.effect, at[0]) for one, at in zip(tried, self.places, strict=False) if len(at) == 1]
        return frozenset(e for e, i in pairs if self.limit[i] and self._beside(i, named)[1] * self.limit[i] ** 2 < 1.0)

    def clear(self, tried: Sequence[Candidate]) -> frozenset[str]:
        """Effects of one parameter that are there beyond chance, whatever their size: from nothing, not from their
        tolerance, they bring `CLEAR`."""
        own, named = list(range(self.own)), sorted(set(self.effects[: self.own]))
        out = set()
        for one, mine in zip(tried, self.places, strict=False):
            if len(mine) == 1 and self.limit[mine[0]] and not self._negative(one, mine, named):
                without = self.drop(own, [*named, one.effect])
                if self.drop([*own, *mine], [*named, one.effect]) - without > CLEAR:
                    out.add(one.effect)
        return frozenset(out)

    def _weight(self, at: int, named: Sequence[str]) -> float:
        score, info = self._beside(at, named)
        return score / max(info, 1e-12)

    def pair(self, tried: Sequence[Candidate], gains: Array, among: int) -> tuple[float, tuple[str, str] | None]:
        """The most that two smooth candidates of the best few bring together, and which they are."""
        own = list(range(self.own))
        named = sorted(set(self.effects[: self.own]))
        base = self.drop(own, named)
        order = [int(k) for k in np.argsort(-gains) if not tried[int(k)].secant][:among]
        best: tuple[float, tuple[str, str] | None] = (0.0, None)
        for i, k in enumerate(order):
            for j in order[i + 1 :]:
                first, second = tried[k].effect, tried[j].effect
                if first != second:
                    both = [*own, *self.places[k], *self.places[j]]
                    gain = self.drop(both, [*named, first, second]) - base
                    if gain > best[0]:
                        best = gain, (first, second)
        return best
