"""A calibration rig after Kolhoff & Kemper 2021: the plant that calibration is judged on.

Parameters are drawn over the whole of their Table 1. The rig makes rest, six-position and rate-table runs of one
sensor, each from a cold start. Made from scratch with numpy, so that a calibration is not judged by its own model.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from core.robot import Procedure, Segment
from core.run import Run, RunMeta
from core.sensors import ImuLog

Floats = npt.NDArray[np.float64]

DEG = np.pi / 180
G = 9.80665
UP = np.vstack((np.eye(3), -np.eye(3)))  # +x, +y, +z, -x, -y, -z up


@dataclass(frozen=True)
class Truth:
    """Errors of one triad, in the model's terms: arrays (3,), matrix (3, 3)."""

    static_bias: Floats
    drift_amplitude: Floats
    drift_tau: Floats
    matrix: Floats
    noise_sd: Floats

    def read(self, true: Floats, t: Floats, rng: np.random.Generator) -> Floats:
        """(n, 3) readings of `true` (n, 3) at t (n,) after switching on, white noise included."""
        drift = self.drift_amplitude * (1 - np.exp(-t[:, None] / self.drift_tau))
        return true @ self.matrix.T + self.static_bias + drift + self.noise_sd * rng.standard_normal(true.shape)


@dataclass(frozen=True)
class Rig:
    """One sensor on the rig. Beyond Table 1: flicker (Allan floor over 0.664; its
    knee with the white noise lies near 100 s), turn-on scatter (sd of the static bias
    from run to run), quantum of the readings, share and size (in sd) of outliers; pairs are gyro, accelerometer."""

    gyro: Truth
    accel: Truth
    rate: float = 100.0
    flicker: tuple[float, float] = (0.7 * DEG / 3600, 3e-4)
    turn_on: tuple[float, float] = (0.0, 0.0)
    quantum: tuple[float, float] = (DEG / 131 / 4, G / 16384)
    outliers: tuple[float, float] = (2e-4, 12.0)
    fixture: float = 0.0  # rad, sd of each position's tilt
    arm: Floats = field(default_factory=lambda: np.array([0.02, -0.01, 0.015]))  # m, off the table's axis


def draw_rig(seed: int, **options: object) -> Rig:
    """A sensor drawn evenly over Table 1 (its minor elements of the gyro's matrix read as -0.001 to 0.001)."""
    rng = np.random.default_rng([seed, 1])

    def triad(static: tuple, drift: tuple, tau: tuple, major: tuple, minor: tuple, noise: tuple, unit: float) -> Truth:
        matrix = rng.uniform(*minor, (3, 3))
        np.fill_diagonal(matrix, rng.uniform(*major, 3))
        return Truth(
            rng.uniform(*static, 3) * unit,
            rng.uniform(*drift, 3) * unit,
            rng.uniform(*tau, 3),
            matrix,
            rng.uniform(*noise, 3) * unit,
        )

    accel = triad((-0.17, 0.026), (-0.002, 0.018), (50, 167), (0.998, 1.02), (-0.03, 0.02), (0.017, 0.028), 1.0)
    gyro = triad((-0.726, 2.739), (-0.115, 0.347), (1030, 3760), (0.97, 1.003), (-0.001, 0.001), (0.01, 0.013), DEG)
    return Rig(gyro=gyro, accel=accel, **options)  # type: ignore[arg-type]


def rest_run(
    rig: Rig, seed: int, seconds: float = 3600.0, up: int = 2, *, t0: float = 0.0, gravity: bool = True
) -> Run:
    """At rest from switching on with axis `up` (row of UP) upwards; the record begins t0 [s] later."""
    t = t0 + np.arange(int(seconds * rig.rate)) / rig.rate
    force = np.tile(G * UP[up], (len(t), 1))
    segment = Segment(t[0], t[-1], tuple(G * UP[up]) if gravity else None, (0.0, 0.0, 0.0))
    return _record(rig, seed, t, force, np.zeros_like(force), Procedure("rest", (segment,)), "rest")


def six_position_run(
    rig: Rig, seed: int, seconds: float = 60.0, order: tuple[int, ...] = (2, 5, 1, 4, 0, 3), handling: float = 8.0
) -> Run:
    """Each of the positions `order` for `seconds`, turned by hand for `handling` seconds between them."""
    rng = np.random.default_rng([seed, 2])
    period = seconds + handling
    t = np.arange(int(period * len(order) * rig.rate)) / rig.rate
    place = np.minimum((t / period).astype(int), len(order) - 1)
    resting = t - place * period < seconds
    tilt = rig.fixture * rng.standard_normal((len(order), 3))
    held = G * (UP[list(order)] + np.cross(tilt, UP[list(order)]))
    force = held[place] + np.where(resting, 0.0, 1.0)[:, None] * 3 * np.sin(2 * np.pi * 0.7 * t[:, None] + [0, 1, 2])
    rate = np.where(resting, 0.0, 1.0)[:, None] * 1.5 * np.sin(2 * np.pi * 0.4 * t[:, None] + [2, 0, 1])
    segments = tuple(
        Segment(k * period, k * period + seconds, tuple(G * UP[up]), (0.0, 0.0, 0.0)) for k, up in enumerate(order)
    )
    return _record(rig, seed, t, force, rate, Procedure("six_position", segments), "six positions")


def rate_table_run(
    rig: Rig,
    seed: int,
    rates: tuple[float, ...] = (-200 * DEG, -80 * DEG, 80 * DEG, 200 * DEG),
    seconds: float = 30.0,
    *,
    spin_up: float = 3.0,
    declared_spin_up: bool = True,
    gravity: bool = True,
) -> Run:
    """Each axis in turn upwards on a table that turns about the vertical, each of `rates` for `seconds`.

    The table comes up to its rate over `spin_up` seconds, inside the declared segment or before it, and is stopped
    for 5 s between. The sensor sits off the axis: the accelerometer feels the turning.
    """
    period = seconds + 2 * spin_up + 5.0
    plan = [(axis, w) for axis in range(3) for w in rates]
    t = np.arange(int(period * len(plan) * rig.rate)) / rig.rate
    place = np.minimum((t / period).astype(int), len(plan) - 1)
    phase = t - place * period
    shape = np.clip(np.minimum(phase / spin_up, (seconds + 2 * spin_up - phase) / spin_up), 0.0, 1.0)
    axis, speed = np.array([a for a, _ in plan])[place], np.array([w for _, w in plan])[place]
    rate = np.eye(3)[axis] * (speed * shape)[:, None]
    force = G * np.eye(3)[axis] + np.cross(rate, np.cross(rate, rig.arm))
    begin = 0.0 if declared_spin_up else spin_up
    segments = tuple(
        Segment(
            k * period + begin,
            k * period + begin + seconds,
            tuple(G * np.eye(3)[a]) if gravity else None,
            tuple(w * np.eye(3)[a]),
        )
        for k, (a, w) in enumerate(plan)
    )
    return _record(rig, seed, t, force, rate, Procedure("rate_table", segments), "rate table")


def _record(rig: Rig, seed: int, t: Floats, force: Floats, rate: Floats, procedure: Procedure, name: str) -> Run:
    """Readings of one cold start: model, flicker, turn-on scatter, outliers, quantisation."""
    rng = np.random.default_rng([seed, 3])
    columns: dict[str, Floats] = {}
    for s, (prefix, truth, true) in enumerate((("g", rig.gyro, rate), ("a", rig.accel, force))):
        readings = truth.read(true, t, rng) + rig.turn_on[s] * rng.standard_normal(3)
        readings += rig.flicker[s] * _flicker(rng, t)
        share, size = rig.outliers
        hit = rng.random(readings.shape) < share
        readings += np.where(hit, size * truth.noise_sd * rng.standard_normal(readings.shape), 0.0)
        if rig.quantum[s]:
            readings = np.round(readings / rig.quantum[s]) * rig.quantum[s]
        columns |= {prefix + axis: np.ascontiguousarray(readings[:, k]) for k, axis in enumerate("xyz")}
    return Run(RunMeta(name=name, procedure=procedure), imu=ImuLog(t, **columns))


def _flicker(rng: np.random.Generator, t: Floats) -> Floats:
    """(n, 3) noise with an Allan floor near 0.664 from seconds to hours: Gauss-Markov processes two octaves apart."""
    from scipy.signal import lfilter

    slow = np.arange(t[0], t[-1] + 2.0)
    total = np.zeros((len(slow), 3))
    for tau in 4.0 ** np.arange(1, 8):
        phi = np.exp(-1 / tau)
        drive = rng.standard_normal((len(slow), 3)) * np.sqrt(1 - phi**2)
        drive[0] = rng.standard_normal(3)
        total += lfilter([1.0], [1.0, -phi], drive, axis=0)
    # Two octaves of 1/f hold B^2 ln4 / pi of variance each.
    total *= np.sqrt(np.log(4) / np.pi)
    return np.column_stack([np.interp(t, slow, total[:, k]) for k in range(3)])
