"""A cause's signature: what a stream shows without it, by the regressor that it follows, beside what the fit says."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from core.effects import EFFECTS
from core.gap.curves import Samples, best_told_by, bins_of, edges_of, means, samples
from core.gap.evidence import Signature
from core.gap.floor import Floor
from core.gap.shrink import NOISES, Shown
from core.gap.where import Ground
from core.gap.world import WHEELS
from core.robot import EffectSet

LEAST = 5
"""Bins with fewer samples are left out."""
CLEAR = 400.0
"""White energy from which on a stream shows an effect."""


def signatures(ground: Ground, shown: Sequence[Shown], causes: EffectSet, floor: Floor) -> dict[str, Signature]:
    """Of every cause that is more than noise."""
    out = {}
    for k, effect in enumerate(name for name in causes if name not in NOISES):
        stream = _stream(ground, k, EFFECTS[effect].family == "drive")
        if stream is None:
            continue
        found = samples(ground.worlds, ground.moved, [(one.full, one.without[k]) for one in shown], stream, floor)
        one = None if found is None else _signature(found, stream)
        if one is not None:
            out[effect] = one
    return out


def _stream(ground: Ground, k: int, drive: bool) -> str | None:
    """The stream on which the effect acts most; of the drive, an encoder; positions where nothing else shows it."""
    sizes = {name: float(each[k]) for name, each in ground.parts.items()}
    if drive and max(sizes.get(name, 0.0) for name in WHEELS) > CLEAR:
        sizes = {name: sizes[name] for name in WHEELS}
    plain = {name: size for name, size in sizes.items() if name not in ("truth.x", "truth.y")}
    chosen = plain if max(plain.values(), default=0.0) > 0.0 else sizes
    best = max(chosen, key=lambda name: chosen[name], default=None)
    return best if best is not None and sizes[best] > 0.0 else None


def _signature(found: Samples, stream: str) -> Signature | None:
    """values: the residual with everything, then without the effect; their difference is what the fit adds."""
    full, without = found.values
    fitted = without - full
    name = best_told_by(found, fitted)
    if name is None:
        return None
    x = found.regressors[name]
    edges = edges_of(name, x)
    size, number = len(edges) - 1, bins_of(x, edges)
    count, residual = means(number, without, size)
    middle, told, after = (means(number, values, size)[1] for values in (x, fitted, full))
    spread = means(number, (full - after[number]) ** 2, size)[1]
    some = count >= LEAST
    sd = np.sqrt(spread / np.maximum(count, 1.0))
    return Signature(stream, name, found.unit, middle[some], residual[some], sd[some], told[some], after[some])
