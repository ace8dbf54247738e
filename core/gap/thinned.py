"""Long runs with fewer rows, for the search: means of IMU readings, every so many of the wheels' and truth's.

The mean of m readings is what an IMU of m times the period reads, so the simulator predicts it exactly. What varies
slower than a twentieth of a second is told as well by fewer rows; noise and scores are taken from all of them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from core.run import Run

Array = npt.NDArray[np.float64]

ROWS = {"imu": 15_000, "wheels": 12_000, "truth": 8_000}
"""So many rows of a stream, of all runs together, are enough for a search."""
SLOWEST = {"imu": 20.0, "wheels": 20.0, "truth": 10.0}
"""No stream is taken slower than this [1/s]."""
APART = 1.5
"""Stamps further apart than this many periods lie on both sides of a gap."""


def thinned(runs: Sequence[Run]) -> list[Run]:
    """The runs as the search sees them; the same ones where they are short."""
    every = {name: _every(name, runs) for name in ROWS}
    return [_fewer(run, every) for run in runs] if max(every.values()) > 1 else list(runs)


def _every(name: str, runs: Sequence[Run]) -> int:
    """How many rows of a stream become one."""
    logs = [log for run in runs if (log := getattr(run, name)) is not None and len(log) > 1]
    if not logs:
        return 1
    rate = min(1.0 / max(float(np.median(np.diff(log.t))), 1e-6) for log in logs)
    return max(min(sum(len(log) for log in logs) // ROWS[name], int(rate / SLOWEST[name])), 1)


def _fewer(run: Run, every: dict[str, int]) -> Run:
    kept: dict[str, Any] = {}
    for name, count in every.items():
        log = getattr(run, name)
        if log is None or count == 1 or (name == "wheels" and run.commands is None):
            continue
        kept[name] = _means(log, count) if name == "imu" else _columns(log, lambda v, n=count: v[::n])
    return dataclasses.replace(run, **kept)


def _means(log: Any, count: int) -> Any:
    """Means of `count` readings that follow each other without a gap."""
    whole = len(log.t) // count * count
    t = log.t[:whole].reshape(-1, count)
    near = np.ptp(t, axis=1) < APART * (count - 1) * float(np.median(np.diff(log.t)))
    return _columns(log, lambda v: v[:whole].astype(np.float64).reshape(-1, count).mean(axis=1)[near])


def _columns(log: Any, change: Any) -> Any:
    columns = {
        field.name: np.ascontiguousarray(change(value))
        for field in dataclasses.fields(log)
        if isinstance(value := getattr(log, field.name), np.ndarray)
    }
    return dataclasses.replace(log, **columns)
