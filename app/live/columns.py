"""Readings of a run that still grows, as raw columns that the store maps: `data/live/<id>/columns/imu.gz.f8`.

They are made from the log and made again from it after a crash, so they are not synced. A key of the store names a
column with its number of rows (`app.store.growing`): a reader sees so many rows, whatever is appended meanwhile.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from app.ingest import sparkline
from app.store import growing
from core.robot import RobotParams
from core.sensors import STREAMS
from core.timing import rate

RATE_ROWS = 2000  # newest stamps that the rate is told from


class Columns:
    """The columns of one run: rows are added in memory, and to the files by `flush`."""

    def __init__(self, data: Path, run_id: str) -> None:
        self._data, self._id = data, run_id
        self.folder = growing.folder(data, run_id)
        self.folder.mkdir(parents=True, exist_ok=True)
        self._waiting: dict[str, list[dict[str, Any]]] = {}
        self._adding, self._flushing = threading.Lock(), threading.Lock()
        self._kept: dict[str, dict[str, int]] = {}  # rows on file, per stream and column
        self._span: dict[str, list[float]] = {}
        self._gaps: dict[str, list[list[float]]] = {}
        self._steps: dict[str, float] = {}
        self.names: list[str] = []  # of beacons, in order of appearance

    def add(self, streams: Mapping[str, Mapping[str, npt.NDArray[Any]]]) -> None:
        """Rows of some streams; ranges with `beacon` as codes into `names`."""
        with self._adding:
            for name, columns in streams.items():
                self._waiting.setdefault(name, []).append(dict(columns))

    def flush(self) -> list[dict[str, Any]]:
        """Append to the files; the streams as the store's rows describe them."""
        with self._flushing:
            with self._adding:
                waiting, self._waiting = self._waiting, {}
            for name, parts in waiting.items():
                self._append(name, parts)
            return [self._described(name) for name in STREAMS if name in self._kept]

    def _append(self, name: str, parts: list[dict[str, Any]]) -> None:
        kept = self._kept.setdefault(name, {})
        before = kept.get("t", 0)
        rows = sum(len(part["t"]) for part in parts)
        for column in dict.fromkeys([*kept, *(c for part in parts for c in part)]):
            code = growing.code_of(column)
            dtype = growing.DTYPES[code]
            values = [part.get(column, np.full(len(part["t"]), np.nan)) for part in parts]
            if column not in kept:  # the first rows did not have it
                values = [np.full(before, np.nan), *values]
            with (self.folder / f"{name}.{column}.{code}").open("ab") as file:
                file.write(np.concatenate(values).astype(dtype).tobytes())
            kept[column] = before + rows
        t = np.concatenate([part["t"] for part in parts])
        self._note_gaps(name, t)
        span = self._span.setdefault(name, [float(t[0]), float(t[-1])])
        span[1] = float(t[-1])

    def _note_gaps(self, name: str, t: npt.NDArray[np.float64]) -> None:
        if name in self._span:
            t = np.concatenate(([self._span[name][1]], t))
        step = np.diff(t)
        if not len(step):
            return
        typical = self._steps.setdefault(name, float(np.median(step)))
        found = self._gaps.setdefault(name, [])
        found += [[float(t[i]), float(t[i + 1])] for i in np.flatnonzero(step > 10 * typical)]
        del found[:-100]

    def open(self, name: str, column: str) -> npt.NDArray[Any]:
        """A column as far as it is on file."""
        return growing.open_column(self._data, growing.key(self._id, name, column, self._kept[name][column]))

    def _described(self, name: str) -> dict[str, Any]:
        kept, span = self._kept[name], self._span[name]
        stamps = self.open(name, "t")[-RATE_ROWS:]
        return {
            "name": name,
            "rows": kept["t"],
            "t0": span[0],
            "t1": span[1],
            "rate_hz": rate(stamps),
            "gaps": list(self._gaps.get(name, [])),
            "columns": {c: growing.key(self._id, name, c, n) for c, n in kept.items()},
            "names": list(self.names) if name == "ranges" else [],
        }

    def sparkline(self, robot: RobotParams) -> list[list[float]]:
        """The path as a run's row shows it."""
        held: dict[str, Mapping[str, Any]] = {
            s: {c: self.open(s, c) for c in self._kept[s]} for s in ("truth", "beacon", "wheels") if s in self._kept
        }
        return sparkline(held, robot)

    def all(self) -> dict[str, dict[str, npt.NDArray[Any]]]:
        """Every column as far as it is on file."""
        return {stream: {column: self.open(stream, column) for column in kept} for stream, kept in self._kept.items()}
