"""A run cut into short blocks for the bias filter: turned angle, and what other sensors say of each. What stands in a
block is known at its end."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.errors import NotEnoughDataError
from core.imu.bias._learn_numba import ANGLE, KELVIN, LOST, MOVES, OTHERS, TIME, WIDTH, WINDOW
from core.imu.bias.integral import integral_behind
from core.imu.bias.result import RATE
from core.run import Run
from core.sensors import CommandLog, ImuLog, WheelLog
from core.timing import gaps, typical_step

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

PAUSE = 10.0  # steps without a reading
FEWEST = 4  # readings of a block
BEGINNING = 256  # readings that the sampling step is told from
WARMTH = 0.05  # share of a block in the running mean of the temperature


@dataclass(frozen=True)
class Blocks:
    """Blocks of a run (K,): t [s] at the end; start (K + 1,) first reading of each and the end; given (K, WIDTH) the
    filter's input. out (M,) [s] and turned (M,) [rad]: the curve's stamps and the raw integral there, every `cells` of
    them a block."""

    t: Floats
    start: Ints
    given: Floats
    out: Floats
    turned: Floats
    cells: int
    notes: tuple[str, ...]

    @property
    def length(self) -> float:
        """Seconds of a block."""
        return self.cells / RATE


def cut(run: Run, imu: ImuLog, length: float) -> Blocks:
    """Blocks of about `length` [s], longer where the gyro is slow. Raises NotEnoughDataError under eight blocks."""
    t, gz = imu.t, imu.gz
    # Bursts have steps far below their mean.
    head = t[: BEGINNING + 1]
    step = max(float(np.median(np.diff(head))), float(head[-1] - head[0]) / (len(head) - 1))
    cells = max(1, round(max(length, FEWEST * step) * RATE))
    pauses = gaps(t, PAUSE * step / typical_step(t))
    out, turned, edges, lost = integral_behind(t, gz, pauses, step)
    count = (len(out) - 1) // cells
    if count < 2 * WINDOW:
        needed = 2 * WINDOW * cells / RATE
        raise NotEnoughDataError(
            f"{t[-1] - t[0]:.3g} s are too short to tell rest from movement: at least {needed:.3g} s", expected=needed
        )
    last = cells * count + 1
    ends, start = out[cells:last:cells], edges[:last:cells].copy()  # in one piece, as live rows have it: one kernel
    given = np.zeros((count, WIDTH))
    # Blocks in which nothing was heard take no time; the one that ends the pause takes all of it.
    heard = np.diff(start) >= 2
    place = np.concatenate(([0.0], ends[heard] - out[0]))
    given[heard, TIME] = np.round(np.diff(place) * RATE) / RATE
    given[:, ANGLE] = np.diff(turned[:last:cells])
    given[:, LOST] = np.diff(lost[:last:cells])
    given[:, KELVIN] = _kelvin(imu, start)
    given[:, MOVES] = _wheels(run.wheels, ends, cells / RATE) | _commanded(run, ends, cells / RATE)
    _others(imu, start, given)
    notes = (f"{len(pauses)} gaps in the stamps: there the heading leans on the readings beside them",)
    return Blocks(ends, start, given, out, turned, cells, notes if len(pauses) else ())


def _others(imu: ImuLog, start: Ints, given: Floats) -> None:
    """The other axes' variances in each block; 0 where there is none."""
    from core.imu.bias._blocks_numba import moments

    for a, name in enumerate(("gx", "gy", "ax", "ay", "az")):
        values = getattr(imu, name)
        if values is not None and np.isfinite(values).any():
            given[:, OTHERS + a] = np.nan_to_num(moments(values, start)[:, 1])


def _wheels(wheels: WheelLog | None, ends: Floats, length: float) -> Flags:
    """Where a wheel has turned by more than a tick's flicker within half a second up to the block's end. The tick is
    the smallest step so far."""
    moving = np.zeros(len(ends), np.bool_)
    if wheels is None or len(wheels) < 2:
        return moving
    reach = max(0.5, 2 * float(np.median(np.diff(wheels.t[: BEGINNING + 1]))))
    now = np.searchsorted(wheels.t, ends + 1e-9, "right") - 1
    then = np.maximum(np.searchsorted(wheels.t, ends - length - reach, "right") - 1, 0)
    for angle in _sides(wheels):
        steps = np.abs(np.diff(angle))
        tick = np.minimum.accumulate(np.where(steps > 1e-9, steps, np.inf))
        tick = np.concatenate(([np.inf], tick))[np.maximum(now, 0)]
        turned = np.abs(angle[np.maximum(now, 0)] - angle[then])
        moving |= np.isfinite(tick) & (turned > 1.5 * tick)
    return moving


def _sides(wheels: WheelLog) -> Iterator[Floats]:
    for values in (wheels.left, wheels.right):
        angle = np.asarray(values, np.float64)
        if np.isfinite(angle).all():
            yield angle


def _commanded(run: Run, ends: Floats, length: float) -> Flags:
    """Where a movement is commanded, at the block's end or its beginning. Wheels know better: asked only where there
    are none."""
    commands: CommandLog | None = run.commands
    moving = np.zeros(len(ends), np.bool_)
    if commands is None or len(commands) < 2 or run.wheels is not None:
        return moving
    size = np.abs(np.nan_to_num(np.asarray(commands.v))) + np.abs(np.nan_to_num(np.asarray(commands.w)))
    for shift in (0.0, length):
        place = np.searchsorted(commands.t, ends - shift + 1e-9, "right") - 1
        moving |= np.where(place >= 0, size[np.maximum(place, 0)] > 1e-3, False)
    return moving


def _kelvin(imu: ImuLog, start: Ints) -> Floats:
    """(K,) temperature over the first known one, a running mean of about four seconds; 0 where there is none."""
    count = len(start) - 1
    if imu.temperature is None or not np.isfinite(imu.temperature).any():
        return np.zeros(count)
    from scipy.signal import lfilter

    from core.imu.bias._blocks_numba import moments

    mean = moments(imu.temperature, start)[:, 0]
    known = np.isfinite(mean)
    if not known.any():
        return np.zeros(count)
    # The last known one holds; before the first there is none.
    place = np.maximum.accumulate(np.where(known, np.arange(count), -1))
    filled = np.where(place >= 0, mean[np.maximum(place, 0)], mean[np.argmax(known)])
    smooth, _ = lfilter([WARMTH], [1.0, WARMTH - 1.0], filled, zi=[filled[0] * (1 - WARMTH)])
    return np.asarray(smooth - filled[0], np.float64)
