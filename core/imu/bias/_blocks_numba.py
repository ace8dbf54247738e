"""Compiled statistics of short blocks of a gyro record. Plain arrays in and out; `blocks` checks and documents."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


@numba.njit(cache=True, parallel=True)
def moments(x: npt.NDArray[np.floating], start: Ints) -> Floats:
    """(K, 2) mean and variance (n - 1) of each block x[start[i]:start[i+1]]; NaN where it has fewer than two."""
    count = start.shape[0] - 1
    out = np.full((count, 2), np.nan)
    for i in numba.prange(count):
        low, n = start[i], start[i + 1] - start[i]
        if n < 2:
            continue
        origin = float(x[low])
        first, second = 0.0, 0.0
        for j in range(low, low + n):
            d = float(x[j]) - origin
            first += d
            second += d * d
        mean = first / n
        out[i, 0] = origin + mean
        out[i, 1] = max(0.0, second - n * mean * mean) / (n - 1)
    return out


@numba.njit(cache=True, parallel=True)
def angles(t: Floats, x: npt.NDArray[np.floating], start: Ints) -> Floats:
    """(K,) integral of x over each block, each reading lasting since the one before it."""
    count = start.shape[0] - 1
    out = np.zeros(count)
    for i in numba.prange(count):
        low, high = start[i], start[i + 1]
        last = t[max(low - 1, 0)]
        total = 0.0
        for j in range(low, high):
            total += float(x[j]) * (t[j] - last)
            last = t[j]
        out[i] = total
    return out


@numba.njit(cache=True)
def at_limit(x: npt.NDArray[np.floating], least: float, most: float) -> int:
    """How many readings sit at the least or the most value together with both of their neighbours."""
    count = 0
    for i in range(1, x.shape[0] - 1):
        v = x[i]
        if v in (least, most) and x[i - 1] == v and x[i + 1] == v:
            count += 1
    return count


@numba.njit(cache=True)
def longest_repeat(x: npt.NDArray[np.floating]) -> int:
    """The longest run of equal readings."""
    most, run = 1, 1
    for i in range(1, x.shape[0]):
        run = run + 1 if x[i] == x[i - 1] else 1
        most = max(most, run)
    return most
