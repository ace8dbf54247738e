"""Compiled likelihood of bias noise. Plain arrays in and out; `drift` checks and documents."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

CLIP = 4.0  # deviations; what lies beyond (a creep, a knock) counts as this


@numba.njit(cache=True)
def cost(
    mean: Floats, noise: Floats, gap: Floats, kelvin: Floats, walk: float, swing: float, tau: float, slope: float
) -> float:
    """-2 log likelihood of means at rest under white noise, random walk, a Gauss-Markov process and a slope over
    temperature."""
    x = np.zeros(3)
    p = np.zeros((3, 3))
    x[0] = mean[0]
    p[0, 0], p[1, 1], p[2, 2] = noise[0], swing, slope
    total = 0.0
    h, g = np.ones(3), np.zeros(3)
    for k in range(1, mean.shape[0]):
        phi = np.exp(-gap[k] / tau)
        x[1] *= phi
        for i in range(3):
            p[1, i] *= phi
            p[i, 1] *= phi
        p[0, 0] += walk * gap[k]
        p[1, 1] += swing * (1 - phi * phi)
        h[2] = kelvin[k]
        s = noise[k]
        for i in range(3):
            g[i] = p[i, 0] + p[i, 1] + p[i, 2] * h[2]
        s += g[0] + g[1] + g[2] * h[2]
        y = mean[k] - x[0] - x[1] - x[2] * h[2]
        z = y / np.sqrt(s)
        weight = 1.0
        if abs(z) > CLIP:
            weight = CLIP / abs(z)
            z = CLIP
        total += np.log(s) + z * z
        for i in range(3):
            x[i] += g[i] / s * y * weight
        for i in range(3):
            for j in range(3):
                p[i, j] -= g[i] * g[j] / s
    return total
