"""Both links explained: the drive from the encoders; body and sensors from the drive as the encoders show it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from core.effects import EFFECTS
from core.gap.asked import cut_off
from core.gap.candidates import Candidate
from core.gap.discrepancy import driven
from core.gap.fit import flaws_of, refit, trifles_of, with_trifles
from core.gap.floor import Floor
from core.gap.linear import Model, Problem, linearise, with_floor
from core.gap.scatter import DENSITIES, Scatter, drift_costs, gyro_left, gyro_walk, scatters
from core.gap.screen import gains_of
from core.gap.selection import WORTH, Found, search
from core.gap.smoothing import smooth
from core.gap.unknown import Rest, rest_of, stream_of
from core.gap.world import WHEELS, World
from core.robot import EffectSet

Array = npt.NDArray[np.float64]
Progress = Callable[[float, str], None]

MEAN_GYRO = ("gyro_bias", "gyro_drift", "gyro_temperature")
"""Mean effects that a walking bias can pass for."""
PER_EFFECT, PER_PARAMETER = 15.0, 8.0
"""What an effect and a parameter must earn, in drop of deviance, where two whole explanations are weighed."""
KINEMATIC = ("wheel_radius", "unequal_wheels")
"""What would have to make up for ticks that are not missed."""
FULL = 0.99
"""Share of its tolerance from which a nuisance is at its end."""
STRANGE = 60.0
"""What a shape of no listed effect must earn."""
FITTED = 1.3
"""A drive whose encoders' mean square stays above this is taken from the encoders, not from its model."""


def silent(fraction: float, message: str) -> None:
    """No progress shown."""


@dataclasses.dataclass(frozen=True)
class Search:
    """Everything the search found: one model per link, rests, noise effects; the floor of all readings."""

    wheels: Found | None
    body: Found
    rests: Mapping[str, Rest]
    noises: tuple[Scatter, ...]
    floor: Floor

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

    @property
    def trifles(self) -> dict[str, dict[str, tuple[float, float]]]:
        """Effects that are real but within their tolerance: (value, standard deviation) by parameter."""
        out: dict[str, dict[str, tuple[float, float]]] = {}
        for one in self.links:
            out |= {e: v for e, v in trifles_of(one.problem, one.fit).items() if e not in self.model}
        return out


def explain(
    problem: Problem,
    tried: Sequence[Candidate],
    progress: Progress = silent,
    whole: Sequence[World] | None = None,
    start: EffectSet | None = None,
) -> Search:
    """The models of both links; missed ticks, which act in both, by weighing whole explanations.

    whole: the worlds with all their readings, where the problem's are thinned, for the noise. start: effects to begin
    with, of which only those stay that are worth it.
    """
    whole = whole or problem.worlds
    links = problem.leads and problem.worlds[0].wheel_inputs is not None
    if not links:
        if problem.leads and problem.worlds[0].wheel_inputs is None:
            worlds = tuple(_smooth_wheels(world) for world in problem.worlds)
            problem = with_floor(dataclasses.replace(problem, worlds=worlds), {})
        body = search(problem, [c for c in tried if c.effect != "missed_ticks"], "body", start)
        return _finish(None, body, tried, whole)
    drive = [c for c in tried if EFFECTS[c.effect].family == "drive"]
    ticks = [c for c in tried if c.effect == "missed_ticks"]
    rest = [c for c in tried if c not in drive and c not in ticks]
    wheels = cut_off(search(problem, drive, "wheels", start, aside=ticks), drive, ticks)
    progress(0.3, "searching the body")
    body = search(_driven(wheels, {}), rest, "body", start)
    lost = _missed(problem, wheels, drive, ticks) if wheels.unknown is None else None
    if lost is not None:
        held = {"missed_ticks": lost.fit.model["missed_ticks"]}
        other = search(_driven(lost, held), rest, "body")
        honest = search(_driven(lost, {}), rest, "body") if _makes_up(other) else None
        if honest is not None and not _makes_up(honest):
            body = honest  # the body moves as the encoders say: they miss nothing, the motors differ
        elif _price(lost, other) < _price(wheels, body):
            wheels, body = lost, other
    progress(0.55, "looking at what is left")
    return _finish(wheels, body, tried, whole)


def _makes_up(body: Found) -> bool:
    """Whether wheels of other sizes, to their tolerance or beyond, or a floor take back what missed ticks gave."""
    model = body.fit.model
    if "slip_patch" in model:
        return True
    for name in KINEMATIC:
        for parameter in EFFECTS[name].parameters if name in model else ():
            if abs(float(model[name][parameter.name]) - 1.0) > (parameter.small or 0.0):
                return True
    beside = body.problem.nuisances
    sizes = zip(beside.effects, np.abs(body.fit.trifles), beside.limit, strict=True)
    return any(size > FULL * limit for effect, size, limit in sizes if effect in KINEMATIC and effect not in model)


def _driven(wheels: Found, held: EffectSet) -> Problem:
    """The body's problem under a fitted drive."""
    normal = wheels.fit.normal
    told = float(normal.c.sum()) < FITTED * float(normal.n.sum()) and wheels.unknown is None
    if told:
        drive = with_trifles(wheels.problem, wheels.fit)
        flaws = flaws_of(wheels.problem, wheels.fit)
        worlds = tuple(driven(wheels.problem, world, wheels.fit.model, drive, flaws) for world in wheels.problem.worlds)
    else:
        worlds = tuple(recorded(world, wheels) for world in wheels.problem.worlds)
    return with_floor(dataclasses.replace(wheels.problem, worlds=worlds, held=held), {})


def recorded(world: World, wheels: Found) -> World:
    """Driven by what the encoders show: the model's angles, corrected by the smoothed rest."""
    predicted = world.wheels([wheels.problem.overlay(wheels.fit.model, "wheels")])
    radius = world.run.meta.robot.wheel_radius or 0.0
    t = world.times["wheels.left"]
    speeds = []
    for name in WHEELS:
        angle = predicted[name][0, world.keep(name)]
        angle = angle + smooth(world.readings[name] - angle, wheels.problem.floor.sigma[name])
        speeds.append(radius * np.diff(angle) / np.diff(t))
    return world.with_wheels(0.5 * (t[1:] + t[:-1]), speeds[0], speeds[1], rough=True)


def _smooth_wheels(world: World) -> World:
    """Driven by its encoders without their rounding: accelerations are second differences of what they count."""
    wheels, robot = world.run.wheels, world.run.meta.robot
    if wheels is None or not robot.ticks_per_rev:
        return world
    known = np.isfinite(wheels.left) & np.isfinite(wheels.right)
    t, speeds = wheels.t[known], []
    if len(t) < 8:
        return world
    for side in (wheels.left[known], wheels.right[known]):
        angle = smooth(np.asarray(side, dtype=np.float64), 2.0 * np.pi / robot.ticks_per_rev / np.sqrt(12.0))
        speeds.append((robot.wheel_radius or 0.0) * np.diff(angle) / np.diff(t))
    return world.with_wheels(0.5 * (t[1:] + t[:-1]), speeds[0], speeds[1], rough=True)


def _missed(problem: Problem, wheels: Found, drive: Sequence[Candidate], ticks: Sequence[Candidate]) -> Found | None:
    """The drive's model with missed ticks, where they promise something."""
    if not ticks:
        return None
    without = {name: values for name, values in wheels.fit.model.items() if name != "drive_gain"}
    fit = wheels.fit if len(without) == len(wheels.fit.model) else refit(wheels.problem, without, "wheels")
    normal = linearise(wheels.problem, fit.model, ticks, "wheels")
    if gains_of(normal, len(fit.parameters), ticks)[0] < WORTH:
        return None
    gain = [c for c in drive if c.effect == "drive_gain"]
    found = search(problem, [*(c for c in drive if c.effect != "drive_gain"), *ticks], "wheels", aside=gain)
    lost = found.fit.model.get("missed_ticks", {"left": 0.0, "right": 0.0})
    small = EFFECTS["missed_ticks"].parameter("left").small or 0.0
    return found if max(abs(float(v)) for v in lost.values()) > small else None


def _price(*links: Found) -> float:
    """What is left over, plus what the model itself costs."""
    total = 0.0
    for one in links:
        total += 0.0 if one.unknown is None else STRANGE - one.unknown[1]
        total += (
            float(one.fit.normal.c.sum()) + PER_EFFECT * len(one.fit.model) + PER_PARAMETER * len(one.fit.parameters)
        )
    return total


def _finish(wheels: Found | None, body: Found, tried: Sequence[Candidate], worlds: Sequence[World]) -> Search:
    """Noise effects, a walking bias in place of mean ones, and what is left."""
    rests = {"body": rest_of(body.problem, body.fit)}
    walk = None if body.unknown is not None else _walking(body, rests["body"])
    if walk is not None:  # a walk follows anything slow: the others are asked again beside it
        floor = dataclasses.replace(body.problem.floor, gyro_walk=walk.parameters["density"][0])
        acting = [c for c in tried if EFFECTS[c.effect].family != "drive" or not body.problem.leads]
        acting = [c for c in acting if c.effect != "missed_ticks"]
        body = search(dataclasses.replace(body.problem, floor=floor), acting, "body")
        rests["body"] = rest_of(body.problem, body.fit)
    trifles = with_trifles(body.problem, body.fit)
    driven_alike = tuple(all_of.driven_as(one) for one, all_of in zip(body.problem.worlds, worlds, strict=True))
    every = with_floor(dataclasses.replace(body.problem, worlds=driven_alike), trifles)
    noises = scatters(every, trifles, list(body.problem.known))
    if walk is not None and "gyro_walk" not in body.problem.known:
        noises.append(walk)
    if wheels is not None:
        rests["wheels"] = rest_of(wheels.problem, wheels.fit)
    return Search(wheels, body, rests, tuple(noises), every.floor)


def _walking(body: Found, left: Rest) -> Scatter | None:
    """A random walk of the gyro's bias, alone or in place of the mean effects that it passes for.

    Not where one shape of what the robot does takes more than a walk would: a walk follows anything slow.
    """
    if "imu.gz" not in body.problem.floor.sigma or "gyro_walk" in body.problem.known:
        return None
    mean = [name for name in MEAN_GYRO if name in body.fit.model]
    rest = {name: values for name, values in body.fit.model.items() if name not in mean}
    bare = refit(body.problem, rest, "body", 2) if mean else body.fit
    bare_left = gyro_left(body.problem, bare)
    walk, gain = gyro_walk(body.problem, bare_left)
    left = rest_of(body.problem, bare) if mean and walk is not None else left
    shaped = max((value for shape, value in left.shapes if stream_of(shape) == "imu.gz"), default=0.0)
    if walk is None or gain < shaped:
        return None
    if mean:
        without, beside = (_steady_cost(body.problem, rows) for rows in (bare_left, gyro_left(body.problem, body.fit)))
        if gain < without - beside - PER_PARAMETER * len(mean):
            return None
    return walk


def _steady_cost(problem: Problem, residuals: Sequence[tuple[Array, Array]]) -> float:
    """-2 log likelihood of gyro residuals without any walk, on the scale of `walk_costs`."""
    return sum(float(drift_costs(problem, t, values, DENSITIES[:1])[0]) for t, values in residuals)
