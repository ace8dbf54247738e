"""Size and probability of what was fitted: materiality by tolerances, odds against each rival, honest deviations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

from core.effects import EFFECTS
from core.gap.candidates import Reach, tolerance
from core.gap.fit import Fit, flaws_seen
from core.gap.selection import Found
from core.gap.types import Config, Value
from core.robot import EffectSet

Array = npt.NDArray[np.float64]

TEMPER, LEFT = 2e-4, 0.05
"""Rivals are not told apart by less than this share of an effect's own drop, nor of what its model leaves over the
noise: no model is exact to more than that."""
SURE = 0.96
"""No probability is higher: the world may hold what no candidate is. Of causes named on the worlds of the bench so many
were right (app/guide/gap.md)."""
LEADS = 0.51
"""Probability of the first of a set whose members these runs cannot tell apart, at least."""
LEAST = {
    "command_delay.delay": 4e-4, "motor_lag.tau": 4e-4, "imu_clock.offset": 3e-4, "beacon_delay.delay": 5e-4,
    "deadband.width": 1e-4, "slip_patch.x": 1e-2, "slip_patch.y": 1e-2, "slip_patch.radius": 1e-2,
    "slip_patch.slip": 5e-4, "bump.time": 1e-3, "accel_limit.a_max": 3e-3, "speed_limit.v_max": 1e-3,
    "gyro_clip.limit": 1e-3,
}  # fmt: skip
"""Added in squares to these deviations: instants agree to half a control step, edges to a sample's way."""


def louder(fit: Fit) -> Array:
    """(P,) by how much what is left exceeds the noise in the channels that tell of each parameter, as a deviation.

    What no model explains is no white noise: it moves parameters as much as it is large (Birge 1932's ratio).
    """
    normal = fit.normal
    n, c = normal.n.sum(axis=1), normal.c.sum(axis=1)
    told = np.einsum("cbii->ci", normal.a)
    ratio = np.maximum(c / np.maximum(n, 1.0), 1.0)
    out: Array = np.sqrt(ratio @ told / np.maximum(told.sum(axis=0), 1e-30))
    return np.maximum(out, 1.0)


EXPECTED, SHARP = 0.1, 0.1
"""Of flaws that no list has, before any is seen: their size in units of what is immaterial, worth one that is seen.
Flaws known to this share of what is immaterial count half of those that are known exactly."""
FEWEST = 12
"""Fewer blocks than this say nothing of their scatter."""


def unlisted(found: Sequence[Found]) -> float:
    """Size of a robot's flaws that no list has, in units of what is immaterial, as those show that are seen.

    What contact, inertia and friction do to the motion is fitted beside every model (`discrepancy.py`); what else such
    a robot does, unseen, moves every parameter by as much of its tolerance.
    """
    total, count = EXPECTED**2, 1.0
    for one in found:
        for size, sd in flaws_seen(one.problem, one.fit):
            weight = SHARP**2 / (SHARP**2 + sd**2)
            total, count = total + weight * (size**2 - sd**2), count + weight
    return float(np.sqrt(max(total, 0.0) / count))


def deviations(fit: Fit, flawed: float = EXPECTED) -> dict[tuple[str, str], float]:
    """Standard deviation of each parameter: the larger of the model's own and one from the scatter between blocks.

    flawed: share of its tolerance to which no parameter is known, as `unlisted` tells.
    """
    a = fit.a
    if not len(a):
        return {}
    size = np.sqrt(np.maximum(np.diag(a), 1e-30))
    inverse = np.linalg.pinv(a / np.outer(size, size), rcond=1e-12) / np.outer(size, size)
    scores = fit.normal.g.sum(axis=0) if fit.scores is None else fit.scores
    scores = scores - scores.mean(axis=0)
    sandwich = inverse @ (scores.T @ scores) @ inverse
    model, blocks = np.sqrt(np.maximum(np.diag(inverse), 0.0)), np.sqrt(np.maximum(np.diag(sandwich), 0.0))
    few = len(scores) < FEWEST
    model = model * louder(fit)
    blocks *= np.sqrt(len(scores) / max(len(scores) - len(a), 1))
    out = {}
    for i, key in enumerate(fit.parameters):
        sd = float(model[i] if few else max(model[i], min(blocks[i], 10.0 * model[i])))
        one = EFFECTS[key[0]].parameter(key[1])
        moved = 0.0 if one.small_of_reach else flawed * abs(one.small or 0.0)
        out[key] = float(np.hypot(np.hypot(sd, moved), LEAST.get(".".join(key), 0.0)))
    return out


def values_of(fit: Fit, effect: str, flawed: float = EXPECTED) -> dict[str, Value]:
    """An effect's parameters with their deviations; flawed: as `deviations` takes it."""
    sd = deviations(fit, flawed)
    out = {}
    for name, value in fit.model[effect].items():
        out[name] = Value(value if isinstance(value, str) else float(value), sd.get((effect, name)))
    return out


ALIKE = {"command_delay": ("motor_lag", "tau"), "motor_lag": ("command_delay", "delay")}
"""To first order one does what the other does: what both could do within their tolerances is immaterial."""


def is_material(effect: str, values: Mapping[str, float | str], known: EffectSet, reach: Reach, config: Config) -> bool:
    """Whether an effect is larger than its tolerance, against what the simulator already models."""
    return size_of(effect, values, known, reach, config) > 1.0


def size_of(effect: str, values: Mapping[str, float | str], known: EffectSet, reach: Reach, config: Config) -> float:
    """How many times its tolerance an effect is, against what the simulator already models."""
    definition = EFFECTS[effect]
    base = {**definition.neutral, **known.get(effect, {})}
    ratios = []
    for parameter in definition.parameters:
        small = config.tolerances.get(f"{effect}.{parameter.name}", tolerance(effect, parameter.name, reach))
        if small is None or parameter.text:
            continue
        if effect in ALIKE and effect not in known:
            small += config.tolerances.get(".".join(ALIKE[effect]), tolerance(*ALIKE[effect], reach) or 0.0)
        value, neutral = float(values[parameter.name]), float(base[parameter.name])
        if np.isinf(neutral):
            top = {"speed_limit": reach.speed, "accel_limit": reach.acceleration, "gyro_clip": reach.turn}[effect]
            ratios.append(max(top - value, 0.0) / small)
        else:
            ratios.append((value - neutral) / small)
    if {p.name for p in definition.parameters} >= {"x", "y"} and effect not in (
        "slip_patch",
        "beacon_shadow",
        "accel_scale",
    ):
        return float(np.linalg.norm(ratios))
    return max((abs(r) for r in ratios), default=0.0)


CLOSE = 0.25
"""Share of its tolerance to which an effect's size is its own: ordinary flaws of a plant add up to that beside it."""


def clear_of_small(effect: str, size: float, values: Mapping[str, Value]) -> float:
    """Probability that an effect is a cause and no ordinary flaw: by how far its size is clear of its tolerance."""
    if effect in ALIKE:
        return 1.0  # two tolerances are its own already
    sd = [
        float(values[p.name].std or 0.0) / p.small
        for p in EFFECTS[effect].parameters
        if p.small and not p.small_of_reach and p.name in values
    ]
    spread = float(np.hypot(min(max(sd, default=0.0), CLOSE), CLOSE))
    return float(ndtr((size - 1.0) / spread - 1.0))


RARE = 2.0
"""Deviations beyond its tolerance at which a noise effect is as likely a cause as not."""


def beyond(effect: str, values: Mapping[str, Value]) -> float:
    """Probability that a noise effect is larger than its tolerance, by its own standard deviation.

    Robots with a flaw within its tolerance are many, those beyond are few: chance must not lift one of the many over.
    """
    chances = []
    for parameter in EFFECTS[effect].parameters:
        one = values.get(parameter.name)
        if one is None or parameter.small is None or isinstance(one.value, str) or not one.std:
            continue
        neutral = float(parameter.neutral)
        edge = parameter.small - neutral if parameter.small > neutral > 0.0 else parameter.small
        chances.append(float(ndtr((abs(float(one.value) - neutral) - edge) / one.std - RARE)))
    return max(chances, default=1.0)


def odds(found: Found) -> dict[str, dict[str, float]]:
    """Per effect of the model, each rival's weight against it: exp(-difference of costs / 2), tempered."""
    out: dict[str, dict[str, float]] = {}
    n = float(found.fit.normal.n.sum())
    left = max(float(found.fit.normal.c.sum()) - n - 4.0 * float(np.sqrt(2.0 * n)), 0.0)
    for step in found.steps:
        if not step.action.startswith("add "):
            continue
        name = step.action[4:]
        gains = dict(step.gains)
        own = gains.get(name, 0.0)
        heat = 2.0 * (1.0 + TEMPER * own + LEFT * left)
        out[name] = {
            rival: float(np.exp(-min(max(own - gain, 0.0) / heat, 50.0)))
            for rival, gain in gains.items()
            if rival != name and rival not in found.fit.model
        }
    return out


FAINT = 2e-3
"""Share of what other effects explain of its channels that an effect must take to be as likely as not: no model of
those is exact to more than a twentieth of its amplitude (as MuJoCo's servo is no first-order lag)."""


def clear_of(name: str, found: Found) -> float:
    """Probability that an effect is no flaw in how another, far larger one is modelled."""
    own = found.earned.get(name, 0.0)
    brought = max((dict(step.gains)[name] for step in found.steps if step.action == f"add {name}"), default=own)
    streams = set(EFFECTS[name].streams)
    others = [v for k, v in found.earned.items() if k != name and streams & set(EFFECTS[k].streams)]
    own = max(own, brought)
    return own / (own + FAINT * sum(others)) if own > 0.0 else 1.0


def probabilities(found: Sequence[Found], material: Sequence[str], doubt: Mapping[str, float]) -> dict[str, float]:
    """Of every effect in question: an effect shares its probability with its rivals and with "unknown".

    doubt: probability per effect that what it explains is no listed effect's.
    """
    out: dict[str, float] = {}
    for one in found:
        for name, rivals in odds(one).items():
            if name not in material:
                continue
            whole = 1.0 + sum(rivals.values())
            rest = SURE * (1.0 - doubt.get(name, 0.0)) * clear_of(name, one)
            leads = rest if all(weight < 1.0 for weight in rivals.values()) else 0.0
            out[name] = max(out.get(name, 0.0), rest / whole, min(leads, LEADS))  # the first of a set stands for it
            for rival, weight in rivals.items():
                out[rival] = max(out.get(rival, 0.0), rest * weight / whole)
    for name in material:
        out.setdefault(name, SURE * (1.0 - doubt.get(name, 0.0)))
    return {**in_question(found), **out}


def in_question(found: Sequence[Found]) -> dict[str, float]:
    """Of effects that bring less than they must: as likely as none at what they must bring, less by what is missing."""
    short = {name: value for one in found for name, value in one.faint.items()}
    weights = {name: float(np.exp(-0.5 * min(value, 100.0))) for name, value in short.items()}
    whole = 1.0 + sum(weights.values())
    return {name: SURE * weight / whole for name, weight in weights.items() if weight > ASKED * whole}


ASKED = 0.01
"""No effect of less probability is in question."""
