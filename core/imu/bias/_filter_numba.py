"""Compiled filter and smoother of heading and gyro bias. Plain arrays in and out; `filtered` checks and documents.

State: 0 heading, 1 bias as a random walk, 2 bias as a Gauss-Markov process, 3 bias per kelvin, 4 what is left of the
true rate after a movement, dying out.
"""

from __future__ import annotations

import numba
import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

SIZE = 5
WINDOW = 4  # blocks of the window that `quiet` is told from
STOP = 3.0  # in noise of a second's angle: what each stop's beginning and end may hide
SCALES = (1, 4, 16, 64)  # blocks over which the mean of a rest is compared with the bias before it


@numba.njit(cache=True)
def _step(  # one block: predict, and where it rests, update with its mean
    x: Floats, p: Floats, still: bool, since: int, angle: float, lost: float, time: float, mean: float, noise: float,
    kelvin: float, walk: float, phi: float, drive: float, tail: float, tail_tau: float, tail_fade: float, white: float,
    gain: Floats, f: Floats, work: Floats,
) -> tuple[float, float]:  # fmt: skip
    n = SIZE
    f[:, :] = 0.0
    f[1, 1], f[2, 2], f[3, 3] = 1.0, phi, 1.0
    f[0, 0] = 1.0
    decay = np.exp(-time / tail_tau)
    if still:
        f[0, 4] = tail_tau * (1 - decay)
        f[4, 4] = decay
    else:
        f[0, 1], f[0, 2], f[0, 3] = -time, -time, -time * kelvin
    for i in range(n):
        for j in range(n):
            s = 0.0
            for k in range(n):
                s += f[i, k] * p[k, j]
            work[i, j] = s
    for i in range(n):
        for j in range(n):
            s = 0.0
            for k in range(n):
                s += work[i, k] * f[j, k]
            p[i, j] = s
    if still:
        x[0] += f[0, 4] * x[4]
        x[4] *= decay
        p[4, 4] += tail * tail * (1 - decay * decay) * np.exp(-2 * since * time / tail_fade)
    else:
        x[0] += angle - time * (x[1] + x[2] + x[3] * kelvin)
        x[4] = 0.0
        p[4, 4] = tail * tail
        p[0, 0] += white * time + lost
    x[2] *= phi
    p[1, 1] += walk * time
    p[2, 2] += drive
    gain[:] = 0.0
    if not still:
        return 0.0, 0.0
    residual = mean - (x[1] + x[2] + x[3] * kelvin + x[4])
    total = noise
    for i in range(n):
        gain[i] = p[i, 1] + p[i, 2] + p[i, 3] * kelvin + p[i, 4]
    total += gain[1] + gain[2] + gain[3] * kelvin + gain[4]
    for i in range(n):
        work[0, i] = gain[i]
        gain[i] /= total
    for i in range(n):
        x[i] += gain[i] * residual
        for j in range(n):
            p[i, j] -= gain[i] * work[0, j]
    return residual, total


@numba.njit(cache=True)
def _bias(x: Floats, p: Floats, kelvin: float) -> tuple[float, float]:
    value = x[1] + x[2] + x[3] * kelvin
    a, b, c = p[1, 1] + p[2, 1] + p[3, 1] * kelvin, p[1, 2] + p[2, 2] + p[3, 2] * kelvin, 0.0
    c = p[1, 3] + p[2, 3] + p[3, 3] * kelvin
    return value, a + b + c * kelvin


@numba.njit(cache=True)
def _too_far(  # the largest scale at which the rest's mean is not the bias before it; 0 where all agree
    k: int, first: int, mean: Floats, noise: Floats, bias: Floats, variance: Floats, time: Floats,
    walk: float, swing: float, gate: float,
) -> int:  # fmt: skip
    found = 0
    for scale in SCALES:
        if k - first + 1 < scale:
            break
        low = k - scale + 1
        total, spread, span = 0.0, 0.0, 0.0
        for i in range(low, k + 1):
            total += mean[i]
            spread += noise[i]
            span += time[i]
        off = total / scale - (bias[low - 1] if low > 0 else bias[low])
        before = variance[low - 1] if low > 0 else 1.0
        if off * off > gate * gate * (spread / (scale * scale) + before + walk * span + swing):
            found = scale
    return found


@numba.njit(cache=True)
def _off(  # whether the mean over the last window speaks against a rest's beginning here
    k: int, mean: Floats, noise: Floats, bias: Floats, variance: Floats, time: Floats, walk: float, swing: float,
    enter: float,
) -> bool:  # fmt: skip
    low = k - WINDOW + 1
    if low < 1:
        return False
    total, spread, span = 0.0, 0.0, 0.0
    for i in range(low, k + 1):
        total += mean[i]
        spread += noise[i]
        span += time[i]
    off = total / WINDOW - bias[low - 1]
    return off * off > enter * enter * (spread / (WINDOW * WINDOW) + variance[low - 1] + walk * span + swing)


@numba.njit(cache=True)
def track(
    quiet: Flags, calm: Flags, decide: bool, angle: Floats, lost: Floats, time: Floats, mean: Floats, noise: Floats,
    kelvin: Floats, setting: Floats,
) -> tuple[Flags, Floats, Floats, Floats, Floats, Floats, Floats]:  # fmt: skip
    """Forward over all blocks. `quiet` (K,): blocks that end a window of rest as far as one can say without knowing
    the bias; `calm` (K,): blocks that are so by themselves. With `decide` the filter judges the quiet ones by their
    mean, else they are taken as they are.

    setting: white [rad^2/s], walk [rad^2/s^3], phi_tau [s], swing [rad^2/s^2], tail [rad/s], tail_tau [s], gate, first
    variance of the bias, of its slope over temperature, patience [blocks], tail_fade [s], enter.

    Returns still (K,), the states at each block's end x (K, 5) and p (K, 5, 5), the updates' residual (K,) and
    variance (K,), and what was known at the time: live (K, 2) heading and its variance, live_bias (K, 2).
    """
    count, n = quiet.shape[0], SIZE
    white, walk, fade, swing, tail, tail_tau, gate = setting[:7]
    patience = int(setting[9])
    xs, ps = np.zeros((count, n)), np.zeros((count, n, n))
    residual, total = np.zeros(count), np.zeros(count)
    live, live_bias = np.zeros((count, 2)), np.zeros((count, 2))
    bias, variance = np.zeros(count), np.ones(count)
    still = np.zeros(count, np.bool_)
    gain, f, work = np.zeros(n), np.zeros((n, n)), np.zeros((n, n))
    x, p = np.zeros(n), np.zeros((n, n))
    since = np.zeros(count, np.int64)
    anew = np.zeros(count, np.bool_)  # where the bias is forgotten
    refused = 0  # quiet blocks in a row that their mean spoke against
    first, fresh = 0, True  # where the present rest began
    k, told = 0, 0
    while k < count:
        if k == 0:
            x[:], p[:, :] = 0.0, 0.0
            p[1, 1], p[2, 2], p[3, 3] = setting[7], swing, setting[8]
        else:
            x[:], p[:, :] = xs[k - 1], ps[k - 1]
        if k >= told:  # seen for the first time: judge it
            told = k + 1
            if not decide:
                still[k] = quiet[k]
            else:
                far = _too_far(k, first, mean, noise, bias, variance, time, walk, swing, gate) if quiet[k] else 0
                if not quiet[k]:
                    first, refused, fresh, back = k + 1, 0, True, 2
                elif far > 0:
                    refused += far
                    first, fresh, back = k + 1, False, far
                    anew[k] = refused >= patience
                    refused = 0 if anew[k] else refused
                elif not (k > first and still[k - 1]) and _off(
                    k, mean, noise, bias, variance, time, walk, swing, setting[11]
                ):
                    refused, back = refused + 1, 0
                    fresh = True
                else:
                    back = 0
                    still[k] = True
                    if k - first >= SCALES[-1]:
                        refused = 0
                low = k
                if back > 0:  # what came before was the movement's beginning, or its end: taken back
                    for i in range(max(0, k - back + 1), k):
                        if still[i]:
                            still[i] = False
                            low = min(low, i)
                elif fresh and still[k]:  # told from a window: the rest began inside it
                    fresh = False
                    for i in range(k - 1, max(k - WINDOW // 2, 0), -1):
                        off = mean[i] - bias[i - 1]
                        if not calm[i] or off * off > gate * gate * (noise[i] + variance[i - 1] + swing):
                            break
                        still[i] = True
                        low = i
                if low < k:
                    k = low
                    continue
        if anew[k]:
            p[1, :], p[:, 1] = 0.0, 0.0
            p[1, 1] = setting[7]
        if still[k] and k > 0 and not still[k - 1]:
            p[0, 0] += STOP * STOP * white
        since[k] = since[k - 1] + 1 if still[k] and k > 0 else 0
        phi = np.exp(-time[k] / fade)
        residual[k], total[k] = _step(
            x, p, still[k], since[k], angle[k], lost[k], time[k], mean[k], noise[k], kelvin[k],
            walk, phi, swing * (1 - phi * phi), tail, tail_tau, setting[10], white, gain, f, work,
        )  # fmt: skip
        xs[k], ps[k] = x, p
        bias[k], variance[k] = _bias(x, p, kelvin[k])
        if k == told - 1:
            live[k, 0], live[k, 1] = x[0], p[0, 0]
            live_bias[k, 0], live_bias[k, 1] = bias[k], variance[k]
        k += 1
    return still, xs, ps, residual, total, live, live_bias


@numba.njit(cache=True)
def smooth(
    still: Flags, xs: Floats, ps: Floats, residual: Floats, total: Floats, time: Floats, noise: Floats, kelvin: Floats,
    setting: Floats,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Backward over what `track` stored (modified Bryson-Frazier: no inverse). Returns heading (K, 2) and bias (K, 2)
    with variances."""
    count, n = still.shape[0], SIZE
    fade, tail_tau = setting[2], setting[5]
    heading, bias = np.zeros((count, 2)), np.zeros((count, 2))
    lam, big = np.zeros(n), np.zeros((n, n))
    h, f, a = np.zeros(n), np.zeros((n, n)), np.zeros((n, n))
    gain, px = np.zeros(n), np.zeros(n)
    for k in range(count - 1, -1, -1):
        p = ps[k]
        px = xs[k] - p @ lam
        pp = p - p @ big @ p
        heading[k, 0], heading[k, 1] = px[0], pp[0, 0]
        bias[k, 0], bias[k, 1] = _bias(px, pp, kelvin[k])
        decay = np.exp(-time[k] / tail_tau)
        if still[k]:
            h[:] = 0.0
            h[1], h[2], h[3], h[4] = 1.0, 1.0, kelvin[k], 1.0
            gain[:] = (p @ h) / noise[k]
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
        f[:, :] = 0.0
        f[0, 0], f[1, 1], f[3, 3] = 1.0, 1.0, 1.0
        f[2, 2] = np.exp(-time[k] / fade)
        if still[k]:
            f[0, 4], f[4, 4] = tail_tau * (1 - decay), decay
        else:
            f[0, 1], f[0, 2], f[0, 3] = -time[k], -time[k], -time[k] * kelvin[k]
        lam = f.T @ lam
        big = f.T @ big @ f
    return heading, bias
