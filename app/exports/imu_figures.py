"""What exports need of a calibration beside its numbers: densities at a rate, and the noise of a run's Allan fit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from core.calibration.imu import ImuCalibration

AXES = ("ax", "ay", "az", "gx", "gy", "gz")


@dataclass(frozen=True)
class AxisNoise:
    """One axis, SI of its unit u; None where neither the calibration nor a run shows it.

    density [u/√Hz] two-sided (a reading's sd is density times √rate); walk [u/s/√Hz] of the bias; sd [u] of a reading.
    The origins say where density and walk are from.
    """

    density: float | None
    walk: float | None
    sd: float | None
    density_origin: str = "not known"
    walk_origin: str = "not known"


Allan = Mapping[str, Mapping[str, float | None]]  # N and K by axis, as `imu.noise` of a run's overview


def axis_noise(calibration: ImuCalibration, axis: str, rate: float, allan: Allan | None = None) -> AxisNoise:
    """Noise of an axis read at `rate` [Hz]: from a run's Allan fit where that shows it, else from the calibration.

    The walk of a calibration is that of its drift as a Gauss-Markov process: amplitude times √(2 / tau).
    """
    model = calibration.gyro if axis[0] == "g" else calibration.accel
    k = "xyz".index(axis[1])
    found = (allan or {}).get(axis) or {}
    sd, density, walk = _known(model.noise_sd[k]), found.get("N"), found.get("K")
    origins = {"density": "Allan fit of a run", "walk": "Allan fit of a run"}
    if density is not None:
        sd = density * math.sqrt(rate)
    elif sd is not None:
        density = sd / math.sqrt(rate)
        origins["density"] = "noise of a reading over the root of the rate"
    if walk is None:
        walk = drive(_known(model.drift_amplitude[k]), _known(model.drift_tau[k]))
        origins["walk"] = "drift of the calibration as a Gauss-Markov process"
    return AxisNoise(density, walk, sd, origins["density"], origins["walk"])


def drive(amplitude: float | None, tau: float | None) -> float | None:
    """Density of the noise that drives a Gauss-Markov process of that deviation [u] and correlation time [s]."""
    return None if amplitude is None or tau is None else abs(amplitude) * math.sqrt(2 / tau)


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
