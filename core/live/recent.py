"""The last seconds of every stream: what a method looks back on when new readings come."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from core.run import Run, RunMeta
from core.sensors import STREAMS, RangeLog
from core.sensors.base import Log

Array = npt.NDArray[np.float64]

FEWEST = 16  # rows of each stream that stay, however old
MOST = 64  # pieces that wait to be put together


class Recent:
    """Rows of the last `keep` seconds, by the newest stamp of all streams. `run` is them as a Run, put together when it
    is asked for."""

    def __init__(self, meta: RunMeta, keep: float) -> None:
        self._run = Run(meta)
        self._new: list[Run] = []
        self.keep = keep

    def append(self, piece: Run) -> None:
        """Rows newer than those of their streams; what is older than `keep` before the newest piece begins goes."""
        self._new.append(piece)
        if len(self._new) > MOST:
            _ = self.run

    @property
    def run(self) -> Run:
        """The last seconds."""
        if self._new:
            new, self._new = self._new, []
            limit = new[-1].span[0] - self.keep
            logs = {name: _last(name, [self._run, *new], limit) for name in STREAMS}
            held: dict[str, Any] = {name: log for name, log in logs.items() if log is not None}
            self._run = Run(self._run.meta, **held)
        return self._run


def _last(name: str, runs: list[Run], limit: float) -> Log | None:
    """A stream of runs that follow each other, without what is older than the limit, but FEWEST rows at least."""
    logs = [log for run in runs if (log := getattr(run, name)) is not None and len(log)]
    if not logs:
        return runs[0].logs().get(name)
    whole = joined(*logs)
    first = min(int(np.searchsorted(whole.t, limit)), len(whole) - FEWEST)
    return tail(whole, first) if first > 0 else whole


def tail(log: Log, first: int) -> Log:
    """The log's rows from `first` on."""
    columns: dict[str, Any] = {name: column[first:] for name, column in log.columns().items()}
    if isinstance(log, RangeLog):
        columns["names"] = log.names
    return type(log)(**columns)


def joined(*logs: Log) -> Log:
    """Rows of logs of one stream, in order; a column that only some of them have is NaN in the others' rows."""
    if len(logs) == 1:
        return logs[0]
    columns: dict[str, Any] = {}
    parts = [log.columns() for log in logs]
    for name in dict.fromkeys(name for part in parts for name in part):
        having = [part[name] if name in part else np.full(len(part["t"]), np.nan) for part in parts]
        columns[name] = np.concatenate(having)
    ranges = [log for log in logs if isinstance(log, RangeLog)]
    if ranges:
        names = tuple(dict.fromkeys(name for log in ranges for name in log.names))
        codes = [np.array([names.index(name) for name in log.names], np.int16)[log.beacon] for log in ranges]
        columns["names"], columns["beacon"] = names, np.concatenate(codes)
    return type(logs[0])(**columns)
