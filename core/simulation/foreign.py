"""The user's own simulator, with effects that it lacks put around it: on its inputs and on its readings.

An effect goes around a simulator only where that is exact: inputs (delay, dead band, gain and sag of the drive),
figures of the robot that the simulator reads from the run (radius, track, mounts, a beacon's place), the stamps that it
is asked for (delays, clocks), and what happens to a finished reading. The rest is refused with its reason (REFUSED).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from core.effects import EFFECTS, active, check_effects, complete
from core.errors import FormatError, ParameterError
from core.robot import EffectSet
from core.run import Run
from core.sensors import BeaconLog, CommandLog, ImuLog, RangeLog
from core.simulation import _noise
from core.simulation import params as P

Array = npt.NDArray[np.float64]
L = TypeVar("L", ImuLog, BeaconLog, RangeLog)
Simulate = Callable[[Run, EffectSet, int], Run]
"""`simulate(run, effects, seed) -> Run`: all streams of `run` at its stamps, driven by its commands."""

INSIDE = "it acts inside the drive or on the ground, which only the simulator itself knows"
NEEDS_TRUE = "it needs the exact motion under the readings, which a finished recording does not hold"
REFUSED: dict[str, str] = {
    **dict.fromkeys(("motor_lag", "speed_limit", "accel_limit"), INSIDE),
    **dict.fromkeys(("unequal_wheels", "wheel_slip", "side_slip", "slip_patch", "bump"), INSIDE),
    **dict.fromkeys(("floor_tilt", "gyro_g_sensitivity", "vibration", "beacon_shadow"), NEEDS_TRUE),
    "missed_ticks": "the simulator has rounded the encoders already",
}
FINISHED = frozenset(
    {
        "gyro_bias", "gyro_drift", "gyro_walk", "gyro_temperature", "gyro_scale", "gyro_noise", "gyro_clip",
        "accel_bias", "accel_scale", "beacon_shift", "beacon_rotation", "beacon_scale", "beacon_noise",
        "beacon_outliers", "range_bias",
    }
)  # fmt: skip
"""Effects on finished readings: all that a recording can take."""
OF_INPUTS = "a recording takes only what happens to finished readings"
MAX_KNOT = 0.1
"""Spacing of knots where the commands fade with the battery [s]; the error is an eighth of (rate * spacing)^2."""
EDGE = 1e-6
"""How long a dead band takes to open or close [s]."""


@dataclass(frozen=True)
class Foreign:
    """A simulator that is not ours. `effects`: ids that it models itself, and takes as its second argument.

    finished: it is a recording, whose inputs cannot be changed any more.
    """

    name: str
    simulate: Simulate
    effects: frozenset[str] = frozenset()
    finished: bool = False

    def refuses(self) -> dict[str, str]:
        """Effects that can be had neither from the simulator nor around it, with the reason."""
        late = dict.fromkeys(EFFECTS.keys() - FINISHED, OF_INPUTS) if self.finished else {}
        return {effect: why for effect, why in {**late, **REFUSED}.items() if effect not in self.effects}


def recorded(name: str, made: Run) -> Foreign:
    """A recorded simulated run as a simulator: it gives its readings whatever it is asked, no input can be changed."""
    return Foreign(name, lambda run, effects, seed: _picked(name, made, run), finished=True)


def around(foreign: Foreign, run: Run, effects: EffectSet, seed: int) -> Run:
    """What `foreign` makes of the run with these effects, its own or put around it.

    The result has the streams and stamps of the run (fixes and ranges may be fewer) and its description. Raises
    ParameterError (an effect that cannot go around it, or gyro and fixes made less noisy than they are) and
    FormatError (streams, stamps or values that are not what was asked for).
    """
    check_effects(effects)
    own = {effect: values for effect, values in effects.items() if effect in foreign.effects}
    outer = {effect: values for effect, values in effects.items() if effect not in foreign.effects}
    refused = foreign.refuses()
    for effect in active(outer):
        if effect in refused:
            raise ParameterError(
                f"{effect} cannot be put around the simulator {foreign.name!r}: {refused[effect]}",
                parameter=effect,
                simulator=foreign.name,
            )
    bare = dataclasses.replace(run.meta, effects={})
    par = P.pack(bare, outer)
    asked = _question(run, par, complete(outer))
    made = foreign.simulate(asked, own, seed)
    check_answer(foreign.name, asked, made)
    return _answer(run, made, par, seed)


def check_answer(name: str, asked: Run, made: Run) -> None:
    """Refuse streams that are missing, stamps other than those asked for, and readings that are not finite."""
    for stream in ("wheels", "imu", "beacon", "ranges", "truth"):
        wanted, found = getattr(asked, stream), getattr(made, stream)
        if wanted is None:
            continue
        if found is None:
            raise FormatError(f"the simulator {name!r} gave no {stream}", simulator=name, stream=stream)
        fewer = stream in ("beacon", "ranges")
        same = np.isin(found.t, wanted.t).all() if fewer else np.array_equal(found.t, wanted.t)
        if not same:
            raise FormatError(
                f"the simulator {name!r} gave {stream} at other stamps than it was asked for",
                simulator=name,
                stream=stream,
                expected=len(wanted),
                found=len(found),
            )
        for column in dataclasses.fields(found):
            values = getattr(found, column.name)
            if isinstance(values, np.ndarray) and values.dtype.kind == "f" and column.name != "temperature":
                _refuse_nan(name, stream, column.name, values, wanted)


def _refuse_nan(name: str, stream: str, column: str, values: Array, wanted: object) -> None:
    if getattr(wanted, column, None) is None or np.isfinite(values).all():
        return
    row = int(np.argmin(np.isfinite(values)))
    raise FormatError(
        f"the simulator {name!r} gave {stream}.{column} a value that is not finite in row {row + 1}",
        simulator=name,
        stream=stream,
        column=column,
        row=row + 1,
    )


def _question(run: Run, par: Array, values: dict[str, dict[str, float | str]]) -> Run:
    """The run as the simulator gets it: other commands, another robot, other stamps."""
    changed = _robot(run, par, values)
    nominal = P.pack(dataclasses.replace(run.meta, effects={}), {})
    driven = [P.DELAY, P.WIDTH, P.GAIN, P.SAG, P.SCALE_L, P.IB]
    if run.commands is not None and (par[driven] != nominal[driven]).any():
        changed = dataclasses.replace(changed, commands=_commands(run, par))
    if run.imu is not None and (par[P.CLOCK_OFFSET] or par[P.CLOCK_RATE] != 1.0):
        t = (run.imu.t - par[P.CLOCK_OFFSET]) * par[P.CLOCK_RATE]
        changed = dataclasses.replace(changed, imu=_from(run.imu, t))
    if par[P.FIX_DELAY] and run.beacon is not None:
        changed = dataclasses.replace(changed, beacon=_from(run.beacon, run.beacon.t - par[P.FIX_DELAY]))
    if par[P.FIX_DELAY] and run.ranges is not None:
        changed = dataclasses.replace(changed, ranges=_from(run.ranges, run.ranges.t - par[P.FIX_DELAY]))
    return changed


def _from(log: L, t: Array) -> L:
    """The log at other stamps, without those before the run begins."""
    keep = t >= 0.0
    columns: dict[str, Any] = {
        f.name: v[keep]
        for f in dataclasses.fields(log)
        if isinstance(v := getattr(log, f.name), np.ndarray) and f.name != "t"
    }
    return dataclasses.replace(log, t=np.ascontiguousarray(t[keep]), **columns)


def _robot(run: Run, par: Array, values: dict[str, dict[str, float | str]]) -> Run:
    """Radius, track, mounts and a moved beacon stand in the description that the simulator reads."""
    robot, meta = run.meta.robot, run.meta
    radius, track = robot.wheel_radius, robot.track_width
    imu = dataclasses.replace(robot.imu, x=par[P.IMU_X], y=par[P.IMU_Y], yaw=par[P.IMU_YAW])
    tag = dataclasses.replace(robot.tag, x=par[P.TAG_X], y=par[P.TAG_Y])
    robot = dataclasses.replace(
        robot,
        wheel_radius=None if radius is None else radius * float(values["wheel_radius"]["scale"]),
        track_width=None if track is None else track * float(values["track_width"]["scale"]),
        imu=imu,
        tag=tag,
    )
    beacons, moved = dict(meta.beacons), values["anchor_moved"]
    if (name := str(moved["beacon"])) in beacons:
        x, y, z = beacons[name]
        beacons[name] = (x + float(moved["x"]), y + float(moved["y"]), z)
    return dataclasses.replace(run, meta=dataclasses.replace(meta, robot=robot, beacons=beacons))


def _commands(run: Run, par: Array) -> CommandLog:
    """Commands that make the nominal drive of the changed robot turn its wheels as the effects would."""
    assert run.commands is not None
    nominal = run.meta.robot
    half = 0.5 * (nominal.track_width or 0.0)
    t, v, w = (np.asarray(c, dtype=np.float64) for c in (run.commands.t, run.commands.v, run.commands.w))
    t = t + par[P.DELAY]
    if par[P.SAG]:
        dense = np.unique(np.concatenate((t, np.arange(t[0], t[-1], MAX_KNOT)))) if len(t) else t
        v, w, t = np.interp(dense, t, v), np.interp(dense, t, w), dense
    rims = np.vstack((v - half * w, v + half * w))
    if par[P.WIDTH]:
        t, rims = _dead_band(t, rims, par[P.WIDTH])
    rims = rims * par[P.GAIN] * np.exp(-par[P.SAG] * np.maximum(t, 0.0))
    scale, wide = _scales(par, nominal.track_width or 0.0)
    forward, turn = 0.5 * (rims[1] + rims[0]), rims[1] - rims[0]
    return CommandLog(t=t, v=forward * scale, w=turn * scale / wide if half else turn * 0.0)


def _scales(par: Array, track: float) -> tuple[float, float]:
    """Radius over nominal, and the true track [m]."""
    wide = 1.0 / par[P.IB] if par[P.IB] else track
    return float(par[P.SCALE_L]), float(wide)


def _dead_band(t: Array, rims: Array, width: float) -> tuple[Array, Array]:
    """Knots where a rim crosses the band, so that piecewise linear commands jump there within EDGE."""
    knots = [t]
    for rim in rims:
        for level in (-width, width):
            above = rim - level
            i = np.flatnonzero(above[:-1] * above[1:] < 0.0)
            at = t[i] + (t[i + 1] - t[i]) * above[i] / (above[i] - above[i + 1])
            knots += [at - EDGE / 2, at + EDGE / 2]
    dense = np.unique(np.concatenate(knots))
    dense = dense[np.diff(dense, prepend=-np.inf) > EDGE / 4]
    out = np.vstack([np.interp(dense, t, rim) for rim in rims])
    return dense, np.where(np.abs(out) < width, 0.0, out)


def _answer(run: Run, made: Run, par: Array, seed: int) -> Run:
    """Readings back at the run's stamps, with what happens to finished readings; the run's own description."""
    imu = None if run.imu is None or made.imu is None else _imu(run, made.imu, par, seed)
    beacon = None if run.beacon is None or made.beacon is None else _beacon(run, made.beacon, par, seed)
    ranges = None if run.ranges is None or made.ranges is None else _ranges(run, made.ranges, par, seed)
    return dataclasses.replace(
        run, wheels=made.wheels, imu=imu, beacon=beacon, ranges=ranges, truth=made.truth if run.truth else None
    )


def _imu(run: Run, made: ImuLog, par: Array, seed: int) -> ImuLog:
    log = run.imu
    assert log is not None
    early = len(log) - len(made)  # asked for before the run begins: as at its begin
    columns = {
        f.name: np.concatenate((np.full(early, v[0]), v)).astype(np.float64)
        for f in dataclasses.fields(made)
        if f.name not in ("t", "temperature") and (v := getattr(made, f.name)) is not None and len(v)
    }
    elapsed = np.maximum((log.t - par[P.CLOCK_OFFSET]) * par[P.CLOCK_RATE], 0.0)
    gz = columns["gz"] * par[P.GYRO_SCALE] + par[P.BIAS]
    if par[P.DRIFT]:
        gz = gz + par[P.DRIFT] * (1.0 - np.exp(-elapsed / par[P.DRIFT_TAU]))
    if par[P.TEMPERATURE]:
        if log.temperature is None:
            raise ParameterError("gyro_temperature needs the imu's temperature column", parameter="gyro_temperature")
        known = log.temperature[np.isfinite(log.temperature)]
        gz = gz + par[P.TEMPERATURE] * np.nan_to_num(log.temperature - (known[0] if len(known) else 0.0))
    rate = 1.0 / float(np.median(np.diff(log.t))) if len(log) > 1 else 0.0
    more = par.copy()
    more[P.GYRO_NOISE] = _more(par[P.GYRO_NOISE], "gyro_noise")
    columns["gz"] = _noise.gyro(more, run.meta.noise, seed, log.t, rate, gz)
    for name, scale, bias in (("ax", P.ACCEL_SCALE_X, P.ACCEL_BIAS_X), ("ay", P.ACCEL_SCALE_Y, P.ACCEL_BIAS_Y)):
        if name in columns:
            columns[name] = columns[name] * par[scale] + par[bias]
    kept = {name: value for name, value in columns.items() if getattr(log, name) is not None}
    return ImuLog(t=log.t, temperature=log.temperature, **kept)


def _more(factor: float, effect: str) -> float:
    """What to add to noise that is there already, as a share of it. Raises ParameterError for less than there is."""
    if factor < 1.0:
        raise ParameterError(
            f"{effect} below 1 cannot be put around a simulator: its noise is in the readings", parameter=effect
        )
    return float(np.sqrt(factor**2 - 1.0))


def _beacon(run: Run, made: BeaconLog, par: Array, seed: int) -> BeaconLog:
    log = run.beacon
    assert log is not None
    t, rows = _back(log.t, made.t, par)
    x, y = made.x[rows].astype(np.float64), made.y[rows].astype(np.float64)
    c, s = np.cos(par[P.FIX_ANGLE]), np.sin(par[P.FIX_ANGLE])
    x, y = par[P.FIX_SCALE] * (c * x - s * y) + par[P.FIX_X], par[P.FIX_SCALE] * (s * x + c * y) + par[P.FIX_Y]
    theta = None
    more = par.copy()
    more[P.FIX_NOISE] = _more(par[P.FIX_NOISE], "beacon_noise")
    sheet = run.meta.noise
    if log.theta is not None and made.theta is not None:
        turned = made.theta[rows].astype(np.float64) + par[P.FIX_ANGLE]
        theta = _noise.reading(more, sheet.beacon_theta, seed, "beacon.theta", turned)
    x = _noise.reading(more, sheet.beacon_xy, seed, "beacon.x", x)
    y = _noise.reading(more, sheet.beacon_xy, seed, "beacon.y", y)
    return BeaconLog(t=t, x=x, y=y, theta=theta)


def _ranges(run: Run, made: RangeLog, par: Array, seed: int) -> RangeLog:
    log = run.ranges
    assert log is not None
    t, rows = _back(log.t, made.t, par)
    value = par[P.FIX_SCALE] * made.range[rows].astype(np.float64) + par[P.RANGE_BIAS]
    more = par.copy()
    more[P.FIX_NOISE] = _more(par[P.FIX_NOISE], "beacon_noise")
    value = _noise.reading(more, run.meta.noise.range, seed, "ranges.range", value)
    return RangeLog(t=t, beacon=made.beacon[rows], range=value, names=made.names)


def _back(stamps: Array, made: Array, par: Array) -> tuple[Array, npt.NDArray[np.int64]]:
    """The run's stamps of what came back, and its row for each; what was asked for too early is left out."""
    asked = stamps - par[P.FIX_DELAY]
    there = np.flatnonzero(np.isin(asked, made))
    return stamps[there], np.searchsorted(made, asked[there])


def _picked(name: str, made: Run, asked: Run) -> Run:
    """A recording's readings at the stamps asked for: its own stamps only."""
    if asked.commands is not None and made.commands is not None:
        same = np.array_equal(asked.commands.t, made.commands.t) and np.array_equal(asked.commands.v, made.commands.v)
        if not (same and np.array_equal(asked.commands.w, made.commands.w)):
            raise ParameterError(
                f"{name} was driven by other commands than the run that it lies beside", simulator=name
            )
    return made


assert set(REFUSED) <= set(EFFECTS)
