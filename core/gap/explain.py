"""Both links explained: the drive from the encoders; body and sensors from the drive as the encoders show it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from core.effects import EFFECTS
from core.gap.candidates import Candidate
from core.gap.fit import Fit, refit
from core.gap.linear import Model, Problem, linearise, whitened, with_floor
from core.gap.scatter import DENSITIES, Scatter, block_means, gyro_walk, scatters, walk_costs
from core.gap.selection import WORTH, Found, gains_of, search
from core.gap.unknown import Rest, rest_of, stream_of
from core.robot import EffectSet

Array = npt.NDArray[np.float64]
Progress = Callable[[float, str], None]

MEAN_GYRO = ("gyro_bias", "gyro_drift", "gyro_temperature")
"""Mean effects that a walking bias can pass for."""
PER_EFFECT, PER_PARAMETER = 15.0, 8.0
"""What an effect and a parameter must earn, in drop of deviance, where two whole explanations are weighed."""


def silent(fraction: float, message: str) -> None:
    """No progress shown."""


@dataclasses.dataclass(frozen=True)
class Search:
    """Everything the search found: one model per link, rests, noise effects."""

    wheels: Found | None
    body: Found
    rests: Mapping[str, Rest]
    noises: tuple[Scatter, ...]

    @property
    def links(self) -> tuple[Found, ...]:
        """The links' models, upstream first."""
        return (self.body,) if self.wheels is None else (self.wheels, self.body)

    @property
    def model(self) -> Model:
        """All effects of all links."""
        merged: Model = {}
        for one in self.links:
            merged |= {name: dict(values) for name, values in one.problem.held.items()}
            merged |= {name: dict(values) for name, values in one.fit.model.items()}
        return merged


def explain(problem: Problem, tried: Sequence[Candidate], progress: Progress = silent) -> Search:
    """The models of both links; missed ticks, which act in both, by weighing whole explanations."""
    links = problem.leads and problem.worlds[0].wheel_inputs is not None
    if not links:
        body = search(problem, [c for c in tried if c.effect != "missed_ticks"], "body")
        return _finish(None, body, tried)
    drive = [c for c in tried if EFFECTS[c.effect].family == "drive"]
    ticks = [c for c in tried if c.effect == "missed_ticks"]
    rest = [c for c in tried if c not in drive and c not in ticks]
    wheels = search(problem, drive, "wheels")
    progress(0.3, "searching the body")
    body = search(_driven(wheels, {}), rest, "body")
    lost = _missed(problem, wheels, drive, ticks)
    if lost is not None:
        held = {"missed_ticks": lost.fit.model["missed_ticks"]}
        other = search(_driven(lost, held), rest, "body")
        if _price(lost, other) < _price(wheels, body):
            wheels, body = lost, other
    progress(0.55, "looking at what is left")
    return _finish(wheels, body, tried)


def _driven(wheels: Found, held: EffectSet) -> Problem:
    """The body's problem under a fitted drive."""
    worlds = tuple(world.with_drive(wheels.fit.model) for world in wheels.problem.worlds)
    return with_floor(dataclasses.replace(wheels.problem, worlds=worlds, held=held), {})


def _missed(problem: Problem, wheels: Found, drive: Sequence[Candidate], ticks: Sequence[Candidate]) -> Found | None:
    """The drive's model with missed ticks, where they promise something."""
    if not ticks:
        return None
    without = {name: values for name, values in wheels.fit.model.items() if name != "drive_gain"}
    fit = wheels.fit if len(without) == len(wheels.fit.model) else refit(wheels.problem, without, "wheels")
    normal = linearise(wheels.problem, fit.model, ticks, "wheels")
    if gains_of(normal, len(fit.parameters), ticks)[0] < WORTH:
        return None
    start = {**fit.model, "missed_ticks": dict(ticks[0].start)}
    found = search(wheels.problem, [c for c in drive if c.effect != "drive_gain"], "wheels", start)
    lost = found.fit.model.get("missed_ticks", {"left": 0.0, "right": 0.0})
    small = EFFECTS["missed_ticks"].parameter("left").small or 0.0
    return found if max(abs(float(v)) for v in lost.values()) > small else None


def _price(*links: Found) -> float:
    """What is left over, plus what the model itself costs."""
    total = 0.0
    for one in links:
        total += (
            float(one.fit.normal.c.sum()) + PER_EFFECT * len(one.fit.model) + PER_PARAMETER * len(one.fit.parameters)
        )
    return total


def _finish(wheels: Found | None, body: Found, tried: Sequence[Candidate]) -> Search:
    """Noise effects, a walking bias in place of mean ones, and what is left."""
    rests = {"body": rest_of(body.problem, body.fit)}
    before = body
    body, walk = _walking(body, rests["body"])
    if body is not before:
        rests["body"] = rest_of(body.problem, body.fit)
    white, _ = whitened(body.problem, body.fit.model, (), "body")
    noises = scatters(body.problem, white, list(body.problem.known))
    if walk is not None and "gyro_walk" not in body.problem.known:
        noises.append(walk)
    if wheels is not None:
        rests["wheels"] = rest_of(wheels.problem, wheels.fit)
    return Search(wheels, body, rests, tuple(noises))


def _walking(body: Found, left: Rest) -> tuple[Found, Scatter | None]:
    """A random walk of the gyro's bias, alone or in place of the mean effects that it passes for.

    Not where one shape of what the robot does takes more than a walk would: a walk follows anything slow.
    """
    if "imu.gz" not in body.problem.floor.sigma:
        return body, None
    mean = [name for name in MEAN_GYRO if name in body.fit.model]
    rest = {name: values for name, values in body.fit.model.items() if name not in mean}
    bare = refit(body.problem, rest, "body", 2) if mean else body.fit
    walk, gain = gyro_walk(body.problem, _gyro_left(body.problem, bare))
    shaped = max((value for shape, value in left.shapes if stream_of(shape) == "imu.gz"), default=0.0)
    if walk is None or gain < 1.5 * shaped:
        return body, None
    if mean:
        sigma = body.problem.floor.sigma["imu.gz"]
        none = DENSITIES[:1]
        parts = [(block_means(t, v)) for t, v in _gyro_left(body.problem, body.fit)]
        with_mean = sum(float(walk_costs(t, m, sigma**2 / n, none)[0]) for t, m, n in parts)
        parts = [(block_means(t, v)) for t, v in _gyro_left(body.problem, bare)]
        without = sum(float(walk_costs(t, m, sigma**2 / n, none)[0]) for t, m, n in parts)
        if gain < without - with_mean - PER_PARAMETER * len(mean):
            return body, None
        return dataclasses.replace(body, fit=bare), walk
    return body, walk


def _gyro_left(problem: Problem, fit: Fit) -> list[tuple[Array, Array]]:
    white, _ = whitened(problem, fit.model, (), "body")
    sigma = problem.floor.sigma["imu.gz"]
    return [(one["imu.gz"].t, one["imu.gz"].residual * sigma) for one in white if "imu.gz" in one]
