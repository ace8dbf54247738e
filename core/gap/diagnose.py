"""`diagnose(runs) -> Diagnosis`: where the gap lies, which effect causes it, how far it shrinks. The story, one screen.

Given: runs of a robot and what its simulator models. Done: each link of the chain is predicted from the recorded stream
before it; its residuals, in units of the noise that they themselves show, are searched for effects by exact refit; what
no listed effect explains is held against generic shapes; size is judged before significance; the gap is scored on runs
that took no part.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping, Sequence

import numpy as np

from core.effects import EFFECTS
from core.gap.candidates import Reach, candidates, tolerance
from core.gap.checks import check_runs, simulator_of
from core.gap.experiment import next_experiment
from core.gap.explain import Progress, Search, explain, silent
from core.gap.fit import refit
from core.gap.floor import Floor
from core.gap.judge import is_material, odds, probabilities, values_of
from core.gap.linear import Problem, with_floor
from core.gap.reference import restarts_of
from core.gap.selection import WORTH
from core.gap.shrink import NOISES, figures, floors, replay
from core.gap.types import Cause, Config, Diagnosis, Immaterial, Place, Rejected, Unexplained, Unseen, Value, Where
from core.gap.unknown import depends_on, matters, rest_of, stream_of, touching, words
from core.gap.where import where
from core.gap.world import WHEELS, World, make_world
from core.robot import EffectSet
from core.run import Run


def diagnose(
    runs: Sequence[Run],
    simulator: EffectSet | None = None,
    held_out: Sequence[Run] = (),
    config: Config | None = None,
    progress: Progress = silent,
) -> Diagnosis:
    """The gap between runs of one robot and its simulator.

    simulator: effects it already models (default: as the runs' `simulator.effects` say). held_out: runs that take no
    part in the fit. Raises ParameterError, MissingStreamError, NotEnoughDataError; whatever `progress` raises.
    """
    began = time.perf_counter()
    config = config or Config()
    check_runs(runs, held_out)
    known = simulator_of(runs, simulator)
    runs = [_with_known(run, known) for run in runs]
    held_out = [_with_known(run, known) for run in held_out]
    progress(0.0, "aligning")
    worlds = tuple(make_world(run, restarts_of(run, config.window)) for run in runs)
    problem = with_floor(Problem(worlds, Floor({}, {}, {}), known), {})
    reach = reach_of(worlds)
    tried = candidates(worlds[0].channels, list(runs[0].meta.beacons), reach, known, _warm(runs))
    progress(0.1, "searching")
    found = explain(problem, tried, progress)
    if any(run.truth is None for run in runs) and any(EFFECTS[name].family in PATH for name in found.model):
        progress(0.6, "again from the path set right")
        worlds = tuple(make_world(run, restarts_of(run, config.window, found.model)) for run in runs)
        found = explain(with_floor(Problem(worlds, Floor({}, {}, {}), known), {}), tried)
    progress(0.7, "scoring")
    kept = tuple(make_world(run, restarts_of(run, config.window, found.model)) for run in held_out)
    out = conclude(found, worlds, kept, reach, known, config)
    return dataclasses.replace(out, runtime_s=time.perf_counter() - began)


PATH = ("kinematics", "ground", "beacons")
"""Families whose effects bend a path that was smoothed without them."""


def _with_known(run: Run, known: EffectSet) -> Run:
    return dataclasses.replace(run, meta=dataclasses.replace(run.meta, effects=known))


def _warm(runs: Sequence[Run]) -> bool:
    """Whether a temperature was recorded that changes."""
    logs = [run.imu.temperature for run in runs if run.imu is not None and run.imu.temperature is not None]
    return (
        bool(logs)
        and len(logs) == len([r for r in runs if r.imu is not None])
        and any(float(np.nanmax(log) - np.nanmin(log)) > 0.0 for log in logs if len(log))
    )


def reach_of(worlds: Sequence[World]) -> Reach:
    """What the runs reach, from what drives them."""
    speed = acceleration = turn = 0.0
    for world in worlds:
        for side in (world.body_inputs.left, world.body_inputs.right):
            speed = max(speed, float(np.abs(side[:, 0]).max(initial=0.0)))
            acceleration = max(acceleration, float(np.quantile(np.abs(side[:, 1]), 0.999)) if len(side) else 0.0)
        rate = world.body_inputs.right[:, 0] - world.body_inputs.left[:, 0]
        turn = max(turn, float(np.abs(rate).max(initial=0.0)) / (world.run.meta.robot.track_width or 1.0))
    return Reach(speed, acceleration, turn)


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
    unexplained, doubt = _unknown(found, material)
    chances = probabilities(found.links, material, doubt)
    fitted = {name: model[name] for name in model if name in material and chances.get(name, 0.0) > 0.5}
    noises: dict[str, dict[str, float | str]] = {
        one.effect: {name: pair[0] for name, pair in one.parameters.items()}
        for one in found.noises
        if one.effect in material
    }
    floor = found.body.problem.floor
    small = {name: model[name] for name in model if name not in material}
    gap, _ = figures(kept or fitted_on, floor, {**small, **fitted, **noises}, noises, bool(kept), config.seed)
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
        where=_spots(fitted_on, floor, {**fitted, **noises}, noises) if verdict != "none" else (),
        causes=causes,
        gap=gap,
        immaterial=tuple(Immaterial(name, values[name]) for name in listed),
        unexplained=unexplained,
        next_experiment=next_experiment(fitted_on[0].run, {**fitted, **noises}, causes),
        rejected=_rejected(found, material, chances),
        unseen=unseen(found, reach),
        probabilities={**chances, **rest},
        model={**model, **noises},
        noise={name: floor.sigma[name] / floor.sheet[name] for name in floor.sigma if name in floor.sheet},
        notes=_notes(floor),
        link=_link(sure, unexplained),
        runtime_s=0.0,
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


def _spots(worlds: Sequence[World], floor: Floor, effects: EffectSet, noises: EffectSet) -> tuple[Where, ...]:
    """Where the fitted runs leave their floor; of a louder sensor, its stated noise is the floor."""
    replays = [replay(world, [{}], floor)[0] for world in worlds]
    levels = floors(worlds[0], floor)
    levels |= {name: 1.0 for effect in noises for name in NOISES[effect] if name in levels}
    return where(worlds, replays, levels, _place_of(effects), effects)


SURE_NONE = 0.95
"""Of "none" where nothing material was found: what a clean run's false alarms leave."""


def _values(found: Search) -> dict[str, dict[str, Value]]:
    out: dict[str, dict[str, Value]] = {}
    for one in found.links:
        out |= {name: values_of(one.fit, name) for name in one.fit.model}
    return out


def _unknown(found: Search, material: Sequence[str]) -> tuple[Unexplained | None, dict[str, float]]:
    """What is left, and for each material effect the probability that it only stood in for something unlisted."""
    doubt: dict[str, float] = {}
    best: tuple[float, Unexplained] | None = None
    for scope, one in zip(("wheels", "body")[-len(found.links) :], found.links, strict=True):
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
        took = one.earned
        suspects = [name for name in touching(shape, list(one.fit.model)) if name in material]
        crumbs = 0.01 * max((value for link in found.links for value in link.earned.values()), default=0.0)
        if not matters(
            gain, max(0.2 * one.tolerated.get(stream, 0.0), min(crumbs, 0.1 * max(took.values(), default=0.0) + 400.0))
        ):
            continue
        if suspects:
            rest = {name: values for name, values in one.fit.model.items() if name not in suspects}
            bare = refit(one.problem, rest, scope, 3)
            again = rest_of(one.problem, bare)
            shape_again, alone = again.best
            lost = bare.cost - one.fit.cost
            heat = 2.0 * (1.0 + 0.01 * lost)
            stand_in = 1.0 / (1.0 + float(np.exp(np.clip((lost - alone - gain * 0.5) / heat, -40.0, 40.0))))
            doubt |= dict.fromkeys(suspects, stand_in)
            if stand_in > 0.5 and shape_again is not None:
                shape, gain, stream = shape_again, alone, stream_of(shape_again)
        excess = max(found.rests[scope].excess.get(stream, gain), gain)
        share = float(min(gain / max(excess, 1e-9), 1.0))
        told = Unexplained(stream, depends_on(shape), words(shape, gain, share), share)
        if best is None or gain > best[0]:
            best = (gain, told)
    return (best[1] if best else None), doubt


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


def _rejected(found: Search, material: Sequence[str], chances: Mapping[str, float]) -> tuple[Rejected, ...]:
    out: dict[str, str] = {}
    for one in found.links:
        for name, gain in one.gains.items():
            if name not in one.fit.model and chances.get(name, 0.0) < 0.5:
                out[name] = (
                    f"adds nothing beside the causes (drop of deviance {gain:.0f}; chance gives up to {WORTH:.0f})"
                )
        for step in one.steps:
            best = dict(step.gains).get(step.action[4:], 0.0)
            for name, gain in step.gains:
                if name not in one.fit.model:
                    out[name] = (
                        f"refitted, it takes {max(gain, 0.0) / max(best, 1.0):.1%} of what {step.action[4:]} takes"
                    )
    return tuple(Rejected(name, reason) for name, reason in out.items() if name not in material)


def unseen(found: Search, reach: Reach) -> tuple[Unseen, ...]:
    """Parameters whose size at twice the search's threshold exceeds five tolerances."""
    out = []
    for effect in EFFECTS.values():
        if not any(set(effect.streams) & set(one.fit.normal.channels) for one in found.links):
            for parameter in effect.parameters:
                small = tolerance(effect.id, parameter.name, reach)
                out += [Unseen(effect.id, parameter.name, None)] if small is not None else []
    return tuple(out)


def _place_of(effects: EffectSet) -> Place | None:
    for name in ("slip_patch", "beacon_shadow"):
        if name in effects:
            values = effects[name]
            return Place(float(values["x"]), float(values["y"]), float(values["radius"]))
    return None


def _notes(floor: Floor) -> tuple[str, ...]:
    out = []
    for name, sigma in floor.sigma.items():
        ratio = sigma / floor.sheet[name] if name in floor.sheet else 1.0
        if name not in WHEELS and not name.startswith("truth") and not 0.8 < ratio < 1.25:
            out.append(f"the noise of {name} is {ratio:.2f} times what run.json states")
    return tuple(out)


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
