"""What all formats share: limits, the format's row in the table, and the sources that a reader hands out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Protocol, Self

import numpy as np
import numpy.typing as npt
import polars as pl

from core.formats.checks import BatchCheck
from core.run import RunMeta
from core.sensors import StreamSpec

if TYPE_CHECKING:
    from core.formats.mapping import ColumnMap
    from core.run import Run

ENGINE_ERRORS = (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError, OverflowError, ValueError)
"""What polars raises on hostile files; a PanicException is not an Exception."""

MAX_EPOCHLESS_S = 1e8  # no run lasts three years: larger stamps count from some epoch
KIB, MIB, GIB = 1 << 10, 1 << 20, 1 << 30
Batch = dict[str, npt.NDArray[np.generic]]


@dataclass(frozen=True)
class Limits:
    """How much a file may ask of this machine; beyond, it is refused with `TooLargeError`."""

    max_unpacked_bytes: int = 16 * GIB  # of all members of an archive, counted while they are unpacked
    max_ratio: float = 200.0  # unpacked over packed, beyond `ratio_free_bytes`
    ratio_free_bytes: int = 64 * MIB
    max_members: int = 1000
    max_rows: int = 4_000_000_000  # of one stream
    max_columns: int = 1000
    max_header_bytes: int = 64 * KIB
    max_line_bytes: int = MIB
    max_footer_bytes: int = 16 * MIB  # of a parquet file
    max_decode_bytes: int = 2 * GIB  # memory to decode a parquet file's batches in
    max_json_bytes: int = 4 * MIB
    max_json_depth: int = 32
    max_names: int = 4096  # different beacon names in one stream
    unordered: frozenset[str] = frozenset()  # streams whose stamps may go back: who reads them mends that


class Table(Protocol):
    """One opened table file: its column names are known, its rows are not read yet."""

    file: str
    names: tuple[str, ...]
    typed: bool  # the file states its columns' types

    def dtypes(self) -> Mapping[str, pl.DataType]:
        """Column types where the file states them, else those of its first rows."""
        ...

    def scan(self, numbers: tuple[str, ...], texts: tuple[str, ...], *, count_rows: str | None = None) -> pl.LazyFrame:
        """The columns asked for, numbers as the file's own float or integer type; lazily, in the file's order."""
        ...

    def explain(self, error: BaseException | None, stream: str | None) -> None:
        """Raise a FormatError with the exact place that made the engine fail; return if nothing is wrong."""
        ...

    def check_shape(self, stream: str | None) -> None:
        """Raise a FormatError at the first row with too few or too many fields."""
        ...

    def cell(self, row: int, column: str) -> str | None:
        """The text of one cell as the file has it (row 1 is the first data row), for messages."""
        ...

    def head(self, rows: int) -> list[tuple[str | None, ...]]:
        """The first rows as text, in the order of `names`."""
        ...


@dataclass
class StreamSource:
    """One stream of an opened run: read it batch by batch.

    `columns`: the dtype of each column that every batch has, `t` first (float64). `names`: the categories of a text
    column (beacon names) in order of appearance, complete once `batches` is exhausted. `sources`: the table's column
    that each column comes from; `row_column` counts the table's rows where not every row belongs to the stream.
    """

    spec: StreamSpec
    table: Table
    columns: Mapping[str, np.dtype[np.generic]]
    frames: Callable[[], Iterator[pl.DataFrame]]
    limits: Limits
    sources: Mapping[str, str]
    row_column: str | None = None
    names_seen: list[str] = field(default_factory=list)

    @property
    def name(self) -> str:
        """The stream's name in the run format."""
        return self.spec.name

    @property
    def names(self) -> tuple[str, ...]:
        """Categories seen so far."""
        return tuple(self.names_seen)

    def batches(self) -> Iterator[Batch]:
        """Column batches in order, checked: finite and strictly increasing t, no infinity, right types.

        Raises FormatError, with file, stream, row and column, at the first thing that is wrong; and at the end if
        there was no row at all.
        """
        self.names_seen.clear()
        check = BatchCheck(self)
        for frame in self.frames():
            if frame.height:
                yield check.convert(frame)
        check.finish()


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
