"""One stream of an opened run, read batch by batch; every batch passes the checks once, where it enters."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NoReturn, Protocol

import numpy as np
import numpy.typing as npt
import polars as pl

from core.errors import StampOrderError, TooLargeError
from core.formats.checks import MAX_NAME_CHARS, refuse, shown
from core.formats.limits import Limits
from core.sensors import StreamSpec

Bools = npt.NDArray[np.bool_]
Batch = dict[str, npt.NDArray[np.generic]]


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


class BatchCheck:
    """Turns the engine's frames of one stream into checked batches; remembers the last stamp between them."""

    def __init__(self, source: StreamSource) -> None:
        self.source, self.spec, self.table, self.limits = source, source.spec, source.table, source.limits
        self.columns, self.row_column = source.columns, source.row_column
        self.rows = 0  # checked so far
        self.last = -np.inf
        self._codes: dict[str, int] = {}
        self._shape_checked = False

    def convert(self, frame: pl.DataFrame) -> Batch:
        """The frame's columns as arrays, checked."""
        if frame.width - (self.row_column is not None) != len(self.columns):
            refuse(self.table.file, "its columns change within the file", stream=self.spec.name)
        self._check_shape(frame)
        batch: Batch = {}
        for name, dtype in self.columns.items():
            if name in self.spec.text_columns:
                batch[name] = self._text(frame, name)
            else:
                column = frame[name]
                if not column.dtype.is_float():
                    column = column.cast(pl.Float64)
                values = column.to_numpy().astype(dtype, copy=False)
                batch[name] = values
                bad = ~np.isfinite(values) if name == "t" else np.isinf(values)
                if bad.any():
                    self._bad_number(frame, name, bad)
        if self.spec.name not in self.limits.unordered:
            self._increasing(frame, batch["t"])
        self.rows += frame.height
        if self.rows > self.limits.max_rows:
            refuse(
                self.table.file, f"more than {self.limits.max_rows:,} rows", kind=TooLargeError, stream=self.spec.name
            )
        return batch

    def finish(self) -> None:
        """To be called after the last batch: a stream without rows is refused."""
        if self.rows:
            return
        self.table.explain(None, self.spec.name)
        refuse(
            self.table.file,
            "the stream is empty: expected at least one row of readings below the header; found none",
            stream=self.spec.name,
            expected="at least one row",
            found="no row",
        )

    def row_of(self, frame: pl.DataFrame, index: int) -> int:
        """Row in the file (1 is the first data row) of a row of this frame."""
        if self.row_column is not None:
            return int(frame[self.row_column][index]) + 1
        return self.rows + index + 1

    def _check_shape(self, frame: pl.DataFrame) -> None:
        # The engine fills a row that is too short with nulls, so nulls may hide one: look once, and only then.
        if not self._shape_checked and any(column.null_count() for column in frame.iter_columns()):
            self._shape_checked = True
            self.table.check_shape(self.spec.name)

    def _text(self, frame: pl.DataFrame, name: str) -> npt.NDArray[np.generic]:
        column = frame[name]
        for value in column.unique(maintain_order=True).to_list():
            if value in self._codes:
                continue
            usable = value is not None and value.strip() and len(value) <= MAX_NAME_CHARS and value.isprintable()
            if not usable:
                index = (column.is_null() if value is None else column == value).arg_max() or 0
                self._refuse_cell(frame, index, name, "a name", "nothing" if value is None else shown(value))
            if len(self._codes) >= self.limits.max_names:
                refuse(
                    self.table.file,
                    f"more than {self.limits.max_names} different names",
                    kind=TooLargeError,
                    stream=self.spec.name,
                    column=name,
                )
            self._codes[value] = len(self._codes)
            self.source.names_seen.append(value)
        return column.replace_strict(self._codes, return_dtype=pl.Int16).to_numpy()

    def _bad_number(self, frame: pl.DataFrame, name: str, bad: Bools) -> NoReturn:
        index = int(bad.argmax())
        row = self.row_of(frame, index)
        raw = self.table.cell(row, self.source.sources[name])
        value = frame[name][index]
        found = shown(raw) if raw else ("an empty cell" if value is None else str(value))
        expected = "a finite stamp in seconds" if name == "t" else "a finite number, or nothing where there is none"
        self._refuse_cell(frame, index, name, expected, found)

    def _refuse_cell(self, frame: pl.DataFrame, index: int, column: str, expected: str, found: str) -> NoReturn:
        refuse(
            self.table.file,
            f"expected {expected}; found {found}",
            stream=self.spec.name,
            row=self.row_of(frame, index),
            column=self.source.sources[column],
            expected=expected,
            found=found,
        )

    def _increasing(self, frame: pl.DataFrame, t: npt.NDArray[Any]) -> None:
        later = t[1:] > t[:-1]
        if t[0] > self.last and later.all():
            self.last = float(t[-1])
            return
        index = 0 if t[0] <= self.last else int(later.argmin()) + 1
        before, now = (self.last if index == 0 else float(t[index - 1])), float(t[index])
        relation = "repeats" if now == before else "is before"
        refuse(
            self.table.file,
            f"stamps must increase strictly; {now!r} {relation} {before!r} of the row above",
            kind=StampOrderError,
            stream=self.spec.name,
            row=self.row_of(frame, index),
            column=self.source.sources["t"],
            expected=f"a stamp after {before!r}",
            found=f"{now!r}",
        )
