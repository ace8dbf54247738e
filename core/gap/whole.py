"""A whole simulated run, driven from the start in one go, held against the recorded one in the gap's windows.

Where the simulator cannot be set down anew every window, its path is: each window's stretch of it is moved as a whole
so that it begins at the reference pose, as a restart would have begun it (exact on a floor that is everywhere alike).
Fixes and ranges follow their tag; what the simulator adds to them stays.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

from core.errors import MissingStreamError
from core.gap.floor import Floor, measure, stated, wrap
from core.gap.shrink import Replay, scored
from core.gap.types import Gap
from core.gap.whiten import windows_of
from core.gap.world import POSES, WHEELS, World
from core.robot import EffectSet
from core.run import Run
from core.sensors import TruthLog
from core.simulation.inputs import beacon_table

Array = npt.NDArray[np.float64]

TICKS = 1e-3
"""Angles this near to whole ticks [ticks] are rounded to them."""


def apart(world: World, nominal: Run, patched: Run, effects: EffectSet) -> Gap:
    """The gap between a recorded run and a simulator's runs of it, as it is and with effects, at the run's stamps.

    The floor holds the noise of both, where the simulator has its own. Raises MissingStreamError where the simulator
    gives nothing that was recorded.
    """
    names = tuple(name for name in world.channels if _gives(nominal, name) and _gives(patched, name))
    if not names:
        raise MissingStreamError("the simulator gives nothing that the run has", method="gap", missing=world.channels)
    world = dataclasses.replace(world, readings={name: world.readings[name] for name in names})
    before, after = _residuals(world, nominal), _residuals(world, patched)
    floor = measure([world], [before], [None])
    rounded = nominal.wheels is not None and _rounded(nominal)
    louder = {
        name: sigma * np.sqrt(2.0) if rounded and name in WHEELS else sigma for name, sigma in floor.sigma.items()
    }
    floor = dataclasses.replace(floor, sigma=louder)
    return scored(world, floor, _replay(world, before, floor), _replay(world, after, floor), effects)


def _gives(made: Run, name: str) -> bool:
    stream, column = name.split(".")
    if name in POSES and _path(made.truth) is None:
        return False
    log = getattr(made, stream)
    return log is not None and getattr(log, column) is not None


def _rounded(made: Run) -> bool:
    """Whether its encoders count whole ticks."""
    ticks = made.meta.robot.ticks_per_rev
    if not ticks or made.wheels is None:
        return False
    count = np.asarray(made.wheels.left, np.float64) * ticks / (2.0 * np.pi)
    return bool(np.abs(count - np.round(count)).max(initial=0.0) < TICKS)


def _replay(world: World, residuals: dict[str, Array], floor: Floor) -> Replay:
    sheet = {**floor.sigma, **stated(world.run)}
    return Replay(world.times, {name: np.nan_to_num(far) / sheet[name] for name, far in residuals.items()})


def _residuals(world: World, made: Run) -> dict[str, Array]:
    """Recorded minus simulated by channel; encoders since their window's start. NaN: the simulator read nothing."""
    moved = _Placed(world.restarts, made.truth) if _path(made.truth) is not None else None
    out = {}
    for name in world.channels:
        if name in WHEELS:
            far = world.readings[name] - _column(world, made, name)
            first = windows_of(world.times[name])
            far = far - np.repeat(far[first], np.diff(np.append(first, len(far))))
        elif name in POSES:
            assert moved is not None
            far = world.readings[name] - (_column(world, made, name) + _shift(world, moved, name))
            far = wrap(far) if name.endswith("theta") else far
        else:
            far = world.readings[name] - _column(world, made, name)
        out[name] = far
    return out


def _column(world: World, made: Run, name: str) -> Array:
    """A simulated column at the stamps of the known readings."""
    stream, column = name.split(".")
    log, t = getattr(made, stream), world.times[name]
    values = np.asarray(getattr(log, column), np.float64)
    at = np.minimum(np.searchsorted(log.t, t), max(len(log) - 1, 0))
    return np.where(log.t[at] == t, values[at], np.nan) if len(log) else np.full(len(t), np.nan)


def _shift(world: World, moved: _Placed, name: str) -> Array:
    """What setting the path down anew does to a pose reading."""
    stream, column = name.split(".")
    t, robot = world.times[name], world.run.meta.robot
    was, now = moved.poses(t)
    if column == "theta":
        return now[2] - was[2]
    if stream == "truth":
        return now[0] - was[0] if column == "x" else now[1] - was[1]
    tags = [_tag(pose, robot.tag.x, robot.tag.y) for pose in (was, now)]
    if stream == "beacon":
        axis = 0 if column == "x" else 1
        return tags[1][axis] - tags[0][axis]
    index, places = beacon_table(world.run)
    place = places[index][world.keep(name)]
    far = [np.hypot(np.hypot(x - place[:, 0], y - place[:, 1]), robot.tag.z - place[:, 2]) for x, y in tags]
    return far[1] - far[0]


def _tag(pose: Array, x: float, y: float) -> tuple[Array, Array]:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return pose[0] + c * x - s * y, pose[1] + s * x + c * y


def _path(truth: TruthLog | None) -> tuple[Array, Array] | None:
    if truth is None or truth.x is None or truth.y is None or truth.theta is None or len(truth) < 2:
        return None
    return truth.t, np.vstack((truth.x, truth.y, np.unwrap(truth.theta))).astype(np.float64)


class _Placed:
    """A simulated path, and how each window of it is moved to begin at the reference pose."""

    def __init__(self, restarts: Array, truth: TruthLog | None) -> None:
        found = _path(truth)
        assert found is not None
        self._t, self._poses = found
        self._starts = restarts[:, 0]
        there = self._at(self._starts)
        turn = restarts[:, 3] - there[2]
        c, s = np.cos(turn), np.sin(turn)
        x, y = restarts[:, 1] - (c * there[0] - s * there[1]), restarts[:, 2] - (s * there[0] + c * there[1])
        self._moves = np.vstack((turn, x, y))

    def _at(self, t: Array) -> Array:
        return np.vstack([np.interp(t, self._t, column) for column in self._poses])

    def poses(self, t: Array) -> tuple[Array, Array]:
        """(3, N) x, y, theta at the stamps: as simulated, and moved; before the first window as simulated."""
        was = self._at(t)
        window = np.searchsorted(self._starts, t, "right") - 1
        turn, x, y = np.where(window >= 0, self._moves[:, np.maximum(window, 0)], 0.0)
        c, s = np.cos(turn), np.sin(turn)
        return was, np.vstack((c * was[0] - s * was[1] + x, s * was[0] + c * was[1] + y, was[2] + turn))
