"""Noise, rounding and saturation on readings without noise. Each column draws from its own stream of the seed.

So one seed gives one noise whatever the effects are: switching an effect on moves only what it touches.
"""

from __future__ import annotations

import zlib

import numpy as np
import numpy.typing as npt

from core.robot import Noise
from core.simulation import params as P

Array = npt.NDArray[np.float64]


def normal(seed: int, column: str, n: int) -> Array:
    """(n,) standard normal numbers of one column."""
    return _generator(seed, column).standard_normal(n)


def _generator(seed: int, column: str) -> np.random.Generator:
    return np.random.default_rng([seed, zlib.crc32(column.encode())])


def gyro(par: Array, noise: Noise, seed: int, stamps: Array, rate: float, gz: Array) -> Array:
    """White noise of standard deviation factor*density*sqrt(rate/2), the bias walk, then the clip."""
    out = gz + par[P.GYRO_NOISE] * _white(noise.gyro_density, rate) * normal(seed, "imu.gz", len(gz))
    if par[P.WALK] != 0.0:
        steps = np.sqrt(np.diff(np.maximum(stamps, 0.0), prepend=0.0))
        out = out + par[P.WALK] * np.cumsum(steps * normal(seed, "imu.gz walk", len(gz)))
    return clip(par, out)


def clip(par: Array, gz: Array) -> Array:
    """Saturation."""
    return np.clip(gz, -par[P.GYRO_CLIP], par[P.GYRO_CLIP]) if np.isfinite(par[P.GYRO_CLIP]) else gz


def accelerometer(par: Array, noise: Noise, seed: int, rate: float, column: str, value: Array, speed: Array) -> Array:
    """White noise and vibration on `ax` or `ay`."""
    out = value + _white(noise.accel_density, rate) * normal(seed, f"imu.{column}", len(value))
    if par[P.VIBRATION] != 0.0:
        out = out + par[P.VIBRATION] * np.abs(speed) * normal(seed, f"imu.{column} vibration", len(value))
    return out


def plain(density: float | None, rate: float, seed: int, column: str, value: Array) -> Array:
    """White noise of a data sheet's density on a column that no effect touches."""
    return value + _white(density, rate) * normal(seed, f"imu.{column}", len(value))


def reading(par: Array, sd: float | None, seed: int, column: str, value: Array) -> Array:
    """White noise of a fix's or range's column: factor * the data sheet's; where `column` ends in theta no outliers."""
    out = value + par[P.FIX_NOISE] * (sd or 0.0) * normal(seed, column, len(value))
    if par[P.OUTLIER_RATE] == 0.0 or column.endswith("theta"):
        return out
    stream = column.split(".")[0]
    hit = _generator(seed, f"{stream} outliers").random(len(value)) < par[P.OUTLIER_RATE]
    return out + np.where(hit, par[P.OUTLIER_SIZE] * normal(seed, f"{column} outliers", len(value)), 0.0)


def _white(density: float | None, rate: float) -> float:
    return (density or 0.0) * float(np.sqrt(rate / 2.0))
