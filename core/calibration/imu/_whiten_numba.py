"""Compiled whitening of block means under coloured noise. Plain arrays in and out; `fit` checks and documents."""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


@numba.njit(cache=True)
def whiten(
    time: Floats,
    new_run: Flags,
    new_segment: Flags,
    white: Floats,
    segment: Floats,
    columns: Floats,
    turn_on: float,
    walk: float,
    swing: float,
    taus: Floats,
    out: Floats,
    offsets: Floats,
) -> float:
    """Innovations of every column (n, c) under one Kalman filter, over their sd, into out (n, c).

    The noise: `white` (n,) variance of each mean; a constant of variance `turn_on` for each run and `segment` (n,) for
    each segment; a random walk from 0 of `walk` per second; Gauss-Markov processes of variance `swing` and times
    `taus` (m,). offsets (runs, c): each run's constant as estimated from it. Gives the log determinant.
    """
    n, c = columns.shape
    m = taus.shape[0]
    d = 3 + m
    p = np.zeros((d, d))
    x = np.zeros((d, c))
    g = np.zeros(d)
    total = 0.0
    run = -1
    for i in range(n):
        if new_run[i]:
            run += 1
            p[:] = 0.0
            x[:] = 0.0
            p[0, 0] = turn_on
            p[1, 1] = segment[i]
            for j in range(m):
                p[3 + j, 3 + j] = swing
        else:
            dt = time[i] - time[i - 1]
            p[2, 2] += walk * dt
            for j in range(m):
                phi = np.exp(-dt / taus[j])
                k = 3 + j
                for a in range(d):
                    p[k, a] *= phi
                    p[a, k] *= phi
                p[k, k] += swing * (1.0 - phi * phi)
                for b in range(c):
                    x[k, b] *= phi
            if new_segment[i]:
                for a in range(d):
                    p[1, a] = 0.0
                    p[a, 1] = 0.0
                for b in range(c):
                    x[1, b] = 0.0
                p[1, 1] = segment[i]
        s = white[i]
        for a in range(d):
            g[a] = 0.0
            for b in range(d):
                g[a] += p[a, b]
            s += g[a]
        total += np.log(s)
        root = np.sqrt(s)
        for b in range(c):
            e = columns[i, b]
            for a in range(d):
                e -= x[a, b]
            out[i, b] = e / root
            for a in range(d):
                x[a, b] += g[a] / s * e
        for a in range(d):
            for b in range(d):
                p[a, b] -= g[a] * g[b] / s
        for b in range(c):
            offsets[run, b] = x[0, b]
    return total
