"""Stretches of a gyro record and their descriptive statistics (Cechowicz 2017, Tab. 2 and Fig. 5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.errors import NotEnoughDataError, ParameterError

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

LENGTH = 3.0  # s, of a segment (the paper's Fig. 5)
RANGE_FACTOR = 7.0  # of the mean sd of still segments (the paper's eq. 5)


@dataclass(frozen=True)
class Segments:
    """Equal stretches of a record. start (M + 1,) first sample of each and the end; t0, t1 (M,) [s]; count (M,)
    samples; the rest (M,) in the reading's unit: minimum, quartile_1, median, quartile_3, maximum, mean, sd (n - 1);
    skewness and kurtosis (3 for a Gaussian) without unit.
    """

    start: npt.NDArray[np.int64]
    t0: Floats
    t1: Floats
    count: npt.NDArray[np.int64]
    minimum: Floats
    quartile_1: Floats
    median: Floats
    quartile_3: Floats
    maximum: Floats
    mean: Floats
    sd: Floats
    skewness: Floats
    kurtosis: Floats

    def __len__(self) -> int:
        return len(self.t0)

    @property
    def range(self) -> Floats:
        """(M,) maximum less minimum, the paper's Rx."""
        return self.maximum - self.minimum


def segments(
    t: Floats, values: npt.NDArray[np.floating], length: float = LENGTH, *, quartiles: bool = True
) -> Segments:
    """Cut readings `values` (n,) with stamps `t` (n,) [s] into stretches of `length` [s] from the first stamp.

    A last stretch that is shorter, and stretches with less than half of the samples that others have (a gap), are
    left out of the statistics (NaN). Without `quartiles` only minimum, maximum, mean and sd are found (the others are
    NaN), many times faster. Raises ParameterError for a length of fewer than four samples,
    NotEnoughDataError for less than one segment.
    """
    if len(t) < 8:
        raise NotEnoughDataError(f"{len(t)} readings are too few to cut into segments", found=len(t), expected=8)
    step = float(np.median(np.diff(t[:200_001])))
    if not length >= 4 * step:
        raise ParameterError(
            f"segments of {length:g} s hold fewer than four samples at {1 / step:.4g} Hz",
            parameter="length",
            found=length,
        )
    count = int((t[-1] - t[0] + step) / length * (1 + 1e-9))
    if count < 1:
        raise NotEnoughDataError(f"the record is shorter than one segment of {length:g} s", expected=length)
    # Half a step early: with even stamps, each segment gets the same number of samples whatever the rounding.
    edges = t[0] + length * np.arange(count + 1) - step / 2
    start = np.searchsorted(t, edges).astype(np.int64)
    table = _statistics(values, start, quartiles)
    held = np.diff(start)
    table[held < 0.5 * np.median(held)] = np.nan
    return Segments(start, edges[:-1], edges[1:], held, *(np.ascontiguousarray(column) for column in table.T))


def _statistics(values: npt.NDArray[np.floating], start: npt.NDArray[np.int64], quartiles: bool) -> Floats:
    """(M, 9) of each stretch, in the order of Segments."""
    from core.imu._segments_numba import describe, extremes

    if quartiles:
        return describe(np.ascontiguousarray(values, np.float64), start)
    few = extremes(values, start)
    table = np.full((len(few), 9), np.nan)
    table[:, [0, 4, 5, 6]] = few
    return table


def still_sd(found: Segments) -> float:
    """Mean standard deviation of the segments at rest, the paper's sigma_sr of eq. 5 to 7.

    Which segments are at rest is not known beforehand. Begun with the quarter that is quietest, segments are taken
    whose range is below RANGE_FACTOR times the mean sd of those taken before, until nothing changes.
    """
    sd, span = found.sd[np.isfinite(found.sd)], found.range[np.isfinite(found.sd)]
    if not len(sd) or not (sd > 0).any():
        raise NotEnoughDataError("no segment with noise in it: all readings are equal")
    sigma = float(np.quantile(sd[sd > 0], 0.25))
    for _ in range(50):
        taken = span < RANGE_FACTOR * sigma
        new = float(sd[taken].mean()) if taken.any() else sigma
        if new == sigma:
            break
        sigma = new
    return sigma
