"""The last seconds of every stream: what a method looks back on when new readings come."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import numpy.typing as npt

from core.run import Run, RunMeta
from core.sensors import STREAMS, Log

Array = npt.NDArray[np.float64]

FEWEST = 16  # rows of each stream that stay, however old


class Recent:
    """Rows of the last `keep` seconds, by the newest stamp of all streams. `run` is them as a Run."""

    def __init__(self, meta: RunMeta, keep: float) -> None:
        self.run = Run(meta)
        self.keep = keep

    def append(self, piece: Run) -> None:
        """Rows newer than those of their streams; what is older than `keep` before the piece begins goes."""
        logs: dict[str, Any] = {}
        limit = piece.span[0] - self.keep
        for name in STREAMS:
            old, new = getattr(self.run, name), getattr(piece, name)
            if old is not None and len(old) > FEWEST and float(old.t[0]) < limit:
                old = tail(old, min(int(np.searchsorted(old.t, limit)), len(old) - FEWEST))
            logs[name] = joined(old, new)
        self.run = Run(self.run.meta, **logs)

    def drop_before(self, t: float) -> None:
        """Forget all readings before a stamp."""
        self.run = self.run.crop(t, np.inf)


def tail(log: Any, first: int) -> Any:
    """The log's rows from `first` on."""
    return dataclasses.replace(log, **{name: column[first:] for name, column in log.columns().items()})


def joined(old: Log | None, new: Log | None) -> Log | None:
    """Rows of two logs of one stream; a column that only one of them has is NaN in the other's rows."""
    if old is None or new is None or not len(new):
        return new if old is None else old
    a, b = old.columns(), new.columns()
    columns: dict[str, Any] = {}
    for name in {**a, **b}:
        first = a.get(name, np.full(len(old), np.nan))
        columns[name] = np.concatenate((first, b.get(name, np.full(len(new), np.nan))))
    if hasattr(old, "names"):
        columns["names"], columns["beacon"] = _names(old, new)
    return type(old)(**columns)


def _names(old: Any, new: Any) -> tuple[tuple[str, ...], npt.NDArray[np.int16]]:
    """Beacons of both logs by one list of names."""
    names = (*old.names, *(n for n in new.names if n not in old.names))
    code = np.array([names.index(n) for n in new.names], np.int16)
    return names, np.concatenate((old.beacon, code[new.beacon] if len(new) else new.beacon))
