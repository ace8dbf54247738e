"""Effects that only add noise, found in what a fitted model leaves: level, walk, vibration, outliers, shadow.

The level is judged against the data sheet, sensor against sensor: where every sensor is louder than its sheet by one
factor, the sheet is wrong, not a sensor. A gyro's walk is judged against the mean effects that could mimic it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.gap.discrepancy import flaws
from core.gap.fit import Fit, with_trifles, without
from core.gap.floor import Floor
from core.gap.linear import Problem, White, whitened
from core.gap.world import World
from core.robot import EffectSet

Array = npt.NDArray[np.float64]

SECOND = 1.0
"""Blocks over which the gyro's residual is averaged [s]."""
DENSITIES = np.concatenate(([0.0], np.geomspace(2e-6, 2e-2, 40)))
"""Walks tried [rad/s/√s]."""
FAR = 4.0
"""A fix further off than this many sigma may be an outlier."""
LEAST = 6
"""So many of them before one speaks of a rate."""
APART, COMMON = 3.0, 0.35
"""Outliers are at least this much wider than the noise, and no more than this share."""
AGREE = 1.12
"""Factors of two sensors nearer than this are one."""
KNOWN = 0.08
"""A sensor whose axes disagree by more than this share says nothing of another's sheet."""


@dataclass(frozen=True)
class Scatter:
    """One noise effect: its parameters with standard deviations, the drop of -2 log likelihood that it brings."""

    effect: str
    parameters: dict[str, tuple[float, float]]
    gain: float


def scatters(problem: Problem, model: EffectSet, known: Sequence[str]) -> list[Scatter]:
    """Every noise effect that the residuals show at all; the caller judges size. known: already modelled, skipped."""
    found = [*levels(problem.floor), vibration(problem), *outliers(problem, model), shadow(problem)]
    return [one for one in found if one is not None and one.effect not in known]


def factors(floor: Floor) -> dict[str, tuple[float, float]]:
    """Noise over data sheet, and its relative uncertainty, by kind of sensor."""
    groups = {
        "gyro": ("imu.gz",),
        "accelerometer": ("imu.ax", "imu.ay"),
        "beacon": ("beacon.x", "beacon.y", "beacon.theta", "ranges.range"),
    }
    out = {}
    for group, names in groups.items():
        rows = [(floor.sigma[n] / floor.sheet[n], floor.sd[n]) for n in names if n in floor.sigma and n in floor.sheet]
        rows = [(f, sd) for f, sd in rows if sd < 0.5]
        if rows:
            weight = np.array([1.0 / sd**2 for _, sd in rows])
            mean = float(np.exp(np.average([np.log(f) for f, _ in rows], weights=weight)))
            spread = max(float(np.std([np.log(f) for f, _ in rows])) if len(rows) > 1 else 0.0, 0.0)
            out[group] = (mean, max(float(weight.sum() ** -0.5), 0.5 * spread))
    return out


def levels(floor: Floor) -> list[Scatter]:
    """`gyro_noise` and `beacon_noise`: louder than the sheet, and than the other sensors are than theirs."""
    found = factors(floor)
    out = []
    for group, effect in (("gyro", "gyro_noise"), ("beacon", "beacon_noise")):
        if group not in found:
            continue
        value, sd = found[group]
        others = [f for name, (f, s) in found.items() if name != group and s < KNOWN]
        if any(value / AGREE < other < value * AGREE for other in others) and value > AGREE:
            continue  # its sheet is as wrong as another's
        if value > 1.0 + 4.0 * sd:
            out.append(Scatter(effect, {"factor": (value, value * sd)}, (np.log(value) / sd) ** 2))
    return out


def vibration(problem: Problem) -> Scatter | None:
    """`vibration`, as the floor has it."""
    k = problem.floor.vibration
    if k <= 0.0:
        return None
    sd = max(problem.floor.vibration_sd, 0.03 * k)
    return Scatter("vibration", {"k": (k, sd)}, (k / sd) ** 2)


def block_means(t: Array, values: Array) -> tuple[Array, Array, Array]:
    """Middle, mean and count of each block of SECOND."""
    number = np.floor(t / SECOND)
    first = np.flatnonzero(np.diff(number, prepend=-1.0))
    count = np.diff(np.append(first, len(t)))
    return np.add.reduceat(t, first) / count, np.add.reduceat(values, first) / count, count.astype(float)


def walk_costs(t: Array, mean: Array, variance: Array, densities: Array = DENSITIES) -> Array:
    """(K,) -2 log likelihood of block means under a bias that walks from 0, for each density."""
    bias, p, cost, last = np.zeros(len(densities)), np.zeros(len(densities)), np.zeros(len(densities)), 0.0
    for at, value, noise in zip(t, mean, variance, strict=True):
        p = p + densities**2 * max(at - last, 0.0)
        last = at
        s = p + noise
        e = value - bias
        cost += np.log(s) + e * e / s
        gain = p / s
        bias = bias + gain * e
        p = p * (1.0 - gain)
    return cost


def drift_costs(problem: Problem, t: Array, values: Array, densities: Array = DENSITIES) -> Array:
    """(K,) -2 log likelihood of what is left of a gyro [rad/s] under a bias that walks from 0, for each density.

    By means over SECOND; of a body that smoothed wheels drive by the angle that they add up to, which sways and stays.
    """
    at, mean, count = block_means(t, values)
    variance = problem.floor.sigma["imu.gz"] ** 2 / count
    if "imu.gz" not in problem.floor.sway:
        return walk_costs(at, mean, variance, densities)
    sway, pace = problem.floor.sway["imu.gz"]
    swing = (sway / pace) ** 2 + max(rounded_turn(world) for world in problem.worlds) ** 2
    return angle_costs(at, np.cumsum(mean) * SECOND, variance * SECOND**2, swing, densities)


def rounded_turn(world: World) -> float:
    """What rounding makes of the body's heading by its wheels [rad]: of a robot at rest it stays as it is."""
    robot = world.run.meta.robot
    if not robot.ticks_per_rev or not robot.track_width:
        return 0.0
    tick = 2.0 * np.pi / robot.ticks_per_rev * (robot.wheel_radius or 0.0)
    return float(tick / np.sqrt(6.0) / robot.track_width)


def angle_costs(t: Array, angle: Array, more: Array, swing: float, densities: Array) -> Array:
    """(K,) the same by angles [rad] at every block's end: `more` (N,) is what white noise adds in a block, `swing` the
    variance of what is off at an instant and does not last.
    """
    k = len(densities)
    bias, turned, cost = np.zeros(k), np.zeros(k), np.zeros(k)
    pbb, pbt, ptt, last = np.zeros(k), np.zeros(k), np.zeros(k), t[0] - SECOND if len(t) else 0.0
    pbb = densities**2 * max(last, 0.0)
    for at, value, white in zip(t, angle, more, strict=True):
        h, last = at - last, at
        turned = turned + SECOND * bias
        ptt = ptt + 2.0 * SECOND * pbt + SECOND**2 * pbb + white + densities**2 * SECOND**3 / 3.0
        pbt = pbt + SECOND * pbb + 0.5 * densities**2 * SECOND**2
        pbb = pbb + densities**2 * h
        s = ptt + swing
        e = value - turned
        cost += np.log(s) + np.minimum(e * e / s, CAPPED)
        gain_b, gain_t = pbt / s, ptt / s
        bias, turned = bias + gain_b * e, turned + gain_t * e
        pbb, pbt, ptt = pbb - gain_b * pbt, pbt * (1.0 - gain_t), ptt * (1.0 - gain_t)
    return cost


CAPPED = 25.0
"""No squared innovation counts for more: an edge is no walk."""


def gyro_walk(problem: Problem, residuals: Sequence[tuple[Array, Array]]) -> tuple[Scatter | None, float]:
    """`gyro_walk` in gyro residuals (t, rad/s) per run, and the drop of -2 log likelihood against no walk."""
    total = np.zeros(len(DENSITIES))
    for t, values in residuals:
        total += drift_costs(problem, t, values)
    best = int(np.argmin(total))
    gain = float(total[0] - total[best])
    if best == 0 or gain < 12.0:
        return None, max(gain, 0.0)
    around = total[max(best - 1, 0) : best + 2]
    step = np.log(DENSITIES[2] / DENSITIES[1])
    bend = (around[0] - 2.0 * around[1] + around[-1]) / step**2 if len(around) == 3 else 1.0
    sd = DENSITIES[best] * float(np.sqrt(2.0 / max(bend, 0.1)))
    return Scatter("gyro_walk", {"density": (float(DENSITIES[best]), sd)}, gain), gain


def gyro_left(problem: Problem, fit: Fit) -> list[tuple[Array, Array]]:
    """Stamps and what a fit leaves of the gyro [rad/s], per run."""
    plain = dataclasses.replace(problem, floor=dataclasses.replace(problem.floor, gyro_walk=0.0, sway={}))
    if problem.floor.sway:
        white = _plainly(plain, fit)
    else:
        white, _ = whitened(plain, fit.model, (), "body")
        white = without(white, problem.nuisances, fit.trifles) if problem.floor.gyro_walk == 0.0 else white
    sigma = problem.floor.sigma["imu.gz"]
    limit = float(fit.model.get("gyro_clip", {}).get("limit", np.inf)) - 4.0 * sigma
    out = []
    for world, one in zip(problem.worlds, white, strict=True):
        if "imu.gz" in one:  # at its clip a gyro's noise has one side: that is no offset
            free = np.abs(world.readings["imu.gz"]) < limit
            if not world.rough:  # an angle that is off by its rounding comes back within a block: keep blocks whole
                free &= np.abs(one["imu.gz"].residual) < FAR  # an edge that is modelled a little late is no walk
                calm = free & _steady(problem, fit, world)
                free = calm if calm.sum() > STEADY * free.sum() else free
            out.append((one["imu.gz"].t[free], one["imu.gz"].residual[free] * sigma))
    return out


def _plainly(plain: Problem, fit: Fit) -> list[dict[str, White]]:
    """Residuals less what the fit's nuisances do, over white noise, where the fit itself holds them for swaying."""
    white, _ = whitened(plain, with_trifles(plain, fit), (), "body")
    keys, columns = flaws(plain, fit.model, "body")
    place = {key: i for i, key in enumerate(plain.nuisances.keys)}
    size = np.array([fit.trifles[place[key]] if key in place else 0.0 for key in keys])
    out = []
    for one, flawed in zip(white, columns, strict=True):
        gz = flawed.get("imu.gz")
        less = one["imu.gz"].residual - (size[gz.index] @ gz.columns if gz is not None else 0.0)
        out.append({"imu.gz": dataclasses.replace(one["imu.gz"], residual=less)} if "imu.gz" in one else {})
    return out


STEADY, ABRUPT = 0.3, 0.1
"""At least so many readings must be steady; turn acceleration below this share of the strongest is."""


def _steady(problem: Problem, fit: Fit, world: World) -> npt.NDArray[np.bool_]:
    """(N,) gyro readings while the robot rests or turns evenly: a bias walks then too, dynamics do not."""
    turn = world.channel(world.body([problem.overlay(fit.model, "body")]), "imu.gz")[0]
    change = np.abs(np.gradient(turn)) / np.maximum(np.gradient(world.times["imu.gz"]), 1e-6)
    calm: npt.NDArray[np.bool_] = change < ABRUPT * np.quantile(change, 0.98)
    return calm


def outliers(problem: Problem, model: EffectSet) -> list[Scatter]:
    """`beacon_outliers`, and the noise level beside them: two normal distributions, by expectation-maximisation."""
    sets: list[Array] = []
    for world in problem.worlds:
        sets += _errors(problem, world, model)
    if not sets:
        return []
    squares = np.concatenate([np.sum(e**2, axis=0) / len(e) for e in sets])
    if int((squares > FAR**2).sum()) < LEAST:
        return []
    rate, near, wide = 0.05, 1.0, 6.0
    for _ in range(80):
        powers = [np.sum(e**2, axis=0) for e in sets]
        inner = [(1.0 - rate) * near ** -len(e) * np.exp(-0.5 * q / near**2) for e, q in zip(sets, powers, strict=True)]
        outer = [rate * wide ** -len(e) * np.exp(-0.5 * q / wide**2) for e, q in zip(sets, powers, strict=True)]
        share = [b / np.maximum(a + b, 1e-300) for a, b in zip(inner, outer, strict=True)]
        count = sum(float(s.sum()) for s in share)
        n = sum(len(s) for s in share)
        rate = count / n
        wide = np.sqrt(_mean_square(share, powers, sets))
        near = np.sqrt(_mean_square([1.0 - s for s in share], powers, sets))
        wide = max(wide, 2.0 * near)
    if wide < APART * near or rate > COMMON:
        return []
    names = [name for name in ("beacon.x", "ranges.range") if name in problem.floor.sigma]
    unit = float(np.mean([problem.floor.sigma[name] for name in names]))
    size = float(np.sqrt(wide**2 - near**2)) * unit
    sd = float(np.sqrt(rate * (1.0 - rate) / n)) * 1.2
    hits = max(rate * n, 1.0)
    return [Scatter("beacon_outliers", {"rate": (rate, sd), "size": (size, size / np.sqrt(2.0 * hits))}, 4.0 * hits)]


def _mean_square(share: list[Array], powers: list[Array], sets: list[Array]) -> float:
    whole = sum(float(s.sum()) * len(e) for s, e in zip(share, sets, strict=True))
    return max(sum(float(s @ q) for s, q in zip(share, powers, strict=True)) / max(whole, 1e-9), 1e-6)


def _errors(problem: Problem, world: World, model: EffectSet) -> list[Array]:
    """Errors of fixes (2, N) and ranges (1, N) beside the fitted model, in sigma, none left out."""
    groups = [
        names for names in (("beacon.x", "beacon.y"), ("ranges.range",)) if all(n in world.readings for n in names)
    ]
    if not groups:
        return []
    body = world.body([problem.overlay(model, "body")])
    return [
        np.vstack([(world.readings[n] - world.channel(body, n)[0]) / problem.floor.sigma[n] for n in names])
        for names in groups
    ]


def shadow(problem: Problem) -> Scatter | None:
    """`beacon_shadow`: a disc from which readings are missing though the rhythm asks for them, and none is there."""
    present, absent = [], []
    for world in problem.worlds:
        for name in ("beacon.x", "ranges.range"):
            if name in world.times and len(world.times[name]) > FAR:
                here, gone = _rhythm(world, name)
                present.append(here)
                absent.append(gone)
    if not present:
        return None
    here, gone = np.concatenate(present), np.concatenate(absent)
    if len(gone) < LEAST:
        return None
    return _disc(here, gone)


def _rhythm(world: World, name: str) -> tuple[Array, Array]:
    """(N, 2) places of readings, and (M, 2) of those that the rhythm misses."""
    t = world.times[name]
    step = float(np.median(np.diff(t)))
    jumps = np.flatnonzero(np.diff(t) > 2.5 * step)
    lost = [np.arange(t[k] + step, t[k + 1] - 0.5 * step, step) for k in jumps]
    times = np.concatenate(lost) if lost else np.empty(0)
    if world.run.truth is not None and world.run.truth.x is not None and world.run.truth.y is not None:
        at, x, y = world.run.truth.t, world.run.truth.x, world.run.truth.y
    elif len(world.restarts):
        at, x, y = world.restarts[:, 0], world.restarts[:, 1], world.restarts[:, 2]
    else:
        return np.empty((0, 2)), np.empty((0, 2))
    return (
        np.column_stack((np.interp(t, at, x), np.interp(t, at, y))),
        np.column_stack((np.interp(times, at, x), np.interp(times, at, y))),
    )


def _disc(here: Array, gone: Array) -> Scatter | None:
    """The disc that holds most missing readings and no present one, by a search over centres among the missing."""
    best = (0.0, np.zeros(2), 0.0)
    chosen = gone[:: max(len(gone) // 60, 1)]
    centres = np.concatenate([chosen, *(0.5 * (chosen + other) for other in chosen[:: max(len(chosen) // 12, 1)])])
    few = here[:: max(len(here) // 4000, 1)]
    for centre in centres:
        near = np.sort(np.hypot(*(few - centre).T))
        radius = float(near[max(int(0.0005 * len(near)), 0)])
        inside = int((np.hypot(*(gone - centre).T) < radius).sum())
        if inside > best[0]:
            best = (inside, centre, radius)
    count, centre, radius = best
    if count < LEAST or count < 0.3 * len(gone):
        return None
    sd = 0.02 + 0.05 * radius
    parameters = {"x": (float(centre[0]), sd), "y": (float(centre[1]), sd), "radius": (radius, sd)}
    return Scatter("beacon_shadow", parameters, 5.0 * count)
