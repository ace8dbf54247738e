"""Parquet: one table with typed columns. Opened by its footer; read in row batches by the streaming engine."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NoReturn

import polars as pl

from core.errors import TooLargeError
from core.formats.base import ENGINE_ERRORS, Format, Opening, RunSource
from core.formats.checks import refuse, shown
from core.formats.limits import Limits
from core.formats.parquet_trial import refusal
from core.formats.single import open_single

MAGIC = b"PAR1"


class ParquetTable:
    """An opened parquet file; see `core.formats.base.Table`."""

    typed = True

    def __init__(self, path: Path, file: str, limits: Limits, stream: str | None = None) -> None:
        self.path, self.file, self.limits = path, file, limits
        self._check_footer(stream)
        reason = refusal(path, limits.max_decode_bytes)
        if reason is not None:
            self._refuse(reason, stream)
        try:
            self.schema = pl.read_parquet_schema(path)
        except ENGINE_ERRORS as error:
            self._broken(error, stream)
        self.names = tuple(self.schema)
        if len(self.names) > limits.max_columns:
            refuse(
                file,
                f"expected at most {limits.max_columns} columns; found {len(self.names)}",
                kind=TooLargeError,
                stream=stream,
                expected=f"at most {limits.max_columns} columns",
                found=len(self.names),
            )

    def dtypes(self) -> Mapping[str, pl.DataType]:
        """Column types from the footer."""
        return self.schema

    def scan(self, numbers: tuple[str, ...], texts: tuple[str, ...], *, count_rows: str | None = None) -> pl.LazyFrame:
        """The columns asked for; numbers in their own type, names as strings."""
        frame = pl.scan_parquet(self.path, glob=False, use_statistics=False, row_index_name=count_rows)
        names = [pl.col(n).cast(pl.String) for n in texts]
        return frame.select(*([count_rows] if count_rows else []), *numbers, *names)

    def explain(self, error: BaseException | None, stream: str | None) -> None:
        """A parquet file that fails while it is read is damaged; the engine's reason is all there is to say."""
        if error is not None:
            self._broken(error, stream)

    def check_shape(self, stream: str | None) -> None:
        """Columns of a parquet file always have one length."""

    def cell(self, row: int, column: str) -> str | None:
        """Typed columns show their value themselves."""
        return None

    def head(self, rows: int) -> list[tuple[str | None, ...]]:
        """The first rows as text."""
        try:
            texts = pl.all().cast(pl.String, strict=False)
            return pl.scan_parquet(self.path, glob=False).head(rows).select(texts).collect(engine="streaming").rows()
        except ENGINE_ERRORS as error:
            self._broken(error, None)

    def _check_footer(self, stream: str | None) -> None:
        size = self.path.stat().st_size
        with self.path.open("rb") as f:
            start = f.read(4)
            f.seek(max(0, size - 8))
            end = f.read(8)
        if size == 0:
            refuse(self.file, "the file is empty", stream=stream, expected="a parquet file", found="0 bytes")
        if start != MAGIC:
            refuse(
                self.file,
                f"not a parquet file: expected to start with 'PAR1'; found {start!r}",
                stream=stream,
                expected="PAR1",
                found=repr(start),
            )
        length = int.from_bytes(end[:4], "little")
        if size < 12 or end[4:] != MAGIC or length > size - 12:
            refuse(
                self.file,
                "the parquet file is cut short or damaged: expected a footer that ends with 'PAR1'",
                stream=stream,
                expected="a footer that ends with PAR1",
                found=repr(end[4:]),
            )
        if length > self.limits.max_footer_bytes:
            refuse(
                self.file,
                f"the footer takes {length:,} bytes; expected at most {self.limits.max_footer_bytes:,}",
                kind=TooLargeError,
                stream=stream,
                expected=self.limits.max_footer_bytes,
                found=length,
            )

    def _broken(self, error: BaseException, stream: str | None) -> NoReturn:
        self._refuse((str(error).strip() or type(error).__name__).splitlines()[0], stream)

    def _refuse(self, reason: str, stream: str | None) -> NoReturn:
        found = shown(reason, 200)
        what = f"the parquet file is damaged: {found}"
        refuse(self.file, what, stream=stream, expected="a readable parquet file", found=found)


def open_parquet(path: Path, opening: Opening) -> RunSource:
    """A run from one parquet file."""
    return open_single(path, opening, ParquetTable, "parquet")


FORMAT = Format(
    name="parquet",
    label="Parquet table",
    suffixes=(".parquet",),
    sniff=lambda name, head: head is not None and head.startswith(MAGIC),
    open=open_parquet,
    table=ParquetTable,
)
