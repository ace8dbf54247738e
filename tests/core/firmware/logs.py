"""Logs and calibrations that the firmware is tried on, and what Python makes of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from core.calibration.imu import AXES, WINDOW, ImuCalibration, constants
from core.calibration.imu.algorithm1 import online
from core.calibration.imu.correct import offline
from core.imu.bias import BiasEstimate, FilterConfig, track_bias
from core.imu.bias.result import ACCEPTED
from core.run import Run, RunMeta
from core.sensors import CommandLog, ImuLog

Floats = npt.NDArray[np.float64]

EPS = 2.0**-24  # half a unit in the last place of float32, relative
GRAVITY = 9.80665


def random_calibration(rng: np.random.Generator, *, silent: float = 0.0) -> ImuCalibration:
    """A sensor of the ranges in Kolhoff & Kemper's Table 1; a share `silent` of the numbers is null."""

    def shown(values: npt.ArrayLike) -> Any:
        array = np.asarray(values, np.float64)
        hidden = np.where(rng.random(array.shape) < silent, None, array.astype(object))
        return hidden.tolist()

    def sensor(static: float, drift: float, tau: tuple[float, float], minor: float, noise: float) -> dict[str, Any]:
        matrix = np.diag(rng.uniform(0.97, 1.02, 3)) + rng.uniform(-minor, minor, (3, 3)) * (1 - np.eye(3))
        return {
            "static_bias": shown(rng.uniform(-static, static, 3)),
            "drift_amplitude": shown(rng.uniform(-drift, drift, 3)),
            "drift_tau": shown(rng.uniform(*tau, 3)),
            "matrix": shown(matrix),
            "noise_sd": [noise] * 3,
        }

    gyro = sensor(0.05, 0.006, (300.0, 3760.0), 0.001, 2.3e-4)
    accel = sensor(0.17, 0.018, (50.0, 167.0), 0.03, 0.02)
    return ImuCalibration.from_json({"schema": "calibration/1", "gyro": gyro, "accel": accel})


def driving_log(
    rng: np.random.Generator, calibration: ImuCalibration, seconds: float, rate: float
) -> tuple[Floats, Floats]:
    """t (n,) [s] in whole microseconds and readings (n, 6) in float32 of a robot that drives a minute in two, through
    that calibration's errors, with a bias that wanders beside them."""
    t = np.round(np.arange(int(seconds * rate)) / rate * 1e6) / 1e6
    true = np.zeros((len(t), 6))
    true[:, 2] = GRAVITY
    inside = t % 120.0
    moving = inside > 60.0
    phase = (inside - 60.0) / 60.0
    true[moving, 0] = 0.8 * np.sin(4 * np.pi * phase[moving])
    true[moving, 5] = 0.6 * np.sin(2 * np.pi * phase[moving]) * np.where(t[moving] % 240 > 120, 1.0, -0.7)
    true[moving, 1] = 0.5 * true[moving, 5]
    out = np.empty_like(true)
    for s, model in enumerate((calibration.accel, calibration.gyro)):
        whole = np.where(np.isfinite(model.matrix), model.matrix, np.eye(3))
        part = slice(3 * s, 3 * s + 3)
        shake = 1.0 + 3.0 * moving[:, None]
        out[:, part] = true[:, part] @ whole.T + model.bias(t) + shake * rng.normal(0, model.noise_sd, (len(t), 3))
    out[:, 5] += np.cumsum(rng.normal(0, 2e-6 / np.sqrt(rate), len(t)))
    return t, out.astype(np.float32).astype(np.float64)


def corrected(calibration: ImuCalibration, t: Floats, readings: Floats, window: int | None = None) -> Floats:
    """(n, 6) Algorithm 1 by Python; `window=1` as the bias trackers get it, without average."""
    made = constants(calibration) if window is None else constants(calibration, window=window)
    return online(made, t, readings)


def alike(calibration: ImuCalibration, t: Floats, readings: Floats, online: Mapping[str, Floats]) -> Floats:
    """(6,) correlation of online axes with those corrected afterwards, in double, by Python's offline counterpart of
    Algorithm 1; aligned by the moving average's delay."""
    after = offline(constants(calibration), t, readings)
    late, early = slice(WINDOW + WINDOW // 2, None), slice(WINDOW, -(WINDOW // 2))
    return np.array([np.corrcoef(online[axis][late], after[early, j])[0, 1] for j, axis in enumerate(AXES)])


def bias_by(
    method: str,
    t: Floats,
    axes: Floats,
    temperature: Floats | None = None,
    commands: CommandLog | None = None,
    config: FilterConfig | None = None,
) -> BiasEstimate:
    """What Python finds on corrected axes (n, 6)."""
    ax, ay, az, gx, gy, gz = axes.T
    imu = ImuLog(t, gz, ax=ax, ay=ay, az=az, gx=gx, gy=gy, temperature=temperature)
    return track_bias(Run(RunMeta(name="log"), imu=imu, commands=commands), method, config)


def live_heading(found: BiasEstimate, t: Floats, rate: Floats) -> tuple[Floats, Floats]:
    """(n,) heading [rad] and bias [rad/s] at each reading as method C knows them then, from its verdicts.

    A segment that is over is corrected by its own mean where it rests, else by the last one's; the segment that is
    not over yet by the last one's. What was before the first rest is corrected once that is found.
    """
    length, step = found.figures["length"], float(np.median(np.diff(t)))
    count = len(found.segments.t)
    place = np.minimum(((t - t[0] + step / 2) / length * (1 + 1e-12)).astype(int), count)
    rests = found.segments.verdict == ACCEPTED
    last = np.maximum.accumulate(np.where(rests, np.arange(count), -1))
    first = int(np.argmax(rests))
    own = np.where(last >= 0, found.segments.mean[last], 0.0)  # of a segment that is over
    held = np.concatenate(([0.0], own))[place]  # of one that is not
    dt = np.diff(t, prepend=t[0])
    settled = np.concatenate((own, [0.0]))
    settled[:first] = found.segments.mean[first]
    drift = dt * settled[place]
    begins = np.flatnonzero(np.diff(place, prepend=-1))
    before = (np.cumsum(drift) - drift)[begins][place - place[0]]
    before[place <= first] = 0.0
    since = np.cumsum(dt) - (np.cumsum(dt) - dt)[begins][place - place[0]]
    return np.cumsum(rate * dt) - before - held * since, held


def wrapped(angle: Floats) -> Floats:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


def scale_of(calibration: ImuCalibration, readings: Floats) -> Floats:
    """(6,) the largest number that Algorithm 1 handles on the way to each output: what rounding is relative to."""
    made = constants(calibration)
    size = np.abs(readings).max(axis=0) + np.abs(made.static) + np.abs(made.drift)
    return np.concatenate([np.abs(made.inverse[s]) @ size[3 * s : 3 * s + 3] for s in (0, 1)])


def path_of(calibration: ImuCalibration, t: Floats, readings: Floats) -> float:
    """[rad] the sizes of all rates that the heading sums, integrated: what its rounding is relative to."""
    made = constants(calibration)
    sizes = np.abs(readings[:, 3:]) + np.abs(made.static[3:]) + np.abs(made.drift[3:])
    return float(np.sum((sizes @ np.abs(made.inverse[1][2])) * np.diff(t, prepend=t[0])))
