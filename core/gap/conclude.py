"""Size, probability, place, shrinkage and advice from what the search found."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from core.effects import EFFECTS
from core.gap.candidates import Reach
from core.gap.experiment import next_experiment
from core.gap.explain import Progress, Search, silent
from core.gap.floor import Floor
from core.gap.generic import Shape
from core.gap.judge import odds
from core.gap.judged import Judged, advisable, judged
from core.gap.leftover import chance_of_unknown
from core.gap.rejected import rejected, unseen
from core.gap.remainder import SURE as LEFT_SURE
from core.gap.remainder import remainder
from core.gap.shrink import Scored, Shown, figures, show
from core.gap.stretches import Part
from core.gap.tell import Told, evidence_of
from core.gap.types import Cause, Config, Diagnosis, Gap, Immaterial, Unexplained
from core.gap.where import Ground, ground_of, look
from core.gap.world import WHEELS, World
from core.robot import EffectSet


def conclude(
    found: Search,
    fitted_on: Sequence[World],
    kept: Sequence[World],
    reach: Reach,
    known: EffectSet,
    config: Config,
    part: Part | None = None,
    progress: Progress = silent,
) -> Diagnosis:
    """Size, probability, place, shrinkage and advice. kept: held-out runs; part: else, what was found on a part."""
    floor, seen_by = found.floor, judged(found, reach, known, config)
    seen = [show(world, seen_by.small, seen_by.causing, floor) for world in fitted_on]
    apart = [show(world, seen_by.small, seen_by.causing, floor) for world in kept]
    names = tuple(seen_by.causing)
    scored = Scored(kept, apart, names, True) if kept else Scored(fitted_on, seen, names, False)
    noises = seen_by.noises
    if part is not None and not kept:
        scored, noises = _on_part(part, reach, known, config, floor, tuple(noises))
    gap, harmful = figures(scored, floor, noises, config.seed)
    seen_by = advisable(seen_by, harmful)
    if harmful:  # told again without what does harm
        seen = [show(world, seen_by.small, seen_by.causing, floor) for world in fitted_on]
        apart = [show(world, seen_by.small, seen_by.causing, floor) for world in kept]
    progress(0.92, "telling where")
    ground = ground_of(fitted_on, seen, seen_by.causing, floor)
    seen_by = _with_rest(seen_by, ground, seen, floor)
    unexplained = seen_by.unexplained
    looked = look(ground, seen_by.causing, _shape(found) if unexplained is not None else None)
    causes = _causes(found, seen_by, _shares(found, seen_by, gap))
    sure = [one for one in causes if one.probability > 0.5]
    verdict = _verdict(sure, unexplained)
    progress(0.94, "choosing the next drive")
    advised = next_experiment(fitted_on[0].run, {**found.model, **seen_by.causing}, found.links, causes, floor, reach)
    progress(0.97, "gathering the evidence")
    told = Told(found.model, seen_by, causes, reach, advised, config.seed)
    listed = (
        name
        for name in (*found.model, *found.trifles, *noises)
        if name not in seen_by.material and name in seen_by.values
    )
    return Diagnosis(
        verdict=verdict,
        where=looked.where if verdict != "none" else (),
        causes=causes,
        gap=gap,
        immaterial=tuple(Immaterial(name, seen_by.values[name]) for name in listed),
        unexplained=unexplained,
        next_experiment=None if advised is None else advised[0],
        rejected=rejected(found, seen_by.material, seen_by.chances),
        unseen=unseen(found, reach),
        probabilities={**seen_by.chances, **_others(found, verdict, seen_by)},
        model={name: values for name, values in {**found.model, **seen_by.noises}.items() if name not in harmful},
        noise={name: floor.sigma[name] / floor.sheet[name] for name in floor.sigma if name in floor.sheet},
        notes=(*_notes(floor), *_warnings(harmful, scored, seen_by)),
        link=_link(sure, unexplained),
        runtime_s=0.0,
        evidence=evidence_of(found, told, ground, seen, looked, kept, apart),
    )


def _with_rest(seen_by: Judged, ground: Ground, seen: Sequence[Shown], floor: Floor) -> Judged:
    """What is left that no search gave a shape, where nothing else unlisted is told."""
    if seen_by.unexplained is not None:
        return seen_by
    left = remainder(ground, seen, floor, {**seen_by.noises, **seen_by.causing})
    return dataclasses.replace(seen_by, unexplained=left)


def _on_part(
    part: Part, reach: Reach, known: EffectSet, config: Config, floor: Floor, louder: Sequence[str]
) -> tuple[Scored, EffectSet]:
    """The stretches that took no part, replayed with what was found without them. louder: noise found on the whole."""
    inner = judged(part.found, reach, known, config)
    noises = {name: values for name, values in inner.noises.items() if name in louder}  # the cuts are no shadow
    inner = dataclasses.replace(inner, noises=noises)
    shown = [show(world, inner.small, inner.causing, floor) for world in part.worlds]
    return Scored(part.worlds, shown, tuple(inner.causing), True, part.spans), inner.noises


def _verdict(sure: Sequence[Cause], unexplained: Unexplained | None) -> str:
    if unexplained is not None:
        return "partly_explained" if sure else "unknown"
    return "explained" if sure else "none"


def _others(found: Search, verdict: str, seen_by: Judged) -> dict[str, float]:
    """Probability of "none" and "unknown"."""
    strange = max(chance_of_unknown(found), *seen_by.doubt.values(), 0.0)
    if seen_by.unexplained is not None:
        strange = max(strange, LEFT_SURE)
    nothing = chance_of_none(strange, seen_by.chances) if verdict == "none" else 0.0
    return {"none": nothing, "unknown": strange}


def chance_of_none(strange: float, chances: Mapping[str, float]) -> float:
    """Probability that nothing material is at work, where nothing is told."""
    return SURE_NONE * (1.0 - strange) * max(1.0 - sum(chances.values()), 0.0)


def _warnings(harmful: Sequence[str], scored: Scored, seen_by: Judged) -> tuple[str, ...]:
    """What a user must know before following the advice."""
    out = [f"adding {name} makes the held-out data worse: not advised" for name in harmful]
    if scored.spans is not None and set(scored.causes) != set(seen_by.causing):
        told = ", ".join(scored.causes) or "no effect"
        out.append(f"on the part of the runs that the score was fitted on, the choice is: {told}")
    return tuple(out)


def _causes(found: Search, seen_by: Judged, shares: Mapping[str, float]) -> tuple[Cause, ...]:
    """The joint explanation by share, then rivals by probability."""
    causes = [
        Cause(name, p, shares.get(name, 0.0), seen_by.values.get(name, {}), _confusable(name, found))
        for name, p in seen_by.chances.items()
    ]
    causes.sort(key=lambda one: (one.probability <= 0.5, -one.share if one.probability > 0.5 else -one.probability))
    return tuple(causes)


SURE_NONE = 0.97
"""Of "none" where nothing material was found: what a clean run's false alarms leave."""


def _shares(found: Search, seen_by: Judged, gap: Gap) -> dict[str, float]:
    """What leaving each cause out brings back of the explained gap; of noise, its part of all that was earned."""
    earned: dict[str, float] = {}
    for one in found.links:
        earned |= one.earned
    earned |= {one.effect: one.gain for one in found.noises}
    earned = {name: value for name, value in earned.items() if name in seen_by.material}
    total = sum(earned.values())
    out = {name: value / total for name, value in earned.items()} if total > 0.0 else {}
    explained = gap.total.before - gap.total.after
    if explained > 0.0:
        for name, left in gap.without.items():
            out[name] = float(np.clip((left - gap.total.after) / explained, 0.0, 1.0))
    return out


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
