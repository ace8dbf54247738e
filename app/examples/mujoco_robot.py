"""A MuJoCo robot as the user's own simulator: `simulate(run, effects, seed) -> Run`, as `/guide/own-simulator` asks.

Rigid bodies with contact instead of the nominal equations: the robot of `run.json` as the MJCF export builds it, driven
by the run's commands. Register it with the effects that it models itself; the others are put around it:
`{"mujoco": {"python": "app.examples.mujoco_robot:simulate", "effects": ["motor_lag", "speed_limit", "unequal_wheels",
"floor_tilt"]}}`. Needs the optional extra `mujoco`.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt

try:
    import mujoco
    from mujoco.rollout import rollout
except ImportError as error:
    raise ImportError(f"this simulator needs MuJoCo ({error}): pip install 'driftscope[mujoco]'") from None

from app.exports.effects_mjcf import effects_mjcf
from core.robot import EffectSet
from core.run import Run
from core.sensors import BeaconLog, ImuLog, RangeLog, TruthLog, WheelLog

Array = npt.NDArray[np.float64]

SETTLE_S = 0.5
"""Before the start: the body comes to rest on its tyres [s]."""


@dataclasses.dataclass(frozen=True)
class History:
    """Every physics step: t (n,) [s]; gyro, accel (n, 3); wheels (n, 2) [rad]; tag (n, 3) [m]; pose (n, 3) of x, y [m],
    theta [rad], not wrapped."""

    t: Array
    gyro: Array
    accel: Array
    wheels: Array
    tag: Array
    pose: Array


def simulate(run: Run, effects: EffectSet, seed: int) -> Run:
    """What a MuJoCo robot with these effects records under the run's commands, at the run's stamps.

    seed: of the sensors' noise; the physics has none. Raises ValueError for a run without commands, or an effect that
    the model cannot express.
    """
    history = drive(run, effects)
    rng = np.random.default_rng(seed)
    return dataclasses.replace(
        run,
        wheels=_wheels(run, history),
        imu=_imu(run, history, rng),
        beacon=_fixes(run, history, rng),
        ranges=_ranges(run, history, rng),
        truth=_truth(run, history),
    )


def drive(run: Run, effects: EffectSet) -> History:
    """The physics under the run's commands, from rest at the run's start to its last reading."""
    model = model_of(run, effects)
    step = model.opt.timestep
    last = max(float(log.t[-1]) for log in run.logs().values() if len(log))
    t = step * np.arange(-round(SETTLE_S / step), np.ceil(last / step) + 10)
    data = mujoco.MjData(model)
    state = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    _, rows = rollout(model, data, state[None], set_points(run, t)[None])
    named = {
        model.sensor(i).name: rows[0][:, model.sensor_adr[i] : model.sensor_adr[i] + model.sensor_dim[i]]
        for i in range(model.nsensor)
    }
    w, x, y, z = named["heading"].T
    theta = np.unwrap(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
    if run.meta.start is not None:
        theta += 2.0 * np.pi * round((run.meta.start.theta - theta[0]) / (2.0 * np.pi))
    wheels = np.hstack((named["left"], named["right"]))
    start = wheels[np.searchsorted(t, 0.0)]
    pose = np.column_stack((named["truth"][:, :2], theta))
    return History(t, named["gyro"], named["accelerometer"], wheels - start, named["fix"], pose)


def model_of(run: Run, effects: EffectSet) -> mujoco.MjModel:
    """The robot of the run with these effects, as the MJCF export writes it."""
    export = effects_mjcf(run.meta, effects)
    lacking = {**export.nearest, **export.missing}
    if lacking:
        raise ValueError(f"this MuJoCo robot does not model {', '.join(lacking)}")
    return mujoco.MjModel.from_xml_string(export.text)


def set_points(run: Run, t: Array) -> Array:
    """(n, 2) set-points of both wheels [rad/s] at t: commands linear in between and held past their ends."""
    commands, robot = run.commands, run.meta.robot
    if commands is None or not robot.wheel_radius or not robot.track_width:
        raise ValueError("this MuJoCo robot needs the run's commands, its wheel_radius and track_width")
    v, w = np.interp(t, commands.t, commands.v), np.interp(t, commands.t, commands.w)
    half = 0.5 * robot.track_width
    return np.where(t[:, None] < 0.0, 0.0, np.column_stack((v - half * w, v + half * w)) / robot.wheel_radius)


def _at(t: Array, history: History, values: Array) -> Array:
    """(len(t), k) of values (n, k), linear between physics steps."""
    return np.column_stack([np.interp(t, history.t, column) for column in values.T])


def _wheels(run: Run, history: History) -> WheelLog | None:
    if run.wheels is None:
        return None
    angles, ticks = _at(run.wheels.t, history, history.wheels), run.meta.robot.ticks_per_rev
    if ticks:
        angles = np.floor(angles * (ticks / (2.0 * np.pi))) * (2.0 * np.pi / ticks)
    return WheelLog(t=run.wheels.t, left=angles[:, 0], right=angles[:, 1])


def _imu(run: Run, history: History, rng: np.random.Generator) -> ImuLog | None:
    """Means over one sample period around each stamp, and white noise of the data sheet's densities."""
    log, sheet = run.imu, run.meta.noise
    if log is None:
        return None
    period = float(np.median(np.diff(log.t))) if len(log) > 1 else history.t[1] - history.t[0]
    readings = np.hstack((history.gyro, history.accel))
    way = np.vstack((np.zeros(6), np.cumsum(0.5 * (readings[1:] + readings[:-1]), axis=0))) * (
        history.t[1] - history.t[0]
    )
    mean = (_at(log.t + period / 2, history, way) - _at(log.t - period / 2, history, way)) / period
    gyro, accel = ((density or 0.0) / np.sqrt(2.0 * period) for density in (sheet.gyro_density, sheet.accel_density))
    mean += np.repeat((gyro, accel), 3) * rng.standard_normal(mean.shape)
    columns = dict(zip(("gx", "gy", "gz", "ax", "ay", "az"), mean.T, strict=True))
    kept = {name: np.ascontiguousarray(v) for name, v in columns.items() if getattr(log, name) is not None}
    return ImuLog(t=log.t, temperature=log.temperature, **kept)


def _fixes(run: Run, history: History, rng: np.random.Generator) -> BeaconLog | None:
    log, sheet = run.beacon, run.meta.noise
    if log is None:
        return None
    seen = np.column_stack((_at(log.t, history, history.tag[:, :2]), _at(log.t, history, history.pose[:, 2:])))
    sd = (sheet.beacon_xy or 0.0, sheet.beacon_xy or 0.0, sheet.beacon_theta or 0.0)
    x, y, theta = (seen + sd * rng.standard_normal(seen.shape)).T.copy()
    return BeaconLog(t=log.t, x=x, y=y, theta=None if log.theta is None else theta)


def _ranges(run: Run, history: History, rng: np.random.Generator) -> RangeLog | None:
    log = run.ranges
    if log is None:
        return None
    places = np.array([run.meta.beacons[name] for name in log.names], dtype=np.float64).reshape(-1, 3)
    away = np.linalg.norm(places[log.beacon] - _at(log.t, history, history.tag), axis=1)
    return dataclasses.replace(log, range=away + (run.meta.noise.range or 0.0) * rng.standard_normal(len(log)))


def _truth(run: Run, history: History) -> TruthLog | None:
    log = run.truth
    if log is None:
        return None
    columns = dict(zip(("x", "y", "theta"), _at(log.t, history, history.pose).T.copy(), strict=True))
    return TruthLog(t=log.t, **{name: v for name, v in columns.items() if getattr(log, name) is not None})
