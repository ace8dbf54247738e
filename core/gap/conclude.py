"""Size, probability, place, shrinkage and advice from what the search found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from core.effects import EFFECTS
from core.gap.candidates import Reach
from core.gap.experiment import next_experiment
from core.gap.explain import Search
from core.gap.floor import Floor
from core.gap.generic import Shape
from core.gap.judge import is_material, odds, probabilities, values_of
from core.gap.leftover import unknown_of
from core.gap.rejected import rejected, unseen
from core.gap.shrink import figures, show
from core.gap.tell import Told, evidence_of
from core.gap.types import Cause, Config, Diagnosis, Immaterial, Unexplained, Value
from core.gap.where import ground_of, look
from core.gap.world import WHEELS, World
from core.robot import EffectSet


def conclude(
    found: Search, fitted_on: Sequence[World], kept: Sequence[World], reach: Reach, known: EffectSet, config: Config
) -> Diagnosis:
    """Size, probability, place, shrinkage and advice from what the search found."""
    model = found.model
    values = _values(found)
    material = [name for name in model if is_material(name, model[name], known, reach, config)]
    for one in found.noises:
        plain = {name: value for name, (value, _) in one.parameters.items()}
        values[one.effect] = {name: Value(*pair) for name, pair in one.parameters.items()}
        if is_material(one.effect, plain, known, reach, config):
            material.append(one.effect)
    unexplained, doubt = unknown_of(found, material)
    chances = probabilities(found.links, material, doubt)
    fitted = {name: model[name] for name in model if name in material and chances.get(name, 0.0) > 0.5}
    noises: dict[str, dict[str, float | str]] = {
        one.effect: {name: pair[0] for name, pair in one.parameters.items()}
        for one in found.noises
        if one.effect in material
    }
    floor = found.body.problem.floor
    small = {name: model[name] for name in model if name not in material}
    causing = {**fitted, **noises}
    seen = [show(world, small, causing, floor) for world in fitted_on]
    scored = [show(world, small, causing, floor) for world in kept]
    gap = figures(kept or fitted_on, floor, scored or seen, noises, bool(kept), config.seed)
    ground = ground_of(fitted_on, seen, causing, floor)
    looked = look(ground, causing, _shape(found) if unexplained is not None else None)
    causes = _causes(found, chances, _shares(found, material), values)
    sure = [one for one in causes if one.probability > 0.5]
    verdict = "explained" if sure else "none"
    if unexplained is not None:
        verdict = "partly_explained" if sure else "unknown"
    rest = {"none": SURE_NONE if verdict == "none" else 0.0, "unknown": SURE_NONE if unexplained is not None else 0.0}
    rest["unknown"] = max(rest["unknown"], *doubt.values()) if doubt else rest["unknown"]
    listed = (name for name in (*model, *noises) if name not in material and name in values)
    return Diagnosis(
        verdict=verdict,
        where=looked.where if verdict != "none" else (),
        causes=causes,
        gap=gap,
        immaterial=tuple(Immaterial(name, values[name]) for name in listed),
        unexplained=unexplained,
        next_experiment=next_experiment(fitted_on[0].run, causing, causes),
        rejected=rejected(found, material, chances),
        unseen=unseen(found, reach),
        probabilities={**chances, **rest},
        model={**model, **noises},
        noise={name: floor.sigma[name] / floor.sheet[name] for name in floor.sigma if name in floor.sheet},
        notes=_notes(floor),
        link=_link(sure, unexplained),
        runtime_s=0.0,
        evidence=evidence_of(
            found, Told(found.model, causing, causes, chances, reach), ground, seen, looked, kept, scored
        ),
    )


def _causes(
    found: Search, chances: Mapping[str, float], shares: Mapping[str, float], values: Mapping[str, Mapping[str, Value]]
) -> tuple[Cause, ...]:
    """The joint explanation by share, then rivals by probability."""
    causes = [
        Cause(name, p, shares.get(name, 0.0), values.get(name, {}), _confusable(name, found))
        for name, p in chances.items()
    ]
    causes.sort(key=lambda one: (one.probability <= 0.5, -one.share if one.probability > 0.5 else -one.probability))
    return tuple(causes)


SURE_NONE = 0.95
"""Of "none" where nothing material was found: what a clean run's false alarms leave."""


def _values(found: Search) -> dict[str, dict[str, Value]]:
    out: dict[str, dict[str, Value]] = {}
    for one in found.links:
        out |= {name: values_of(one.fit, name) for name in one.fit.model}
    return out


def _shares(found: Search, material: Sequence[str]) -> dict[str, float]:
    """Each effect's part of all that was explained."""
    earned: dict[str, float] = {}
    for one in found.links:
        earned |= one.earned
    earned |= {one.effect: one.gain for one in found.noises}
    earned = {name: value for name, value in earned.items() if name in material}
    total = sum(earned.values())
    return {name: value / total for name, value in earned.items()} if total > 0.0 else {}


def _confusable(name: str, found: Search) -> tuple[str, ...]:
    out: list[str] = []
    for one in found.links:
        out += [rival for rival, weight in odds(one).get(name, {}).items() if weight > 0.1]
    if found.wheels is None and name in ("wheel_radius", "unequal_wheels"):
        out.append("missed_ticks")
    return tuple(dict.fromkeys(out))


def _notes(floor: Floor) -> tuple[str, ...]:
    out = []
    for name, sigma in floor.sigma.items():
        ratio = sigma / floor.sheet[name] if name in floor.sheet else 1.0
        if name not in WHEELS and not name.startswith("truth") and not 0.8 < ratio < 1.25:
            out.append(f"the noise of {name} is {ratio:.2f} times what run.json states")
    return tuple(out)


def _shape(found: Search) -> Shape | None:
    """The shape that takes most of what is left."""
    strangers = [one.unknown for one in found.links if one.unknown is not None]
    if strangers:
        return max(strangers, key=lambda pair: pair[1])[0]
    return max((rest.best for rest in found.rests.values()), key=lambda pair: pair[1])[0]


def _link(causes: Sequence[Cause], unexplained: Unexplained | None) -> str | None:
    """The link of the chain at fault."""
    links = {
        "drive": "commands to wheels",
        "kinematics": "wheels to body",
        "ground": "wheels to body",
        "gyroscope": "body to gyro",
        "accelerometer": "body to accelerometer",
        "encoders": "wheels to encoders",
        "beacons": "body to beacons",
        "timing": "the IMU's clock",
    }
    if causes:
        return links[EFFECTS[causes[0].effect].family]
    if unexplained is None:
        return None
    stream = unexplained.stream.split(".")[0]
    return {"wheels": "commands to wheels", "imu": "body to imu", "truth": "wheels to body"}.get(
        stream, "body to beacons"
    )
