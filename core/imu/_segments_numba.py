"""Compiled statistics of stretches of a record. Plain arrays in and out; `core.imu.segments` checks and documents."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


@numba.njit(cache=True)
def _quantile(ordered: Floats, share: float) -> float:
    place = share * (ordered.shape[0] - 1)
    low = int(place)
    high = min(low + 1, ordered.shape[0] - 1)
    return float(ordered[low] + (place - low) * (ordered[high] - ordered[low]))


@numba.njit(cache=True, parallel=True)
def describe(x: Floats, start: Ints) -> Floats:
    """(M, 9) of each stretch x[start[i]:start[i+1]]: min, quartile 1, median, quartile 3, max, mean, sd, skewness,
    kurtosis."""
    m = start.shape[0] - 1
    out = np.full((m, 9), np.nan)
    for i in numba.prange(m):
        n = start[i + 1] - start[i]
        if n == 0:
            continue
        ordered = np.sort(x[start[i] : start[i + 1]])
        mean = 0.0
        for value in ordered:
            mean += value
        mean /= n
        m2, m3, m4 = 0.0, 0.0, 0.0
        for value in ordered:
            d = value - mean
            m2 += d * d
            m3 += d * d * d
            m4 += d * d * d * d
        out[i, 0], out[i, 4] = ordered[0], ordered[n - 1]
        out[i, 1], out[i, 2], out[i, 3] = _quantile(ordered, 0.25), _quantile(ordered, 0.5), _quantile(ordered, 0.75)
        out[i, 5] = mean
        if n > 1:
            out[i, 6] = np.sqrt(m2 / (n - 1))
        if ordered[n - 1] > ordered[0]:
            out[i, 7] = (m3 / n) / (m2 / n) ** 1.5
            out[i, 8] = (m4 / n) / (m2 / n) ** 2
    return out


@numba.njit(cache=True, parallel=True)
def extremes(x: npt.NDArray[np.floating], start: Ints) -> Floats:
    """(K, 4) minimum, maximum, mean and standard deviation (n - 1) of each block; NaN where it is empty."""
    count = start.shape[0] - 1
    out = np.full((count, 4), np.nan)
    for i in numba.prange(count):
        low, n = start[i], start[i + 1] - start[i]
        if n < 1:
            continue
        origin = float(x[low])
        least, most, first, second = origin, origin, 0.0, 0.0
        for j in range(low, low + n):
            value = float(x[j])
            least = min(least, value)
            most = max(most, value)
            d = value - origin
            first += d
            second += d * d
        mean = first / n
        out[i, 0], out[i, 1], out[i, 2] = least, most, origin + mean
        if n > 1:
            out[i, 3] = np.sqrt(max(0.0, second - n * mean * mean) / (n - 1))
    return out
