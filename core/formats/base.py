"""What all formats share: limits, the format's row in the table, and the sources that a reader hands out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

import polars as pl

from core.formats.limits import Limits
from core.formats.source import StreamSource, Table
from core.run import RunMeta

if TYPE_CHECKING:
    from core.formats.mapping import ColumnMap
    from core.run import Run

ENGINE_ERRORS = (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError, OverflowError, ValueError)
"""What polars raises on hostile files; a PanicException is not an Exception."""

MAX_EPOCHLESS_S = 1e8  # no run lasts three years: larger stamps count from some epoch


@dataclass
class RunSource:
    """An opened run: its description, warnings, and streams to be read one after the other. Close it after use.

    `simulated`: the simulated run that lies beside it in a folder `sim/`, where there is one.
    """

    file: str
    format: str
    meta: RunMeta
    sources: tuple[StreamSource, ...]
    found: list[str] = field(default_factory=list)
    cleanup: ExitStack = field(default_factory=ExitStack)
    simulated: RunSource | None = None

    def streams(self) -> Iterator[StreamSource]:
        """The streams in the run format's order."""
        return iter(self.sources)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user should read: unknown keys, ignored files; after reading, beacons that run.json does not list."""
        told = []
        for source in self.sources:
            unknown = [name for name in source.names if name not in self.meta.beacons]
            if unknown:
                shown = ", ".join(map(repr, unknown[:10])) + ", ..." * (len(unknown) > 10)
                told.append(f"{source.table.file}: not listed in run.json, so their distances cannot be used: {shown}")
        return (*self.found, *told)

    def close(self) -> None:
        """Remove temporary files."""
        self.cleanup.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


@dataclass(frozen=True)
class Opening:
    """What a caller gives to a reader besides the path: limits, a column mapping, and where to unpack to."""

    limits: Limits = field(default_factory=Limits)
    mapping: ColumnMap | None = None
    tmp: Path | None = None  # default: the system's temporary directory
    name: str | None = None  # the file's name for messages and sniffing, if it is stored under another


@dataclass(frozen=True)
class Format:
    """One file format. `sniff(name, head)` says whether a file is one; `head` holds its first bytes, None: a folder."""

    name: str
    label: str
    suffixes: tuple[str, ...]
    sniff: Callable[[str, bytes | None], bool]
    open: Callable[[Path, Opening], RunSource]
    table: Callable[[Path, str, Limits], Table] | None = None  # for formats that are one table
    write: Mapping[str, Callable[[Run, Path, Run | None], None]] = field(default_factory=dict)
