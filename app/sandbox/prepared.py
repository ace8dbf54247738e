"""A stretch of a run, or a scenario, made ready once so that every further simulation of it costs milliseconds."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from app.figures.path import shape_points
from app.figures.series import window
from app.simulators import RECORDED
from core.effects import EFFECTS
from core.errors import DriftscopeError, MissingStreamError, ParameterError
from core.gap.floor import Floor
from core.gap.linear import Problem, with_floor
from core.gap.reference import restarts_of
from core.gap.shrink import NOISES, Replay, replay, replay_inputs, scored
from core.gap.types import Gap
from core.gap.whole import apart
from core.gap.world import CHANNELS, World, make_world
from core.robot import EffectSet
from core.run import Run
from core.sensors import TruthLog
from core.simulation import simulate
from core.simulation._batch_numba import Inputs
from core.simulation.foreign import Foreign, around
from core.simulation.inputs import prepare
from core.simulation.links import body_from_wheels, truth_from_path

Array = npt.NDArray[np.float64]

Picked = tuple[slice, npt.NDArray[np.intp]]

PATH_STEP = 0.05
"""Spacing of the simulated path where the run has no truth [s]."""
SCENARIO = "a scenario was driven by nobody: there is nothing to hold it against"
MADE = 2
"""Simulated runs that are kept beside the nominal one."""


@dataclass(frozen=True)
class Yardstick:
    """What the gap number needs: the run in windows, its noise floor, the nominal simulator's replay."""

    world: World
    floor: Floor
    inputs: Inputs | None
    nominal: Replay

    def gap(self, effects: EffectSet) -> Gap:
        """Nominal against these effects, window by window."""
        acting = {name: values for name, values in effects.items() if name not in NOISES}
        after = replay(self.world, [acting], self.floor, self.inputs)[0] if acting else self.nominal
        return scored(self.world, self.floor, self.nominal, after, effects)


@dataclass
class Prepared:
    """`run`: the stretch as recorded (a scenario: stamps only). `driven`: the same with stamps for the whole path.

    real: the recorded path's columns t, x, y, theta with its label, or None. beside: the simulated run that was stored
    with it, of the same stretch. yardstick: None where `no_gap` says why.
    """

    run: Run
    recorded: bool
    full: tuple[float, float]
    driven: Run
    inputs: Inputs
    real: tuple[str, str, Mapping[str, Any]] | None
    yardstick: Yardstick | None
    no_gap: str | None
    placed: bool = False
    beside: Run | None = None
    _nominal: dict[tuple[str, int, bool], Run] = field(default_factory=dict)
    _made: dict[tuple[str, str, int], Run] = field(default_factory=dict)
    _thin: dict[str, tuple[Any, tuple[tuple[float, float], int], Picked]] = field(default_factory=dict)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _making: threading.Lock = field(default_factory=threading.Lock)

    @property
    def channels(self) -> tuple[str, ...]:
        """Columns that the simulator gives and the run has."""
        return tuple(name for name in CHANNELS if _has(self.run, name))

    @property
    def rows(self) -> int:
        """Readings in memory, about."""
        return sum(len(log) * 4 for log in self.driven.logs().values())

    def made(self, effects: EffectSet, seed: int, noise: bool, foreign: Foreign | None) -> Run:
        """The stretch simulated with these effects. Raises as `simulate` or `around`."""
        if foreign is not None:
            return self._around(foreign, effects, seed)
        return simulate(self.driven, effects, seed, noise=noise, inputs=self.inputs)

    def nominal(self, seed: int, noise: bool, foreign: Foreign | None) -> Run:
        """The simulator as it is; kept until seed, noise or simulator change."""
        key = (foreign.name if foreign else "", seed, noise or foreign is not None)
        with self._making:
            found = self._nominal.get(key)
            if found is None:
                found = self.made({}, seed, noise, foreign)
                self._nominal = {key: found}
            return found

    def _around(self, foreign: Foreign, effects: EffectSet, seed: int) -> Run:
        """The last few are kept: paths and gap are asked for one after the other, and such a run may take a minute."""
        key = (foreign.name, repr(sorted((name, sorted(v.items())) for name, v in effects.items())), seed)
        with self._lock:
            if key in self._made:
                return self._made[key]
        # a recording has its own stamps: of the path too, where the run has none
        if foreign.name == RECORDED and self.beside is not None:
            made = around(foreign, self.run, effects, seed)
            made = dataclasses.replace(made, truth=made.truth or self.beside.truth)
        else:
            made = around(foreign, self.driven, effects, seed)
        with self._lock:
            self._made = {**dict(list(self._made.items())[1 - MADE :]), key: made}
        return made

    def gap(
        self, effects: EffectSet, seed: int = 0, foreign: Foreign | None = None, made: Run | None = None
    ) -> Gap | None:
        """How far real and simulated are apart; None where `no_gap` says why. Raises as `around`.

        made: what `foreign` makes of the run with these effects, if at hand, its path in it.
        """
        if self.yardstick is None:
            return None
        if foreign is None:
            return self.yardstick.gap(effects)
        if made is None or self.path(made) is None:
            made = self.made(effects, seed, True, foreign)
        nominal = self.nominal(seed, True, foreign) if effects else made
        return apart(self.yardstick.world, nominal, made, effects)

    def path(self, made: Run) -> Mapping[str, Any] | None:
        """Columns t, x, y, theta of a simulated path; None where the simulator tells none."""
        truth = made.truth
        if truth is None or truth.x is None or truth.y is None or truth.theta is None:
            return None
        return {"t": truth.t, "x": truth.x, "y": truth.y, "theta": truth.theta}

    def thinned(self, method: str, columns: Mapping[str, Any], inside: tuple[float, float], points: int) -> Picked:
        """Rows of a path within `inside` [s], and about `points` of them that keep its shape.

        Of a path that is the same as at the last move they are known.
        """
        known = self._thin.get(method)
        if known is not None and known[0] is columns["x"] and known[1] == (inside, points):
            return known[2]
        rows = window(columns["t"], *inside)
        found = rows, shape_points(columns["t"][rows], columns["x"][rows], columns["y"][rows], points)
        self._thin[method] = (columns["x"], (inside, points), found)
        return found

    def readings(self, made: Run, name: str) -> Array:
        """(N,) a simulated column at the run's own stamps; NaN where the simulator has no reading."""
        stream, column = name.split(".")
        log, own = getattr(made, stream), getattr(self.run, stream)
        values = np.asarray(getattr(log, column), np.float64)
        if len(values) == len(own):
            return values
        out = np.full(len(own), np.nan)
        out[np.searchsorted(own.t, log.t)] = values
        return out

    def recording(self, name: str) -> Array | None:
        """(N,) a column of the simulated run that was stored with this one, where it has it at the run's stamps."""
        stream, column = name.split(".")
        log, own = getattr(self.beside, stream, None), getattr(self.run, stream)
        if log is None or getattr(log, column) is None or not np.isin(log.t, own.t).all():
            return None
        return None if self.beside is None else self.readings(self.beside, name)

    def idle(self) -> dict[str, str]:
        """Effects that cannot show in this run, with the reason."""
        channels, run = set(self.channels), self.run
        out = {}
        for effect in EFFECTS.values():
            if effect.family == "drive" and run.commands is None:
                out[effect.id] = "it acts on commands, which this run does not have"
            elif not channels.intersection(effect.streams) and effect.id != "beacon_shadow":
                out[effect.id] = f"it moves {', '.join(effect.streams)} only, which this run does not have"
        if run.imu is not None and run.imu.temperature is None:
            out["gyro_temperature"] = "it needs the IMU's temperature, which was not recorded"
        if not run.meta.beacons:
            out["anchor_moved"] = "this run has no beacons"
        return out


def make_prepared(
    run: Run,
    full: tuple[float, float],
    *,
    recorded: bool,
    best: tuple[str, str, Any] | None,
    beside: Run | None = None,
) -> Prepared:
    """A cropped run ready to be simulated. best: method, label and columns of its best path, where it has no truth.

    beside: a simulated run that was recorded with it.

    Raises MissingStreamError where nothing can drive the simulator.
    """
    missing = [name for name in ("wheel_radius", "track_width") if getattr(run.meta.robot, name) is None]
    if missing:
        raise MissingStreamError(
            f"the simulator needs the robot's {' and '.join(missing)}; add it to run.json",
            method="sandbox",
            missing=[f"robot.{name}" for name in missing],
        )
    truth = run.truth
    whole = truth is not None and truth.x is not None and truth.y is not None and truth.theta is not None
    driven = run if whole else dataclasses.replace(run, truth=_stamps_of_path(run, truth))
    restarts = restarts_of(run) if recorded else np.empty((0, 4))
    placed = run.meta.start is None and len(restarts) > 0
    inputs = prepare(driven, restarts[:1] if placed else None)
    yardstick, why = _yardstick(run, restarts) if recorded else (None, SCENARIO)
    real = best
    if whole and recorded:
        assert truth is not None
        real = ("truth", "Truth", {"t": truth.t, "x": truth.x, "y": truth.y, "theta": truth.theta})
    beside = None if beside is None else _with_path(beside)
    return Prepared(run, recorded, full, driven, inputs, real, yardstick, why, placed, beside)


def stretch(run: Run, start: float | None, end: float | None) -> tuple[Run, Inputs]:
    """The run from `start` to `end` [s], and what drives it: out of the middle it is set down where the robot was.

    Raises ParameterError for a stretch that ends before it starts, or lies outside the run.
    """
    t0, t1 = run.span
    first, last = t0 if start is None else start, t1 if end is None else end
    if not t0 <= first < last <= t1:
        raise ParameterError(
            f"a stretch from {first:g} to {last:g} s is not within the run's {t0:g} to {t1:g} s",
            parameter="start" if not t0 <= first < t1 else "end",
            expected=[t0, t1],
            found=[first, last],
        )
    cut = run if (first, last) == (t0, t1) else run.crop(first, last)
    restarts = restarts_of(cut) if cut.meta.start is None else np.empty((0, 4))
    return cut, prepare(cut, restarts[:1] if len(restarts) else None)


def _with_path(made: Run) -> Run:
    """With the path that its wheels drive, where it tells none itself."""
    told = made.truth is not None and made.truth.x is not None and made.truth.theta is not None
    if told or made.wheels is None or len(made.wheels) < 2:
        return made
    blank = dataclasses.replace(made, imu=None, beacon=None, ranges=None, truth=_stamps_of_path(made, None))
    return dataclasses.replace(made, truth=truth_from_path(body_from_wheels(blank, {}), blank))


def _stamps_of_path(run: Run, truth: TruthLog | None) -> TruthLog:
    t0, t1 = run.span
    t = truth.t if truth is not None and len(truth) > 1 else np.arange(t0, t1 + PATH_STEP / 2, PATH_STEP)
    blank = np.full(len(t), np.nan)
    return TruthLog(t=t, x=blank, y=blank, theta=blank)


def _yardstick(run: Run, restarts: Array) -> tuple[Yardstick | None, str | None]:
    if not len(restarts):
        return None, "no truth, fixes or ranges: nothing tells where the robot was"
    try:
        world = make_world(run, restarts)
        floor = with_floor(Problem((world,), Floor({}, {}, {}), run.meta.effects), {}).floor
        inputs = replay_inputs(world)
        return Yardstick(world, floor, inputs, replay(world, [{}], floor, inputs)[0]), None
    except DriftscopeError as error:
        return None, error.message


def _has(run: Run, name: str) -> bool:
    stream, column = name.split(".")
    log = getattr(run, stream)
    return log is not None and len(log) > 0 and getattr(log, column) is not None
