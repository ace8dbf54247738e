"""Records as they come (gaps, lost samples, jittered stamps of arrival) laid on an even time grid.

A sensor samples evenly; what jitters is mostly the stamp. So readings keep their order, and a place of the grid is
left empty only where samples are really missing: where the stamps fall behind for good, not where a late burst
catches up again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from core.errors import NotEnoughDataError, ParameterError
from core.imu.stamps import onward, told

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Record:
    """Readings on an even grid.

    values (n,) float64, the present readings in order; place (n,) int64, their grid places, or None where none is
    missing; tau0 [s] the grid's step; jitter [s] the root mean square of stamp minus grid time; lost, how many places
    are empty.
    """

    values: Floats
    tau0: float
    place: npt.NDArray[np.int64] | None
    jitter: float
    lost: int
    notes: tuple[str, ...] = ()

    @property
    def duration(self) -> float:
        """Seconds from the first to behind the last grid place."""
        return (len(self.values) + self.lost) * self.tau0


def to_grid(t: Floats, values: npt.NDArray[np.floating], *, window: float = 2.0) -> Record:
    """Lay readings `values` (n,) with stamps `t` (n,) [s] on the even grid that the sensor sampled on.

    NaN readings are dropped (their places stay empty), and those whose stamps go back or repeat, with a note.
    `window` [s]: a stamp that is late for longer than this was not late, samples before it are missing. Raises
    NotEnoughDataError under 9 readings.
    """
    if t.shape != values.shape or t.ndim != 1:
        raise ParameterError(f"t has shape {t.shape} and the readings {values.shape}; expected one shape (n,)")
    kept = onward(t)
    notes = told(t, kept)
    kept &= np.isfinite(values)
    if not kept.all():
        t, values = t[kept], values[kept]
    n = t.shape[0]
    if n < 9:
        raise NotEnoughDataError(
            f"{n} finite readings are too few for an Allan deviation: at least 9", found=n, expected=9
        )
    step = np.diff(t)
    mean = (t[-1] - t[0]) / (n - 1)
    if float(step.max()) < 1.5 * mean:  # even, or jittered by less than half a step: nothing can be missing
        jitter = float(np.std(t - (t[0] + mean * np.arange(n)))) if n < 2_000_000 else float(np.std(step)) / np.sqrt(2)
        return Record(np.ascontiguousarray(values, np.float64), float(mean), None, jitter, 0, notes)
    made = _with_gaps(t, np.ascontiguousarray(values, np.float64), step, window)
    return replace(made, notes=notes + made.notes)


def _with_gaps(t: Floats, values: Floats, step: Floats, window: float) -> Record:
    """Places by the lower envelope of the stamps' delay: a burst catches up with it, a loss lifts it for good."""
    from scipy.ndimage import minimum_filter1d

    n = t.shape[0]
    tau0 = _grid_step(t, step)
    reach = min(n, max(2, round(window / tau0)))
    index = np.arange(n)
    lost_before = np.zeros(n, np.int64)
    # Large pauses first (they would hide small ones), then what the envelope still rises by.
    pauses = np.where(step > window, np.round(step / tau0) - 1, 0).astype(np.int64)
    lost_before[1:] = np.cumsum(pauses)
    for _ in range(3):
        delay = t - t[0] - tau0 * (index + lost_before)
        envelope = minimum_filter1d(delay, reach, origin=-(reach // 2), mode="nearest")
        rise = np.diff(envelope)
        missing = np.where(rise > 0.6 * tau0, np.round(rise / tau0), 0).astype(np.int64)
        if not missing.any():
            break
        lost_before[1:] += np.cumsum(missing)
        tau0 = float((t[-1] - t[0]) / (n - 1 + lost_before[-1]))
    place = index + lost_before
    lost = int(lost_before[-1])
    jitter = float(np.std(t - t[0] - tau0 * place))
    notes = []
    if lost:
        notes.append(
            f"{lost} of {n + lost} samples are missing; averages that they would enter are left out or thinned"
        )
    if jitter > tau0:
        notes.append(
            f"stamps jitter by {jitter * 1e3:.1f} ms against a step of {tau0 * 1e3:.1f} ms; order, not stamps, was used"
        )
    return Record(values, tau0, place if lost else None, jitter, lost, tuple(notes))


def _grid_step(t: Floats, step: Floats) -> float:
    """The sensor's step: the mean over stretches without a long pause, so that losses do not stretch it."""
    typical = float(np.median(step))
    mean = float(np.mean(step))
    # Bursty stamps: the median says nothing; the mean over the quieter half of the steps' blocks does.
    if typical < 0.5 * mean or typical > 1.5 * mean:
        blocks = max(1, len(step) // 200)
        means = [float(np.mean(b)) for b in np.array_split(step, blocks)]
        return float(np.median(means))
    near = step[np.abs(step - typical) < 0.5 * typical]
    return float(np.mean(near))
