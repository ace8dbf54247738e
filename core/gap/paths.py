"""Curves of a run for a map and a timeline: where it was, how far off the simulator was there, and its free run."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from core.effects import EFFECTS
from core.gap.curves import heading_of
from core.gap.energy import SPAN, Energy
from core.gap.evidence import FreeRun, PathTrace, Poses, RunEvidence, Timeline
from core.gap.motion import Motion
from core.gap.rolling import with_past
from core.gap.world import World
from core.robot import EffectSet, Pose
from core.simulation import params as P
from core.simulation.inputs import prepare
from core.simulation.simulate import simulate_sets

Array = npt.NDArray[np.float64]

POINTS = 600
"""At most so many blocks of time per curve."""
SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Shares of the fitted effects for which the free run is shown."""
KEPT = {
    "slip_patch": ("x", "y", "radius"), "bump": ("time",), "gyro_drift": ("tau",), "anchor_moved": ("beacon",),
    "beacon_shadow": ("x", "y"), "beacon_outliers": ("size",),
}  # fmt: skip
"""Parameters that say where or when, not how much."""


def run_evidence(
    number: int, world: World, moved: Motion, energy: Mapping[str, Energy], model: EffectSet, held_out: bool
) -> RunEvidence:
    """All curves of one run."""
    return RunEvidence(
        run=number,
        name=world.run.meta.name,
        held_out=held_out,
        path=_trace(world, moved, energy),
        timeline=_timeline(moved, energy),
        free_run=free_run(world, model),
    )


def _step(blocks: int) -> int:
    """Blocks of SPAN that make one of a curve's."""
    return max(round(1.0 / SPAN), -(-blocks // POINTS))


def _mean_squares(moved: Motion, energy: Mapping[str, Energy], field: str) -> tuple[Array, dict[str, Array]]:
    """Middles of a curve's blocks, and each channel's mean square there (NaN without readings)."""
    first = np.arange(0, len(moved.t), _step(len(moved.t)))
    count = np.diff(np.append(first, len(moved.t)))
    out = {}
    for name, one in energy.items():
        rows = np.add.reduceat(one.rows, first)
        with np.errstate(invalid="ignore", divide="ignore"):
            out[name] = np.where(rows > 0.0, np.add.reduceat(getattr(one, field), first) / rows, np.nan)
    middle: Array = np.add.reduceat(moved.t, first) / count
    return middle, out


def _timeline(moved: Motion, energy: Mapping[str, Energy]) -> Timeline:
    t, before = _mean_squares(moved, energy, "before")
    _, after = _mean_squares(moved, energy, "after")
    root = [{name: np.sqrt(values) for name, values in part.items()} for part in (before, after)]
    return Timeline(t, root[0], root[1])


def _trace(world: World, moved: Motion, energy: Mapping[str, Energy]) -> PathTrace | None:
    t, squares = _mean_squares(moved, energy, "before")
    theta = heading_of(world, t)
    if theta is None or not squares or not np.isfinite(moved.x).all():
        return None
    stacked = np.stack(list(squares.values()))
    known = np.isfinite(stacked)
    gap = np.sqrt(np.where(known, stacked, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1))
    return PathTrace(t, np.interp(t, moved.t, moved.x), np.interp(t, moved.t, moved.y), theta, gap)


def scaled(model: EffectSet, known: EffectSet, share: float) -> dict[str, dict[str, float | str]]:
    """The fitted effects at a share of their size; a limit recedes as the share falls."""
    out: dict[str, dict[str, float | str]] = {}
    for effect, values in model.items():
        start = {**EFFECTS[effect].neutral, **known.get(effect, {})}
        mixed: dict[str, float | str] = {}
        for name, value in values.items():
            base = start[name]
            if isinstance(value, str) or isinstance(base, str) or name in KEPT.get(effect, ()):
                mixed[name] = value
            elif np.isinf(base):
                mixed[name] = value / share if share > 0.0 else base
            else:
                mixed[name] = base + share * (value - base)
        out[effect] = mixed
    return out


def free_run(world: World, model: EffectSet) -> FreeRun | None:
    """The run driven by its commands (its wheels, where there are none) from its start, the pose never set anew.

    None where nothing tells the real pose, or the run is too short to show.
    """
    run = world.run
    real = _real(world)
    if real is None:
        return None
    t, poses = real
    bare = dataclasses.replace(run, imu=None, beacon=None, ranges=None, truth=None, wheels=None)
    start = Pose(float(poses.x[0]), float(poses.y[0]), float(poses.theta[0]))
    driven = bare if run.commands is not None else dataclasses.replace(bare, wheels=run.wheels)
    inputs = prepare(driven, np.array([[t[0], start.x, start.y, start.theta]]))
    inputs = inputs._replace(truth=t, wheels=np.empty(0))
    inputs = with_past(inputs, run) if run.commands is not None else inputs
    moving = {k: v for k, v in model.items() if EFFECTS[k].family in ("drive", "kinematics", "ground")}
    if run.commands is None:
        moving = {k: v for k, v in moving.items() if EFFECTS[k].family != "drive"}
    sets = [P.pack(run.meta, scaled(moving, run.meta.effects, share), start=start) for share in SHARES]
    out, _ = simulate_sets(inputs, np.stack(sets))
    paths = tuple(Poses(out.x[k], out.y[k], out.theta[k]) for k in range(len(SHARES)))
    return FreeRun(t, poses, SHARES, paths)


def _real(world: World) -> tuple[Array, Poses] | None:
    """Where the robot was, at even stamps: from truth, else from the smoothed windows' starts."""
    names = ("truth.x", "truth.y", "truth.theta")
    if all(name in world.readings for name in names):
        at, columns = world.times["truth.x"], [world.readings[name] for name in names]
        if len({len(column) for column in columns}) > 1:
            return None
    elif len(world.restarts) > 1:
        at, columns = world.restarts[:, 0], [world.restarts[:, k] for k in (1, 2, 3)]
    else:
        return None
    if len(at) < 2:
        return None
    t = np.linspace(float(at[0]), float(at[-1]), int(np.clip((at[-1] - at[0]) / 0.2, 2, POINTS)))
    x, y, theta = (np.interp(t, at, column) for column in (columns[0], columns[1], np.unwrap(columns[2])))
    return t, Poses(x, y, theta)
