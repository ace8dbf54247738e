"""Drives to simulate: each scenario gives a Run with its commands, and streams whose stamps `simulate` fills.

A drive is a list of legs; speeds change at steady rates, so that commands are piecewise linear.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from core.errors import ParameterError
from core.robot import BeaconMap, ImuMount, Noise, Pose, RobotParams, TagMount
from core.run import Run, RunMeta
from core.sensors import BeaconLog, CommandLog, ImuLog, RangeLog, TruthLog, WheelLog

Array = npt.NDArray[np.float64]
Leg = tuple[tuple[float, float, float], ...]
"""Knots (duration since the last [s], v [m/s], w [rad/s]) of one manoeuvre."""

ACCELERATION, TURN_ACCELERATION = 0.5, 1.5  # m/s^2, rad/s^2
ROBOT = RobotParams(
    wheel_radius=0.075,
    track_width=0.32,
    ticks_per_rev=2048,
    imu=ImuMount(x=0.05, y=-0.02),
    tag=TagMount(z=0.4),
)
ROOM: BeaconMap = {"B1": (0.0, 0.0, 2.5), "B2": (9.0, 0.0, 2.2), "B3": (9.0, 7.0, 2.5), "B4": (0.0, 7.0, 2.3)}
NOISE = Noise(
    gyro_density=1.9e-4,
    accel_density=2.0e-3,
    beacon_xy=0.03,
    beacon_theta=0.02,
    range=0.05,
    truth_xy=0.001,
    truth_theta=0.001,
)


@dataclass(frozen=True)
class Rates:
    """Readings per second [Hz] of each stream; 0 leaves the stream out."""

    commands: float = 50.0
    wheels: float = 50.0
    imu: float = 100.0
    beacon: float = 10.0
    ranges: float = 8.0
    truth: float = 50.0


@dataclass(frozen=True)
class Scenario:
    """A named drive. `legs` are made anew for each run; `start` suits the room of `ROOM` [m, rad]."""

    name: str
    label: str
    legs: Callable[[], list[Leg]]
    start: Pose = field(default_factory=lambda: Pose(1.5, 1.5, 0.0))

    def commands(self, rate: float = 50.0) -> CommandLog:
        """The drive's commands sampled at `rate` [Hz], ending at rest."""
        knots = np.array([knot for leg in self.legs() for knot in leg])
        times = np.concatenate(([0.0], np.cumsum(knots[:, 0])))
        t = np.arange(math.ceil(times[-1] * rate) + 1) / rate
        v, w = (np.interp(t, times, np.concatenate(([0.0], knots[:, i]))) for i in (1, 2))
        return CommandLog(t=t, v=v, w=w)

    def run(
        self,
        rates: Rates | None = None,
        *,
        robot: RobotParams = ROBOT,
        beacons: BeaconMap = ROOM,
        noise: Noise = NOISE,
    ) -> Run:
        """A Run with the drive's commands and streams of NaN readings at the given rates, for `simulate` to fill.

        Raises ParameterError for a rate that is negative or not finite, or no commands.
        """
        rates = rates or Rates()
        for name, rate in vars(rates).items():
            if not math.isfinite(rate) or rate < 0.0 or (name == "commands" and rate == 0.0):
                raise ParameterError(f"rate of {name} is {rate} Hz", parameter=f"rates.{name}", found=rate)
        commands = self.commands(rates.commands)
        end = float(commands.t[-1])
        meta = RunMeta(name=self.name, robot=robot, beacons=beacons, start=self.start, noise=noise)
        return Run(meta=meta, commands=commands, **_blank_streams(rates, end, beacons))  # type: ignore[arg-type]  # by name


def _blank_streams(rates: Rates, end: float, beacons: BeaconMap) -> Mapping[str, object]:
    """Logs of NaN at each rate over 0 .. end; the first IMU sample half a period in, fixes one period in."""
    streams: dict[str, object] = {}
    if rates.wheels:
        t, blank = _blank(rates.wheels, end, 0.0)
        streams["wheels"] = WheelLog(t=t, left=blank, right=blank)
    if rates.imu:
        t, blank = _blank(rates.imu, end, 0.5)
        streams["imu"] = ImuLog(t=t, gz=blank, ax=blank, ay=blank, az=blank, gx=blank, gy=blank)
    if rates.beacon:
        t, blank = _blank(rates.beacon, end, 1.0)
        streams["beacon"] = BeaconLog(t=t, x=blank, y=blank, theta=blank)
    if rates.ranges and beacons:
        t, blank = _blank(rates.ranges, end, 0.7)
        turn = (np.arange(len(t)) % len(beacons)).astype(np.int16)
        streams["ranges"] = RangeLog(t=t, beacon=turn, range=blank, names=tuple(beacons))
    if rates.truth:
        t, blank = _blank(rates.truth, end, 0.0)
        streams["truth"] = TruthLog(t=t, x=blank, y=blank, theta=blank)
    return streams


def _blank(rate: float, end: float, phase: float) -> tuple[Array, Array]:
    t = (np.arange(int(end * rate - phase) + 1, dtype=np.float64) + phase) / rate
    return t, np.full(len(t), np.nan)


def drive(distance: float, v: float, *, curvature: float = 0.0) -> Leg:
    """Speed up to v, go `distance` in all (backwards where v < 0), stop; along an arc of `curvature` [1/m]."""
    ramp = min(abs(v) / ACCELERATION, math.sqrt(distance / ACCELERATION))
    top = math.copysign(ramp * ACCELERATION, v)
    hold = max(distance / abs(top) - ramp, 0.0)
    return (ramp, top, top * curvature), (hold, top, top * curvature), (ramp, 0.0, 0.0)


def turn(angle: float, w: float = 0.8) -> Leg:
    """Turn on the spot by `angle` [rad], counter-clockwise where it is positive."""
    ramp = min(w / TURN_ACCELERATION, math.sqrt(abs(angle) / TURN_ACCELERATION))
    top = math.copysign(ramp * TURN_ACCELERATION, angle)
    hold = max(abs(angle / top) - ramp, 0.0)
    return (ramp, 0.0, top), (hold, 0.0, top), (ramp, 0.0, 0.0)


def stop(seconds: float) -> Leg:
    """Stand still."""
    return ((seconds, 0.0, 0.0),)


def weave(seconds: float, v: float, w: float, period: float) -> Leg:
    """Drive at v while the turn rate swings between +-w in triangles of `period`, ending straight and at rest."""
    ramp = abs(v) / ACCELERATION
    swings = max(round(seconds / period), 1)
    cycle = ((0.25 * period, v, w), (0.5 * period, v, -w), (0.25 * period, v, 0.0))
    return ((ramp, v, 0.0), *(cycle * swings), (ramp, 0.0, 0.0))


def _square(sign: float, side: float = 4.0) -> list[Leg]:
    return [stop(3.0), *([drive(side, 0.5), stop(0.5), turn(sign * math.pi / 2), stop(0.5)] * 4), stop(3.0)]


def _figure_eight() -> list[Leg]:
    loop = 2.0 * math.pi * 1.5
    return [stop(3.0), *([drive(loop, 0.6, curvature=1 / 1.5), drive(loop, 0.6, curvature=-1 / 1.5)] * 2), stop(3.0)]


def _in_place() -> list[Leg]:
    turns = [turn(sign * math.tau, w) for w in (0.4, 0.8, 1.6) for sign in (1.0, -1.0)]
    return [stop(3.0), *(leg for one in turns for leg in (one, stop(1.5))), stop(3.0)]


def _corridor() -> list[Leg]:
    there = [leg for _ in range(3) for leg in (drive(2.0, 0.6), stop(4.0))]
    return [stop(5.0), *there, turn(math.pi), stop(2.0), *there, turn(-math.pi), stop(5.0)]


def _mission() -> list[Leg]:
    """One round through a room and back the other way round, with a rest at every station: about 150 s."""
    quarter = math.pi / 2
    out = [drive(5.5, 0.7), stop(6.0), turn(quarter), drive(3.5, 0.5), stop(1.0), turn(quarter), drive(5.5, 0.8)]
    back = [stop(8.0), turn(quarter), drive(3.5, 0.6), turn(quarter), stop(6.0)]
    arcs = [drive(3.0, 0.5, curvature=0.5), drive(3.0, 0.5, curvature=-0.5), stop(5.0), turn(2 * quarter)]
    home = [drive(3.0, 0.5, curvature=0.5), drive(3.0, 0.5, curvature=-0.5), turn(2 * quarter), stop(10.0)]
    return [stop(15.0), *out, *back, *arcs, *home]


def _staircase() -> list[Leg]:
    steps = [((0.4, v, 0.0), (4.0, v, 0.0)) for v in (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.4, 0.2, 0.05)]
    spins = [((0.4, 0.0, w), (4.0, 0.0, w)) for w in (0.2, 0.5, 1.0, -1.0, -0.5, -0.2)]
    return [stop(3.0), *steps, stop(2.0), *spins, ((0.4, 0.0, 0.0),), stop(3.0)]


def _stop_go() -> list[Leg]:
    return [stop(3.0), *([drive(0.5, 0.5), stop(1.0), drive(0.5, -0.5), stop(1.0), turn(0.5), stop(1.0)] * 6)]


SCENARIOS: dict[str, Scenario] = {
    s.name: s
    for s in (
        Scenario("straight", "straight line", lambda: [stop(3.0), drive(6.0, 0.5), stop(3.0)]),
        Scenario("square-ccw", "square, counter-clockwise", lambda: _square(1.0)),
        Scenario("square-cw", "square, clockwise", lambda: _square(-1.0), Pose(1.5, 5.5, 0.0)),
        Scenario("figure-eight", "figure eight", _figure_eight, Pose(4.5, 3.5, 0.0)),
        Scenario("slalom", "slalom", lambda: [stop(3.0), weave(16.0, 0.4, 0.9, 4.0), stop(3.0)]),
        Scenario("in-place", "turns on the spot", _in_place, Pose(4.5, 3.5, 0.0)),
        Scenario("corridor", "corridor with stops", _corridor),
        Scenario("mission", "mission with stops", _mission),
        Scenario("staircase", "speed staircase", _staircase, Pose(0.5, 3.5, 0.0)),
        Scenario("stop-go", "stop and go", _stop_go, Pose(4.5, 3.5, 0.0)),
        Scenario("standstill", "standstill", lambda: [stop(60.0)], Pose(4.5, 3.5, 0.0)),
    )
}
