"""Each link of the chain alone: commands -> wheels, wheels -> body, a path -> gyro, accelerometer, fixes, ranges.

Predict each stream from the recorded stream before it, not from the simulated one, and what is wrong in one link does
not spread to the next. All readings here are expected ones: no noise, encoders not rounded; NaN in a beacon's shadow.
Each link uses only the effects that act in it; the others may be present and do nothing.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.integrate import cumulative_simpson
from scipy.interpolate import CubicSpline

from core.effects import EFFECTS
from core.errors import MissingStreamError, ParameterError
from core.robot import EffectSet
from core.run import Run
from core.sensors import BeaconLog, ImuLog, RangeLog, TruthLog, WheelLog
from core.simulation import _noise
from core.simulation import _rollout_numba as R
from core.simulation import params as P
from core.simulation._batch_numba import Inputs, Outputs, roll, sense_path
from core.simulation.inputs import prepare, rim_speeds, with_drive
from core.simulation.simulate import blank_outputs, capacity, last_instant, require

Array = npt.NDArray[np.float64]

FINE = 0.005
"""Spacing of the nodes of a path given by poses [s]."""


@dataclass(frozen=True)
class Path:
    """The body's motion as the kernels hold it: nodes (n, NODE), columns as in `_rollout_numba`; held past its ends."""

    nodes: Array

    @property
    def t(self) -> Array:
        """(n,) stamps of the nodes [s]; two share one where speeds jump."""
        return self.nodes[:, R.T]

    @property
    def pose(self) -> Array:
        """(n, 3) rows of x, y [m], theta [rad] at the nodes."""
        return self.nodes[:, [R.X, R.Y, R.TH]]

    @property
    def twist(self) -> Array:
        """(n, 3) rows of forward speed, sideways speed [m/s], turn rate [rad/s] at the nodes."""
        return self.nodes[:, [R.V, R.VY, R.W]]


def wheels_from_commands(run: Run, effects: EffectSet) -> WheelLog:
    """Both encoders at the stamps of the run's wheels, driven by its commands. Raises as `simulate`."""
    if run.commands is None or run.wheels is None:
        raise MissingStreamError(
            "this link needs the run's commands and wheels",
            method="wheels_from_commands",
            missing=["commands", "wheels"],
        )
    only = dataclasses.replace(run, imu=None, beacon=None, ranges=None, truth=None)
    out = _sense(body_from_commands(only, effects), only, effects)
    return WheelLog(t=run.wheels.t, left=out.left[0], right=out.right[0])


def body_from_commands(run: Run, effects: EffectSet, *, restarts: Array | None = None) -> Path:
    """The body's path under the run's commands. restarts: as in `simulate_many`. Raises as `simulate`."""
    par = P.pack(run.meta, effects)
    require(run, par)
    return _roll(par, prepare(run, restarts))


def body_from_wheels(run: Run, effects: EffectSet, *, restarts: Array | None = None) -> Path:
    """The body's path under the recorded wheels: kinematics and ground, the drive left out, missed ticks put back.

    Raises MissingStreamError (no wheels, no wheel radius or track width) and ParameterError (effects).
    """
    if run.wheels is None or len(run.wheels) < 2:
        raise MissingStreamError("this link needs the run's wheels", method="body_from_wheels", missing=["wheels"])
    both = {**run.meta.effects, **effects}
    par = P.pack(
        dataclasses.replace(run.meta, effects={}),
        {name: values for name, values in both.items() if name not in EFFECTS or EFFECTS[name].family != "drive"},
    )
    times, left, right = rim_speeds(run.wheels, par[P.RADIUS])
    left, right = left / (1.0 - par[P.MISSED_LEFT]), right / (1.0 - par[P.MISSED_RIGHT])
    return _roll(par, with_drive(prepare(run, restarts), times, left, right))


def body_from_poses(run: Run, t: Array, x: Array, y: Array, theta: Array) -> Path:
    """The path through given poses (N,) by cubic splines, theta unwrapped or not; nodes at the run's IMU windows too.

    Accelerations come from the splines' curvature: give smooth poses. Raises ParameterError for fewer than four poses,
    stamps that do not increase, or values that are not finite.
    """
    columns = np.vstack((x, y, np.unwrap(theta))).astype(np.float64)
    if len(t) < 4 or not np.isfinite(columns).all() or not (np.diff(t) > 0.0).all():
        raise ParameterError("a path needs at least four finite poses at increasing stamps", parameter="t")
    edges = prepare(dataclasses.replace(run, ranges=None)).grid
    steps = np.arange(t[0], t[-1], FINE)
    times = np.unique(np.concatenate((t, steps, edges[(edges > t[0]) & (edges < t[-1])])))
    times = times[np.diff(times, append=np.inf) > R.JUMP]
    spline = CubicSpline(t, columns, axis=1)
    (px, py, th), (vx, vy, w) = spline(times), spline(times, 1)
    c, s = np.cos(th), np.sin(th)
    nodes = np.zeros((len(times), R.NODE))
    nodes[:, [R.T, R.X, R.Y, R.TH, R.XD, R.YD, R.W]] = np.column_stack((times, px, py, th, vx, vy, w))
    nodes[:, R.V], nodes[:, R.VY] = c * vx + s * vy, c * vy - s * vx
    nodes[:, R.TURN] = th - th[0]
    v, side = nodes[:, R.V], nodes[:, R.VY]
    for column, rate in ((R.WV, w * v), (R.WVY, w * side), (R.WW, w * w), (R.CC, c), (R.SS, s)):
        nodes[:, column] = cumulative_simpson(rate, x=times, initial=0.0)
    return Path(nodes)


def imu_from_path(path: Path, run: Run, effects: EffectSet) -> ImuLog:
    """gz, ax, ay along a path at the stamps of the run's IMU. Raises as `simulate`."""
    if run.imu is None:
        raise MissingStreamError("this link needs the run's imu stamps", method="imu_from_path", missing=["imu"])
    out = _sense(path, run, effects)
    gz = _noise.clip(P.pack(run.meta, effects), out.gz[0])
    return ImuLog(t=run.imu.t, gz=gz, ax=out.ax[0], ay=out.ay[0], temperature=run.imu.temperature)


def beacon_from_path(path: Path, run: Run, effects: EffectSet) -> BeaconLog:
    """Fixes along a path at the stamps of the run's beacon. Raises as `simulate`."""
    if run.beacon is None:
        raise MissingStreamError("this link needs the run's fixes", method="beacon_from_path", missing=["beacon"])
    out = _sense(path, run, effects)
    return BeaconLog(t=run.beacon.t, x=out.beacon_x[0], y=out.beacon_y[0], theta=out.beacon_theta[0])


def ranges_from_path(path: Path, run: Run, effects: EffectSet) -> RangeLog:
    """Distances along a path at the stamps and to the beacons of the run's ranges. Raises as `simulate`."""
    if run.ranges is None:
        raise MissingStreamError("this link needs the run's ranges", method="ranges_from_path", missing=["ranges"])
    out = _sense(path, run, effects)
    return dataclasses.replace(run.ranges, range=out.range[0])


def truth_from_path(path: Path, run: Run) -> TruthLog:
    """Poses along a path at the stamps of the run's truth. Raises MissingStreamError."""
    if run.truth is None:
        raise MissingStreamError("this link needs the run's truth stamps", method="truth_from_path", missing=["truth"])
    out = _sense(path, run, {})
    return TruthLog(t=run.truth.t, x=out.x[0], y=out.y[0], theta=out.theta[0])


def _roll(par: Array, inputs: Inputs) -> Path:
    end = last_instant(inputs, par)
    edges = np.empty((len(inputs.grid), R.EDGE))
    room, n = capacity(inputs, end), -1
    while n < 0:
        nodes = np.empty((room, R.NODE))
        n = roll(par, end, inputs, nodes, edges)
        room *= 2
    return Path(nodes[:n].copy())


def _sense(path: Path, run: Run, effects: EffectSet) -> Outputs:
    par = P.pack(run.meta, effects)
    require(run, par)
    inputs = prepare(run)
    out = blank_outputs(inputs, 1)
    sense_path(par, path.nodes, inputs, out)
    return out
