"""What no effect of the table says of any real drive: its modes differ, its tyres yield; nuisances beside every model.

Inertia couples the wheels, so that turning lags other than driving; a servo leaves a little for friction and load; in
contact the body lags its wheels. Each such flaw is one column in units of the size up to which it is immaterial, by the
tolerances of the effects that it resembles. Keys start with "~": no effect of the table is told by them.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from core.effects import EFFECTS
from core.gap.generic import displaced, felt, later, regressors, seen
from core.gap.linear import Problem, White
from core.gap.whiten import events_of, imu_sigma, residuals_of, white_imu, white_poses, white_wheels
from core.gap.world import IMU, WHEELS, World
from core.robot import EffectSet
from core.simulation import params as P
from core.simulation.simulate import simulate_sets

Array = npt.NDArray[np.float64]

LAG, DELAY, CLOCK = (
    EFFECTS[effect].parameter(name).small or 0.0
    for effect, name in (("motor_lag", "tau"), ("command_delay", "delay"), ("imu_clock", "offset"))
)
BEND = (LAG + DELAY) ** 2
"""Second order of a response [s²]: a lag and a delay, each within its tolerance."""
APART = 0.5
"""Of a lag that the model has, so much may turning differ from driving: a wheel bears another inertia in each."""
LOADED = 1.5e-3
"""Share of its turning that a robot may lose for each metre per second: a load that is not over the axle pulls at the
tyres in turns [s/m]; less than half of what the track width is known to, at common speeds."""
FRICTION, COAST = 1e-3, 0.1
"""Rim speed that friction may cost a servo [m/s]: a third of the dead band's tolerance; and, of one with a lag, what a
lag costs against this deceleration [m/s²], rolling on a floor at a hundredth of its weight."""
SLOW = 0.05
"""Rim speeds above this [m/s] have a direction."""
WHEEL_KEYS = ("~drive.bend", "~drive.turning_lag", "~drive.turning_bend", "~drive.friction")
BODY_KEYS = ("~body.lag", "~body.turning_lag", "~body.bend", "~body.turning_bend", "~body.turning_load", "~gyro.lag")


def wheel_flaws(world: World, model: EffectSet, t: Array, left: Array, right: Array) -> tuple[Array, Array]:
    """(4, N) what each flaw of `WHEEL_KEYS` adds to either wheel's predicted angle [rad] at stamps t."""
    step = np.maximum(np.gradient(t), 1e-6)
    radius = world.run.meta.robot.wheel_radius or 1.0
    tau = float(model.get("motor_lag", {}).get("tau", 0.0))
    lag = LAG + APART * tau
    half, mean = 0.5 * (right - left), 0.5 * (right + left)
    first, second = _slower(half, step, tau)
    driving = (BEND + APART * tau * LAG) * _slower(mean, step, tau)[1]
    turning = np.array((-lag * first, (BEND + (APART * tau) ** 2) * second))
    servo = (FRICTION + COAST * tau) / radius
    sides = []
    for sign, angle in ((-1.0, left), (1.0, right)):
        rate = np.gradient(angle) / step
        friction = -np.cumsum(np.tanh(rate * radius / SLOW) * np.diff(t, prepend=t[:1])) * servo
        lagging, bend = sign * turning
        sides.append(np.array((driving, lagging, bend, friction)))
    return sides[0], sides[1]


def _slower(angle: Array, step: Array, tau: float) -> tuple[Array, Array]:
    """What a further lag takes off an angle, per second of it, and its second order; behind a lag that there is."""
    share = float(np.median(step)) / (tau + float(np.median(step)))

    def lagged(values: Array) -> Array:
        out: Array = lfilter([share], [1.0, share - 1.0], values) if tau > 0.0 else values
        return out

    first = lagged(np.gradient(angle) / step)
    return first, lagged(np.gradient(first) / step)


def flaws(problem: Problem, model: EffectSet, scope: str) -> tuple[tuple[str, ...], list[dict[str, White]]]:
    """Keys of all flaws of a scope, and their white columns per run and channel about a model; none where both links
    are one."""
    if scope == "wheels":
        return WHEEL_KEYS, [_of_wheels(problem, world, model) for world in problem.worlds]
    if not problem.leads:
        return (), [{} for _ in problem.worlds]
    return BODY_KEYS, [_of_body(problem, world, model) for world in problem.worlds]


def _of_wheels(problem: Problem, world: World, model: EffectSet) -> dict[str, White]:
    predicted = world.wheels([problem.overlay(model, "wheels")])
    t = world.times["wheels.left"]
    left, right = (predicted[name][0, world.keep(name)] for name in WHEELS)
    if len(left) != len(right):
        return {}
    index = np.arange(len(WHEEL_KEYS))
    out = {}
    for name, columns in zip(WHEELS, wheel_flaws(world, model, t, left, right), strict=True):
        out[name] = White(t, np.zeros(len(t)), white_wheels(world, name, columns, problem.floor), index)
    return out


def _of_body(problem: Problem, world: World, model: EffectSet) -> dict[str, White]:
    body = world.body([problem.overlay(model, "body")])
    if len(world.body_inputs.imu) <= SHORT:
        return {}
    r = regressors(world, body)
    rate, zero = np.maximum(np.gradient(world.body_inputs.imu), 1e-6), np.zeros_like(r["w"])
    motions = (
        (-LAG * r["a"], zero, zero),
        (zero, zero, -LAG * r["alpha"]),
        (BEND * np.gradient(r["a"]) / rate, zero, zero),
        (zero, zero, BEND * np.gradient(r["alpha"]) / rate),
        (zero, zero, LOADED * r["v"] * r["w"]),
    )
    index, out = np.arange(len(motions)), {}
    lagging = world.body([problem.overlay(later(model, LAG), "body")])
    for name in (name for name in IMU if name in world.readings):
        sigma = imu_sigma(world, name, body, problem.floor)
        rows = np.array([felt(world, name, motion, r)[world.keep(name)] for motion in motions])
        shift = world.channel(lagging, name)[0] - world.channel(body, name)[0]
        if name == "imu.gz":
            rows[1] = shift
            rows = np.vstack((rows, shift * (CLOCK / LAG)))
        else:
            rows[0] = shift - rows[1]
        white = white_imu(world, name, rows, sigma, problem.floor)
        out[name] = White(world.times[name], np.zeros(len(sigma)), white, np.arange(len(white)))
    still: Mapping[str, Array] = {name: np.zeros((1, len(world.run.wheels or ()))) for name in WHEELS}
    events = events_of(world, body, problem.floor, residuals_of(world, still, body))
    if events is None or len(world.stamps) <= SHORT:
        return out
    moved = [displaced(world, body, motion) for motion in motions]
    values = {name: np.array([seen(world, body, name, far) for far, _ in moved]) for name in events.names}
    walk, side = problem.floor.walk, problem.floor.side
    posed, _ = white_poses(events, values, np.array([-jump for _, jump in moved]), walk, side)
    for name in events.names:
        t = world.times[name]
        out[name] = White(t, np.zeros(len(t)), posed[name], index)
    return out


SHORT = 3
"""Fewer stamps than this have no derivatives."""


FINE = 5e-3
"""Step of the rim speeds by which a body is driven [s]."""


def driven(problem: Problem, world: World, model: EffectSet, drive: EffectSet, sizes: Mapping[str, float]) -> World:
    """Driven by a fitted drive with its flaws of these sizes by key. drive: the model with its trifles."""
    inputs = world.wheel_inputs
    if inputs is None or not any(sizes.get(key) for key in WHEEL_KEYS):
        return world.with_drive(drive)
    t = np.arange(inputs.wheels[0], inputs.wheels[-1], FINE)
    kept = problem.overlay(drive, "wheels")
    out, _ = simulate_sets(inputs._replace(wheels=t), P.pack(world.run.meta, kept)[None, :], parallel=False)
    size = np.array([sizes.get(key, 0.0) for key in WHEEL_KEYS])
    radius = world.run.meta.robot.wheel_radius or 0.0
    flawed = wheel_flaws(world, model, t, out.left[0], out.right[0])
    speeds = [
        radius * np.diff(a + size @ more) / FINE for a, more in zip((out.left[0], out.right[0]), flawed, strict=True)
    ]
    return world.with_wheels(0.5 * (t[1:] + t[:-1]), *speeds)
