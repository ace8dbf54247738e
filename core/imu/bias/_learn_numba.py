"""Compiled learning of the bias filter: levels of noise, what is left of a movement, drift. Plain arrays; `_best_numba`
documents the filter that this is a part of, and this file holds its state and constants."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from core.imu.bias._filter_numba import SIZE

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

RING = 80  # blocks that may still be relabelled
WINDOW = 4  # blocks in which a rest is recognised
SCALES = (1, 4, 16, 64)  # blocks over which a rest's mean is compared with the bias before it
EVEN = 25.9  # chi-square of WINDOW - 1 degrees of freedom at 1e-5
STEADY = 24.7  # chi-square of 3 WINDOW - 1 at 1e-2
FAR = 5.0  # relative deviations of a block's variance that speak against rest
NOTHING = 1e30  # variance of what was not heard
QUIETER = 5.0  # deviations by which blocks must be quieter than what passed for rest
CLIP = 3.0  # deviations beyond which a reading counts as this

# A block: [s], [rad], [rad^2] hidden by a gap, readings, clipped mean [rad/s], its readings' clipped and plain
# variance, plain mean, [K], whether another sensor says that the body moves, and the other axes' variances.
TIME, ANGLE, LOST, COUNT, MEAN, CLIPPED, PLAIN, RAW, KELVIN, MOVES, OTHERS = range(11)
AXES = 5
WIDTH = OTHERS + AXES

# Settings
GATE, ENTER, PATIENCE, FIRST, SLOPE, TAIL, TAU, TAIL_TAU, STOP, GIVEN, N2, K2, SD2, LENGTH = range(14)
SETTINGS = 14

# Levels learnt: variance of a reading at rest, relative spread of a block's variance, variance of a block's mean of
# clipped and of plain readings, readings per block, blocks learnt from, K^2 and Gauss-Markov variance in use.
READING, SPREAD, NOISE, WHITE, HELD, LEARNT, WALK, SWING = range(8)

EDGES = (0, 2, 5, 12, 25, 50)  # blocks since a rest began, of the bins that the tail is learnt in
TABLE = 50
DOUBT = 3.0  # times its own variance that the tail's mean must exceed, squared
TAIL_PRIOR = 6.0  # stops that the prior of the tail counts for

# Counters
AT, BEGAN, FRESH, REFUSED, VETOED, OLD, OLD_SINCE, OLD_SIGN, GROUPED = range(9)

BANK_K = (1 / 3000, 1 / 800, 1 / 200, 1 / 50)  # candidates of K over N
BANK_K_PRIOR = (0.1, 0.4, 0.4, 0.1)
BANK_SD = (1 / 60, 1 / 20, 1 / 7, 1 / 2.5, 1 / 1.4)  # candidates of the Gauss-Markov deviation over N
BANK_SD_PRIOR = (0.1, 0.4, 0.35, 0.1, 0.05)
SDS = len(BANK_SD)
USUAL_TAU = 100.0  # s, of the Gauss-Markov process
GROUP = 10  # blocks of a mean that the drift is learnt from
FAST = 0.85  # of the Gauss-Markov deviation: flicker too fast for rests to show, yet part of the bias
SHOWN = 6.0  # s: where flicker stands out from the white noise of a mean over so long, rests show more of it


class State(NamedTuple):
    """All that a step needs of the past."""

    x: Floats  # (5,)
    p: Floats  # (5, 5)
    block: Floats  # (RING, WIDTH)
    x_before: Floats  # (RING, 5)
    p_before: Floats  # (RING, 5, 5)
    mark: Ints  # (RING, 4): rests, blocks since the rest began, bias forgotten here, sign of the movement before
    bias: Floats  # (RING, 2) bias after the block and its variance
    level: Floats  # (8,)
    others: Floats  # (AXES,) variance of the other axes at rest
    quietest: Floats  # (2 + AXES,) variance, readings and other axes of the steadiest block since the last rest
    driving: Floats  # (1,) lower quartile of a block's variance in movement
    tail: Floats  # (TABLE, 2) mean (signed by the movement) and variance of what is left, by blocks since a rest began
    bins: Floats  # (5, 7) of the tail: sum, count of this rest; mean, variance, rests, variance of one, mean in use
    start: Floats  # (2,) bias and variance before the rest that is being learnt from
    bank: Floats  # (20, 7) drift candidates: weight, b, f, three variances, spare
    last: Floats  # (3,) clipped and plain mean of the block that was learnt from last, spare
    group: Floats  # (4,) sum of means, of variances, count, time since the last group
    n: Ints  # (9,) counters


def new_state(setting: Floats) -> State:
    """The state before the first block."""
    p = np.zeros((SIZE, SIZE))
    p[1, 1], p[2, 2], p[3, 3] = setting[FIRST], setting[SD2], setting[SLOPE]
    bank = np.zeros((len(BANK_K) * len(BANK_SD), 7))
    bank[:, 0] = np.outer(BANK_K_PRIOR, BANK_SD_PRIOR).ravel()
    level = np.zeros(8)
    level[WALK], level[SWING] = setting[K2], setting[SD2]
    return State(
        np.zeros(SIZE),
        p,
        np.zeros((RING, WIDTH)),
        np.zeros((RING, SIZE)),
        np.zeros((RING, SIZE, SIZE)),
        np.zeros((RING, 4), np.int64),
        np.zeros((RING, 2)),
        level,
        np.zeros(AXES),
        np.zeros(2 + AXES),
        np.zeros(1),
        np.zeros((TABLE, 2)),
        np.zeros((len(EDGES) - 1, 7)),
        np.zeros(2),
        bank,
        np.zeros(3),
        np.zeros(4),
        np.zeros(9, np.int64),
    )


@numba.njit(cache=False)
def set_level(s: State, c: Floats, k: int) -> None:
    """The first level of noise, or a new one where WINDOW blocks in a row are far quieter than what passed for rest."""
    if k < WINDOW - 1:
        return
    most, total, plain, held = 0.0, 0.0, 0.0, 0.0
    for i in range(k - WINDOW + 1, k + 1):
        b = s.block[i % RING]
        if b[COUNT] < 2:
            return
        most = max(most, b[CLIPPED])
        total += b[CLIPPED] / WINDOW
        plain += b[PLAIN] / WINDOW
        held += b[COUNT] / WINDOW
    # QUIETER deviations of a chi-square (Wilson & Hilferty) of as many degrees of freedom as the window holds.
    below = max(1 - QUIETER * np.sqrt(2 / (9 * WINDOW * (held - 1))), 0.0) ** 3
    if total > 0 and (s.level[READING] <= 0 or most < s.level[READING] * below):
        _begin(s, c, k, total, plain, held)


@numba.njit(cache=False)
def raise_level(s: State, c: Floats, k: int, scatter: float) -> None:
    """A higher level where for long nothing has passed for rest: that of the steadiest blocks since, if their means
    (`scatter` over 3 WINDOW of them) scatter no more than their own noise says."""
    s.n[VETOED] += 1
    b, q = s.block[k % RING], s.quietest
    if b[COUNT] >= 2 and b[PLAIN] > 0 and scatter < STEADY * b[PLAIN] / b[COUNT] and (q[0] <= 0 or b[PLAIN] < q[0]):
        q[0], q[1] = b[PLAIN], b[COUNT]
        q[2:] = b[OTHERS:]
    if s.n[VETOED] >= c[PATIENCE] * (1 if s.level[LEARNT] == 0 else 4):
        s.n[VETOED] = 0
        if q[0] > 0:
            _begin(s, c, k, q[0], q[0], q[1])
            s.others[:] = q[2:]
        q[0] = 0.0


@numba.njit(cache=False)
def _begin(s: State, c: Floats, k: int, reading: float, plain: float, held: float) -> None:
    s.level[READING], s.level[SPREAD] = reading, np.sqrt(2 / (held - 1))
    s.level[NOISE], s.level[WHITE] = reading / held, plain / held
    s.level[HELD], s.level[LEARNT] = held, 0.0
    for a in range(AXES):
        s.others[a] = 0.0
        for i in range(max(0, k - WINDOW + 1), k + 1):
            s.others[a] += s.block[i % RING, OTHERS + a] / WINDOW
    _scale(s, c)


@numba.njit(cache=False)
def _scale(s: State, c: Floats) -> None:
    """What goes with the white noise: drift and tail begin as usual for a gyro of this noise."""
    h = c[LENGTH]
    white = c[N2] if c[GIVEN] > 0 else s.level[WHITE] * h
    if c[GIVEN] <= 0:
        s.level[WALK], s.level[SWING] = _drift(s, white)
        s.p[2, 2] = max(s.p[2, 2], s.level[SWING])
    for i in range(s.bins.shape[0]):
        middle = (EDGES[i] + EDGES[i + 1]) / 2 * h
        s.bins[i, 2], s.bins[i, 4], s.bins[i, 5] = 0.0, 0.0, 0.0
        s.bins[i, 3] = c[TAIL] * c[TAIL] * white * np.exp(-2 * middle / 5)
    _tabulate(s)


@numba.njit(cache=False)
def _tabulate(s: State) -> None:
    """The tail by blocks since the rest began: straight lines between the bins' middles, never rising."""
    m = s.bins.shape[0]
    for i in range(m):  # a mean that may as well be chance would turn every rest the same way
        q = s.bins[i]
        chance = DOUBT * q[5] / (q[4] + 1)
        q[6] = q[2] * (1 - chance / (q[2] * q[2])) if q[2] * q[2] > chance else 0.0
    # Of the first blocks only those were taken for rest whose noise hid the creep: it is told from the next two bins.
    if s.bins[1, 6] * s.bins[2, 6] > 0:
        s.bins[0, 6] = s.bins[1, 6] * np.sqrt(max(s.bins[1, 6] / s.bins[2, 6], 1.0))
    for k in range(TABLE):
        at = k + 0.5
        i = 0
        while i < m - 2 and at > (EDGES[i + 1] + EDGES[i + 2]) / 2:
            i += 1
        left, right = (EDGES[i] + EDGES[i + 1]) / 2, (EDGES[i + 1] + EDGES[i + 2]) / 2
        u = min(max((at - left) / (right - left), 0.0), 1.0)
        s.tail[k, 0] = (1 - u) * s.bins[i, 6] + u * s.bins[i + 1, 6]
        # What of the mean is not used counts as variance.
        near, far = s.bins[i, 2] - s.bins[i, 6], s.bins[i + 1, 2] - s.bins[i + 1, 6]
        s.tail[k, 1] = max((1 - u) * (s.bins[i, 3] + near * near) + u * (s.bins[i + 1, 3] + far * far), 0.0)
    # Early on a rest shows too little: what stood out was not taken for one.
    for k in range(TABLE - 2, -1, -1):
        s.tail[k, 1] = max(s.tail[k, 1], s.tail[k + 1, 1])


@numba.njit(cache=False)
def learn(s: State, c: Floats, slot: int) -> None:
    """From the block that leaves the ring: its label stands."""
    n, level = s.n, s.level
    b = s.block[slot]
    rests = s.mark[slot, 0] == 1
    if rests and b[COUNT] >= 2:
        _learn_levels(s, b)
        since = s.mark[slot, 1]
        if since == 0 or n[OLD] == 0:
            s.bins[:, 0], s.bins[:, 1] = 0.0, 0.0
        if since <= TABLE:
            _learn_tail(s, b, since)
            if since == TABLE:
                _end_of_rest(s, TABLE + 5, c[LENGTH])
        if c[GIVEN] <= 0:
            _learn_drift(s, c, b, since, s.mark[slot, 3])
    elif not rests:
        if n[OLD] == 1 and n[OLD_SINCE] < TABLE:
            _end_of_rest(s, n[OLD_SINCE], c[LENGTH])
        s.group[3] += b[TIME]
        s.group[0], s.group[1], s.group[2] = 0.0, 0.0, 0.0
        s.start[0], s.start[1] = s.bias[slot]
        if s.driving[0] <= 0:
            s.driving[0] = b[PLAIN]
        s.driving[0] *= 1.0025 if b[PLAIN] > s.driving[0] else 0.9925
    if b[COUNT] < 2:
        return
    n[OLD], n[OLD_SINCE], n[OLD_SIGN] = s.mark[slot, 0], s.mark[slot, 1], s.mark[slot, 3]
    s.last[0], s.last[1], s.last[2] = b[MEAN], b[RAW], level[READING]


@numba.njit(cache=False)
def _learn_levels(s: State, b: Floats) -> None:
    level = s.level
    level[LEARNT] += 1
    share = 1 / min(level[LEARNT] + 10, 1500.0)
    off = b[CLIPPED] / level[READING] - 1
    level[SPREAD] += share * (1.25 * min(abs(off), 4 * level[SPREAD]) - level[SPREAD])
    level[SPREAD] = min(max(level[SPREAD], 0.7 * np.sqrt(2 / max(level[HELD] - 1, 1.0))), 0.8)
    level[READING] *= 1 + share * min(off, 3.0)
    level[HELD] += share * (b[COUNT] - level[HELD])
    for a in range(AXES):
        s.others[a] += share * (b[OTHERS + a] - s.others[a])
    if s.n[OLD] == 1:
        d = b[MEAN] - s.last[0]
        level[NOISE] += share * (min(d * d / 2, 8 * level[NOISE]) - level[NOISE])
        d = b[RAW] - s.last[1]
        level[WHITE] += share * (min(d * d / 2, 25 * level[WHITE]) - level[WHITE])  # outliers turn the heading too


@numba.njit(cache=False)
def _learn_tail(s: State, b: Floats, since: int) -> None:
    for i in range(s.bins.shape[0]):
        if EDGES[i] <= since < EDGES[i + 1]:
            s.bins[i, 0] += b[MEAN] - s.start[0]
            s.bins[i, 1] += 1


@numba.njit(cache=False)
def _end_of_rest(s: State, length: int, h: float) -> None:
    """What was left in the bins that this rest filled."""
    white = s.level[WHITE] * h
    for i in range(s.bins.shape[0]):
        m = s.bins[i, 1]
        if m < EDGES[i + 1] - EDGES[i] or EDGES[i + 1] + 4 > length or s.n[OLD_SIGN] == 0:
            continue
        e = s.n[OLD_SIGN] * s.bins[i, 0] / m
        known = s.level[NOISE] / m + s.start[1]
        if s.start[1] > s.level[NOISE]:
            continue
        q = s.bins[i]
        q[4] += 1
        d = e - q[2]
        most = 16 * (known + max(q[3], 0.0))
        # The mean's prior: 0 within 0.7 N, less where the rest has lasted.
        usual = 0.5 * white * np.exp(-(EDGES[i] + EDGES[i + 1]) / 8 * h) + 1e-3 * known
        q[2] += min(max(d, -np.sqrt(most)), np.sqrt(most)) / min(q[4] + known / usual, 1000.0)
        q[3] += (min(d * d, most) - known - q[3]) / min(q[4] + TAIL_PRIOR, 400.0)
        q[5] += (known + max(q[3], 0.0) - q[5]) / min(q[4], 400.0)
    _tabulate(s)


@numba.njit(cache=False)
def _learn_drift(s: State, c: Floats, b: Floats, since: int, sign: int) -> None:
    """Means over GROUP blocks weigh the candidates by their likelihood."""
    g = s.group
    tail = s.tail[since, 1] if since < TABLE else 0.0
    left = sign * s.tail[since, 0] if since < TABLE else 0.0
    g[0] += b[MEAN] - s.x[3] * b[KELVIN] - left
    g[1] += s.level[NOISE]
    g[2] += 1
    g[3] += b[TIME]
    if g[2] < GROUP:
        return
    mean, noise, gap = g[0] / GROUP, g[1] / GROUP**2 + tail, g[3]
    g[:] = 0.0
    white = s.level[WHITE] * c[LENGTH]
    phi, total, first = np.exp(-gap / c[TAU]), 0.0, s.n[GROUPED] == 0
    for i in range(s.bank.shape[0]):
        q = s.bank[i]
        k2, sd2 = BANK_K[i // SDS] ** 2 * white, BANK_SD[i % SDS] ** 2 * white
        if first:
            q[1], q[2], q[3], q[4], q[5] = mean, 0.0, noise, 0.0, sd2
            total += q[0]
            continue
        q[2] *= phi
        q[3] += k2 * gap
        q[4] *= phi
        q[5] = q[5] * phi * phi + sd2 * (1 - phi * phi)
        gain_b, gain_f = q[3] + q[4], q[4] + q[5]
        spread = gain_b + gain_f + noise
        off = mean - q[1] - q[2]
        q[0] *= np.exp(-0.5 * min(off * off / spread, 16.0)) / np.sqrt(spread / noise)
        q[1] += gain_b / spread * off
        q[2] += gain_f / spread * off
        q[3] -= gain_b * gain_b / spread
        q[4] -= gain_b * gain_f / spread
        q[5] -= gain_f * gain_f / spread
        total += q[0]
    s.n[GROUPED] += 1
    for i in range(s.bank.shape[0]):
        s.bank[i, 0] = 0.9995 * s.bank[i, 0] / total + 0.0005 / s.bank.shape[0]
    s.level[WALK], s.level[SWING] = _drift(s, white)


@numba.njit(cache=False)
def _drift(s: State, white: float) -> tuple[float, float]:
    """K^2 and Gauss-Markov variance: means over the candidates."""
    walk, swing = 0.0, 0.0
    for i in range(s.bank.shape[0]):
        walk += s.bank[i, 0] * BANK_K[i // SDS] ** 2
        swing += s.bank[i, 0] * BANK_SD[i % SDS] ** 2
    return walk * white, swing * white
