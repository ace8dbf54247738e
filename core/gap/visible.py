"""What these runs could not have shown: each parameter's standard deviation beside everything that was fitted.

From the information that the search's last screening gathered: an effect's own block, less what the fitted effects and
the turn-on biases could do in its place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.effects import EFFECTS
from core.gap.candidates import Candidate, Reach, tolerance
from core.gap.evidence import CannotSee
from core.gap.floor import Floor
from core.gap.shrink import NOISES
from core.robot import EffectSet

Array = npt.NDArray[np.float64]

SEEN = 4.0
"""A parameter is visible from so many standard deviations on."""
NUISANCE = ("gyro_bias", "accel_bias")
"""Effects that are always there a little."""
FAINT = 1e-6
"""What is left of an effect's information below this share is none."""


@dataclass(frozen=True)
class Sight:
    """The last screening: (P, P) information about the model's own parameters (the first `own`) and the candidates'."""

    information: Array
    own: int
    tried: tuple[Candidate, ...]


def cannot_see(
    screens: Sequence[Sight], model: EffectSet, channels: Sequence[str], reach: Reach, floor: Floor
) -> tuple[CannotSee, ...]:
    """Parameters that would have to be larger than their tolerance to be seen, hardest first."""
    sizes: dict[tuple[str, str], float | None] = {}
    for screen in screens:
        for key, size in _sizes(screen).items():
            old = sizes.get(key)
            sizes[key] = size if old is None else min(old, size if size is not None else old)
    out = []
    for effect in EFFECTS.values():
        if effect.id in model:
            continue
        for parameter in effect.parameters:
            small = tolerance(effect.id, parameter.name, reach)
            if small is None or parameter.text:
                continue
            key, size = (effect.id, parameter.name), None
            if effect.id in NOISES:
                size = _noise(effect.id, channels, floor)
            elif set(effect.streams) & set(channels):
                if key not in sizes:
                    continue  # no screening tried it beside what was found
                size = sizes[key]
            if size is None or size > small:
                out.append((size, small, CannotSee(effect.id, parameter.name, parameter.unit, size)))
    out.sort(key=lambda row: -np.inf if row[0] is None else -row[0] / max(row[1], 1e-12))
    return tuple(one for _, _, one in out)


def _sizes(screen: Sight) -> dict[tuple[str, str], float | None]:
    """From which deviation on each candidate's parameters are visible; None: at none."""
    out: dict[tuple[str, str], float | None] = {}
    a, at = screen.information, screen.own
    rows: list[tuple[Candidate, list[int]]] = []
    for one in screen.tried:
        rows.append((one, list(range(at, at + len(one.keys)))))
        at += len(one.keys)
    biases = [i for one, mine in rows if one.effect in NUISANCE for i in mine]
    for one, mine in rows:
        others = [*range(screen.own), *(i for i in biases if i not in mine and one.effect not in NUISANCE)]
        left = _profiled(a, mine, others)
        for k, name in enumerate(EFFECTS[one.effect].switch if one.secant else one.free):
            key = (one.effect, name)
            whole = float(a[mine[0 if one.secant else k], mine[0 if one.secant else k]])
            size = _secant(one, name, left[0, 0]) if one.secant else _deviation(left, k, whole)
            old = out.get(key)
            out[key] = size if old is None else old if size is None else min(old, size)
    return out


def _profiled(a: Array, mine: Sequence[int], others: Sequence[int]) -> Array:
    """(M, M) information about `mine` with the others free."""
    own: Array = a[np.ix_(mine, mine)]
    if not others:
        return own
    cross, block = a[np.ix_(mine, others)], a[np.ix_(others, others)]
    size = np.sqrt(np.maximum(np.diag(block), 1e-12))
    inverse = np.linalg.pinv(block / np.outer(size, size), rcond=1e-10) / np.outer(size, size)
    out: Array = own - cross @ inverse @ cross.T
    return out


def _deviation(information: Array, k: int, whole: float) -> float | None:
    """SEEN standard deviations of one parameter, its effect's other parameters free."""
    rest = [i for i in range(len(information)) if i != k]
    left = float(_profiled(information, [k], rest)[0, 0])
    return SEEN / float(np.sqrt(left)) if whole > 0.0 and left > FAINT * whole else None


def _secant(one: Candidate, name: str, energy: float) -> float | None:
    """The size at which an effect that is no derivative is visible, from what its start would change."""
    if energy <= 0.0:
        return None
    value, neutral = float(one.start[name]), float(EFFECTS[one.effect].parameter(name).neutral)
    if np.isinf(neutral):
        return None if energy < SEEN**2 else 0.0
    if value == neutral:
        return None
    return abs(value - neutral) * SEEN / float(np.sqrt(energy))


def _noise(effect: str, channels: Sequence[str], floor: Floor) -> float | None:
    """A louder sensor is seen from its noise's own uncertainty on."""
    names = [name for name in NOISES[effect] or ("beacon.x", "ranges.range") if name in channels]
    if not names:
        return None
    if effect in ("gyro_noise", "beacon_noise"):
        return SEEN * float(np.sqrt(1.0 / sum(1.0 / floor.sd[name] ** 2 for name in names)))
    return 0.0
