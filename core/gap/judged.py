"""What a search found, judged by size and probability: the material causes, the trifles, the rest."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from scipy.special import ndtr

from core.effects import EFFECTS
from core.gap.candidates import Reach
from core.gap.explain import Search
from core.gap.judge import SURE, beyond, clear_of_small, is_material, probabilities, size_of, unlisted, values_of
from core.gap.leftover import unknown_of
from core.gap.types import Config, Unexplained, Value
from core.robot import EffectSet


@dataclass(frozen=True)
class Judged:
    """material: effects beyond their tolerance. doubt: that one only stood in for what is unlisted. small: the others.

    fitted: the material ones that are likely; noises: those that only add noise.
    """

    values: Mapping[str, Mapping[str, Value]]
    material: tuple[str, ...]
    chances: Mapping[str, float]
    doubt: Mapping[str, float]
    unexplained: Unexplained | None
    fitted: EffectSet
    small: EffectSet
    noises: EffectSet

    @property
    def causing(self) -> EffectSet:
        """All that is told as a cause."""
        return {**self.fitted, **self.noises}


def judged(found: Search, reach: Reach, known: EffectSet, config: Config) -> Judged:
    """Size first: what is below its tolerance is no cause, however significant."""
    trifles = found.trifles
    finer = _finer(trifles, known, reach, config)
    model = {**found.model, **finer}
    values: dict[str, Mapping[str, Value]] = {}
    flawed = unlisted(found.links)
    for link in found.links:
        values |= {name: values_of(link.fit, name, flawed) for name in link.fit.model}
    values |= {effect: {name: Value(*pair) for name, pair in one.items()} for effect, one in trifles.items()}
    material = [name for name in model if is_material(name, model[name], known, reach, config)]
    noises: dict[str, dict[str, float | str]] = {}
    for one in found.noises:
        plain: dict[str, float | str] = {name: value for name, (value, _) in one.parameters.items()}
        values[one.effect] = {name: Value(*pair) for name, pair in one.parameters.items()}
        if is_material(one.effect, plain, known, reach, config):
            material.append(one.effect)
            noises[one.effect] = plain
    unexplained, doubt = unknown_of(found, material)
    chances = probabilities(found.links, material, doubt)
    chances |= {name: chances[name] * beyond(name, values[name]) for name in noises if name in chances}
    sizes = {name: size_of(name, model[name], known, reach, config) for name in material if name in model}
    chances |= {name: chances[name] * clear_of_small(name, size, values[name]) for name, size in sizes.items()}
    chances |= {name: _clear_of(name, trifles[name], known, config) for name in finer}
    fitted = {name: model[name] for name in model if name in material and chances.get(name, 0.0) > 0.5}
    small: dict[str, Mapping[str, float | str]] = {name: model[name] for name in model if name not in material}
    small |= {
        effect: {name: value for name, (value, _) in one.items()}
        for effect, one in trifles.items()
        if effect not in material
    }
    return Judged(values, tuple(material), chances, doubt, unexplained, fitted, small, noises)


def _finer(
    trifles: Mapping[str, Mapping[str, tuple[float, float]]], known: EffectSet, reach: Reach, config: Config
) -> dict[str, dict[str, float | str]]:
    """Of what is real but small by the table, effects that the user's own tolerances make matter."""
    out: dict[str, dict[str, float | str]] = {}
    for effect, one in trifles.items():
        whole = {
            **EFFECTS[effect].neutral,
            **known.get(effect, {}),
            **{name: value for name, (value, _) in one.items()},
        }
        if any(f"{effect}.{name}" in config.tolerances for name in one) and is_material(
            effect, whole, known, reach, config
        ):
            out[effect] = whole
    return out


def _clear_of(effect: str, one: Mapping[str, tuple[float, float]], known: EffectSet, config: Config) -> float:
    """Probability that an effect is larger than the user's own tolerance, by its standard deviations."""
    base = {**EFFECTS[effect].neutral, **known.get(effect, {})}
    return max(
        SURE * float(ndtr((abs(value - float(base[name])) - config.tolerances[key]) / max(sd, 1e-12)))
        for name, (value, sd) in one.items()
        if (key := f"{effect}.{name}") in config.tolerances
    )


def advisable(found: Judged, harmful: Sequence[str]) -> Judged:
    """Without effects that make held-out data worse: whatever they explain, it is not what the robot does."""
    if not harmful:
        return found
    chances = {name: min(p, UNADVISED) if name in harmful else p for name, p in found.chances.items()}
    fitted = {name: values for name, values in found.fitted.items() if name not in harmful}
    return dataclasses.replace(found, chances=chances, fitted=fitted)


UNADVISED = 0.45
"""Probability left to an effect that makes held-out data worse."""
