"""Compiled filter of heading and gyro bias, a step per block, looking back only. Plain arrays; `filtered` documents.

State x: 0 heading, 1 bias as a random walk, 2 bias as a Gauss-Markov process, 3 bias per kelvin, 4 what is left of the
true rate where a rest begins. One `step` takes one block of readings (`features` makes it of them):

    learn    the block that leaves the ring is settled: if it rests, noise levels, tail and drift learn from it
    judge    does the block rest, and do the last blocks have to be relabelled?
    rewind   if so, back to the state before the first of them (kept in the ring)
    advance  per block. Moving: heading += angle - h bias, r = 0, variance += N^2 h. Resting: heading += h r, r dies
             out, and the block's mean measures bias + r with variance R

Memory is the ring of RING blocks with the state before each, whatever the length of the run. No function beyond sqrt
and exp is called. For float32: angles in degrees keep the covariance far from its smallest numbers.
"""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any

import numba
import numpy as np
import numpy.typing as npt

from core.imu.bias._filter_numba import advance, bias_of
from core.imu.bias._learn_numba import (
    ANGLE,
    AT,
    AXES,
    BEGAN,
    CLIP,
    CLIPPED,
    COUNT,
    ENTER,
    EVEN,
    FAR,
    FAST,
    FIRST,
    FRESH,
    GATE,
    HELD,
    KELVIN,
    LENGTH,
    LOST,
    MEAN,
    MOVES,
    NOISE,
    NOTHING,
    OTHERS,
    PATIENCE,
    PLAIN,
    RAW,
    READING,
    REFUSED,
    RING,
    SCALES,
    SHOWN,
    SPREAD,
    STEADY,
    STOP,
    SWING,
    TABLE,
    TAIL_TAU,
    TAU,
    TIME,
    VETOED,
    WALK,
    WHITE,
    WINDOW,
    State,
    learn,
    raise_level,
    set_level,
)

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]


@numba.njit(cache=False)
def features(x: npt.NDArray[np.floating], low: int, high: int, reading: float, out: Floats) -> None:
    """COUNT, RAW, PLAIN, MEAN and CLIPPED of readings x[low:high] into `out`; clipped at CLIP deviations of a
    `reading`'s variance at rest (0: not known, not clipped)."""
    n = high - low
    out[COUNT], out[RAW], out[PLAIN], out[MEAN], out[CLIPPED] = n, 0.0, 0.0, 0.0, 0.0
    if n < 2:
        out[COUNT] = 0.0
        return
    origin = float(x[low])
    first, second = 0.0, 0.0
    for j in range(low, high):
        d = float(x[j]) - origin
        first += d
        second += d * d
    shift = first / n
    out[RAW] = origin + shift
    out[PLAIN] = max(0.0, second - n * shift * shift) / (n - 1)
    out[MEAN], out[CLIPPED] = out[RAW], out[PLAIN]
    if reading > 0:
        reach = CLIP * np.sqrt(reading)
        middle = out[RAW]
        first, second = 0.0, 0.0
        for j in range(low, high):
            d = min(max(float(x[j]) - middle, -reach), reach)
            first += d
            second += d * d
        shift = first / n
        out[MEAN] = middle + shift
        out[CLIPPED] = max(0.0, second - n * shift * shift) / (n - 1)


@numba.njit(cache=False)
def step(s: State, c: Floats, block: Floats) -> int:
    """Take one block (WIDTH,) in. Returns from which block on labels changed (mostly this one's number)."""
    k = s.n[AT]
    slot = k % RING
    if k >= RING:
        learn(s, c, slot)
    s.block[slot] = block
    s.mark[slot, 0], s.mark[slot, 2] = 0, 0
    set_level(s, c, k)
    low = _judge(s, c, k)
    if low < k:
        s.x[:] = s.x_before[low % RING]
        s.p[:, :] = s.p_before[low % RING]
    for i in range(low, k + 1):
        _advance(s, c, i)
    s.n[AT] = k + 1
    return low


@numba.njit(cache=False)
def known(s: State, c: Floats, out: Floats) -> None:
    """What is known after the last block, into out (7,): heading, its variance, bias, its variance, rests, variance
    of a reading as its mean in rest shows it, variance of flicker that is too fast for rests to show."""
    slot = (s.n[AT] - 1) % RING
    out[0], out[1] = s.x[0], s.p[0, 0]
    out[2], out[3] = s.bias[slot]
    out[4] = s.mark[slot, 0]
    out[5] = s.level[NOISE] * s.level[HELD]
    white = s.level[WHITE] * c[LENGTH]
    out[6] = FAST * FAST * s.level[SWING] / (1 + SHOWN * s.level[SWING] / white) if white > 0 else 0.0


@numba.njit(cache=False)
def _judge(s: State, c: Floats, k: int) -> int:
    """Label the block k, and the last ones anew where it tells that they were wrong. Returns the first changed."""
    slot = k % RING
    if s.block[slot, COUNT] < 2:  # nothing was heard: it goes on as it was
        s.mark[slot, 0] = s.mark[(k - 1) % RING, 0] if k > 0 else 0
        return k
    last = (k - 1) % RING
    resting = k > 0 and s.mark[last, 0] == 1
    quiet = _quiet(s, k, resting)
    if resting and not quiet and _thin(s, k):  # just after a pause: the window says nothing
        quiet = _agrees(s, k, c[ENTER])
    far = _too_far(s, c, k) if quiet else 0
    back, n = 0, s.n
    if not quiet:
        n[BEGAN], n[REFUSED], n[FRESH] = k + 1, 0, 1
        back = _onset(s, k) if resting else 0
    elif far > 0:
        n[REFUSED] += far
        n[BEGAN], n[FRESH], back = k + 1, 0, far
        if n[REFUSED] >= c[PATIENCE]:
            s.mark[slot, 2] = 1
            n[REFUSED] = 0
    elif not resting and _off(s, c, k):
        n[REFUSED] += 1
        n[FRESH] = 1
    else:
        s.mark[slot, 0] = 1
        n[VETOED], s.quietest[0] = 0, 0.0
        if k - n[BEGAN] >= SCALES[-1]:
            n[REFUSED] = 0
    if s.mark[slot, 0] == 0:
        raise_level(s, c, k, _scatter(s, k, 3 * WINDOW))
    low = k
    oldest = max(0, k - RING + 1)
    if back > 0:  # what came before was the movement's beginning, or its end
        for i in range(max(oldest, k - back + 1), k):
            if s.mark[i % RING, 0] == 1:
                s.mark[i % RING, 0] = 0
                low = min(low, i)
    elif n[FRESH] == 1 and s.mark[slot, 0] == 1:  # told from a window: the rest began inside it
        n[FRESH] = 0
        # Little of it: what creeps in here is lost, and bends the bias as well. At the very start all of it.
        back = WINDOW if k < WINDOW else WINDOW // 2
        for i in range(k - 1, max(k - back, oldest - 1), -1):
            if not _agrees(s, i, 1.5):
                break
            s.mark[i % RING, 0] = 1
            low = i
    return low


@numba.njit(cache=False)
def _agrees(s: State, i: int, most: float) -> bool:  # one block's mean with the bias before it, in deviations
    b, old = s.block[i % RING], s.bias[(i - 1) % RING]
    off = b[MEAN] - old[0]
    calm = b[CLIPPED] < s.level[READING] * (1 + FAR * s.level[SPREAD])
    spread = s.level[NOISE] * s.level[HELD] / max(b[COUNT], 1.0) + old[1] + s.level[SWING]
    return calm and b[MOVES] == 0 and b[COUNT] > 0 and (i == 0 or off * off < most * most * spread)


@numba.njit(cache=False)
def _onset(s: State, k: int) -> int:  # how many blocks of the movement that shows in block k lie before it, and one
    b = s.block[k % RING]
    sign = 1.0 if b[RAW] > s.bias[(k - 1) % RING, 0] else -1.0
    back = 2
    for i in range(k - 2, max(k - 6, k - RING + 1, 0), -1):
        off = sign * (s.block[i % RING, MEAN] - s.bias[(i - 1) % RING, 0])
        if off < 1.5 * np.sqrt(s.level[NOISE]):
            break
        back = k - i + 1
    return back


@numba.njit(cache=False)
def _quiet(s: State, k: int, resting: bool) -> bool:
    """Whether block k ends a window of rest as far as one can say without the bias."""
    b, level = s.block[k % RING], s.level
    if level[READING] <= 0 or b[COUNT] < min(4.0, level[HELD] / 2) or b[MOVES] != 0:
        return False
    for a in range(AXES):
        if b[OTHERS + a] > s.others[a] * (1 + 2 * FAR * max(level[SPREAD], 0.1)):
            return False
    # One noisy block by itself is an outlier's or a knock's: it ends no rest.
    loud = 0
    for i in range(max(0, k - WINDOW + 1 if resting else k), k + 1):
        loud += 1 if s.block[i % RING, CLIPPED] > level[READING] * (1 + FAR * level[SPREAD]) else 0
    if loud <= (1 if resting else 0) and _scatter(s, k, WINDOW) < EVEN * level[NOISE]:
        return True
    # Or it shakes in rest, but less than in movement.
    return b[PLAIN] < 0.5 * s.driving[0] and _scatter(s, k, 3 * WINDOW) < STEADY * level[NOISE]


@numba.njit(cache=False)
def _thin(s: State, k: int) -> bool:  # whether half of the last window was not heard
    n = 0
    for i in range(max(0, k - WINDOW + 1), k):
        n += 1 if s.block[i % RING, COUNT] < 2 else 0
    return 2 * n >= WINDOW


@numba.njit(cache=False)
def _scatter(s: State, k: int, window: int) -> float:  # sum of squares of the last blocks' means about their mean
    if k - window + 1 < 0:
        return 1e30
    origin = s.block[k % RING, MEAN]
    one, two, n = 0.0, 0.0, 0
    for i in range(k - window + 1, k + 1):
        b = s.block[i % RING]
        if b[COUNT] < 2:
            continue
        d = b[MEAN] - origin
        one += d
        two += d * d
        n += 1
    if 2 * n <= window:
        return 1e30
    return max(two - one * one / n, 0.0) * (window - 1) / (n - 1)


@numba.njit(cache=False)
def _apart(s: State, k: int, scale: int) -> tuple[float, float]:
    """Mean of the last `scale` blocks less the bias before them, and the variance of that in rest."""
    low = k - scale + 1
    total, held, span = 0.0, 0.0, 0.0
    for i in range(low, k + 1):
        b = s.block[i % RING]
        total += b[MEAN] * b[COUNT]
        held += b[COUNT]
        span += b[TIME]
    old = s.bias[(low - 1) % RING]
    noise = s.level[NOISE] * s.level[HELD] / held
    return total / held - old[0], noise + old[1] + s.level[WALK] * span + s.level[SWING]


@numba.njit(cache=False)
def _too_far(s: State, c: Floats, k: int) -> int:
    """The largest scale at which the rest's mean is not the bias before it; 0 where all agree."""
    found = 0
    for scale in SCALES:
        if k - s.n[BEGAN] + 1 < scale or k - scale < max(0, k - RING + 1):
            break
        off, spread = _apart(s, k, scale)
        if off * off > c[GATE] * c[GATE] * spread:
            found = scale
    return found


@numba.njit(cache=False)
def _off(s: State, c: Floats, k: int) -> bool:  # whether the last window's mean speaks against a rest's beginning here
    if k < WINDOW:
        return False
    off, spread = _apart(s, k, WINDOW)
    return off * off > c[ENTER] * c[ENTER] * spread


@numba.njit(cache=False)
def _advance(s: State, c: Floats, k: int) -> None:
    """Filter over block k by its label."""
    slot, last = k % RING, (k - 1) % RING
    b, x, p = s.block[slot], s.x, s.p
    s.x_before[slot] = x
    s.p_before[slot] = p
    if s.mark[slot, 2] == 1:  # the bias is elsewhere now
        p[1, :], p[:, 1] = 0.0, 0.0
        p[1, 1] = c[FIRST]
        x[1] = b[MEAN] - x[2] - x[3] * b[KELVIN]
    h, white = b[TIME], s.level[WHITE] * c[LENGTH]
    rests = s.mark[slot, 0] == 1
    before = k > 0 and s.mark[last, 0] == 1
    since = s.mark[last, 1] + 1 if before else 0
    sign = s.mark[last, 3] if k > 0 else 0
    if not rests:
        since = 0
        off = b[RAW] - x[1] - x[2] - x[3] * b[KELVIN]
        if off * off > 9 * s.level[NOISE]:
            sign = 1 if off > 0 else -1
    s.mark[slot, 1], s.mark[slot, 3] = since, sign
    phi = np.exp(-h / c[TAU])
    noise = s.level[NOISE] * s.level[HELD] / b[COUNT] if b[COUNT] >= 2 else NOTHING
    left, fresh, keep = 0.0, 0.0, 0.0
    if rests:
        if since == 0:
            p[0, 0] += c[STOP] * c[STOP] * white
            if k > 0 and s.block[last, COUNT] < 2:  # the movement ended unheard
                x[0] += b[ANGLE] - h * (x[1] + x[2] + x[3] * b[KELVIN])
                p[0, 0] += b[LOST] + white * h
        left, fresh, keep = _left(s, since, np.exp(-h / c[TAIL_TAU]))
    advance(
        x, p, rests, h, b[ANGLE], b[LOST], b[MEAN], b[KELVIN], white * h, noise, s.level[WALK] * h, phi,
        s.level[SWING] * (1 - phi * phi), sign * left, fresh, keep,
    )  # fmt: skip
    s.bias[slot, 0], s.bias[slot, 1] = bias_of(x, p, b[KELVIN])


@numba.njit(cache=False)
def _left(s: State, since: int, decay: float) -> tuple[float, float, float]:
    """Of the tail after `since` blocks: its mean, the variance that comes new, and what is kept of it."""
    if since >= TABLE:
        return 0.0, 0.0, decay
    now = s.tail[since, 1]
    if since == 0:
        return s.tail[0, 0], now, 0.0
    past = s.tail[since - 1, 1]
    return s.tail[since, 0], now * (1 - decay * decay), decay * np.sqrt(now / past) if past > 0 else 0.0


def _entry_point(digest: int) -> Any:
    """What Python calls. The cache on disk notices changes of this file, not of those that it calls: so it closes over
    a digest of those, and alone is cached."""

    @numba.njit(cache=True)
    def run(
        s: State, c: Floats, x: npt.NDArray[np.floating], start: Ints, given: Floats
    ) -> tuple[Floats, Ints, Floats]:
        """Blocks x[start[i]:start[i+1]] with `given` (K, WIDTH), whose columns of `features` are filled here. All of a
        record, or a block or two as they come: the state `s` goes on.

        Returns what was known at each block's end (K, 7, as `known`); the marks (K, 4) as they stand after the last of
        these blocks; the blocks' clipped means (K,).
        """
        count = start.shape[0] - 1 if digest else 0
        live, marks, mean = np.zeros((count, 7)), np.zeros((count, 4), np.int64), np.zeros(count)
        first = s.n[AT]
        for k in range(count):
            block = given[k]
            features(x, start[k], start[k + 1], s.level[READING], block)
            low = step(s, c, block)
            known(s, c, live[k])
            for i in range(max(low, first), first + k + 1):
                marks[i - first] = s.mark[i % RING]
            mean[k] = block[MEAN]
        return live, marks, mean

    return run


run = _entry_point(
    zlib.crc32(b"".join(Path(__file__).with_name(n).read_bytes() for n in ("_filter_numba.py", "_learn_numba.py"))) | 1
)
