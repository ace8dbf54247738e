"""`simulate(run, effects, seed) -> Run`: the nominal simulator with effects added, at the stamps of the given run.

The given run says what to drive (its commands), what to read (its streams and columns) and when (its stamps); its own
readings are not used, except the recorded temperature. All is at rest at the start pose until t = 0; a run without a
start (one cropped out of a longer run) begins at rest at the map's origin with its first command.
"""

from __future__ import annotations

import contextlib
import dataclasses
import threading
from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt
from numba import get_num_threads

from core.errors import MissingStreamError
from core.robot import EffectSet
from core.run import Run
from core.sensors import BeaconLog, ImuLog, RangeLog, TruthLog, WheelLog
from core.simulation import _noise
from core.simulation import params as P
from core.simulation._batch_numba import Inputs, Outputs, simulate_batch, simulate_every
from core.simulation._rollout_numba import MAX_STEP, NODE
from core.simulation._sense_numba import GRAVITY
from core.simulation.inputs import prepare

Array = npt.NDArray[np.float64]

_BATCH_LOCK = threading.Lock()
"""One parallel batch at a time: numba's fallback thread pool must not be entered twice."""


def simulate(run: Run, effects: EffectSet, seed: int, *, noise: bool = True, inputs: Inputs | None = None) -> Run:
    """The run that a robot with these effects would have recorded, driven by the same commands.

    effects: added to those that `run.meta.effects` says the simulator already models (same id: these replace them).
    seed: of all noise. noise=False gives expected readings: no white noise, no random effect, encoders not rounded.
    Fixes and ranges that a beacon shadow swallows are left out. Columns that a planar simulator cannot move
    (az, gx, gy) read gravity and zero, temperature is passed through. The result keeps `run.meta`.
    inputs: `prepare(run)`, where the same run is simulated many times; with restarts, the pose is set anew at these.

    Raises ParameterError (effects), MissingStreamError (robot, commands or beacon places missing).
    """
    par = P.pack(run.meta, effects)
    require(run, par)
    out, _ = simulate_sets(prepare(run) if inputs is None else inputs, par[None, :], parallel=False)
    wheels = _wheels(run, par, out, noise)
    imu = _imu(run, par, out, seed, noise)
    beacon, ranges = _beacon(run, par, out, seed, noise), _ranges(run, par, out, seed, noise)
    return dataclasses.replace(run, wheels=wheels, imu=imu, beacon=beacon, ranges=ranges, truth=_truth(run, out))


def simulate_many(run: Run, effects: Sequence[EffectSet], *, restarts: Array | None = None) -> Outputs:
    """Expected readings (as `noise=False`) for many effect sets at once, over all cores: (B, rows) per column.

    restarts (K, 4): t [s] increasing, x, y, theta: the body is set to these poses at these times while wheels and
    drive run on, as for comparing a run window by window. Rows in a beacon's shadow are NaN. Raises as `simulate`.
    """
    sets = np.stack([P.pack(run.meta, one) for one in effects]) if effects else np.empty((0, P.SLOTS))
    for par in sets:
        require(run, par)
    out, _ = simulate_sets(prepare(run, restarts), sets)
    limit = sets[:, P.GYRO_CLIP, None]
    return out._replace(gz=np.clip(out.gz, -limit, limit))


def simulate_sets(inputs: Inputs, sets: Array, *, parallel: bool = True) -> tuple[Outputs, npt.NDArray[np.int64]]:
    """The kernels on packed sets (B, SLOTS) as they are (no checks, gyro not clipped); (readings, nodes of each).

    For fitting, where one run meets thousands of parameter sets: prepare once, change slots, call again.
    """
    sets = np.require(sets, np.float64, ("C", "W"))
    ends = np.array([last_instant(inputs, par) for par in sets])
    out = blank_outputs(inputs, len(sets))
    status = np.full(len(sets), -1, np.int64)
    rows = capacity(inputs, float(ends.max(initial=0.0)))
    workers = min(get_num_threads(), len(sets)) if parallel else 1
    while len(sets) and (status < 0).any():
        with _room(workers, rows) as room:
            if workers > 1:
                with _BATCH_LOCK:
                    simulate_batch(sets, ends, inputs, room, out, status, workers)
            else:
                simulate_every(sets, ends, inputs, room, out, status, 0, 1)
        rows *= 2
    return out, status


_ROOMS: list[Array] = []
MOST_ROOMS, LARGEST_ROOM = 2, 256 << 20
"""Rooms that are kept for the next simulation, and the largest of them [bytes, of which those in use are memory]."""


@contextlib.contextmanager
def _room(workers: int, rows: int) -> Iterator[Array]:
    """(workers or more, rows or more, NODE) to work in. Fresh memory costs as much time as a simulation does."""
    try:
        room = _ROOMS.pop()
    except IndexError:
        room = np.empty((0, 0, NODE))
    if room.shape[0] < workers or room.shape[1] < rows:
        room = np.empty((workers, rows, NODE))
    try:
        yield room
    finally:
        if room.nbytes <= LARGEST_ROOM and len(_ROOMS) < MOST_ROOMS:
            _ROOMS.append(room)


COLUMNS = {
    "wheels": ("left", "right"),
    "imu": ("gz", "ax", "ay", "speed"),
    "beacon": ("beacon_x", "beacon_y", "beacon_theta"),
    "ranges": ("range",),
    "truth": ("x", "y", "theta"),
}
"""Columns of `Outputs` by the stream whose stamps they are at."""


def blank_outputs(inputs: Inputs, sets: int) -> Outputs:
    """Unfilled readings for so many parameter sets."""
    return Outputs(
        **{name: np.empty((sets, len(getattr(inputs, stream)))) for stream, names in COLUMNS.items() for name in names}
    )


def require(run: Run, par: Array) -> None:
    """Refuse what this run cannot show. Raises MissingStreamError."""
    if par[P.TEMPERATURE] != 0.0 and run.imu is not None and run.imu.temperature is None:
        raise MissingStreamError(
            "gyro_temperature needs the imu's temperature column", method="simulate", missing=["imu.temperature"]
        )
    if run.commands is None and any(par[slot] != neutral for slot, neutral in P.DRIVE_NEUTRAL.items()):
        raise MissingStreamError(
            "effects of the drive act on commands, which this run does not have",
            method="simulate",
            missing=["commands"],
        )


def last_instant(inputs: Inputs, par: Array) -> float:
    """The last instant that any reading asks for [s]."""
    last = [float(t[-1]) for t in (inputs.wheels, inputs.beacon, inputs.ranges, inputs.truth) if len(t)]
    if len(inputs.grid):
        last.append(float((inputs.grid[-1] - par[P.CLOCK_OFFSET]) * par[P.CLOCK_RATE]))
    return max([*last, inputs.begin])


def capacity(inputs: Inputs, end: float) -> int:
    """Nodes to make room for: one per piece, as many again for jumps and events; untouched memory costs nothing."""
    pieces = (end - inputs.begin) / MAX_STEP + len(inputs.times) + len(inputs.cuts) + 2 * len(inputs.restarts)
    return int(2.2 * pieces) + 1024


def _wheels(run: Run, par: Array, out: Outputs, noise: bool) -> WheelLog | None:
    if run.wheels is None:
        return None
    left, right = out.left[0], out.right[0]
    ticks = run.meta.robot.ticks_per_rev
    if noise and ticks:
        tick = 2.0 * np.pi / ticks
        left, right = tick * np.floor(left / tick), tick * np.floor(right / tick)
    return WheelLog(t=run.wheels.t, left=left, right=right)


def _imu(run: Run, par: Array, out: Outputs, seed: int, noise: bool) -> ImuLog | None:
    log, sheet = run.imu, run.meta.noise
    if log is None:
        return None
    rate = 1.0 / float(np.median(np.diff(log.t))) if len(log) > 1 else 0.0
    gz, ax, ay = _noise.clip(par, out.gz[0]), out.ax[0], out.ay[0]
    flat = {"az": np.full(len(log), GRAVITY), "gx": np.zeros(len(log)), "gy": np.zeros(len(log))}
    if noise:
        gz = _noise.gyro(par, sheet, seed, log.t, rate, out.gz[0])
        ax = _noise.accelerometer(par, sheet, seed, rate, "ax", ax, out.speed[0])
        ay = _noise.accelerometer(par, sheet, seed, rate, "ay", ay, out.speed[0])
        density = {"az": sheet.accel_density, "gx": sheet.gyro_density, "gy": sheet.gyro_density}
        flat = {name: _noise.plain(density[name], rate, seed, name, value) for name, value in flat.items()}
    columns = {"gz": gz, "ax": ax, "ay": ay, **flat}
    kept = {name: value for name, value in columns.items() if getattr(log, name) is not None}
    return ImuLog(t=log.t, temperature=log.temperature, **kept)


def _beacon(run: Run, par: Array, out: Outputs, seed: int, noise: bool) -> BeaconLog | None:
    log, sheet = run.beacon, run.meta.noise
    if log is None:
        return None
    x, y, theta = out.beacon_x[0], out.beacon_y[0], out.beacon_theta[0]
    if noise:
        x = _noise.reading(par, sheet.beacon_xy, seed, "beacon.x", x)
        y = _noise.reading(par, sheet.beacon_xy, seed, "beacon.y", y)
        theta = _noise.reading(par, sheet.beacon_theta, seed, "beacon.theta", theta)
    seen = np.isfinite(out.beacon_x[0])
    return BeaconLog(t=log.t[seen], x=x[seen], y=y[seen], theta=None if log.theta is None else theta[seen])


def _ranges(run: Run, par: Array, out: Outputs, seed: int, noise: bool) -> RangeLog | None:
    log = run.ranges
    if log is None:
        return None
    value = out.range[0]
    if noise:
        value = _noise.reading(par, run.meta.noise.range, seed, "ranges.range", value)
    seen = np.isfinite(out.range[0])
    return RangeLog(t=log.t[seen], beacon=log.beacon[seen], range=value[seen], names=log.names)


def _truth(run: Run, out: Outputs) -> TruthLog | None:
    log = run.truth
    if log is None:
        return None
    columns = {"x": out.x[0], "y": out.y[0], "theta": out.theta[0]}
    return TruthLog(t=log.t, **{name: value for name, value in columns.items() if getattr(log, name) is not None})
