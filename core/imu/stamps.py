"""Stamps that go back in time or repeat: which readings are kept, and what is told of the others."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from core.sensors import ImuLog

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


def onward(t: Floats) -> Flags:
    """(N,) which of the stamps t (N,) [s] to keep so that they increase strictly; those not finite are not.

    Either those after all before them (a clock that was set back: what it stamps twice is left out), or those before
    all behind them (a stamp far too late: it alone is left out), whichever keeps more.
    """
    good = np.isfinite(t)
    if good.all() and bool((t[1:] > t[:-1]).all()):
        return good
    low, high = np.where(good, t, -np.inf), np.where(good, t, np.inf)
    after, before = good.copy(), good.copy()
    after[1:] &= t[1:] > np.maximum.accumulate(low)[:-1]
    before[:-1] &= t[:-1] < np.minimum.accumulate(high[::-1])[::-1][1:]
    return after if after.sum() >= before.sum() else before


def told(t: Floats, kept: Flags) -> tuple[str, ...]:
    """A note on the finite stamps that are not `kept` (N,): how many, and where the first one goes back."""
    out = int((np.isfinite(t) & ~kept).sum())
    if not out:
        return ()
    known = np.flatnonzero(np.isfinite(t))
    k = int(np.argmax(~(t[known][1:] > t[known][:-1])))
    now, last = t[known[k + 1]], t[known[k]]
    where = f"row {known[k + 1] + 1} says {now:.9g} s after {last:.9g} s"
    return (f"Stamps go back in time or repeat, first where {where}; {out} of {len(t)} readings are left out.",)


def in_order(imu: ImuLog) -> tuple[ImuLog, tuple[str, ...]]:
    """The readings whose stamps go on, and what was left out."""
    kept = onward(imu.t)
    if kept.all():
        return imu, ()
    columns = {name: column[kept] for name, column in imu.columns().items()}
    return ImuLog(**columns), told(imu.t, kept)  # type: ignore[arg-type]  # columns() says its names only at run time
