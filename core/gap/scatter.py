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
from core.gap.floor import Floor, rounding_of
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
    variance = problem.floor.sigma["imu.gz"] ** 2 / count + stuck(problem)
    if "imu.gz" not in problem.floor.sway:
        return walk_costs(at, mean, variance, densities)
    sway, pace = problem.floor.sway["imu.gz"]
    swing = (sway / pace) ** 2 + max(rounded_turn(world) for world in problem.worlds) ** 2
    return angle_costs(at, np.cumsum(mean) * SECOND, variance * SECOND**2, swing, densities)


def stuck(problem: Problem) -> float:
    """Variance [rad²/s²] of what coarse rounding adds to a gyro that its noise does not shake loose, alike for long.

    The first harmonic of the rounding's error, fading with the noise (Widrow & Kollár 2008, ch. 5).
    """
    step = max(rounding_of(world.readings["imu.gz"]) for world in problem.worlds if "imu.gz" in world.readings)
    if step == 0.0:
        return 0.0
    noise = max(problem.floor.sigma["imu.gz"] ** 2 - step**2 / 12.0, 0.0)
    return 0.5 * (step / np.pi) ** 2 * float(np.exp(-4.0 * np.pi**2 * noise / step**2))


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
        pbb = pbb + densities**2 * max(at - last - SECOND, 0.0)  # what it walks between blocks turns nothing
        last = at
        turned = turned + SECOND * bias
        ptt = ptt + 2.0 * SECOND * pbt + SECOND**2 * pbb + white + densities**2 * SECOND**3 / 3.0
        pbt = pbt + SECOND * pbb + 0.5 * densities**2 * SECOND**2
        pbb = pbb + densities**2 * SECOND
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
    if best in (0, len(DENSITIES) - 1) or gain < 12.0:  # at the end of what is tried it is no walk
        return None, max(gain, 0.0)
    near = min(max(best, 2), len(DENSITIES) - 2)  # the first of all is no walk
    before, at, after = total[near - 1 : near + 2]
    bend, slope = max(float(before - 2.0 * at + after), 1e-3), 0.5 * float(after - before)
    step = float(np.log(DENSITIES[2] / DENSITIES[1]))
    density = float(DENSITIES[near] * np.exp(-step * np.clip(slope / bend, -1.0, 1.0)))
    sd = density * step * float(np.sqrt(2.0 / max(bend, 0.1 * step**2)))
    return Scatter("gyro_walk", {"density": (density, sd)}, gain), gain


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
    """`beacon_outliers`, and the noise level beside them: two normal distributions, by expectation-maximisation.

    Sensors share the outliers' size in metres, and how much louder than its floor each is.
    """
    sets: list[tuple[float, Array]] = []
    for world in problem.worlds:
        sets += _errors(problem, world, model)
    if not sets:
        return []
    dims = [len(e) for _, e in sets]
    powers = [np.sum(e**2, axis=0) for _, e in sets]
    squares = np.concatenate([q / d for q, d in zip(powers, dims, strict=True)])
    if int((squares > FAR**2).sum()) < LEAST:
        return []
    units = np.array([unit for unit, _ in sets])
    rate, near, size = 0.05, 1.0, 6.0 * float(units.mean())
    n = sum(len(q) for q in powers)
    for _ in range(80):
        wide = near**2 + (size / units) ** 2
        share = [_outlying(q, d, rate, near**2, w) for q, d, w in zip(powers, dims, wide.tolist(), strict=True)]
        rate = sum(float(s.sum()) for s in share) / n
        whole = sum(float(s.sum()) * d for s, d in zip(share, dims, strict=True))
        # of a wide error, the part that is the outlier's own, and that part's variance (both are normal)
        part = [(1.0 - near**2 / w) * u for w, u in zip(wide.tolist(), units.tolist(), strict=True)]
        own = [p * p * float(s @ q) for s, q, p in zip(share, powers, part, strict=True)]
        own += [float(s.sum()) * d * near * near * p * u for s, d, p, u in zip(share, dims, part, units, strict=True)]
        size = float(np.sqrt(sum(own) / max(whole, 1e-9)))
        near = float(np.sqrt(_mean_square([1.0 - s for s in share], powers, dims)))
    unit = float(units.mean())
    if np.hypot(size / unit, near) < APART * near or rate > COMMON:
        return []
    hits = [float(s.sum()) for s in share]
    known = sum(h * d * (1.0 - near**2 / w) ** 2 for h, d, w in zip(hits, dims, wide.tolist(), strict=True))
    sd = float(np.sqrt(rate * (1.0 - rate) / n)) * 1.2
    found = {"rate": (rate, sd), "size": (size, size / float(np.sqrt(2.0 * max(known, 1.0))))}
    return [Scatter("beacon_outliers", found, 4.0 * max(rate * n, 1.0))]


def _outlying(power: Array, dims: int, rate: float, near: float, wide: float) -> Array:
    """(N,) chance that each error is an outlier. power: its square over its dimensions; near, wide: variances."""
    inner = (1.0 - rate) * near ** (-0.5 * dims) * np.exp(-0.5 * power / near)
    outer = rate * wide ** (-0.5 * dims) * np.exp(-0.5 * power / wide)
    out: Array = outer / np.maximum(inner + outer, 1e-300)
    return out


def _mean_square(share: Sequence[Array], powers: Sequence[Array], dims: Sequence[int]) -> float:
    whole = sum(float(s.sum()) * d for s, d in zip(share, dims, strict=True))
    return max(sum(float(s @ q) for s, q in zip(share, powers, strict=True)) / max(whole, 1e-9), 1e-6)


def _errors(problem: Problem, world: World, model: EffectSet) -> list[tuple[float, Array]]:
    """Sigma [m] and errors of fixes (2, N) and ranges (1, N) beside the fitted model, in sigma, none left out."""
    groups = [
        names for names in (("beacon.x", "beacon.y"), ("ranges.range",)) if all(n in world.readings for n in names)
    ]
    if not groups:
        return []
    body = world.body([problem.overlay(model, "body")])
    out = []
    for names in groups:
        sigma = [problem.floor.sigma[n] for n in names]
        far = [(world.readings[n] - world.channel(body, n)[0]) / s for n, s in zip(names, sigma, strict=True)]
        out.append((float(np.mean(sigma)), np.vstack(far)))
    return out


def shadow(problem: Problem) -> Scatter | None:
    """`beacon_shadow`: a disc from which readings are missing though the rhythm asks for them, and none is there."""
    parts = [
        _rhythm(world, name)
        for world in problem.worlds
        for name in ("beacon.x", "ranges.range")
        if name in world.times and len(world.times[name]) > FAR
    ]
    if not parts:
        return None
    here, gone = (np.concatenate([part[k] for part in parts]) for k in range(2))
    if len(gone) < LEAST or len(here) < LEAST:
        return None
    exact = all(world.run.truth is not None for world in problem.worlds)
    return _disc(here, gone, EDGE if exact else SMOOTH)


def _rhythm(world: World, name: str) -> tuple[Array, Array]:
    """(N, 2) places of the tag at readings, and (M, 2) at those that the rhythm misses."""
    t = world.times[name]
    step = float(np.median(np.diff(t)))
    jumps = np.flatnonzero(np.diff(t) > 2.5 * step)
    lost = [np.arange(t[k] + step, t[k + 1] - 0.5 * step, step) for k in jumps]
    times = np.concatenate(lost) if lost else np.empty(0)
    truth, mount = world.run.truth, world.run.meta.robot.tag
    if truth is not None and truth.x is not None and truth.y is not None and truth.theta is not None:
        at, x, y, theta = truth.t, truth.x, truth.y, np.unwrap(truth.theta)
    elif len(world.restarts):
        at, x, y, theta = world.restarts[:, 0], world.restarts[:, 1], world.restarts[:, 2], world.restarts[:, 3]
    else:
        return np.empty((0, 2)), np.empty((0, 2))
    c, s = np.cos(theta), np.sin(theta)
    tag = (x + c * mount.x - s * mount.y, y + s * mount.x + c * mount.y)
    here, gone = (np.column_stack([np.interp(when, at, part) for part in tag]) for when in (t, times))
    return here, gone


STRAY = 0.01
"""Share of readings that get lost outside a shadow, and of those inside that still come."""
EDGE, SMOOTH = 0.01, 0.04
"""How sharp a shadow's edge is, the robot's place and a lost reading's instant being known to about this [m]; the same
where the place is smoothed, without truth."""
WALKERS, ROUNDS, HELD, SEEN = 48, 400, 60, 400
"""Discs that walk about, and for how long; walkers left far behind start anew after HELD rounds; readings looked at."""
SMALLEST, LARGEST = 0.1, 2.0
"""Radii of shadows [m]."""


def _disc(here: Array, gone: Array, edge: float) -> Scatter | None:
    """The disc that holds what is missing and nothing that came: mean and scatter of all discs by their likelihood.

    Where the robot only grazed it, many discs do. Differential evolution Markov chains (ter Braak 2006).
    """
    rng = np.random.default_rng(len(gone))
    low, high = gone.min(axis=0) - 0.5 * LARGEST, gone.max(axis=0) + 0.5 * LARGEST
    near = here[np.all((here > low - LARGEST) & (here < high + LARGEST), axis=1)]
    steps = [max(len(points) // SEEN, 1) for points in (near, gone)]
    few = (near[:: steps[0]], gone[:: steps[1]])
    bottom, top = np.array([*low, SMALLEST]), np.array([*high, LARGEST])
    at = rng.uniform(bottom, top, (40 * WALKERS, 3))
    level = _likelihood(at, few, steps, edge)
    best = np.argsort(-level)[:WALKERS]
    at, level, kept = at[best], level[best], []
    for k in range(ROUNDS):
        if k == HELD:
            good = np.argsort(-level)[: WALKERS // 4]
            chosen = good[np.arange(WALKERS) % len(good)]
            at, level = at[chosen] + 1e-3 * rng.standard_normal(at.shape), level[chosen]
            level = _likelihood(at, few, steps, edge)
        others = rng.permutation(WALKERS), rng.permutation(WALKERS)
        size = 1.0 if k % 10 == 0 else 0.97 * rng.uniform(0.3, 1.0)
        moved = at + size * (at[others[0]] - at[others[1]]) + 2e-3 * rng.standard_normal(at.shape)
        inside = np.all((moved > bottom) & (moved < top), axis=1)
        tried = np.where(inside, _likelihood(np.clip(moved, bottom, top), few, steps, edge), -np.inf)
        better = np.log(rng.uniform(size=WALKERS)) < tried - level
        at, level = np.where(better[:, None], moved, at), np.where(better, tried, level)
        if k > 2 * HELD:
            kept.append(at)
    discs, share = _levelled(np.concatenate(kept))
    x, y, radius = (float(value) for value in share @ discs)
    held = int((np.hypot(gone[:, 0] - x, gone[:, 1] - y) < radius).sum())
    if held < LEAST or held < 0.3 * len(gone):
        return None
    sd = np.hypot(np.sqrt(share @ (discs - share @ discs) ** 2), edge)
    parameters = {"x": (x, float(sd[0])), "y": (y, float(sd[1])), "radius": (radius, float(sd[2]))}
    return Scatter("beacon_shadow", parameters, 5.0 * held)


def _levelled(discs: Array) -> tuple[Array, Array]:
    """Discs (K, 3) with weights by which all radii that are possible count alike: where a disc touches the readings
    around it on all sides, as the true one does, few others fit, and that speaks not against it."""
    low, high = np.quantile(discs[:, 2], (0.005, 0.995))
    discs = discs[(discs[:, 2] >= low) & (discs[:, 2] <= high)]
    size = np.maximum((discs[:, 2] - low) / max(high - low, 1e-9) * CLASSES, 0.0).astype(int).clip(max=CLASSES - 1)
    weight = 1.0 / np.bincount(size, minlength=CLASSES)[size]
    return discs, weight / weight.sum()


CLASSES = 12
"""Classes of radii that count alike."""


def _likelihood(discs: Array, places: Sequence[Array], counts: Sequence[int], edge: float) -> Array:
    """(K,) log likelihood of discs (K, 3), radii equally likely by their logarithm. places: of readings, of lost ones;
    counts: how many each of them stands for. On its side of the edge a reading says no more."""
    out: Array = -np.log(discs[:, 2])
    for points, side, count in zip(places, (1.0, -1.0), counts, strict=True):
        far = np.hypot(points[:, 0] - discs[:, :1], points[:, 1] - discs[:, 1:2])
        deep = np.maximum(side * (discs[:, 2:] - far), 0.0) / edge
        out -= count * np.minimum(0.5 * deep * deep, -np.log(STRAY)).sum(axis=1)
    return out
