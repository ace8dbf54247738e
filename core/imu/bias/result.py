"""What every bias method gives: bias and heading over time, and what was made of each segment."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

RATE = 10.0  # Hz, of the curves

ACCEPTED, REJECTED_BY_RANGE, REJECTED_BY_BAND, EMPTY = 1, 2, 3, 0


@dataclass(frozen=True)
class SegmentVerdicts:
    """One row per segment (M,): its middle t [s], mean [rad/s], and verdict (ACCEPTED, REJECTED_BY_RANGE,
    REJECTED_BY_BAND, EMPTY)."""

    t: Floats
    mean: Floats
    verdict: npt.NDArray[np.int8]


@dataclass(frozen=True)
class BiasEstimate:
    """Gyro bias and heading by one method.

    t (N,) [s] at RATE over the whole run; theta (N,) [rad] unwrapped, 0 at the first stamp; bias, sd (N,) [rad/s];
    accepted (N,) whether the segment at t entered the bias. `figures` are what the method used or found (sigma_sr, n,
    ...), SI.
    """

    method: str
    t: Floats
    theta: Floats
    bias: Floats
    sd: Floats
    theta_sd: Floats | None
    accepted: npt.NDArray[np.bool_]
    segments: SegmentVerdicts
    figures: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class BiasErrors:
    """Heading error E = reference - estimate (eq. 8) at the curve's stamps inside the reference.

    t, error (K,) [s, rad], 0 at the first common stamp; max_rad its largest size; net_rate the error at the end over
    the time [rad/s]; hourly_rate the largest change over an hour, over that hour [rad/s] (over the whole run where it
    is shorter).
    """

    t: Floats
    error: Floats
    max_rad: float
    net_rate: float
    hourly_rate: float
