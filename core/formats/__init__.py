"""The table of file formats. You give a path; we say which format it is, and hand out checked streams or a Run.

To add a format: a file here with its FORMAT, and a row in FORMATS. Every error is one of `core.errors`, and names
file, stream, row (1 is the first data row), column, what was expected and what was found.
"""

from __future__ import annotations

from pathlib import Path

from core.errors import FormatError, ParameterError, UnknownFormatError
from core.formats import run_folder, run_zip
from core.formats.base import Batch, Format, Limits, Opening, RunSource, StreamSource
from core.formats.run_json import meta_from_json, meta_to_json
from core.formats.streams import read_all
from core.run import Run

FORMATS: dict[str, Format] = {f.name: f for f in (run_folder.FORMAT, run_zip.FORMAT)}

WRITERS = {name: writer for f in FORMATS.values() for name, writer in f.write.items()}
"""What `write_run` can write, by name."""

HEAD_BYTES = 4096


def sniff(path: Path) -> Format:
    """The format of a file or folder, by its first bytes. UnknownFormatError if no reader recognises it."""
    if not path.exists():
        raise UnknownFormatError(f"{path.name}: there is no such file", file=path.name)
    head = b""
    if path.is_file():
        with path.open("rb") as f:
            head = f.read(HEAD_BYTES)
    for known in FORMATS.values():
        if known.sniff(path, head):
            return known
    expected = ", ".join(f.label for f in FORMATS.values())
    raise UnknownFormatError(
        f"{path.name}: not a file that can be read; expected one of: {expected}", file=path.name, expected=expected
    )


def open_run(
    path: Path, *, limits: Limits | None = None, tmp: Path | None = None, name: str | None = None
) -> RunSource:
    """Open a run for reading in batches, in bounded memory; use it in a `with`, it may hold temporary files.

    `tmp` is where archives are unpacked to; `name` is what to call the file in messages if it is stored under another.
    """
    opening = Opening(limits or Limits(), None, tmp, name)
    return sniff(path).open(path, opening)


def read_run(path: Path, *, limits: Limits | None = None) -> Run:
    """The whole run in memory. FormatError and its kin where the file breaks its format."""
    with open_run(path, limits=limits) as source:
        return read_all(source)


def write_run(run: Run, path: Path, format: str) -> None:  # noqa: A002
    """Write a run: format is one of WRITERS ('folder-csv', 'folder-parquet', 'zip-csv', 'zip-parquet')."""
    if format not in WRITERS:
        known = ", ".join(WRITERS)
        raise ParameterError(f"unknown format {format!r}; expected one of {known}", parameter="format", expected=known)
    WRITERS[format](run, path)


__all__ = [
    "FORMATS",
    "WRITERS",
    "Batch",
    "Format",
    "FormatError",
    "Limits",
    "RunSource",
    "StreamSource",
    "meta_from_json",
    "meta_to_json",
    "open_run",
    "read_run",
    "sniff",
    "write_run",
]
