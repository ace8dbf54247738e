"""Methods A, B and C of Cechowicz (Acta Mechanica et Automatica 11(2), 2017): bias from segments at rest.

A: the bias of the start, kept. B: of each segment that passes the range test (5). C: of each that passes (5) and
whose mean also lies within sigma_sr of the moving average of the n segments before it that passed (5), (7).

Where the paper is ambiguous: method B's text names (6), its results need (5). sigma_sr is the mean sd of segments at
rest in both tests, (7) is therefore a wide band. n counts earlier segments that passed (5). A's start is its first
segment. A segment that passes is corrected by its own mean (3); between, the last value is held. Heading by (4) with
the brackets that it lacks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.errors import ParameterError
from core.imu.bias.integral import curve_stamps, integral_at
from core.imu.bias.result import (
    ACCEPTED,
    EMPTY,
    REJECTED_BY_BAND,
    REJECTED_BY_RANGE,
    BiasEstimate,
    SegmentVerdicts,
)
from core.imu.oddities import RESTLESS, wander
from core.imu.segments import LENGTH, RANGE_FACTOR, Segments, segments, still_sd

Floats = npt.NDArray[np.float64]
Verdicts = npt.NDArray[np.int8]


@dataclass(frozen=True)
class SegmentConfig:
    """length [s] of a segment; n, how many earlier segments the moving average of method C takes."""

    length: float = LENGTH
    n: int = 10

    def __post_init__(self) -> None:
        if self.n < 1:
            raise ParameterError(f"n is {self.n}, expected at least 1", parameter="n", expected=">= 1", found=self.n)


def method_a(t: Floats, gz: npt.NDArray[np.floating], config: SegmentConfig | None = None) -> BiasEstimate:
    """The mean of the first segment, kept for the whole run."""
    config = config or SegmentConfig()
    found = segments(t, gz, config.length, quartiles=False)
    verdict = np.where(np.isfinite(found.mean), REJECTED_BY_BAND, EMPTY).astype(np.int8)
    verdict[int(np.flatnonzero(np.isfinite(found.mean))[0])] = ACCEPTED
    return _estimate("A", t, gz, found, verdict, config)


def method_b(t: Floats, gz: npt.NDArray[np.floating], config: SegmentConfig | None = None) -> BiasEstimate:
    """The mean of each segment that passes the range test (5), held until the next."""
    config = config or SegmentConfig()
    found = segments(t, gz, config.length, quartiles=False)
    return _estimate("B", t, gz, found, range_test(found), config)


def method_c(t: Floats, gz: npt.NDArray[np.floating], config: SegmentConfig | None = None) -> BiasEstimate:
    """As B, of the segments that also lie in the band (7)."""
    config = config or SegmentConfig()
    found = segments(t, gz, config.length, quartiles=False)
    return _estimate("C", t, gz, found, band_test(found, range_test(found), config.n), config)


def range_test(found: Segments) -> Verdicts:
    """(M,) verdicts by (5): the segment's range is below 7 sigma_sr."""
    passed = found.range < RANGE_FACTOR * still_sd(found)
    return np.where(np.isfinite(found.mean), np.where(passed, ACCEPTED, REJECTED_BY_RANGE), EMPTY).astype(np.int8)


def band_test(found: Segments, verdict: Verdicts, n: int) -> Verdicts:
    """(M,) verdicts by (7) on top of (5): within sigma_sr of the mean of the n segments before that passed (5)."""
    out = verdict.copy()
    passed = np.flatnonzero(verdict == ACCEPTED)
    mean = found.mean[passed]
    total = np.concatenate(([0.0], np.cumsum(mean)))
    k = np.arange(len(mean))
    low = np.maximum(k - n, 0)
    before = (total[k] - total[low]) / np.maximum(k - low, 1)
    outside = np.abs(mean - before) > still_sd(found)
    outside[:1] = False  # the first has none before it
    out[passed[outside]] = REJECTED_BY_BAND
    return out


def _estimate(
    method: str, t: Floats, gz: npt.NDArray[np.floating], found: Segments, verdict: Verdicts, config: SegmentConfig
) -> BiasEstimate:
    """Bias per sample from the segments' verdicts, heading by (4), both on the curve's stamps."""
    taken = np.flatnonzero(verdict == ACCEPTED)
    sigma = still_sd(found)
    notes: tuple[str, ...] = () if len(taken) else ("No segment at rest was found: the bias stays 0.",)
    if (times := wander(sigma, gz)) > RESTLESS:
        notes += (
            f"Hardly a segment is at rest: even the quietest wander by {times:.3g} times their readings' own noise. "
            "The bias holds some of the movement.",
        )
    # Each segment's last accepted one up to it; those before the first accepted take that one.
    last = np.maximum.accumulate(np.where(verdict == ACCEPTED, np.arange(len(verdict)), -1))
    value = np.where(last >= 0, found.mean[np.maximum(last, 0)], found.mean[taken[0]] if len(taken) else 0.0)
    out = curve_stamps(t)
    turned, _ = integral_at(t, gz, out)
    # A segment's bias holds for its readings, each of which lasts since the one before it.
    edges = t[np.maximum(found.start - 1, 0)]
    edges[-1] = t[-1]
    drifted = np.concatenate(([0.0], np.cumsum(value * np.diff(edges))))
    theta = turned - np.interp(out, edges, drifted)
    place = np.minimum(np.searchsorted(found.t1, out, "right"), len(found) - 1)
    counted = found.count[np.maximum(last, 0)]
    return BiasEstimate(
        method,
        out,
        theta,
        value[place],
        sigma / np.sqrt(np.maximum(counted, 1))[place],
        None,
        verdict[place] == ACCEPTED,
        SegmentVerdicts((found.t0 + found.t1) / 2, found.mean, verdict),
        {"sigma_sr": sigma, "n": float(config.n), "length": config.length},
        notes,
    )
