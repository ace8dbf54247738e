"""The table of file formats. You give a path; we say which format it is, and hand out checked streams or a Run.

To add a format: a file here with its FORMAT, and a row in FORMATS. Every error is one of `core.errors`, and names
file, stream, row (1 is the first data row), column, what was expected and what was found.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path, PurePath

from core.errors import FormatError, ParameterError, UnknownFormatError
from core.formats import csv_table, parquet_table, run_folder, run_zip, tum
from core.formats.base import Format, Opening, RunSource
from core.formats.kitti import write_kitti
from core.formats.limits import Limits
from core.formats.mapping import UNITS, ColumnMap, ColumnSource, suggest_mapping
from core.formats.run_json import meta_from_json, meta_to_json
from core.formats.single import fitting_stream
from core.formats.source import Batch, StreamSource, Table
from core.formats.streams import read_all
from core.run import Run
from core.trajectory import Trajectory

FORMATS: dict[str, Format] = {
    f.name: f for f in (run_folder.FORMAT, run_zip.FORMAT, parquet_table.FORMAT, tum.FORMAT, csv_table.FORMAT)
}
"""What can be read, in the order in which a file is tried."""

WRITERS: dict[str, Callable[[Run, Path, Run | None], None]] = {
    name: writer for f in FORMATS.values() for name, writer in f.write.items()
}
"""What `write_run` can write, by name."""

TRAJECTORY_WRITERS: dict[str, Callable[[Trajectory, Path], None]] = {"tum": tum.write_tum, "kitti": write_kitti}
"""What `write_trajectory` can write, by name."""

HEAD_BYTES = 4096


def sniff(path: Path, name: str | None = None) -> Format:
    """The format of a file or folder, by its first bytes, else by its suffix. UnknownFormatError if none fits."""
    file = name or path.name
    if not path.exists():
        raise UnknownFormatError(f"{file}: there is no such file", file=file)
    head = None
    if not path.is_dir():
        with path.open("rb") as f:
            head = f.read(HEAD_BYTES)
    suffix = PurePath(file).suffix.lower()
    for known in FORMATS.values():
        if known.sniff(file, head):
            return known
    for known in FORMATS.values():
        if head is not None and suffix in known.suffixes:
            return known
    expected = ", ".join(f.label for f in FORMATS.values())
    raise UnknownFormatError(f"{file}: cannot be read; expected one of: {expected}", file=file, expected=expected)


def open_run(
    path: Path,
    *,
    limits: Limits | None = None,
    mapping: ColumnMap | Mapping[str, object] | None = None,
    tmp: Path | None = None,
    name: str | None = None,
) -> RunSource:
    """Open a run for reading in batches, in bounded memory; use it in a `with`, it may hold temporary files.

    `mapping` (or its JSON form) says what the columns of a single foreign table are; without it such a table raises
    NeedsMappingError. `tmp` is where archives are unpacked to. `name` is the file's own name, if it is stored under
    another. Raises FormatError and its kin, here or from the streams' batches, where the file breaks its format.
    """
    if mapping is not None and not isinstance(mapping, ColumnMap):
        mapping = ColumnMap.from_json(mapping)
    return sniff(path, name).open(path, Opening(limits or Limits(), mapping, tmp, name))


def open_table(path: Path, name: str | None = None, limits: Limits | None = None) -> Table:
    """A CSV or parquet file by itself, to look into: its column names, types and first rows."""
    found = sniff(path, name)
    if found.table is None:
        raise UnknownFormatError(
            f"{name or path.name}: expected one table; found a {found.label}", file=name or path.name
        )
    return found.table(path, name or path.name, limits or Limits())


def read_run(
    path: Path,
    *,
    limits: Limits | None = None,
    mapping: ColumnMap | Mapping[str, object] | None = None,
    name: str | None = None,
) -> Run:
    """The whole run in memory; arguments and errors as for `open_run`."""
    with open_run(path, limits=limits, mapping=mapping, name=name) as source:
        return read_all(source)


def read_simulated(path: Path, *, limits: Limits | None = None) -> Run | None:
    """The simulated run that lies in `sim/` beside a real one, None without; errors as for `open_run`."""
    with open_run(path, limits=limits) as source:
        return None if source.simulated is None else read_all(source.simulated)


def write_run(run: Run, path: Path, format: str, simulated: Run | None = None) -> None:  # noqa: A002
    """Write a run: format is one of WRITERS ('folder-csv', 'folder-parquet', 'zip-csv', 'zip-parquet').

    simulated: a simulated run, to lie in `sim/` beside it.
    """
    if format not in WRITERS:
        known = ", ".join(WRITERS)
        raise ParameterError(f"unknown format {format!r}; expected one of {known}", parameter="format", expected=known)
    WRITERS[format](run, path, simulated)


def write_trajectory(trajectory: Trajectory, path: Path, format: str) -> None:  # noqa: A002
    """Write a path: format is 'tum' or 'kitti'."""
    if format not in TRAJECTORY_WRITERS:
        known = ", ".join(TRAJECTORY_WRITERS)
        raise ParameterError(f"unknown format {format!r}; expected one of {known}", parameter="format", expected=known)
    TRAJECTORY_WRITERS[format](trajectory, path)


__all__ = [
    "FORMATS",
    "TRAJECTORY_WRITERS",
    "UNITS",
    "WRITERS",
    "Batch",
    "ColumnMap",
    "ColumnSource",
    "Format",
    "FormatError",
    "Limits",
    "RunSource",
    "StreamSource",
    "Table",
    "fitting_stream",
    "meta_from_json",
    "meta_to_json",
    "open_run",
    "open_table",
    "read_run",
    "read_simulated",
    "sniff",
    "suggest_mapping",
    "write_run",
    "write_trajectory",
]
