"""A run cut into short blocks: turned angle, mean rate, and everything that tells a rest from a movement."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.errors import NotEnoughDataError
from core.imu.bias.integral import curve_stamps, integral_at
from core.imu.bias.result import RATE
from core.run import Run
from core.sensors import CommandLog, ImuLog, WheelLog
from core.timing import gaps, typical_step

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

PAUSE = 10.0  # steps without a reading
FEWEST = 4  # readings of a block
CLIP = 4.0  # deviations, beyond which a reading counts as this
WINDOW = 4  # blocks of the likelihood ratio
EVEN = 25.9  # chi-square of WINDOW - 1 degrees of freedom at 1e-5
STEADY = 24.7  # chi-square of 3 WINDOW - 1 at 1e-2
FALSE_ALARMS = 5.0  # deviations of a window's statistic


@dataclass(frozen=True)
class Blocks:
    """Blocks of a run (K,): t [s] at the end, time [s] since the block before.

    angle [rad] turned by the raw reading; lost [rad^2] its variance from gaps in the record; mean [rad/s] of the
    clipped readings; noise [rad^2/s^2] of that mean at rest; kelvin from the first temperature; calm by its own
    readings; quiet as the end of a window of WINDOW blocks. out (M,) [s] and turned (M,) [rad]: the curve's stamps and
    the raw integral there; every `cells` of them a block. white [rad/s/sqrt(Hz)].
    """

    t: Floats
    time: Floats
    angle: Floats
    lost: Floats
    mean: Floats
    noise: Floats
    kelvin: Floats
    calm: Flags
    quiet: Flags
    out: Floats
    turned: Floats
    cells: int
    white: float
    notes: tuple[str, ...]


def cut(run: Run, imu: ImuLog, length: float) -> Blocks:
    """Blocks of about `length` [s], longer where the gyro is slow. Raises NotEnoughDataError under eight blocks."""
    t, gz = imu.t, imu.gz
    step = float(np.median(np.diff(t[:200_001])))
    mean_step = (t[-1] - t[0]) / (len(t) - 1)
    out = curve_stamps(t)
    cells = max(1, round(max(length, FEWEST * max(step, mean_step)) * RATE))
    count = (len(out) - 1) // cells
    needed = 2 * WINDOW * cells / RATE
    if count < 2 * WINDOW:
        raise NotEnoughDataError(
            f"{t[-1] - t[0]:.3g} s are too short to tell rest from movement: at least {needed:.3g} s",
            expected=needed,
        )
    turned, edges = integral_at(t, gz, out)
    ends = out[cells : cells * count + 1 : cells]
    start = edges[: cells * count + 1 : cells]
    angle = np.diff(turned[: cells * count + 1 : cells])
    mean, noise, calm, even, white = _gyro(gz, start, cells / RATE)
    moving = _others(imu, start) | _wheels(run.wheels, ends, cells / RATE) | _commanded(run, ends, cells / RATE)
    calm &= ~moving
    # Of bursts, where the typical step is far below the mean, a pause is one against the mean.
    lost, holes = _gaps(t, gz, ends, PAUSE * max(1.0, mean_step / typical_step(t)))
    notes = (f"{holes} gaps in the stamps: there the heading leans on the readings beside them",) if holes else ()
    kelvin = _kelvin(imu, start)
    time = np.full(count, cells / RATE)
    return Blocks(ends, time, angle, lost, mean, noise, kelvin, calm, calm & even, out, turned, cells, white, notes)


def _gaps(t: Floats, gz: npt.NDArray[np.floating], ends: Floats, factor: float) -> tuple[Floats, int]:
    """(K,) variance of the angle that gaps hide, spread evenly over each gap, and how many there are.

    The rate in a gap is taken as somewhere between those beside it, all the gap long.
    """
    lost = np.zeros(len(ends))
    found = gaps(t, factor)
    for low, high in found:
        i, j = np.searchsorted(t, (low, high))
        before, after = float(np.mean(gz[max(0, i - 9) : i + 1])), float(np.mean(gz[j : j + 10]))
        a, b = np.searchsorted(ends, (low, high))
        inside = slice(a, min(b + 1, len(ends)))
        held = len(lost[inside])
        if held:
            lost[inside] += ((high - low) * (after - before)) ** 2 / 12 / held
    return lost, len(found)


def _gyro(
    gz: npt.NDArray[np.floating], start: npt.NDArray[np.int64], length: float
) -> tuple[Floats, Floats, Flags, Flags, float]:
    """Clipped mean, its variance at rest, calm and even flags, and the white noise."""
    from core.imu.bias._blocks_numba import clipped_moments, moments

    plain = moments(gz, start)
    sd, _ = still_level(plain[:, 1])
    table = clipped_moments(gz, start, plain[:, 0], CLIP * sd)
    mean = table[:, 0]
    size = np.diff(start).astype(np.float64)
    usable = np.isfinite(mean) & (size >= min(FEWEST, np.median(size)))
    sd, spread = still_level(np.where(usable, table[:, 1], np.nan))
    ratio = table[:, 1] / sd**2 - 1
    with np.errstate(invalid="ignore"):
        calm = usable & (ratio < FALSE_ALARMS * spread)
    typical = float(np.median(size))
    scatter = _scatter(mean, WINDOW)
    even = calm
    for _ in range(4):
        # Calm blocks of a steady turn's beginning and end have other means; they go as the noise comes down.
        noise_of_mean = _mean_noise(mean, calm & even, sd, typical)
        even = scatter < EVEN * noise_of_mean
    noise = noise_of_mean * typical / np.maximum(size, 1)
    white = float(np.sqrt(_mean_noise(plain[:, 0], calm & even, sd, typical) * length))
    steady = _scatter(mean, 3 * WINDOW) / noise_of_mean
    with np.errstate(invalid="ignore"):
        steady_flag = usable & (steady < STEADY)
    return np.where(usable, mean, 0.0), noise, calm | steady_flag, even, white


def still_level(variance: Floats) -> tuple[float, float]:
    """Standard deviation of readings at rest, and the relative spread of a block's variance there.

    Begun with the quietest tenth of the blocks, blocks are taken up to FALSE_ALARMS spreads until nothing changes.
    """
    known = np.sort(variance[np.isfinite(variance)])
    if not len(known):
        raise NotEnoughDataError("no stretch of the record holds enough readings to tell rest from movement")
    positive = known[known > 0]
    if not len(positive):
        raise NotEnoughDataError("all readings are equal: there is no noise to tell rest from movement by")
    taken = positive[: max(4, len(positive) // 10)]
    level = float(taken[-1])
    spread = 0.3
    for _ in range(30):
        taken = positive[: int(np.searchsorted(positive, level * (1 + FALSE_ALARMS * spread), "right"))]
        middle = float(np.median(taken))
        new_spread = max(1.4826 * float(np.median(np.abs(taken - middle))) / middle, 0.03)
        new_spread = min(new_spread, 0.6)
        if middle == level and new_spread == spread:
            break
        level, spread = middle, new_spread
    return float(np.sqrt(level)), spread


def _mean_noise(mean: Floats, calm: Flags, sd: float, size: float) -> float:
    """Variance of a block's mean at rest, from neighbours' differences: bias and slow creep fall out."""
    pair = np.diff(mean)[calm[1:] & calm[:-1]]
    least = (sd * sd / max(size, 1.0)) * 0.05
    if len(pair) < 8:
        return sd * sd / max(size, 1.0)
    robust = 1.4826 * float(np.median(np.abs(pair)))
    return max(robust**2 / 2, least)


def _scatter(mean: Floats, window: int) -> Floats:
    """(K,) sum of squares about their mean of each block and the window - 1 before; infinite where one is missing."""
    centred = mean - np.nanmedian(mean)
    one = np.concatenate(([0.0], np.cumsum(np.nan_to_num(centred))))
    two = np.concatenate(([0.0], np.cumsum(np.nan_to_num(centred**2))))
    lost = np.concatenate(([0], np.cumsum(~np.isfinite(mean))))
    out = np.full(len(mean), np.inf)
    total, square = one[window:] - one[:-window], two[window:] - two[:-window]
    whole = (lost[window:] - lost[:-window]) == 0
    out[window - 1 :] = np.where(whole, np.maximum(square - total**2 / window, 0.0), np.inf)
    return out


def _others(imu: ImuLog, start: npt.NDArray[np.int64]) -> Flags:
    """Where another axis says that the body moves: its variance is far over that of its own rests."""
    from core.imu.bias._blocks_numba import moments

    moving = np.zeros(len(start) - 1, np.bool_)
    for name in ("gx", "gy", "ax", "ay", "az"):
        values = getattr(imu, name)
        if values is None or not np.isfinite(values).any():
            continue
        variance = moments(values, start)[:, 1]
        if not (variance > 0).any():
            continue
        sd, spread = still_level(variance)
        with np.errstate(invalid="ignore"):
            moving |= variance > sd**2 * (1 + 2 * FALSE_ALARMS * spread)
    return moving


def _wheels(wheels: WheelLog | None, ends: Floats, length: float) -> Flags:
    """Where a wheel has turned by more than a tick's flicker within half a second about the block."""
    moving = np.zeros(len(ends), np.bool_)
    if wheels is None or len(wheels) < 2:
        return moving
    for angle in _sides(wheels):
        steps = np.abs(np.diff(angle))
        steps = steps[steps > 1e-9]
        if not len(steps):
            continue
        tick = float(steps.min())
        reach = max(0.5, 2 * float(np.median(np.diff(wheels.t))))
        ahead = np.interp(ends, wheels.t, angle)
        before = np.interp(ends - length - reach, wheels.t, angle)
        moving |= np.abs(ahead - before) > 1.5 * tick
    return moving


def _sides(wheels: WheelLog) -> Iterator[Floats]:
    for values in (wheels.left, wheels.right):
        angle = np.asarray(values, np.float64)
        if np.isfinite(angle).all():
            yield angle


def _commanded(run: Run, ends: Floats, length: float) -> Flags:
    """Where a movement is commanded. Wheels know better: asked only where there are none."""
    commands: CommandLog | None = run.commands
    moving = np.zeros(len(ends), np.bool_)
    if commands is None or len(commands) < 2 or run.wheels is not None:
        return moving
    for values, least in ((commands.v, 1e-3), (commands.w, 1e-3)):
        size = np.abs(np.nan_to_num(np.asarray(values, np.float64)))
        for shift in (0.0, length):
            moving |= np.interp(ends - shift, commands.t, size) > least
    return moving


def _kelvin(imu: ImuLog, start: npt.NDArray[np.int64]) -> Floats:
    """(K,) temperature over the first known one, smoothed over a second by the block means; 0 where there is none."""
    count = len(start) - 1
    if imu.temperature is None or not np.isfinite(imu.temperature).any():
        return np.zeros(count)
    from core.imu.bias._blocks_numba import moments

    mean = moments(imu.temperature, start)[:, 0]
    known = np.flatnonzero(np.isfinite(mean))
    if not len(known):
        return np.zeros(count)
    filled = np.interp(np.arange(count), known, mean[known])
    # One-sided: what is used at a time was known then.
    from scipy.signal import lfilter

    share = 0.05
    smooth, _ = lfilter([share], [1.0, share - 1.0], filled, zi=[filled[0] * (1 - share)])
    return np.asarray(smooth - smooth[0], np.float64)
