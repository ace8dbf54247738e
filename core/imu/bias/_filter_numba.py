"""Compiled filter over blocks whose rests are known, and its smoother. Plain arrays; `filtered` documents.

State: 0 heading, 1 bias as a random walk, 2 bias as a Gauss-Markov process, 3 bias per kelvin, 4 what is left of the
true rate where a rest begins.
"""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

SIZE = 5


@numba.njit(cache=True)
def transition(f: Floats, rests: bool, h: float, kelvin: float, phi: float, keep: float) -> None:
    """(5, 5) matrix of a block: moving, the heading loses the bias; resting, it gains what is left."""
    f[:, :] = 0.0
    f[0, 0], f[1, 1], f[2, 2], f[3, 3] = 1.0, 1.0, phi, 1.0
    if rests:
        f[0, 4], f[4, 4] = 0.5 * h * (1 + keep), keep
    else:
        f[0, 1], f[0, 2], f[0, 3] = -h, -h, -h * kelvin


@numba.njit(cache=True)
def advance(  # one block: predict, and where it rests, update with its mean; returns the residual and its variance
    x: Floats, p: Floats, rests: bool, h: float, angle: float, lost: float, mean: float, kelvin: float,
    white: float, noise: float, walk: float, phi: float, drive: float, tail: float, fresh: float, keep: float,
) -> tuple[float, float]:  # fmt: skip
    n = SIZE
    f, work = np.zeros((n, n)), np.zeros((n, n))
    transition(f, rests, h, kelvin, phi, keep)
    if rests:
        x[0] += f[0, 4] * x[4] + h * tail
        x[4] *= keep
    else:
        x[0] += angle - h * (x[1] + x[2] + x[3] * kelvin)
        x[4] = 0.0
    x[2] *= phi
    for i in range(n):
        for j in range(n):
            for k in range(n):
                work[i, j] += f[i, k] * p[k, j]
    for i in range(n):
        for j in range(n):
            s = 0.0
            for k in range(n):
                s += work[i, k] * f[j, k]
            p[i, j] = s
    p[1, 1] += walk
    p[2, 2] += drive
    if not rests:
        p[0, 0] += white + lost
        return 0.0, 0.0
    p[4, 4] += fresh
    gain = work[0]
    for i in range(n):
        gain[i] = p[i, 1] + p[i, 2] + p[i, 3] * kelvin + p[i, 4]
    total = noise + gain[1] + gain[2] + gain[3] * kelvin + gain[4]
    residual = mean - (x[1] + x[2] + x[3] * kelvin + x[4] + tail)
    for i in range(n):
        x[i] += gain[i] / total * residual
    for i in range(n):
        for j in range(n):
            p[i, j] -= gain[i] * gain[j] / total
    return residual, total


@numba.njit(cache=True)
def bias_of(x: Floats, p: Floats, kelvin: float) -> tuple[float, float]:
    """Bias and its variance."""
    a = p[1, 1] + p[2, 1] + p[3, 1] * kelvin
    b = p[1, 2] + p[2, 2] + p[3, 2] * kelvin
    c = p[1, 3] + p[2, 3] + p[3, 3] * kelvin
    return x[1] + x[2] + x[3] * kelvin, a + b + c * kelvin


@numba.njit(cache=True)
def follow(
    rests: Flags, since: Ints, sign: Ints, anew: Flags, blocks: Floats, noise: Floats, tail: Floats, start: Floats,
    setting: Floats,
) -> tuple[Floats, Floats, Floats, Floats, Floats]:  # fmt: skip
    """Forward over blocks (K, 5) of [s], angle, lost, mean, kelvin that are known to rest, `since` so many blocks,
    after a movement of this sign; `anew` where the bias is forgotten; noise (K,) variance of a mean.

    tail (T, 2): mean and variance of what is left. start (3,): variances of bias, Gauss-Markov process and slope.
    setting: white [rad^2/s], walk [rad^2/s^3], tau [s], tail_tau [s], stop [rad^2].

    Returns x (K, 5), p (K, 5, 5), residual, its variance and what is kept of the tail (K,).
    """
    count, n = rests.shape[0], SIZE
    xs, ps = np.zeros((count, n)), np.zeros((count, n, n))
    residual, total, kept = np.zeros(count), np.zeros(count), np.zeros(count)
    x, p = np.zeros(n), np.zeros((n, n))
    p[1, 1], p[2, 2], p[3, 3] = start
    white, walk, tau, tail_tau, stop = setting
    for k in range(count):
        h = blocks[k, 0]
        if anew[k]:
            p[1, :], p[:, 1] = 0.0, 0.0
            p[1, 1] = start[0]
            x[1] = blocks[k, 3] - x[2] - x[3] * blocks[k, 4]
        phi, decay = np.exp(-h / tau), np.exp(-h / tail_tau)
        left, fresh, keep = 0.0, 0.0, 0.0
        if rests[k]:
            i = since[k]
            if i == 0:
                p[0, 0] += stop
            if i < tail.shape[0]:
                left, fresh = sign[k] * tail[i, 0], tail[i, 1]
            if i > 0:
                fresh *= 1 - decay * decay
                keep = decay
                if i < tail.shape[0]:
                    keep *= np.sqrt(tail[i, 1] / tail[i - 1, 1]) if tail[i - 1, 1] > 0 else 0.0
        kept[k] = keep
        residual[k], total[k] = advance(
            x, p, rests[k], h, blocks[k, 1], blocks[k, 2], blocks[k, 3], blocks[k, 4], white * h, noise[k],
            walk * h, phi, start[1] * (1 - phi * phi), left, fresh, keep,
        )  # fmt: skip
        xs[k], ps[k] = x, p
    return xs, ps, residual, total, kept


@numba.njit(cache=True)
def smooth(
    rests: Flags, xs: Floats, ps: Floats, residual: Floats, total: Floats, kept: Floats, blocks: Floats, noise: Floats,
    setting: Floats,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Backward over what `follow` stored (modified Bryson-Frazier: no inverse). Returns heading (K, 2) and bias (K, 2)
    with variances."""
    count, n = rests.shape[0], SIZE
    heading, bias = np.zeros((count, 2)), np.zeros((count, 2))
    lam, big = np.zeros(n), np.zeros((n, n))
    h, f, a = np.zeros(n), np.zeros((n, n)), np.zeros((n, n))
    for k in range(count - 1, -1, -1):
        p = ps[k]
        x = xs[k] - p @ lam
        pp = p - p @ big @ p
        heading[k, 0], heading[k, 1] = x[0], pp[0, 0]
        bias[k, 0], bias[k, 1] = bias_of(x, pp, blocks[k, 4])
        if rests[k]:
            h[:] = 0.0
            h[1], h[2], h[3], h[4] = 1.0, 1.0, blocks[k, 4], 1.0
            gain = (p @ h) / noise[k]
            a[:, :] = 0.0
            for i in range(n):
                a[i, i] = 1.0
                for j in range(n):
                    a[i, j] -= gain[i] * h[j]
            lam = a.T @ lam - h * (residual[k] / total[k])
            big = a.T @ big @ a
            for i in range(n):
                for j in range(n):
                    big[i, j] += h[i] * h[j] / total[k]
        transition(f, rests[k], blocks[k, 0], blocks[k, 4], np.exp(-blocks[k, 0] / setting[2]), kept[k])
        lam = f.T @ lam
        big = f.T @ big @ f
    return heading, bias
