"""One false-discovery control over everything that is looked at: streams first, then what lies inside them.

Benjamini and Bogomolov 2014, "Selective inference on multiple families of hypotheses": families (here streams) are
chosen by Simes' p-value with Benjamini and Hochberg's rule; inside each chosen one the same rule, at a rate that is
lowered by the share of families chosen, in Yekutieli's form, since cells of one stream overlap.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

RATE = 0.05
"""False-discovery rate."""


def step_up(p: Array, rate: float = RATE, dependent: bool = False) -> Mask:
    """(N,) which of these p-values are discoveries. dependent: whatever their dependence (Benjamini, Yekutieli)."""
    n = len(p)
    out = np.zeros(n, dtype=bool)
    if not n:
        return out
    weight = float(np.sum(1.0 / np.arange(1, n + 1))) if dependent else 1.0
    order = np.argsort(p)
    fine = p[order] <= rate * np.arange(1, n + 1) / (n * weight)
    out[order[: int(np.flatnonzero(fine).max(initial=-1)) + 1]] = True
    return out


def simes(p: Array) -> float:
    """One p-value for a family."""
    if not len(p):
        return 1.0
    return float(min(1.0, np.min(np.sort(p) * len(p) / np.arange(1, len(p) + 1))))


def hierarchical(families: Mapping[str, Array], rate: float = RATE) -> dict[str, Mask]:
    """Discoveries in each family; none in families that are not chosen."""
    names = list(families)
    chosen = step_up(np.array([simes(families[name]) for name in names]), rate)
    inner = rate * float(chosen.sum()) / max(len(names), 1)
    return {
        name: step_up(families[name], inner, dependent=True) if real else np.zeros(len(families[name]), dtype=bool)
        for name, real in zip(names, chosen, strict=True)
    }
