"""Residuals by what the robot does: samples of one channel with their regressors, and means in bins.

Of encoders and of truth the rate of the residual within a window is taken: what builds up there is told by its speed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.gap.energy import window_of
from core.gap.floor import Floor, stated
from core.gap.motion import Motion
from core.gap.shrink import Replay
from core.gap.world import World

Array = npt.NDArray[np.float64]

UNITS = {
    "speed": "m/s", "turn rate": "rad/s", "left rim speed": "m/s", "right rim speed": "m/s",
    "acceleration": "m/s²", "turn acceleration": "rad/s²", "speed times turn rate": "m/s²", "time": "s",
    "temperature": "K", "heading": "rad", "x": "m", "y": "m", "velocity along x": "m/s", "velocity along y": "m/s",
    "left wheel angle": "rad", "right wheel angle": "rad",
}  # fmt: skip
"""Regressors, in the order in which they are preferred where they tell the same."""
ROUND = ("heading", "left wheel angle", "right wheel angle")
"""Regressors that come back after a turn."""
BINS = 20
MOST = 200_000
"""At most so many samples of a run are looked at, evenly taken."""
PART = 10.0
"""Length of the blocks of the bootstrap [s]."""
PREFERRED = 0.97
"""An earlier regressor that explains this share of what a later one does is kept."""


@dataclass(frozen=True)
class Samples:
    """One channel of all runs: (R, N) values of R replays in SI, (N,) regressors, each sample's block and run."""

    unit: str
    values: Array
    regressors: dict[str, Array]
    part: npt.NDArray[np.int64]
    run: npt.NDArray[np.int64]


def unit_of(stream: str) -> str:
    """Of a channel's readings."""
    if stream.startswith("wheels") or stream.endswith("theta"):
        return "rad"
    return {"imu.gz": "rad/s", "imu.ax": "m/s²", "imu.ay": "m/s²"}.get(stream, "m")


def rated(stream: str) -> bool:
    """Whether a channel's residual is told by its rate."""
    return stream.startswith(("wheels", "truth"))


def samples(
    worlds: Sequence[World], moved: Sequence[Motion], replays: Sequence[Sequence[Replay]], stream: str, floor: Floor
) -> Samples | None:
    """replays: per run, those to look at. None where no run has enough readings."""
    values, rows, parts, numbers, first = [], [], [], [], 0
    for k, (world, moves, shown) in enumerate(zip(worlds, moved, replays, strict=True)):
        if stream not in world.readings or len(world.times[stream]) < 8:
            continue
        t = world.times[stream]
        sheet = {**floor.sigma, **stated(world.run)}[stream]
        block = np.stack([one.values[stream] for one in shown]) * sheet
        keep = np.ones(len(t), dtype=bool)
        if rated(stream):
            step = np.maximum(np.diff(t), 1e-6)
            same = np.diff(window_of(world, stream)) == 0
            block, t, keep = np.diff(block, axis=1) / step, t[1:], same
        thin = -(-len(t) // MOST)
        block, t, keep = block[:, ::thin], t[::thin], keep[::thin]
        values.append(block[:, keep])
        rows.append({name: column[keep] for name, column in _regressors(world, moves, t).items()})
        parts.append((t[keep] / PART).astype(np.int64) + first)
        numbers.append(np.full(int(keep.sum()), k))
        first += int(t[-1] / PART) + 1
    if not values:
        return None
    names = [name for name in UNITS if all(name in row for row in rows)]
    unit = unit_of(stream) + ("/s" if rated(stream) else "")
    table = {name: np.concatenate([row[name] for row in rows]) for name in names}
    return Samples(unit, np.concatenate(values, axis=1), table, np.concatenate(parts), np.concatenate(numbers))


def _regressors(world: World, moved: Motion, t: Array) -> dict[str, Array]:
    """(N,) each regressor that the run has, at the stamps."""
    span = max(float(moved.t[1] - moved.t[0]), 1e-6) if len(moved.t) > 1 else 1.0
    change = {"speed": moved.v, "turn rate": moved.w, "speed times turn rate": moved.v * moved.w}
    half = 0.5 * (world.run.meta.robot.track_width or 0.0) * moved.w
    change |= {"left rim speed": moved.v - half, "right rim speed": moved.v + half}
    if len(moved.t) > 2:
        change |= {
            "acceleration": np.gradient(moved.v, span),
            "turn acceleration": np.gradient(moved.w, span),
        }
    out = {name: np.interp(t, moved.t, column) for name, column in change.items()}
    out["time"] = t
    if world.run.imu is not None and world.run.imu.temperature is not None and np.ptp(world.body_inputs.warmth) > 0.0:
        out["temperature"] = np.interp(t, world.body_inputs.imu, world.body_inputs.warmth)
    heading = heading_of(world, t)
    if heading is not None:
        out["heading"] = np.mod(heading, 2.0 * np.pi)
        out |= {"x": np.interp(t, moved.t, moved.x), "y": np.interp(t, moved.t, moved.y)}
        out["velocity along x"] = out["speed"] * np.cos(heading)
        out["velocity along y"] = out["speed"] * np.sin(heading)
    for side in ("left", "right"):
        if world.run.wheels is not None and len(world.run.wheels) > 1:
            angle = np.interp(t, world.run.wheels.t, np.nan_to_num(getattr(world.run.wheels, side)))
            out[f"{side} wheel angle"] = np.mod(angle, 2.0 * np.pi)
    return out


def heading_of(world: World, t: Array) -> Array | None:
    """(N,) heading at stamps, from truth, else from the windows' starts."""
    if "truth.theta" in world.readings:
        return np.interp(t, world.times["truth.theta"], np.unwrap(world.readings["truth.theta"]))
    if len(world.restarts):
        return np.interp(t, world.restarts[:, 0], np.unwrap(world.restarts[:, 3]))
    return None


def edges_of(name: str, x: Array) -> Array:
    """Edges of bins with about as many samples each; of a round regressor, even ones."""
    if name in ROUND:
        return np.linspace(0.0, 2.0 * np.pi, BINS + 1)
    edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, BINS + 1)))
    return edges if len(edges) > 2 else np.array([edges[0], edges[0] + 1e-9, edges[-1] + 2e-9])


def bins_of(x: Array, edges: Array) -> npt.NDArray[np.int64]:
    """(N,) bin of each sample."""
    return np.clip(np.searchsorted(edges, x, "right") - 1, 0, len(edges) - 2)


def means(number: npt.NDArray[np.int64], values: Array, size: int) -> tuple[Array, Array]:
    """(size,) counts and means per bin (NaN where empty)."""
    count = np.bincount(number, minlength=size).astype(np.float64)
    with np.errstate(invalid="ignore"):
        return count, np.bincount(number, values, size) / np.where(count > 0.0, count, np.nan)


def told_by(found: Samples, values: Array) -> list[tuple[str, float]]:
    """Regressors by the share of the values' variance that bins of them explain, beyond chance; best first."""
    whole = float(np.var(values)) * len(values)
    out = []
    for name, x in found.regressors.items():
        if float(np.ptp(x)) <= 0.0 or whole <= 0.0:
            continue
        edges = edges_of(name, x)
        count, mean = means(bins_of(x, edges), values, len(edges) - 1)
        between = float(np.nansum(count * (mean - values.mean()) ** 2))
        chance = (whole - between) / max(len(values) - len(count), 1) * (len(count) - 1)
        out.append((name, max(between - chance, 0.0) / whole))
    return sorted(out, key=lambda pair: -pair[1])


def best_told_by(found: Samples, values: Array) -> str | None:
    """The simplest of the regressors that explain most."""
    ranked = told_by(found, values)
    if not ranked or ranked[0][1] <= 0.0:
        return None
    fine = {name for name, share in ranked if share >= PREFERRED * ranked[0][1]}
    return next(name for name in UNITS if name in fine)


def band(found: Samples, name: str, values: Array, seed: int, draws: int = 200) -> tuple[Array, Array, Array, Array]:
    """(bins,) middles, means, and the 5 % and 95 % bounds of the means, by bootstrap over blocks of PART."""
    x = found.regressors[name]
    edges = edges_of(name, x)
    size, number = len(edges) - 1, bins_of(x, edges)
    blocks = int(found.part.max()) + 1
    joint = found.part * size + number
    count = np.bincount(joint, minlength=blocks * size).reshape(blocks, size).astype(np.float64)
    total = np.bincount(joint, values, blocks * size).reshape(blocks, size)
    rng = np.random.default_rng(seed)
    chosen = rng.multinomial(blocks, np.full(blocks, 1.0 / blocks), draws).astype(np.float64)
    with np.errstate(invalid="ignore"):
        drawn = (chosen @ total) / np.where(chosen @ count > 0.0, chosen @ count, np.nan)
        mean = total.sum(axis=0) / np.where(count.sum(axis=0) > 0.0, count.sum(axis=0), np.nan)
    some = np.isfinite(mean)
    middle = np.bincount(number, x, size)[some] / np.bincount(number, minlength=size)[some]
    return (
        middle,
        mean[some],
        np.nanquantile(drawn[:, some], 0.05, axis=0),
        np.nanquantile(drawn[:, some], 0.95, axis=0),
    )
