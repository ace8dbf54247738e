"""Equations of Kolhoff & Kemper 2021 as curves: drift spectrum (eq. 5), moving average (eq. 8), lines (Fig. 8, 9).

Misprints mended: eq. 5's `(2j pi f)^2 + Tc^2` is `(2 pi f)^2 + Tc^-2`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.calibration.imu.algorithm1 import AXES, WINDOW
from core.calibration.imu.contradictions import declared
from core.calibration.imu.model import ImuCalibration
from core.calibration.imu.stretches import Stretch
from core.errors import ParameterError

Floats = npt.NDArray[np.float64]


def spectrum(amplitude: float, tau: float, f: npt.ArrayLike) -> Floats:
    """(n,) power spectral density [u^2/Hz], two-sided, of the fitted process at f (n,) [Hz], eq. 5:
    G = 2 A^2 / Tc / ((2 pi f)^2 + Tc^-2). Its integral over all f is A^2."""
    if not tau > 0:
        raise ParameterError(f"a correlation time is over 0; found {tau}", parameter="tau", found=tau)
    w = 2 * np.pi * np.asarray(f, np.float64)
    return np.asarray(2 * amplitude**2 / tau / (w**2 + tau**-2))


@dataclass(frozen=True)
class Bode:
    """Frequency response: f (n,) [Hz]; gain (n,) of 1; phase (n,) [rad], wrapped; delay [s]."""

    f: Floats
    gain: Floats
    phase: Floats
    delay: float


def moving_average_bode(rate: float, f: npt.ArrayLike, window: int = WINDOW) -> Bode:
    """Response of the one-sided moving average of `window` readings at `rate` [Hz], eq. 8 with T = window / rate:
    Z = sin(pi f T) / (pi f T) exp(-j pi f T). Zeros at multiples of 1 / T.

    Eq. 8 is the continuous filter. Sampled, the average of readings delays by (window - 1) / 2 of them.
    """
    if not rate > 0:
        raise ParameterError(f"a rate is over 0; found {rate}", parameter="rate", found=rate)
    frequency = np.asarray(f, np.float64)
    duration = window / rate
    response = np.sinc(frequency * duration) * np.exp(-1j * np.pi * frequency * duration)
    return Bode(frequency, np.abs(response), np.angle(response), (window - 1) / 2 / rate)


@dataclass(frozen=True)
class CharacteristicLine:
    """Measured over real of one axis (Fig. 8 and 9): a point per segment (k,), and the fitted line's ends (2,).

    real: declared component along the axis; measured: mean reading less drift; corrected: after bias and matrix.
    """

    axis: str
    real: Floats
    measured: Floats
    corrected: Floats
    line_real: Floats
    line_measured: Floats


def characteristic_lines(found: Sequence[Stretch], calibration: ImuCalibration) -> tuple[CharacteristicLine, ...]:
    """A line per axis with known matrix and at least two declared levels, in the order of AXES."""
    lines = []
    for s, model in enumerate((calibration.accel, calibration.gyro)):
        gyro = s == 1
        parts = [p for p in found if declared(p, gyro) is not None and (gyro or p.still)]
        if not parts or not np.isfinite(model.matrix).all():
            continue
        u = np.array([declared(p, gyro) for p in parts])
        levels = np.array([p.level[3 * s : 3 * s + 3] for p in parts])
        bias = np.array([model.bias((p.lo + p.hi) / 2).T @ p.count / p.count.sum() for p in parts])
        corrected = np.linalg.solve(model.matrix, (levels - bias).T).T
        measured = levels - bias + np.nan_to_num(model.static_bias)
        for k in range(3):
            ends = np.array([u[:, k].min(), u[:, k].max()])
            if ends[0] == ends[1]:
                continue
            line = model.matrix[k, k] * ends + np.nan_to_num(model.static_bias[k])
            name = AXES[3 * s + k]
            lines.append(CharacteristicLine(name, u[:, k], measured[:, k], corrected[:, k], ends, line))
    return tuple(lines)
