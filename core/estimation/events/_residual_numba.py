"""Compiled walk over IMU, wheels and commands: what they say of the same motion, and where they contradict each other.

Three residuals, one value per base step (two wheel readings at least STEP apart; IMU integrals are taken at the same
moment, shifted by the learnt delay between the streams):

    turn   wheels' turn - gyro's turn           [rad]    parameters: gyro bias, track scale, wheel inequality, delay
    along  wheels' speed-up - accelerometer's   [m/s]    parameter: accelerometer bias with tilt, a random walk
    side   accelerometer across - v w           [m/s]    parameter: the same, across

Parameters are Kalman constants, so that a residual is judged with what is not known of them. The noise of a residual is
learnt for sums over 1, 3, 8 and 20 steps and for four speeds, each reading counted at most as a clear outlier. A sum is
tested at a point (chi-square) and single steps for persistence (CUSUM); at an alarm the onset is the step that makes
the data most likely. State lives in arrays, so a log may come in pieces. One file, as the cache looks at this one
alone.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

IMU, WHEEL, COMMAND = range(3)  # kinds of reading; data: gz ax ay az | left right [m] | v w
STEP = 0.04  # s
WAIT = 0.06  # s: how long a wheel reading waits for an IMU that may be late
PAUSE = 0.6  # s: longer, and the wheels have paused
RING, QUEUE, HISTORY = 256, 64, 48  # IMU samples, waiting wheel readings, base steps
TURN, ALONG, SIDE = range(3)
BINS, WINDOWS = 4, 4
LENGTHS = (1, 3, 8, 20)  # base steps
OUTLIER = 4.0  # sigma^2: most that a reading adds to the learnt noise
IN_ALARM = 4.0  # during an alarm noise is learnt so much slower: it may be the noise that is wrong
CLIP = 4.0  # sigma: most that a step adds to the CUSUM
DRIFT = 0.5  # sigma per step that the CUSUM forgives
COAST = 2.0  # s that the accelerometer may carry the speed
SKID = 5.0  # s of contradiction in turning after which the track width is doubted
STILL = 0.3  # s, window of the IMU's own stillness

# Scalars of the state
(HEAD, COUNT, G, VX, BX, VY, T_IMU, GZ, AX, AY, DT_IMU, Q_HEAD, Q_COUNT, T_BASE, L_BASE, R_BASE, G_BASE, BX_BASE,
 VX_BASE, VY_BASE, GZ_BASE, E_LAST, H_LAST, STEPS, FLAT_L, FLAT_R, SET_L, SET_R, ASKED, UNASKED, T_CMD, LAST_L, LAST_R,
 BA, PA, BS, PS, BAD_UNTIL, SEEN_CMD, BEFORE_L, BEFORE_R, MOVES, CV, CW, ARM, SHIFT, USED) = range(47)  # fmt: skip
SCALARS = 47

# Columns of a row
(R_T, R_KNOWN, R_H, R_VL, R_VR, R_TURNS, R_FLAT_L, R_FLAT_R, R_SET_L, R_SET_R, R_ASKED, R_UNASKED, R_STILL, R_BEFORE_L,
 R_BEFORE_R, R_GYRO, R_BUSY) = range(17)  # fmt: skip
R_CHANNEL = 17  # then 6 per channel: active, onset, alarm, z, sum, duration
PER_CHANNEL = 6
ROW = R_CHANNEL + 3 * PER_CHANNEL


class Limits(NamedTuple):
    """Numbers of one run, SI; sd_ are systematic errors that no test may go below."""

    track: float  # m, 0 where unknown
    arm_x: float
    arm_y: float
    has_accel: float
    point: float  # sigma of a point test
    cusum: float  # sigma of the CUSUM
    quantum: float  # m, encoder step at the rim
    q_gyro: float  # (rad/s)^2/Hz
    q_bias: float
    q_tilt: float  # (m/s^2)^2/s
    sd_turn: float
    sd_along: float
    memory: float  # s of learning
    still_gyro: float  # (rad/s)^2 per sample at rest, from the sheet
    still_accel: float


@njit(error_model="numpy")
def _imu(t: float, d: Any, s: Any, ring: Any, c: Any) -> None:
    """Take an IMU sample: integrals of turn, speed, distance, side speed; sums for its own stillness."""
    if math.isnan(d[0]):
        return
    first = s[COUNT] == 0.0
    dt = 0.0 if first else t - s[T_IMU]
    ax, ay = d[1] + c.arm_x * d[0] * d[0], d[2] + c.arm_y * d[0] * d[0]
    if math.isnan(ax) or math.isnan(ay):
        ax, ay = s[AX], s[AY]
    if first:
        s[GZ], s[AX], s[AY] = d[0], ax, ay
    elif s[DT_IMU] > 0.0 and dt > 6.0 * s[DT_IMU] + 0.02:
        s[BAD_UNTIL] = t + WAIT
    if not first:
        s[DT_IMU] = dt if s[DT_IMU] == 0.0 else s[DT_IMU] + 0.05 * (min(dt, 3.0 * s[DT_IMU]) - s[DT_IMU])
    s[G] += 0.5 * (d[0] + s[GZ]) * dt
    v = s[VX] + 0.5 * (ax + s[AX]) * dt
    s[BX] += 0.5 * (v + s[VX]) * dt
    s[VX] = v
    s[VY] += 0.5 * (ay + s[AY]) * dt
    s[T_IMU], s[GZ], s[AX], s[AY] = t, d[0], ax, ay
    s[HEAD] = (s[HEAD] + 1.0) % RING
    s[COUNT] = min(s[COUNT] + 1.0, RING)
    row = ring[int(s[HEAD])]
    row[0], row[1], row[2], row[3], row[4], row[5] = t, s[G], s[VX], s[BX], s[VY], d[0]
    row[6], row[7] = ax, ay


@njit(error_model="numpy")
def _at(t: float, s: Any, ring: Any, out: Any) -> bool:
    """IMU integrals at t: G, VX, BX, VY, gz, linear between samples; held for a moment after the last."""
    n, head = int(s[COUNT]), int(s[HEAD])
    if n < 2:
        return False
    newest = ring[head]
    if t >= newest[0]:
        dt = t - newest[0]
        if dt > 3.0 * s[DT_IMU] + 0.02:
            return False
        out[0], out[1] = newest[1] + newest[5] * dt, newest[2] + newest[6] * dt
        out[2], out[3] = newest[3] + newest[2] * dt, newest[4] + newest[7] * dt
        out[4] = newest[5]
        return True
    for k in range(1, n):
        a = ring[(head - k) % RING]
        if a[0] <= t:
            b = ring[(head - k + 1) % RING]
            f = (t - a[0]) / (b[0] - a[0])
            out[0], out[1], out[3] = a[1] + f * (b[1] - a[1]), a[2] + f * (b[2] - a[2]), a[4] + f * (b[4] - a[4])
            out[2] = a[3] + 0.5 * (a[2] + out[1]) * (t - a[0])
            out[4] = a[5] + f * (b[5] - a[5])
            return True
    return False


@njit(error_model="numpy")
def _still(t: float, s: Any, ring: Any, c: Any, calm: Any) -> float:
    """Variance of gyro and accelerometer over the last STILL seconds up to t, over that at rest; -1 where unknown."""
    n, head = int(s[COUNT]), int(s[HEAD])
    m, sums = 0, (0.0, 0.0, 0.0)
    g = g2 = x = x2 = y = y2 = 0.0
    base = ring[head]
    for k in range(n):
        row = ring[(head - k) % RING]
        if row[0] > t:
            continue
        if row[0] < t - STILL:
            break
        a, b, d = row[5] - base[5], row[6] - base[6], row[7] - base[7]
        g, g2, x, x2, y, y2, m = g + a, g2 + a * a, x + b, x2 + b * b, y + d, y2 + d * d, m + 1
    if m < 4:
        return -1.0
    sums = ((g2 - g * g / m) / (m - 1), (x2 - x * x / m) / (m - 1), (y2 - y * y / m) / (m - 1))
    calm[3], calm[4] = sums[0], sums[1] + sums[2]
    gyro = sums[0] / calm[0]
    return gyro if c.has_accel == 0.0 else (gyro + (sums[1] + sums[2]) / calm[1]) / 2.0


@njit(error_model="numpy")
def _learn_calm(s: Any, calm: Any, h: float, c: Any) -> None:
    """Noise at rest: of stretches in which nothing turns and nothing is asked; falls at once, grows slowly."""
    quiet = min(s[FLAT_L], s[FLAT_R]) > 0.5 and s[UNASKED] > 0.5
    if not quiet:
        return
    for k in range(2):
        seen = max(calm[3 + k], (c.still_gyro, c.still_accel)[k])
        if calm[2] == 0.0:
            calm[k] = min(seen, 100.0 * (c.still_gyro, c.still_accel)[k])
        calm[k] += h / 5.0 * (min(seen, 3.0 * calm[k]) - calm[k])
    calm[2] += h


@njit(error_model="numpy")
def _update(p: Any, P: Any, H: Any, nu: float, r: float) -> None:
    """Kalman update of the turn's constants, weaker the further out (Huber), not at all far out."""
    share = 0.0
    for i in range(4):
        for j in range(4):
            share += H[i] * P[i, j] * H[j]
    S = share + r
    nis = nu * nu / S
    if nis > 25.0:
        return
    S += r * max(math.sqrt(nis) / 2.0 - 1.0, 0.0)
    K0 = (P[0, 0] * H[0] + P[0, 1] * H[1] + P[0, 2] * H[2] + P[0, 3] * H[3]) / S
    K1 = (P[1, 0] * H[0] + P[1, 1] * H[1] + P[1, 2] * H[2] + P[1, 3] * H[3]) / S
    K2 = (P[2, 0] * H[0] + P[2, 1] * H[1] + P[2, 2] * H[2] + P[2, 3] * H[3]) / S
    K3 = (P[3, 0] * H[0] + P[3, 1] * H[1] + P[3, 2] * H[2] + P[3, 3] * H[3]) / S
    K = (K0, K1, K2, K3)
    for i in range(4):
        p[i] += K[i] * nu
    for i in range(4):
        for j in range(i + 1):
            P[i, j] -= K[i] * K[j] * S
            P[j, i] = P[i, j]


@njit(error_model="numpy")
def _test(t: float, h: float, nu: float, slow: float, late: float, quiet: float, speed: int, ch: Any, past: Any,
          noise: Any, weight: Any, c: Any) -> None:  # fmt: skip
    """One step of a channel with residual nu, sd `slow` by constants (same sign all along), `late` by the delay.

    ch: n, cusum up, down, active, onset, alarm, z, sum, t of last loud step, calm steps, -, peak, sd of a step;
    past (HISTORY, 5): nu, slow, late, speed, t of the step's begin, newest first.
    """
    n = int(ch[0])
    for i in range(min(n, HISTORY - 1), 0, -1):
        for j in range(5):
            past[i, j] = past[i - 1, j]
    past[0, 0], past[0, 1], past[0, 2], past[0, 3], past[0, 4] = nu, slow, late, speed, t - h
    n = min(n + 1, HISTORY)
    ch[0] = n
    total, coherent, shifted, top, best, long_run, m = 0.0, 0.0, 0.0, 0, 0.0, 0.0, 0
    for w in range(WINDOWS):
        if LENGTHS[w] > n:
            break
        while m < LENGTHS[w]:
            total, coherent, shifted = total + past[m, 0], coherent + past[m, 1], shifted + past[m, 2]
            top = max(top, int(past[m, 3]))
            m += 1
        v = max(noise[top, w], quiet)
        near = min(total * total, OUTLIER * v) * 1.09
        rate = max(h / c.memory, h / (weight[top, w] + h)) if ch[3] == 0.0 else h / (IN_ALARM * c.memory)
        noise[top, w] += rate * (near - noise[top, w])
        weight[top, w] += h if ch[3] == 0.0 else 0.0
        v += coherent * coherent + shifted * shifted
        z = total / math.sqrt(v)
        if abs(z) > abs(best):
            best = z
        long_run = max(long_run, v / m)
    step = nu / math.sqrt(long_run)
    step = min(max(step, -CLIP), CLIP)
    ch[1] = max(ch[1] + step - DRIFT, 0.0)
    ch[2] = max(ch[2] - step - DRIFT, 0.0)
    ch[12] = math.sqrt(long_run)
    if ch[3] == 0.0:
        if abs(best) > c.point or max(ch[1], ch[2]) > c.cusum:
            _open(t, h, best, ch, past, n)
    else:
        ch[7] += nu
        ch[6] = max(ch[6], abs(best))
        ch[11] = max(ch[11], abs(ch[7]))


@njit(error_model="numpy")
def _crept(at: int, total: float, sd: float, past: Any, n: int) -> int:
    """Where a jump only takes back what crept in before it (grip returns), the onset is where that began."""
    back, most, begin = 0.0, 0.0, at
    for i in range(at + 1, n):
        back += past[i, 0]
        m = i - at
        gain = back * back / m
        if back * total < 0.0 and abs(back) > 0.5 * abs(total) and gain > 9.0 * sd * sd and gain > most:
            most, begin = gain, i
    return begin


@njit(error_model="numpy")
def _open(t: float, h: float, z: float, ch: Any, past: Any, n: int) -> None:
    """Raise the alarm; onset is the begin of the step from which on the data are most likely shifted."""
    total, most, at = 0.0, -1.0, 0
    for i in range(n):
        total += past[i, 0]
        gain = total * total / (i + 1.0)
        if gain > most:
            most, at = gain, i
    total = 0.0
    for i in range(at + 1):
        total += past[i, 0]
    at = _crept(at, total, ch[12], past, n)
    ch[3], ch[4], ch[5], ch[6], ch[7] = 1.0, past[at, 4], t, max(abs(z), max(ch[1], ch[2])), total
    ch[8], ch[9], ch[11] = t, 0.0, abs(total)


@njit(error_model="numpy")
def _close(k: int, t: float, h: float, resting: bool, ch: Any, past: Any) -> None:
    """Whether it is over: the turn when it no longer grows, speeds when they agree again or after COAST."""
    if ch[3] == 0.0:
        return
    age = t - ch[4]
    if k == TURN:
        last = abs(past[0, 0] + past[1, 0] + past[2, 0])
        quiet = last < 3.0 * ch[12] * math.sqrt(3.0)
    else:
        quiet = abs(ch[7]) < max(0.03, min(3.0 * ch[12] * math.sqrt(max(age / h, 1.0)), 0.35 * ch[11]))
        quiet = quiet or age > COAST or resting
    ch[9] = ch[9] + 1.0 if quiet else 0.0
    if not quiet:
        ch[8] = t
    if ch[9] >= 4.0 or (age > 3.0 * COAST and k != TURN):
        ch[3], ch[0], ch[1], ch[2] = 0.0, 0.0, 0.0, 0.0


@njit(error_model="numpy")
def _contexts(t: float, h: float, dl: float, dr: float, s: Any) -> None:
    """How long each wheel has been flat, how fast it was before, how long motion has been asked for or not."""
    if abs(dl) > 1e-9:
        s[BEFORE_L], s[LAST_L], s[FLAT_L] = s[LAST_L], dl / h, 0.0
    else:
        s[FLAT_L] += h
    if abs(dr) > 1e-9:
        s[BEFORE_R], s[LAST_R], s[FLAT_R] = s[LAST_R], dr / h, 0.0
    else:
        s[FLAT_R] += h
    asked = s[SEEN_CMD] > 0.0 and (abs(s[CV]) > 1e-3 or abs(s[CW]) > 1e-3)
    s[ASKED] = s[ASKED] + h if asked else 0.0
    s[UNASKED] = 0.0 if asked else s[UNASKED] + h


@njit(error_model="numpy")
def _anchor(now: Any, s: Any) -> None:
    """IMU integrals at the begin of the next step, and the delay that they were taken with."""
    s[G_BASE], s[VX_BASE], s[BX_BASE], s[VY_BASE], s[GZ_BASE] = now[0], now[1], now[2], now[3], now[4]
    s[SHIFT] = s[USED]


@njit(error_model="numpy")
def _restart(t: float, left: float, right: float, now: Any, known: bool, s: Any, ch: Any) -> None:
    """Begin anew from this reading: nothing before it is compared with anything after it."""
    s[T_BASE], s[L_BASE], s[R_BASE], s[STEPS] = t, left, right, 0.0
    if known:
        _anchor(now, s)
        s[STEPS] = 1.0
    for k in range(3):
        for j in range(10):
            ch[k, j] = 0.0


@njit(error_model="numpy")
def _base_step(t: float, left: float, right: float, s: Any, ring: Any, p: Any, P: Any, ch: Any, past: Any, noise: Any,
               weight: Any, calm: Any, now: Any, H: Any, row: Any, c: Any) -> bool:  # fmt: skip
    """Compare the sensors over one base step; False where there is nothing to compare."""
    h = t - s[T_BASE]
    s[USED] = p[3]
    known = _at(t + s[USED], s, ring, now) and t > s[BAD_UNTIL]
    dl, dr = left - s[L_BASE], right - s[R_BASE]
    if s[STEPS] < 0.0 or h > PAUSE or max(abs(dl), abs(dr)) > 10.0 * h:
        _restart(t, left, right, now, known, s, ch)
        return False
    _contexts(t, h, dl, dr, s)
    vl, vr = dl / h, dr / h
    v, still = 0.5 * (vl + vr), -1.0
    row[R_T], row[R_H], row[R_VL], row[R_VR] = t, h, vl, vr
    if known and s[STEPS] >= 1.0:
        _compare(t, h, v, (dr - dl), s, p, P, ch, past, noise, weight, now, H, c)
        still = _still(t + s[USED], s, ring, c, calm)
        if still >= 0.0:
            _learn_calm(s, calm, h, c)
        resting = calm[2] > 0.5 and 0.0 <= still < 3.0 and min(s[FLAT_L], s[FLAT_R]) > 0.1
        for k in range(3):
            _close(k, t, h, resting, ch[k], past[k])
        s[STEPS] += 1.0
        row[R_GYRO] = (now[0] - s[G_BASE]) / (h + s[USED] - s[SHIFT]) - p[0]
    if known:
        if s[STEPS] < 1.0:
            s[STEPS] = 1.0
        _anchor(now, s)
    else:
        _restart(t, left, right, now, known, s, ch)
    s[T_BASE], s[L_BASE], s[R_BASE] = t, left, right
    row[R_STILL] = still if calm[2] > 0.5 else -1.0
    row[R_TURNS], row[R_FLAT_L], row[R_FLAT_R], row[R_SET_L], row[R_SET_R] = (
        dr - dl, s[FLAT_L], s[FLAT_R], s[CV] - s[CW] * c.track / 2.0, s[CV] + s[CW] * c.track / 2.0,
    )  # fmt: skip
    row[R_ASKED], row[R_UNASKED], row[R_BEFORE_L], row[R_BEFORE_R] = s[ASKED], s[UNASKED], s[BEFORE_L], s[BEFORE_R]
    row[R_BUSY] = 0.0 if known else 1.0
    for k in range(3):
        at = R_CHANNEL + k * PER_CHANNEL
        for j in range(5):
            row[at + j] = ch[k, 3 + j]
        row[at + 5] = ch[k, 12]
    return True


@njit(error_model="numpy")
def _compare(t: float, h: float, v: float, spread: float, s: Any, p: Any, P: Any, ch: Any, past: Any, noise: Any,
             weight: Any, now: Any, H: Any, c: Any) -> None:  # fmt: skip
    """The three residuals of a step, their tests, and what the calm ones teach of the constants."""
    imu_h = h + s[USED] - s[SHIFT]  # the learnt delay may have moved since
    w = (now[0] - s[G_BASE]) / imu_h - p[0]
    rim = abs(v) + abs(w) * (c.track if c.track > 0.0 else 0.3) / 2.0
    speed = 0 if min(s[FLAT_L], s[FLAT_R]) > 0.0 else (1 if rim < 0.15 else (2 if rim < 0.5 else 3))
    P[0, 0] += c.q_bias * h
    for i in range(1, 4):
        P[i, i] += (1e-9, 1e-9, 1e-8)[i - 1] * h
    if c.track > 0.0:
        H[0], H[1], H[2], H[3] = -h, w * h, v * h, now[4] - s[GZ_BASE]
        nu = spread / c.track - w * h * (1.0 + p[1]) - p[2] * v * h
        slow = math.sqrt(P[0, 0]) * h + math.sqrt(P[1, 1]) * abs(H[1]) + math.sqrt(P[2, 2]) * abs(H[2])
        floor = c.sd_turn**2 + c.quantum**2 / (3.0 * c.track**2) + c.q_gyro * h
        _test(t, h, nu, slow, math.sqrt(P[3, 3]) * H[3], floor, speed, ch[0], past[0], noise[0], weight[0], c)
        if ch[0, 3] == 0.0:
            _update(p, P, H, nu, max(ch[0, 12] ** 2, floor))
            p[3] = min(max(p[3], -WAIT), WAIT)
        elif t - ch[0, 4] > SKID and min(s[FLAT_L], s[FLAT_R]) + s[FLAT_L] + s[FLAT_R] == 0.0:
            P[1, 1] += 0.25
            for j in range(10):
                ch[0, j] = 0.0
    if c.has_accel == 0.0:
        return
    e = v - (now[2] - s[BX_BASE]) / imu_h
    gained = (now[1] - s[VX_BASE]) / imu_h
    q = c.q_tilt * h * (0.01 if speed == 0 else 1.0)  # who stands does not come onto another slope
    s[PA], s[PS] = s[PA] + q, s[PS] + q
    late = math.sqrt(P[3, 3])
    if s[STEPS] >= 2.0:
        between = 0.5 * (h + s[H_LAST])
        nu = e - s[E_LAST] + s[BA] * between
        floor = c.sd_along**2 + c.quantum**2 / (6.0 * h * h)
        _test(t, h, nu, math.sqrt(s[PA]) * between, late * (gained - s[ARM]), floor, speed, ch[1], past[1], noise[1],
              weight[1], c)  # fmt: skip
        if ch[1, 3] == 0.0 and max(ch[1, 1], ch[1, 2]) < 0.5 * c.cusum:
            s[BA], s[PA] = _tilt(s[BA], s[PA], -nu, between, ch[1, 12])
    nu = (now[3] - s[VY_BASE]) * h / imu_h - v * w * h - s[BS] * h
    _test(t, h, nu, math.sqrt(s[PS]) * h, late * h * abs(w) * abs(gained), c.sd_along**2, speed, ch[2], past[2],
          noise[2], weight[2], c)  # fmt: skip
    if ch[2, 3] == 0.0 and max(ch[2, 1], ch[2, 2]) < 0.5 * c.cusum:
        s[BS], s[PS] = _tilt(s[BS], s[PS], nu, h, ch[2, 12])
    s[E_LAST], s[H_LAST], s[ARM] = e, h, gained


@njit(error_model="numpy")
def _tilt(b: float, P: float, nu: float, h: float, sd: float) -> tuple[float, float]:
    """Accelerometer bias by one residual nu [m/s] over h, at most three sigma of it."""
    S = P * h * h + sd * sd
    limit = 3.0 * math.sqrt(S)
    gain = P * h / S
    return b + gain * min(max(nu, -limit), limit), P * (1.0 - gain * h)


@njit(error_model="numpy", cache=True, nogil=True)
def walk(t: Any, kind: Any, data: Any, s: Any, ring: Any, queue: Any, p: Any, P: Any, ch: Any, past: Any, noise: Any,
         weight: Any, calm: Any, rows: Any, flush: bool, c: Any) -> int:  # fmt: skip
    """Walk over readings in the order of their stamps; fills rows (., ROW) and returns how many. `flush` at the end.

    t (E,), kind (E,), data (E, 4). State: s (SCALARS,), ring (RING, 8), queue (QUEUE, 3), p (4,), P (4, 4), ch (3, 13),
    past (3, HISTORY, 5), noise and weight (3, BINS, WINDOWS), calm (5,).
    """
    now, H, found = np.zeros(5), np.zeros(4), 0
    for i in range(t.shape[0] + (1 if flush else 0)):
        last = i == t.shape[0]
        if not last:
            if kind[i] == IMU:
                _imu(t[i], data[i], s, ring, c)
            elif kind[i] == COMMAND:
                s[CV], s[CW], s[SEEN_CMD] = data[i, 0], data[i, 1], 1.0
            else:
                at = int(s[Q_HEAD] + s[Q_COUNT]) % QUEUE
                queue[at, 0], queue[at, 1], queue[at, 2] = t[i], data[i, 0], data[i, 1]
                s[Q_COUNT] = min(s[Q_COUNT] + 1.0, QUEUE)
        while s[Q_COUNT] > 0.0:
            q = queue[int(s[Q_HEAD])]
            if not last and t[i] < q[0] + WAIT:
                break
            s[Q_HEAD], s[Q_COUNT] = (s[Q_HEAD] + 1.0) % QUEUE, s[Q_COUNT] - 1.0
            if s[STEPS] >= 0.0 and q[0] - s[T_BASE] < STEP - 1e-3:
                continue
            if _base_step(q[0], q[1], q[2], s, ring, p, P, ch, past, noise, weight, calm, now, H, rows[found], c):
                rows[found, R_KNOWN] = q[0] if last else t[i]
                found += 1
    return found
