"""Columns of live runs: raw files that grow, mapped up to the number of rows that their key names.

A key is `live-<run id>-<stream>-<column>-<rows>-<f8|i2>`; it stands where a stored array has its hash. What it names
never changes, as files are only appended to.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

KEY = re.compile(r"live-([0-9a-f]{16})-([a-z]+)-([a-z]+)-([0-9]{1,15})-(f8|i2)")
DTYPES: dict[str, np.dtype[Any]] = {"f8": np.dtype("<f8"), "i2": np.dtype("<i2")}


def code_of(column: str) -> str:
    """The element type of a column, as its file's name ends."""
    return "i2" if column == "beacon" else "f8"


def folder(data: Path, run_id: str) -> Path:
    """Where a live run's columns lie."""
    return data / "live" / run_id / "columns"


def key(run_id: str, stream: str, column: str, rows: int) -> str:
    """The key of a column's first so many rows."""
    return f"live-{run_id}-{stream}-{column}-{rows}-{code_of(column)}"


def open_column(data: Path, found: str) -> npt.NDArray[Any]:
    """The rows that a key names, mapped read-only. ValueError if it is none, FileNotFoundError if the run is over."""
    match = KEY.fullmatch(found)
    if match is None:
        raise ValueError(f"not a key of a live run: {found!r}")
    run_id, stream, column, rows, code = match.groups()
    path, count, dtype = folder(data, run_id) / f"{stream}.{column}.{code}", int(rows), DTYPES[code]
    if not count:
        return np.zeros(0, dtype)
    if path.stat().st_size < count * dtype.itemsize:
        raise FileNotFoundError(f"{path.name} of the live run {run_id} is shorter than {count} rows")
    mapped: npt.NDArray[Any] = np.memmap(path, dtype, mode="r", shape=(count,))
    return mapped.view(np.ndarray)
