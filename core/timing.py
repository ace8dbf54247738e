"""Clocks: the typical step of a stream's stamps, its rate, and where the stamps pause."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Stamps = npt.NDArray[np.float64]
SAMPLE = 100_000  # steps looked at for the typical one
CHUNK = 1 << 20  # steps differenced at once: a day of stamps may be a memory map


def typical_step(t: Stamps) -> float:
    """Typical time between two stamps [s]: mean of the steps within 50 % of the median step; 0 below two stamps.

    The median alone is wrong for rounded stamps (384 Hz in whole milliseconds has steps of 2 and 3 ms), the mean alone
    for pauses. Of long streams an even sample of the steps is taken, so this is cheap on a memory map.
    """
    n = t.shape[0] - 1
    if n < 1:
        return 0.0
    first = np.arange(n) if n <= SAMPLE else np.linspace(0, n - 1, SAMPLE).astype(np.int64)
    steps = t[first + 1] - t[first]
    median = float(np.median(steps))
    near = steps[np.abs(steps - median) <= 0.5 * median]
    return float(near.mean()) if near.size else median


def rate(t: Stamps) -> float:
    """Typical sampling rate [Hz]: one over the typical step; 0 below two stamps."""
    step = typical_step(t)
    return 1.0 / step if step > 0 else 0.0


def gaps(t: Stamps, factor: float = 10.0) -> Stamps:
    """(M, 2) last stamp before and first stamp after each pause of more than `factor` typical steps [s]."""
    longest = factor * typical_step(t)
    parts = [
        start + np.flatnonzero(np.diff(t[start : start + CHUNK + 1]) > longest)
        for start in range(0, max(t.shape[0] - 1, 0), CHUNK)
    ]
    before = np.concatenate(parts) if parts else np.zeros(0, np.int64)
    return np.column_stack((t[before], t[before + 1])).astype(np.float64, copy=False)
