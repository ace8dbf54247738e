"""Heading error of a bias method against a reference (Cechowicz 2017, eq. 8)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from core.imu.bias.result import BiasErrors, BiasEstimate
from core.sensors import TruthLog

HOUR = 3600.0


def heading_errors(estimate: BiasEstimate, truth: TruthLog | None) -> BiasErrors | None:
    """Errors of the estimate's heading; None where there is no reference heading that overlaps it."""
    if truth is None or truth.theta is None:
        return None
    theta = np.asarray(truth.theta, np.float64)
    known = np.isfinite(theta)
    if known.sum() < 2:
        return None
    stamps, reference = truth.t[known], np.unwrap(theta[known])
    inside = (estimate.t >= stamps[0]) & (estimate.t <= stamps[-1])
    if inside.sum() < 2:
        return None
    t = estimate.t[inside]
    error = np.interp(t, stamps, reference) - estimate.theta[inside]
    error = error - error[0]
    return BiasErrors(t, error, float(np.abs(error).max()), float(error[-1] / (t[-1] - t[0])), _hourly(t, error))


def _hourly(t: npt.NDArray[np.float64], error: npt.NDArray[np.float64]) -> float:
    """Largest change over an hour, as a rate; over the whole stretch where it is shorter than an hour."""
    if t[-1] - t[0] <= HOUR:
        return float(abs(error[-1]) / (t[-1] - t[0]))
    later = np.interp(t[t <= t[-1] - HOUR] + HOUR, t, error)
    return float(np.abs(later - error[: len(later)]).max() / HOUR)
