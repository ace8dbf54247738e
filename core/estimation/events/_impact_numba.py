"""Compiled walk over the accelerometer: blows along the floor (a speed gained or lost in no time) and up from it.

Each axis is taken against its own recent mean (bias, tilt and gravity go away). Two statistics a sample:

    blow    |sum of a dt| over BLOW s, in the plane, in sigma of that sum
    heave   root mean square of az and of the pitch and roll rates over SHORT and LONG s, in sigma of a sample

Noise is learnt for four speeds, a reading counted at most as a clear outlier. State lives in arrays, so a log may come
in pieces. One file, as the cache of compiled code looks at this one alone.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

BLOW, SHORT, LONG = 0.06, 0.05, 0.25  # s
MEAN = 0.5  # s, memory of an axis' own mean
LOOK = 0.05  # s after the alarm in which the blow shows its size
CALM = 0.12  # s without a sign until it is over
LONGEST = 1.0  # s: what goes on shaking for longer is no blow any more
OUTLIER = 4.0  # sigma^2: most that a reading adds to the learnt noise
IN_ALARM = 4.0  # during an alarm noise is learnt so much slower: it may be the noise that is wrong
RING = 512
BINS = 4
NOISES = 4  # blow, az, tilt rates, plane
SIZE = 12  # of a found blow: t0, alarm, t1, release, statistic, jx, jy, peaks in plane, of az, of rates, wheels, place
STATE = 40
PLANE, UP = 12, 24  # places of the two kinds of blow in the state


class Limits(NamedTuple):
    """Thresholds: sigma of both statistics; least speed [m/s] and peaks [m/s^2] that count; memory [s] of learning."""

    blow: float
    heave: float
    least_blow: float
    least_peak: float
    least_heave: float
    memory: float
    floor_accel: float  # m/s^2, per sample
    floor_rate: float  # rad/s, per sample


@njit(error_model="numpy")
def _learn(noise: Any, weight: Any, b: int, k: Any, square: float, floor: float, dt: float, memory: float) -> float:
    v = max(noise[b, k], floor)
    rate = min(max(dt / memory, dt / (weight[b, k] + dt)), 1.0)
    noise[b, k] += rate * (min(square, OUTLIER * v) * 1.09 - noise[b, k])
    weight[b, k] += dt
    return v


@njit(error_model="numpy")
def _windows(n: Any, head: int, ring: Any, out: Any) -> None:
    """Over the ring: the blow's two speeds, mean squares of az and rates, short and long, peaks within SHORT."""
    for j in range(10):
        out[j] = 0.0
    now = ring[head, 0]
    short = long = 0
    for k in range(n):
        row = ring[(head - k) % RING]
        age = now - row[0]
        if age > LONG:
            break
        out[4] += row[3] * row[3]
        out[5] += row[4]
        long += 1
        if age < BLOW - 1e-6:
            out[0] += row[1] * row[5]
            out[1] += row[2] * row[5]
        if age < SHORT - 1e-6:
            out[2] += row[3] * row[3]
            out[3] += row[4]
            short += 1
    out[2], out[3] = out[2] / max(short, 1), out[3] / max(short, 1)
    out[4], out[5] = out[4] / max(long, 1), out[5] / max(long, 1)


@njit(error_model="numpy")
def _begin(n: Any, head: int, ring: Any, axis: float, sigma: float) -> float:
    """When it began: the first loud sample with no 50 ms of calm since; axis 3 is up, else the plane."""
    now = ring[head, 0]
    peak = 0.0
    for k in range(n):
        row = ring[(head - k) % RING]
        if now - row[0] > 0.2:
            break
        peak = max(peak, abs(row[3]) if axis > 2.5 else math.hypot(row[1], row[2]))
    level = max(3.0 * sigma, 0.15 * peak)
    begin = loud = now
    for k in range(n):
        row = ring[(head - k) % RING]
        if now - row[0] > 0.3 or loud - row[0] > 0.05:
            break
        if (abs(row[3]) if axis > 2.5 else math.hypot(row[1], row[2])) > level:
            begin, loud = row[0] - row[5], row[0]
    return begin


@njit(error_model="numpy")
def _follow(o: Any, t: float, loud: bool, stat: float, now: Any, s: Any, found: Any, n: Any) -> Any:
    """Keep an open blow's peaks; write it out once it is calm. o: its place in s."""
    if t - s[o + 2] <= LOOK:
        s[o + 4] = max(s[o + 4], stat)
        if math.hypot(now[6], now[7]) > math.hypot(s[o + 5], s[o + 6]):
            s[o + 5], s[o + 6] = now[6], now[7]
        for j in range(3):
            s[o + 7 + j] = max(s[o + 7 + j], now[j])
    if loud and t - s[o + 2] < LONGEST:
        s[o + 3] = t
    if t - s[o + 3] < CALM:
        return n
    row = found[n]
    row[0], row[1], row[2], row[3], row[4] = s[o + 1], s[o + 2], s[o + 3], t, s[o + 4]
    row[5], row[6], row[7], row[8], row[9] = s[o + 5], s[o + 6], s[o + 7], s[o + 8], s[o + 9]
    row[10], row[11] = s[o + 10], float(o)
    s[o] = 0.0
    return n + 1


@njit(error_model="numpy")
def _open(o: Any, t: float, t0: float, stat: float, w: Any, s: Any) -> None:
    s[o], s[o + 1], s[o + 2], s[o + 3], s[o + 4], s[9] = 1.0, t0, t, t, stat, t
    for j in range(7, 10):
        s[o + j] = 0.0
    s[o + 5], s[o + 6], s[o + 10] = w[0], w[1], s[10]


@njit(error_model="numpy", cache=True, nogil=True)
def walk(t: Any, data: Any, speed: Any, s: Any, ring: Any, noise: Any, weight: Any, last: Any, found: Any,
         flush: bool, c: Any) -> int:  # fmt: skip
    """Fill found (., SIZE) with blows that ended here, and return how many; column 11 is PLANE or UP.

    t (N,), data (N, 5) ax ay az gx gy, NaN where absent, speed (N, 2) of the faster rim
    and of their mean. State: s (STATE,), ring (RING, 6),
    noise and weight (BINS, NOISES). last (N,): when the newest blow was known, as of each sample.
    """
    n: Any = np.int64(0)  # as a literal it would be compiled twice
    w, now = np.zeros(10), np.zeros(8)
    for i in range(t.shape[0]):
        dt = t[i] - s[0] if s[1] > 0.0 else 0.01
        ax, ay = data[i, 0], data[i, 1]
        last[i] = s[9]
        if math.isnan(ax) or math.isnan(ay):
            continue
        az = 0.0 if math.isnan(data[i, 2]) else data[i, 2]
        gx, gy = (0.0 if math.isnan(data[i, 3]) else data[i, 3]), (0.0 if math.isnan(data[i, 4]) else data[i, 4])
        values = (ax, ay, az, gx, gy)
        if s[1] == 0.0 or dt > 0.5:
            for k in range(5):
                s[2 + k] = values[k]
            s[1], dt = 1.0, 0.01
        s[0], s[10] = t[i], speed[i, 1]
        quiet = s[PLANE] == 0.0 and s[UP] == 0.0
        gain = dt / (MEAN + dt) * (1.0 if quiet else 0.3)
        head, s[7] = int(s[7] + 1) % RING, (s[7] + 1.0) % RING
        s[8] = min(s[8] + 1.0, RING)
        row = ring[head]
        row[0], row[5] = t[i], min(dt, 0.1)
        row[1], row[2], row[3] = ax - s[2], ay - s[3], az - s[4]
        row[4] = (gx - s[5]) ** 2 + (gy - s[6]) ** 2
        for k in range(5):
            s[2 + k] += gain * (values[k] - s[2 + k])
        _windows(int(s[8]), head, ring, w)
        b = 0 if speed[i, 0] < 1e-6 else (1 if speed[i, 0] < 0.15 else (2 if speed[i, 0] < 0.5 else 3))
        plane = row[1] ** 2 + row[2] ** 2
        n = _judge(t[i], b, row, plane, w, now, head, s, ring, noise, weight, found, n, c)
        last[i] = s[9]
    if flush:
        for o in (PLANE, UP):
            if s[o] > 0.0:
                s[o + 3] = min(s[o + 3], s[0])
                n = _follow(o, s[0] + 2.0 * CALM, s[o] < 0.0, 0.0, now, s, found, n)
                found[n - 1, 3] = s[0]
    return n


@njit(error_model="numpy")
def _judge(t: float, b: int, row: Any, plane: float, w: Any, now: Any, head: int, s: Any, ring: Any, noise: Any,
           weight: Any, found: Any, n: Any, c: Any) -> Any:  # fmt: skip
    """Both statistics of a sample against the noise so far; opens, follows and closes blows; then learns."""
    fa, fr = c.floor_accel**2, c.floor_rate**2
    dt = row[5]
    a = max(b, 2)  # wheels that stand are no sign that the body does
    v_blow = max(noise[b, 0], noise[a, 0], fa * 2.0 * BLOW * dt)
    v_up, v_rate = max(noise[b, 1], noise[a, 1], fa), max(noise[b, 2], noise[a, 2], fr)
    v_plane = max(noise[b, 3], noise[a, 3], 2.0 * fa)
    blow2 = w[0] * w[0] + w[1] * w[1]
    z_blow = math.sqrt(2.0 * blow2 / v_blow)
    heave = math.sqrt(max(0.5 * (w[2] / v_up + w[3] / v_rate), w[4] / v_up + w[5] / v_rate))
    now[0], now[1], now[2] = math.sqrt(plane), abs(row[3]), math.sqrt(row[4])
    now[6], now[7] = w[0], w[1]
    blown = z_blow > c.blow and blow2 > c.least_blow**2
    heaved = heave > c.heave and w[2] > 0.25 * c.least_heave**2
    if s[PLANE] > 0.0:
        n = _follow(np.int64(PLANE), t, blown or (plane > 9.0 * v_plane and plane > 1.0), z_blow, now, s, found, n)
    elif blown and _peak(head, s, ring) > c.least_peak:
        _open(np.int64(PLANE), t, _begin(int(s[8]), head, ring, 2.0, math.sqrt(v_plane)), z_blow, w, s)
        _peaks(np.int64(PLANE), head, s, ring)
    if s[UP] > 0.0:
        n = _follow(np.int64(UP), t, heave > 0.6 * c.heave, heave, now, s, found, n)
    elif heaved:
        _open(np.int64(UP), t, _begin(int(s[8]), head, ring, 3.0, math.sqrt(v_up)), heave, w, s)
        _peaks(np.int64(UP), head, s, ring)
    memory = c.memory * (1.0 if s[PLANE] == 0.0 and s[UP] == 0.0 else IN_ALARM)
    _learn(noise, weight, b, np.int64(0), blow2, fa * 2.0 * BLOW * dt, dt, memory)
    _learn(noise, weight, b, np.int64(1), row[3] ** 2, fa, dt, memory)
    _learn(noise, weight, b, np.int64(2), row[4], fr, dt, memory)
    _learn(noise, weight, b, np.int64(3), plane, 2.0 * fa, dt, memory)
    return n


@njit(error_model="numpy")
def _peak(head: int, s: Any, ring: Any) -> float:
    """Largest reading in the plane within the last BLOW seconds."""
    top = 0.0
    for k in range(int(s[8])):
        row = ring[(head - k) % RING]
        if ring[head, 0] - row[0] > BLOW:
            break
        top = max(top, row[1] ** 2 + row[2] ** 2)
    return math.sqrt(top)


@njit(error_model="numpy")
def _peaks(o: Any, head: int, s: Any, ring: Any) -> None:
    """What the ring holds of a blow that is only now known: its peaks."""
    for k in range(int(s[8])):
        row = ring[(head - k) % RING]
        if row[0] < s[o + 1]:
            break
        s[o + 7] = max(s[o + 7], math.hypot(row[1], row[2]))
        s[o + 8] = max(s[o + 8], abs(row[3]))
        s[o + 9] = max(s[o + 9], math.sqrt(row[4]))
