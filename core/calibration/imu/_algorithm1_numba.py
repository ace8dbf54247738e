"""Compiled Algorithm 1 (Kolhoff & Kemper 2021). Plain arrays in and out; `algorithm1` checks and documents."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

AXES = 6


@numba.njit(cache=True)
def advance(
    readings: Floats,
    dt: Floats,
    static: Floats,
    drift: Floats,
    rate: Floats,
    inverse: Floats,
    g: Floats,
    ring: Floats,
    count: Ints,
    out: Floats,
) -> None:
    """Rows of `readings` (n, 6) with the time dt (n,) since the row before, into out (n, 6).

    g (6,), ring (window, 6) and count (6,) are the state and are changed. inverse (2, 3, 3): accelerometer, gyro.
    """
    window = ring.shape[0]
    mean = np.empty(AXES)
    for i in range(readings.shape[0]):
        for j in range(AXES):
            # Euler's step of g' = -g / Tc; over a pause longer than Tc it would swing below zero.
            g[j] *= max(0.0, 1.0 - dt[i] * rate[j])
            value = readings[i, j]
            if np.isfinite(value):
                ring[count[j] % window, j] = value - drift[j] * (1.0 - g[j]) - static[j]
                count[j] += 1
            held = min(count[j], window)
            if held == 0:
                mean[j] = np.nan
                continue
            total = 0.0
            for k in range(held):
                total += ring[k, j]
            mean[j] = total / held
        for s in range(2):
            for a in range(3):
                value = 0.0
                for b in range(3):
                    factor = inverse[s, a, b]
                    if factor != 0.0:
                        value += factor * mean[3 * s + b]
                out[i, 3 * s + a] = value
