"""Compiled sums of squared differences of averages. Plain arrays in and out; `core.imu.allan` checks and documents."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

# Sums may be regrouped (that is what vectorises them); NaN and infinity keep their meaning.
_FAST = {"reassoc", "nsz", "contract", "arcp"}


@numba.njit(cache=True)
def integral(values: Floats, mean: float) -> Floats:
    """(n+1,) running sum of values less their mean, from 0."""
    out = np.empty(values.shape[0] + 1)
    total = 0.0
    out[0] = 0.0
    for i in range(values.shape[0]):
        total += values[i] - mean
        out[i + 1] = total
    return out


@numba.njit(cache=True, fastmath=_FAST)
def _second(a: Floats, b: Floats, c: Floats) -> float:
    # Slices, not x[i + m]: the compiler then knows that no index is negative, and vectorises (five times faster).
    total = 0.0
    for i in range(a.shape[0]):
        d = c[i] - 2.0 * b[i] + a[i]
        total += d * d
    return total


@numba.njit(cache=True, fastmath=_FAST)
def _third(a: Floats, b: Floats, c: Floats, e: Floats) -> float:
    total = 0.0
    for i in range(a.shape[0]):
        d = e[i] - 3.0 * (c[i] - b[i]) - a[i]
        total += d * d
    return total


@numba.njit(cache=True, parallel=True)
def sums_allan(x: Floats, factors: Ints, block: int) -> Floats:
    """Sum over i of (x[i+2m] - 2 x[i+m] + x[i])^2 per factor m. A block of x stays in cache for all factors."""
    n, k = x.shape[0], factors.shape[0]
    blocks = (n + block - 1) // block
    partial = np.zeros((blocks, k))
    for index in numba.prange(blocks):
        low = index * block
        for j in range(k):
            m = factors[j]
            high = min(low + block, n - 2 * m)
            if high > low:
                partial[index, j] = _second(x[low:high], x[low + m : high + m], x[low + 2 * m : high + 2 * m])
    return partial.sum(axis=0)


@numba.njit(cache=True, parallel=True)
def sums_hadamard(x: Floats, factors: Ints, block: int) -> Floats:
    """Sum over i of (x[i+3m] - 3 x[i+2m] + 3 x[i+m] - x[i])^2 per factor m."""
    n, k = x.shape[0], factors.shape[0]
    blocks = (n + block - 1) // block
    partial = np.zeros((blocks, k))
    for index in numba.prange(blocks):
        low = index * block
        for j in range(k):
            m = factors[j]
            high = min(low + block, n - 3 * m)
            if high > low:
                partial[index, j] = _third(
                    x[low:high], x[low + m : high + m], x[low + 2 * m : high + 2 * m], x[low + 3 * m : high + 3 * m]
                )
    return partial.sum(axis=0)


@numba.njit(cache=True, parallel=True)
def sums_with_gaps(total: Floats, count: Ints, factors: Ints, order: int, least: float) -> tuple[Floats, Ints]:
    """The same for records with missing samples.

    `total` (n+1,) running sum of the present samples, `count` (n+1,) how many are present before each grid place. A
    difference of cluster means counts where each of its clusters holds at least the share `least` of its m samples.
    Returns, per factor, the sum of squared differences of means and how many entered.
    """
    n, k = total.shape[0], factors.shape[0]
    sums = np.zeros(k)
    used = np.zeros(k, np.int64)
    for j in numba.prange(k):
        m = factors[j]
        need = max(1.0, least * m)
        for i in range(n - order * m):
            d = 0.0
            whole = True
            for c in range(order):
                a, b = i + c * m, i + (c + 1) * m
                present = count[b] - count[a]
                if present < need:
                    whole = False
                    break
                if order == 2:
                    weight = 1.0 if c == 1 else -1.0
                else:
                    weight = 1.0 if c != 1 else -2.0
                d += weight * (total[b] - total[a]) / present
            if whole:
                sums[j] += d * d
                used[j] += 1
    return sums, used
