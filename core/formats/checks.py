"""The checks that every reading passes, batch by batch, once, where it enters: types, stamps, infinities, names."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
import numpy.typing as npt
import polars as pl

from core.errors import FormatError, StampOrderError, TooLargeError

if TYPE_CHECKING:
    from core.formats.base import Batch, StreamSource

Bools = npt.NDArray[np.bool_]
MAX_NAME_CHARS = 200


def shown(value: object, limit: int = 60) -> str:
    """A value for a message: quoted if text, cut if long, control characters escaped."""
    text = repr(value) if isinstance(value, str) else f"{value}"
    return text if len(text) <= limit else f"{text[: limit - 3]}..."


def refuse(file: str, what: str, *, kind: type[FormatError] = FormatError, **where: object) -> NoReturn:
    """Raise a FormatError whose message starts with the place (file, stream, row, column) and ends with `what`."""
    place = [file]
    if where.get("stream"):
        place.append(f"stream {where['stream']}")
    if where.get("row"):
        place.append(f"row {where['row']}")
    if where.get("column"):
        place.append(f"column {shown(where['column'])}")
    raise kind(f"{', '.join(place)}: {what}", file=file, **where)


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
