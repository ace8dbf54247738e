"""Where a local effect would lie: starts for a slippery patch (a disc) and a bump (an instant), from the residuals.

Both are linear in their size once place or instant are given, so every disc of a grid, and every instant, is scored by
the drop of the cost that it would bring; the best few become candidates that are refitted exactly.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt
from scipy.signal import fftconvolve

from core.gap.candidates import Candidate
from core.gap.linear import Problem
from core.gap.whiten import imu_sigma
from core.gap.world import World
from core.robot import EffectSet
from core.simulation._batch_numba import Outputs

Array = npt.NDArray[np.float64]

CELLS = 60
"""Cells along the longer side of the map."""
RADII = (0.2, 0.3, 0.45, 0.6, 0.8, 1.0, 1.25, 1.5, 2.0)
"""Discs tried [m]."""
STRIDE = 0.2
"""Displacements of truth are taken over this long [s]."""
SPAN = 0.3
"""A bump's length [s]."""
PATCHES, BUMPS = 3, 2
"""So many starts of each are handed on."""
SLIPS = (-0.9, 0.95)


def placed(problem: Problem, model: EffectSet) -> list[Candidate]:
    """Starts of slip patches and bumps about a model."""
    scope = problem.overlay(model, "body")
    bodies = [world.body([scope]) for world in problem.worlds]
    out: list[Candidate] = []
    if "slip_patch" not in model:
        out += _patches(problem, bodies)
    if "bump" not in model:
        out += _bumps(problem, bodies)
    return out


def _patches(problem: Problem, bodies: list[Outputs]) -> list[Candidate]:
    points = [_slip_scores(problem, w, b) for w, b in zip(problem.worlds, bodies, strict=True)]
    xy, score, info = (np.concatenate(part) for part in zip(*points, strict=True))
    if len(xy) < 10:
        return []
    low, high = xy.min(axis=0), xy.max(axis=0)
    cell = max(float((high - low).max()) / CELLS, 0.02)
    shape = tuple(np.ceil((high - low) / cell).astype(int) + 1)
    index = tuple(((xy - low) / cell).round().astype(int).T)
    b, a = np.zeros(shape), np.zeros(shape)
    np.add.at(b, index, score)
    np.add.at(a, index, info)
    found: list[tuple[float, Disc]] = []
    for radius in RADII:
        reach = int(np.ceil(radius / cell))
        if reach > max(shape):
            continue
        axis = np.arange(-reach, reach + 1) * cell
        disc = (axis[:, None] ** 2 + axis[None, :] ** 2 <= radius**2).astype(float)
        inside_b, inside_a = fftconvolve(b, disc, mode="same"), fftconvolve(a, disc, mode="same")
        slip = np.clip(inside_b / np.maximum(inside_a, 1.0), *SLIPS)
        gain = 2.0 * slip * inside_b - slip**2 * inside_a
        at = np.unravel_index(int(np.argmax(gain)), shape)
        place = low + cell * np.array(at)
        found.append((float(gain[at]), (float(place[0]), float(place[1]), radius)))
    found.sort(key=lambda pair: -pair[0])
    rough = [disc for gain, disc in found[:REFINED] if gain > 0.0]
    fine = sorted((_moved(disc, xy, score, info) for disc in rough), key=lambda pair: -pair[0])
    fine = [(gain, disc) for gain, disc in fine if is_place(problem, disc, bodies)]
    names = ("x", "y", "radius", "slip")
    starts = [dict(zip(names, (*disc, _slip(disc, xy, score, info)[1]), strict=True)) for _, disc in fine]
    return [Candidate("slip_patch", one, names, secant=True) for one in starts[:PATCHES]]


Disc = tuple[float, float, float]
WHOLE = 0.9
"""A disc that holds more than this of what the runs tell is no patch."""
REFINED = 6
"""So many discs of the grid have their edges moved over the points themselves."""
MOVES = (0.2, 0.1, 0.05, 0.025, 0.012, 0.006)
"""By so much [m], one after the other."""


def is_place(problem: Problem, disc: Disc, bodies: Sequence[Outputs] | None = None) -> bool:
    """Whether a disc is met other than by beginning in it: what only the beginning shows is a start, not a place.

    Nor is what hardly a reading shows. bodies: the runs' paths, where they are known.
    """
    if bodies is None:
        bodies = [world.body([problem.overlay({}, "body")]) for world in problem.worlds]
    inside = first = 0
    for world, body in zip(problem.worlds, bodies, strict=True):
        set_down = world.stamps >= world.restarts[:1, 0].max(initial=-np.inf)
        x, y = body.x[0, set_down], body.y[0, set_down]
        here = (x - disc[0]) ** 2 + (y - disc[1]) ** 2 < disc[2] ** 2
        inside += int(here.sum())
        first += len(here) if here.all() else int(here.argmin())
    return inside - first > max(STARTS * inside, FEWEST)


STARTS, FEWEST = 0.25, 5
"""Of the readings in a disc, this share must come after a run first left it, or before it was there; and so many."""


def possible(problem: Problem, name: str, model: EffectSet) -> bool:
    """Whether the readings allow for what was fitted: a patch is met more than once, no gyro reads beyond its clip."""
    if name == "slip_patch":
        return is_place(problem, _disc(model))
    seen = [np.abs(world.readings["imu.gz"]) for world in problem.worlds if "imu.gz" in world.readings]
    if name != "gyro_clip" or not seen:
        return True
    return float(np.mean(np.concatenate(seen) > WIDER * float(model[name]["limit"]))) < ABOVE


WIDER, ABOVE = 1.02, 0.005
"""A clip is refuted by this share of readings that lie beyond it by so much."""


def _disc(model: EffectSet) -> tuple[float, float, float]:
    x, y, radius = (float(model["slip_patch"][name]) for name in ("x", "y", "radius"))
    return x, y, radius


def _slip(disc: Disc, xy: Array, score: Array, info: Array) -> tuple[float, float]:
    """What a disc brings at its best slip, and that slip."""
    inside = (xy[:, 0] - disc[0]) ** 2 + (xy[:, 1] - disc[1]) ** 2 < disc[2] ** 2
    b, a = float(score @ inside), float(info @ inside)
    if a > WHOLE * float(info.sum()):
        return 0.0, 0.0  # that is no patch but the whole floor
    slip = float(np.clip(b / max(a, 1.0), *SLIPS))
    return 2.0 * slip * b - slip**2 * a, slip


def _moved(disc: Disc, xy: Array, score: Array, info: Array) -> tuple[float, Disc]:
    """A disc whose sides have been moved while that brings more."""
    best = _slip(disc, xy, score, info)[0]
    for step in MOVES:
        better = True
        while better:
            better = False
            for dx, dy, dr in EDGES:
                tried = (
                    disc[0] + 0.5 * step * dx,
                    disc[1] + 0.5 * step * dy,
                    max(disc[2] + 0.5 * step * dr, 0.02),
                )
                gain = _slip(tried, xy, score, info)[0]
                if gain > best + 1.0:
                    best, disc, better = gain, tried, True
    return best, disc


def _slip_scores(problem: Problem, world: World, body: Outputs) -> tuple[Array, Array, Array]:
    """(N, 2) places, and score and information of a slip there: from the turn rate and from truth's displacements."""
    stamps, path = world.stamps, np.column_stack((body.x[0], body.y[0]))
    xy, score, info = [np.empty((0, 2))], [np.empty(0)], [np.empty(0)]
    if "imu.gz" in world.readings and len(stamps):
        t = world.times["imu.gz"]
        predicted = world.channel(body, "imu.gz")[0]
        sigma = imu_sigma(world, "imu.gz", body, problem.floor)
        far = world.readings["imu.gz"] - predicted
        xy.append(_places(world, body, t))
        score.append(-predicted * far / sigma**2)
        info.append((predicted / sigma) ** 2)
    if all(name in world.readings for name in ("truth.x", "truth.y", "truth.theta")):
        t, rows = world.times["truth.x"], world.at["truth.x"]
        step = max(round(STRIDE * len(t) / max(t[-1] - t[0], 1e-9)), 1)
        chosen = rows[::step]
        moved = np.diff(path[chosen], axis=0)
        seen = np.diff(np.column_stack((world.readings["truth.x"], world.readings["truth.y"]))[::step], axis=0)
        length = np.hypot(*moved.T)
        restarted = np.searchsorted(world.restarts[:, 0], t[::step][1:], "right") != np.searchsorted(
            world.restarts[:, 0], t[::step][:-1], "right"
        )
        fine = ~restarted & (length > 1e-6) & (length < 1.0)
        along = np.einsum("ij,ij->i", seen - moved, moved) / np.maximum(length, 1e-9)
        variance = 2.0 * problem.floor.sigma["truth.x"] ** 2
        xy.append(_places(world, body, 0.5 * (t[::step][1:] + t[::step][:-1]))[fine])
        score.append((-length * along / variance)[fine])
        info.append((length**2 / variance)[fine])
    return np.concatenate(xy), np.concatenate(score), np.concatenate(info)


def _places(world: World, body: Outputs, t: Array) -> Array:
    """(N, 2) where the robot was: by truth, where there is some, for the path as predicted strays in a patch."""
    if "truth.x" in world.readings and "truth.y" in world.readings:
        at = world.times["truth.x"]
        return np.column_stack([np.interp(t, at, world.readings[name]) for name in ("truth.x", "truth.y")])
    return np.column_stack((np.interp(t, world.stamps, body.x[0]), np.interp(t, world.stamps, body.y[0])))


def _bumps(problem: Problem, bodies: list[Outputs]) -> list[Candidate]:
    """Instants, on a grid, at which turn rate and forward force show the bump's profile in all runs together."""
    end = max((float(w.times["imu.gz"][-1]) for w in problem.worlds if "imu.gz" in w.readings), default=0.0)
    if end < 1.0:
        return []
    grid = np.arange(0.0, end, 0.02)
    turn, way = np.zeros((2, len(grid))), np.zeros((2, len(grid)))
    for world, body in zip(problem.worlds, bodies, strict=True):
        for name, sums in (("imu.gz", turn), ("imu.ax", way), ("imu.ay", way)):
            if name in world.readings:
                sums += _profile_scores(problem, world, body, name, grid)
    gains = []
    for b, a in (turn, way):
        gains.append(np.where(a > 0.0, b**2 / np.maximum(a, 1e-9), 0.0))
    gain = gains[0] + gains[1]
    out: list[Candidate] = []
    for _ in range(BUMPS):
        k = int(np.argmax(gain))
        sizes = [float(b[k] / a[k]) if a[k] > 0 else 0.0 for b, a in (turn, way)]
        start = {"time": float(grid[k]), "distance": sizes[1], "turn": sizes[0]}
        out.append(Candidate("bump", start, ("time", "distance", "turn"), secant=True))
        gain[max(k - 40, 0) : k + 41] = -1.0
    return out


def _profile_scores(problem: Problem, world: World, body: Outputs, name: str, grid: Array) -> Array:
    """(2, G) score and information of a bump that starts at each instant of the grid, in one axis."""
    t = world.times[name]
    rate = 1.0 / max(float(np.median(np.diff(t))), 1e-6)
    far = world.readings[name] - world.channel(body, name)[0]
    weight = 1.0 / imu_sigma(world, name, body, problem.floor) ** 2
    s = np.arange(int(SPAN * rate) + 1) / rate
    if name == "imu.gz":
        shape = (1.0 - np.cos(2.0 * np.pi * s / SPAN)) / SPAN
    else:
        forward = _forward(world, name)
        shape = forward * 2.0 * np.pi / SPAN**2 * np.sin(2.0 * np.pi * s / SPAN)
    b = np.correlate(far * weight, shape, mode="valid")
    a = np.correlate(weight, shape**2, mode="valid")
    if not len(b):
        return np.zeros((2, len(grid)))
    at = np.clip(np.searchsorted(t[: len(b)], grid), 0, len(b) - 1)
    return np.vstack((b[at], a[at]))


def _forward(world: World, name: str) -> float:
    """Share of a forward force that an axis of the IMU sees."""
    yaw = world.run.meta.robot.imu.yaw
    return float(np.cos(yaw)) if name.endswith("ax") else float(-np.sin(yaw))


def polish(
    cost: Callable[[Mapping[str, float | str]], float], start: Mapping[str, float | str], steps: Sequence[float]
) -> Mapping[str, float | str]:
    """Move a disc's edges one by one, left, right, top, bottom, while the cost falls: between the edges' own small
    neighbourhoods least squares sees nothing.
    """
    best, lowest = dict(start), cost(start)
    rng = np.random.default_rng(0)
    for step in steps:
        for away in rng.normal(0.0, 0.7 * step, (SCATTERED, 3)):
            x, y, radius = (float(best[name]) + float(d) for name, d in zip(("x", "y", "radius"), away, strict=True))
            tried = {**best, "x": x, "y": y, "radius": max(radius, 0.02)}
            value = cost(tried)
            if value < lowest - 1.0:
                best, lowest = tried, value
        for _ in range(2):
            moved, back = False, set[tuple[int, int, int]]()
            for dx, dy, dr in EDGES:
                if (dx, dy, dr) in back:  # it has just come from there
                    continue
                tried = {
                    **best,
                    "x": float(best["x"]) + 0.5 * step * dx,
                    "y": float(best["y"]) + 0.5 * step * dy,
                    "radius": max(float(best["radius"]) + 0.5 * step * dr, 0.02),
                }
                value = cost(tried)
                if value < lowest - 1.0:
                    best, lowest, moved = tried, value, True
                    back.add((-dx, -dy, -dr))
            if not moved:
                break
    return best


SCATTERED = 8
"""Discs tried by chance around the best, before its edges are moved by each step."""
EDGES = (
    (1, 0, 1), (1, 0, -1), (-1, 0, 1), (-1, 0, -1), (0, 1, 1), (0, 1, -1), (0, -1, 1), (0, -1, -1),
    (0, 0, 1), (0, 0, -1), (1, 1, 0), (1, -1, 0), (-1, 1, 0), (-1, -1, 0), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0),
)  # fmt: skip
"""Moves of (x, y, radius), in halves of a step: one side of the disc, all sides, the whole disc."""
