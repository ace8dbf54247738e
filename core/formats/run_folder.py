"""Run folder: `run.json` and one NAME.csv or NAME.parquet per stream; in `sim/` the same of a simulated run."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path, PurePosixPath

import polars as pl

from core.errors import FormatError
from core.formats.base import Format, Opening, RunSource
from core.formats.checks import refuse, shown
from core.formats.csv_table import CsvTable
from core.formats.limits import Limits
from core.formats.parquet_table import ParquetTable
from core.formats.run_json import read_run_json, write_run_json
from core.formats.source import Table
from core.formats.streams import native_stream
from core.run import Run
from core.sensors import STREAMS, Log, RangeLog

DESCRIPTION = "run.json"
SIMULATED = "sim"
"""Folder of a simulated run beside the real one."""
TABLES: dict[str, type[CsvTable] | type[ParquetTable]] = {".csv": CsvTable, ".parquet": ParquetTable}
"""Table formats by file suffix."""


def open_folder(path: Path, opening: Opening) -> RunSource:
    """A run folder, and the simulated run beside it."""
    files = {file.name: file for file in sorted(path.iterdir()) if not file.name.startswith(".")}
    folders = [name for name, file in files.items() if file.is_dir()]
    source = open_files(
        {n: f for n, f in files.items() if n not in folders}, opening, opening.name or path.resolve().name, "folder"
    )
    beside = path / SIMULATED
    if SIMULATED in folders and (beside / DESCRIPTION).is_file():
        folders.remove(SIMULATED)
        inside = {f.name: f for f in sorted(beside.iterdir()) if f.is_file() and not f.name.startswith(".")}
        source.simulated = open_files(inside, opening, f"{source.file}/{SIMULATED}", "folder", f"{SIMULATED}/")
    source.found += [f"folder {name!r} was ignored" for name in folders]
    return source


def open_files(files: dict[str, Path], opening: Opening, label: str, kind: str, inside: str = "") -> RunSource:
    """A run from its files by name: what a folder and an archive have in common. inside: the folder, for messages."""
    if DESCRIPTION not in files:
        refuse(label, f"there is no {DESCRIPTION}", expected=DESCRIPTION, found=sorted(files)[:50])
    tables = stream_files(list(files), label)
    meta, warnings = read_run_json(files[DESCRIPTION], inside + DESCRIPTION, opening.limits)
    if not tables:
        refuse(
            label,
            "there is no stream",
            expected=[f"{n}.csv" for n in STREAMS] + ["or .parquet"],
            found=sorted(files)[:50],
        )
    streams = tuple(
        native_stream(
            STREAMS[name], _open_table(files[tables[name]], inside + tables[name], opening.limits, name), opening.limits
        )
        for name in STREAMS
        if name in tables
    )
    ignored = sorted(set(files) - set(tables.values()) - {DESCRIPTION})
    warnings += [f"file {inside + name!r} was ignored: not part of a run" for name in ignored]
    return RunSource(label, kind, meta, streams, warnings)


def _open_table(path: Path, file: str, limits: Limits, stream: str) -> Table:
    return TABLES[PurePosixPath(file).suffix](path, file, limits, stream)


def stream_files(names: list[str], label: str) -> dict[str, str]:
    """The table file of each stream. A table that is no stream, and a stream with two tables, are refused."""
    tables: dict[str, str] = {}
    for name in sorted(names):
        stem, suffix = PurePosixPath(name).stem, PurePosixPath(name).suffix
        if suffix.lower() not in TABLES:
            continue
        if stem not in STREAMS or suffix not in TABLES:
            expected = [f"{stream}{suffix.lower()}" for stream in STREAMS]
            refuse(
                label,
                f"{shown(name)} is no stream; expected one of {', '.join(expected)}",
                expected=expected,
                found=name,
            )
        if stem in tables:
            refuse(
                label,
                f"there are both {tables[stem]} and {name}",
                stream=stem,
                expected="one table per stream",
                found=[tables[stem], name],
            )
        tables[stem] = name
    return tables


def write_csv(run: Run, path: Path, simulated: Run | None = None) -> None:
    """Write a run folder of CSV files."""
    write_folder(run, path, ".csv", simulated)


def write_parquet(run: Run, path: Path, simulated: Run | None = None) -> None:
    """Write a run folder of parquet files."""
    write_folder(run, path, ".parquet", simulated)


def write_folder(run: Run, path: Path, suffix: str, simulated: Run | None = None) -> None:
    """Write `run.json` and a table per stream that has readings. The run is checked first, nothing is overwritten.

    simulated: goes into `sim/` beside them.
    """
    frames = {name: log_frame(name, log) for name, log in run.logs().items() if len(log)}
    path.mkdir(parents=True, exist_ok=True)
    if any(path.iterdir()):
        raise FormatError(f"{path.name}: expected a new or empty folder", file=path.name, expected="an empty folder")
    write_run_json(run.meta, path / DESCRIPTION)
    for name, frame in frames.items():
        WRITERS[suffix](frame, path / f"{name}{suffix}")
    if simulated is not None:
        write_folder(simulated, path / SIMULATED, suffix)


def log_frame(name: str, log: Log) -> pl.DataFrame:
    """A stream as a frame: absent values null, beacons by name."""
    columns = dict(log.columns())
    frame = pl.DataFrame(columns)
    if isinstance(log, RangeLog):
        by_code = dict(enumerate(log.names))
        frame = frame.with_columns(pl.col("beacon").replace_strict(by_code, return_dtype=pl.String))
    return frame


def _csv(frame: pl.DataFrame, path: Path) -> None:
    # float32 as float64: its shortest text would not read back to the same float64.
    floats = pl.col(pl.Float32, pl.Float64).cast(pl.Float64).fill_nan(None)
    frame.with_columns(floats).write_csv(path)


def _parquet(frame: pl.DataFrame, path: Path) -> None:
    frame.with_columns(pl.col(pl.Float32, pl.Float64).fill_nan(None)).write_parquet(path)


WRITERS: dict[str, Callable[[pl.DataFrame, Path], None]] = {".csv": _csv, ".parquet": _parquet}

FORMAT = Format(
    name="folder",
    label="run folder",
    suffixes=(),
    sniff=lambda name, head: head is None,
    open=open_folder,
    write={"folder-csv": write_csv, "folder-parquet": write_parquet},
)
