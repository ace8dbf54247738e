"""A robot that is not there: the product's simulator in real time, a tick at a time, with any effects.

Each tick simulates what is new alone: the drive runs up for SETTLE seconds out of the commands before, and the body is
set down where the last tick left it. So a tick costs the same after a minute and after a day.
"""

from __future__ import annotations

import dataclasses
import math
from collections import deque
from typing import Any

import numpy as np
import numpy.typing as npt

from core.robot import EffectSet, Pose
from core.run import Run, RunMeta
from core.sensors import BeaconLog, CommandLog, ImuLog, RangeLog, TruthLog, WheelLog
from core.simulation import simulate
from core.simulation.inputs import prepare
from core.simulation.scenarios import NOISE, ROBOT, ROOM, Rates

Array = npt.NDArray[np.float64]

SETTLE = 10.0  # s after which what a drive was asked to do is forgotten
WALK = "gyro_walk"  # the one effect that remembers: summed here
META = RunMeta(name="virtual robot", robot=ROBOT, beacons=ROOM, start=Pose(1.5, 1.5, 0.0), noise=NOISE)


class VirtualRobot:
    """State of the robot after the last tick; `step` drives it on."""

    def __init__(self, meta: RunMeta = META, effects: EffectSet | None = None, seed: int = 0,
                 rates: Rates | None = None) -> None:  # fmt: skip
        self.meta, self.rates = meta, rates or Rates()
        self._effects = {k: v for k, v in (effects or {}).items() if k != WALK}
        self._walk_rate = float((effects or {}).get(WALK, {}).get("density", 0.0))
        self._seed, self._tick, self._walk = seed, 0, 0.0
        self.t = 0.0
        self.pose = meta.start or Pose()
        self._rolled = np.zeros(2)  # wheel angles now, not rounded
        self._commands: deque[tuple[float, float, float]] = deque([(0.0, 0.0, 0.0)])

    def step(self, until: float, v: float, w: float) -> Run:
        """Drive on until then, from the last set-point to v [m/s], w [rad/s], linearly; all readings of this time."""
        begin, known = self.t, self._commands
        if len(known) > 1 and known[-1][1:] == known[-2][1:] == (v, w):
            known.pop()  # it only goes on
        known.append((until, v, w))
        while len(known) > 2 and known[1][0] < begin - 2 * SETTLE:
            known.popleft()
        asked = self._asked(begin, until)
        made = self._simulated(asked, begin, noise=True)
        clean = self._simulated(asked, begin, noise=False)
        self._tick += 1
        return self._taken(made, clean, begin, until)

    def _asked(self, begin: float, until: float) -> Run:
        """Stamps of the tick; wheels and truth also at both ends, as the next tick goes on from there."""
        t, v, w = (np.array(column) for column in zip(*self._commands, strict=True))
        logs: dict[str, Any] = {}
        ends = np.unique(np.array((begin, until)))
        for name, rate, phase in (("imu", self.rates.imu, 0.5), ("beacon", self.rates.beacon, 1.0),
                                  ("ranges", self.rates.ranges, 0.7)):  # fmt: skip
            stamps = _stamps(rate, phase, begin, until)
            if name == "imu" and len(stamps) == 1:
                stamps = np.concatenate((stamps - 1 / rate, stamps))  # one alone has no period
            if len(stamps):
                logs[name] = _blank(name, stamps, rate, self.meta)
        both = np.unique(np.concatenate((ends, _stamps(self.rates.wheels, 0.0, begin, until))))
        logs["wheels"], logs["truth"] = _blank("wheels", both, 1.0, self.meta), _blank("truth", ends, 1.0, self.meta)
        return Run(dataclasses.replace(self.meta, start=self.pose), commands=CommandLog(t, v, w), **logs)

    def _simulated(self, asked: Run, begin: float, *, noise: bool) -> Run:
        inputs = prepare(asked, np.array([[begin, self.pose.x, self.pose.y, self.pose.theta]]))
        inputs = inputs._replace(begin=begin - SETTLE)
        return simulate(asked, self._effects, self._seed * 1_000_003 + self._tick, noise=noise, inputs=inputs)

    def _taken(self, made: Run, clean: Run, begin: float, until: float) -> Run:
        assert clean.wheels is not None and clean.truth is not None and made.truth is not None
        angles = np.column_stack((clean.wheels.left, clean.wheels.right)).astype(np.float64)
        angles += self._rolled - angles[0]
        self._rolled = angles[-1].copy()
        ticks = self.meta.robot.ticks_per_rev
        if ticks:
            step = 2 * math.pi / ticks
            angles = np.floor(angles / step) * step
        truth = clean.truth
        assert truth.x is not None and truth.y is not None and truth.theta is not None
        self.pose = Pose(float(truth.x[-1]), float(truth.y[-1]), float(truth.theta[-1]))
        self.t = until
        logs: dict[str, Any] = {
            "commands": CommandLog(*(np.array(column) for column in zip(*self._new_commands(begin), strict=True))),
            "wheels": self._on_time("wheels", clean.wheels.t, angles.T, begin),
            "imu": self._imu(made.imu, begin),
            "beacon": made.beacon,
            "ranges": made.ranges,
            "truth": TruthLog(*(np.array([value]) for value in (until, *dataclasses.astuple(self.pose)))),
        }
        return Run(self.meta, **{name: log for name, log in logs.items() if log is not None and len(log)})

    def _new_commands(self, begin: float) -> list[tuple[float, float, float]]:
        """The set-point that the tick ends with; of the first tick also that it begins with."""
        return [*([self._commands[0]] if begin == 0.0 else []), self._commands[-1]]

    def _on_time(self, name: str, t: Array, columns: Array, begin: float) -> WheelLog:
        """Without the ends of the tick, where none is due."""
        due = np.isin(t, _stamps(self.rates.wheels, 0.0, begin, self.t))
        return WheelLog(t[due], columns[0][due], columns[1][due])

    def _imu(self, imu: ImuLog | None, begin: float) -> ImuLog | None:
        if imu is None:
            return None
        imu = imu.crop(begin, np.inf)
        if self._walk_rate:
            noise = np.random.default_rng([self._seed, 77, self._tick]).standard_normal(len(imu))
            walked = self._walk + self._walk_rate * np.sqrt(1.0 / self.rates.imu) * np.cumsum(noise)
            self._walk = float(walked[-1]) if len(walked) else self._walk
            imu = dataclasses.replace(imu, gz=imu.gz + walked)
        return imu


def _stamps(rate: float, phase: float, begin: float, until: float) -> Array:
    """Stamps (k + phase) / rate in begin <= t < until."""
    if not rate:
        return np.zeros(0)
    k = np.arange(math.floor(begin * rate - phase) - 1, math.ceil(until * rate - phase) + 2)
    t = (k + phase) / rate
    return np.asarray(t[(t >= begin) & (t < until) & (k >= 0)], np.float64)


def _blank(name: str, t: Array, rate: float, meta: RunMeta) -> Any:
    nothing = np.full(len(t), np.nan)
    if name == "imu":
        return ImuLog(t, nothing, nothing, nothing, nothing, nothing, nothing)
    if name == "beacon":
        return BeaconLog(t, nothing, nothing, nothing)
    if name == "ranges":
        turn = np.floor(t * rate).astype(np.int64) % max(len(meta.beacons), 1)
        return RangeLog(t, turn.astype(np.int16), nothing, tuple(meta.beacons))
    return WheelLog(t, nothing, nothing) if name == "wheels" else TruthLog(t, nothing, nothing, nothing)
