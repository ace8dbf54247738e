"""Drifting bias and correlation time as Kolhoff & Kemper 2021 find them (section 3, eq. 3 and 4).

The record is de-noised by a high-order FIR low-pass; its start and its end give static value and asymptote, their
difference is the drifting bias; what remains above the asymptote is the process g, and Tc is the lag at which its
autocorrelation has fallen to 1/e (the print has lost the minus sign: exp(-1), 36.8 %).

Choices where the paper leaves one: the low-pass has a twelfth of the record's length (Hamming window, cut-off at
four over that length), zero-phase, the record reflected oddly at its ends; the start is the de-noised first value,
the asymptote the mean of the last twentieth; the autocorrelation is the integral over what overlaps, as eq. 4 says.

The rule reads short where the record is not many times Tc: the asymptote is not reached, and the overlap shrinks with
the lag. `expected` says what it would read, on average, had the joint fit the truth; so its bias can be seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.calibration.imu.algorithm1 import AXES
from core.calibration.imu.columns import FASTEST, SLOWEST
from core.calibration.imu.fit import AxisFit
from core.calibration.imu.stretches import Stretch

Floats = npt.NDArray[np.float64]

FEWEST = 60  # blocks of a record
COPIES = 40  # of the record, simulated for the deviations
SEED = 0


@dataclass(frozen=True)
class PaperDrift:
    """One axis of one record by the paper's way: start, asymptote and amplitude (their difference) in the axis' unit;
    tau [s], NaN where the autocorrelation never falls to 1/e; deviations, and what tau is expected to read if the joint
    fit is the truth (NaN where that shows no drift). lag (n,) [s] and correlation (n,) of eq. 4, normed to 1.
    """

    axis: str
    run: int
    start: float
    asymptote: float
    amplitude: float
    tau: float
    amplitude_sd: float
    tau_sd: float
    expected: float
    lag: Floats
    correlation: Floats


def paper_drift(record: Stretch, axis: int, fitted: AxisFit) -> PaperDrift | None:
    """The paper's drift of one axis from one rest record; None where that has under FEWEST blocks."""
    if len(record.lo) < FEWEST or not np.isfinite(record.mean[:, axis]).all():
        return None
    middle = (record.lo + record.hi) / 2
    t = np.linspace(middle[0], middle[-1], len(middle))
    values = np.interp(t, middle, record.mean[:, axis])
    start, end, tau, correlation = _read(values, t[1] - t[0])
    again = _again(t, record, axis, fitted)
    sds = (np.nan, np.nan, np.nan)
    if len(again):
        spread = np.array([(e - s, c) for s, e, c, _ in (_read(copy, t[1] - t[0]) for copy in again)])
        known = spread[np.isfinite(spread[:, 1])]
        expected = float(known[:, 1].mean()) if len(known) else np.nan
        tau_sd = float(known[:, 1].std(ddof=1)) if len(known) > 1 else np.nan
        sds = (float(spread[:, 0].std(ddof=1)), tau_sd, expected)
    return PaperDrift(AXES[axis], record.run, start, end, end - start, tau, *sds, t - t[0], correlation)


def _read(values: Floats, step: float) -> tuple[float, float, float, Floats]:
    """Start, asymptote, Tc and the normed autocorrelation of evenly spaced values."""
    smooth = _denoised(values)
    start = float(smooth[0])
    asymptote = float(smooth[-max(1, len(smooth) // 20) :].mean())
    g = smooth - asymptote
    n = len(g)
    power = np.abs(np.fft.rfft(g, 2 * n)) ** 2
    correlation = np.fft.irfft(power)[:n]
    if not correlation[0] > 0:
        return start, asymptote, np.nan, np.zeros(n)
    correlation = correlation / correlation[0]
    below = np.flatnonzero(correlation < np.exp(-1))
    if not len(below):
        return start, asymptote, np.nan, correlation
    k = int(below[0])
    part = (correlation[k - 1] - np.exp(-1)) / (correlation[k - 1] - correlation[k])
    return start, asymptote, float((k - 1 + part) * step), correlation


def _denoised(values: Floats) -> Floats:
    """Zero-phase FIR low-pass of a twelfth of the record."""
    from scipy.signal import firwin

    half = max(2, len(values) // 24)
    taps = firwin(2 * half + 1, min(0.9, 4 / half))
    before = 2 * values[0] - values[half:0:-1]
    after = 2 * values[-1] - values[-2 : -half - 2 : -1]
    # The reflection turns about the ends' own level, not about one noisy reading.
    few = max(1, half // 4)
    before += 2 * (values[:few].mean() - values[0])
    after += 2 * (values[-few:].mean() - values[-1])
    return np.convolve(np.concatenate([before, values, after]), taps, "valid")


def _again(t: Floats, record: Stretch, axis: int, fitted: AxisFit) -> Floats:
    """(COPIES, n) the record as the joint fit would make it; none where it shows no drift."""
    from scipy.signal import lfilter

    if not np.isfinite(fitted.tau):
        return np.zeros((0, len(t)))
    rng = np.random.default_rng(SEED)
    levels, step = fitted.levels, t[1] - t[0]
    shape = (COPIES, len(t))
    out = np.tile(fitted.amplitude * -np.expm1(-t / fitted.tau), (COPIES, 1))
    out += np.sqrt(levels.white * record.noise[axis] / np.median(record.count)) * rng.standard_normal(shape)
    out += np.cumsum(np.sqrt(levels.walk * step) * rng.standard_normal(shape), axis=1)
    tau = max(2 * step, FASTEST)
    while tau < SLOWEST * (t[-1] - t[0]):
        phi = np.exp(-step / tau)
        drive = np.sqrt(levels.swing * (1 - phi**2)) * rng.standard_normal(shape)
        drive[:, 0] = np.sqrt(levels.swing) * rng.standard_normal(COPIES)
        out += lfilter([1.0], [1.0, -phi], drive, axis=1)
        tau *= 4
    return out
