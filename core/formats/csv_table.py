"""CSV: one table as text; header row, comma, decimal point, UTF-8. Read in row batches by the streaming engine.

The engine is fast and tells little when it fails, and it fills short rows silently. So the header is read here, and
where something is wrong a second look, still by columns or raw bytes, finds the row and the column.
"""

from __future__ import annotations

import codecs
import csv
import mmap
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

import polars as pl

from core.errors import TooLargeError
from core.formats.base import ENGINE_ERRORS, Format, Opening, RunSource
from core.formats.checks import refuse, shown
from core.formats.limits import Limits
from core.formats.single import open_single

CHUNK = 1 << 22
QUOTE_BUFFER = 1 << 18
SAMPLE_ROWS = 100
NUMBER = "a number, or nothing where there is none"
WIDE_BOMS = {codecs.BOM_UTF32_LE: "UTF-32", codecs.BOM_UTF16_LE: "UTF-16", codecs.BOM_UTF16_BE: "UTF-16"}


class CsvTable:
    """An opened CSV file; see `core.formats.base.Table`."""

    typed = False

    def __init__(self, path: Path, file: str, limits: Limits, stream: str | None = None) -> None:
        self.path, self.file, self.limits = path, file, limits
        self.names = self._read_header(stream)
        self._shape_is_sound = False
        self._numbers: tuple[str, ...] = ()
        self._has_quotes = self._check_lines(stream)
        if self._has_quotes:  # a quote that never ends would make the engine hold the rest of the file
            self.check_shape(stream)

    def dtypes(self) -> Mapping[str, pl.DataType]:
        """Float64 where the first rows hold numbers, else String."""
        sample = pl.LazyFrame(self.head(SAMPLE_ROWS), dict.fromkeys(self.names, pl.String()), orient="row")
        return {
            name: pl.Float64() if _not_numbers(pl.col(name), sample).collect().is_empty() else pl.String()
            for name in self.names
        }

    def scan(self, numbers: tuple[str, ...], texts: tuple[str, ...], *, count_rows: str | None = None) -> pl.LazyFrame:
        """The columns asked for: float64 and strings."""
        schema: dict[str, pl.DataType] = {n: pl.Float64() if n in numbers else pl.String() for n in self.names}
        self._numbers = numbers
        frame = self._scan(schema, row_index_name=count_rows)
        return frame.select([*([count_rows] if count_rows else []), *numbers, *texts])

    def explain(self, error: BaseException | None, stream: str | None) -> None:
        """Find what the engine stumbled over: wrong encoding, a ragged row, or text where a number belongs."""
        self._check_encoding(stream)
        self.check_shape(stream)
        if error is None:
            return
        self._find_text(stream)
        self._unreadable(error, stream)

    def check_shape(self, stream: str | None) -> None:
        """Raise at the first line that has not as many fields as the header."""
        if self._shape_is_sound:
            return
        line = pl.col("line")
        unclosed = pl.lit(False)
        if self._has_quotes:  # commas between quotes separate nothing
            unclosed = line.str.count_matches('"', literal=True) % 2 == 1
            line = line.str.replace_all('"[^"]*"', "")
        fields = line.str.count_matches(",", literal=True) + 1
        wrong = (fields != len(self.names)) | unclosed
        lines = pl.scan_lines(self.path, name="line", glob=False)
        try:
            first, some = (
                lines.select(wrong.arg_max().alias("first"), wrong.any().alias("some"))
                .collect(engine="streaming")
                .row(0)
            )
            if some:
                where = lines.slice(first, 1).select("line", fields.alias("fields"), unclosed.alias("unclosed"))
                self._ragged(first, where.collect(engine="streaming").row(0, named=True), stream)
        except ENGINE_ERRORS as error:
            self._check_encoding(stream)
            self._unreadable(error, stream)
        self._shape_is_sound = True

    def cell(self, row: int, column: str) -> str | None:
        """The text of one cell, None if it is empty."""
        if column not in self.names:
            return None
        try:
            found = self._texts().slice(row - 1, 1).select(column).collect(engine="streaming")
        except ENGINE_ERRORS:
            return None
        return found.item() if found.height else None

    def head(self, rows: int) -> list[tuple[str | None, ...]]:
        """The first rows as text."""
        try:
            return self._texts().head(rows).collect(engine="streaming").rows()
        except ENGINE_ERRORS as error:
            self._check_encoding(None)
            self._unreadable(error, None)

    def _scan(
        self, schema: dict[str, pl.DataType], *, row_index_name: str | None = None, ragged: bool = False
    ) -> pl.LazyFrame:
        return pl.scan_csv(
            self.path,
            schema=schema,
            has_header=False,
            skip_lines=1,
            glob=False,
            missing_columns="insert",
            row_index_name=row_index_name,
            truncate_ragged_lines=ragged,
            raise_if_empty=False,
        )

    def _texts(self, row_index_name: str | None = None) -> pl.LazyFrame:
        return self._scan({n: pl.String() for n in self.names}, row_index_name=row_index_name, ragged=True)

    def _read_header(self, stream: str | None) -> tuple[str, ...]:
        with self.path.open("rb") as f:
            head = f.read(self.limits.max_header_bytes + 1)
        if not head:
            refuse(
                self.file,
                "the file is empty: expected a header row",
                stream=stream,
                expected="a header row",
                found="0 bytes",
            )
        for bom, encoding in WIDE_BOMS.items():
            if head.startswith(bom):
                self._wrong_encoding(encoding, stream)
        line, newline, _ = head.partition(b"\n")
        if b"\0" in line:
            self._wrong_encoding("binary data (a NUL byte in the header)", stream)
        if not newline and len(head) > self.limits.max_header_bytes:
            limit = self.limits.max_header_bytes
            refuse(
                self.file,
                f"the header row has no end within {limit:,} bytes",
                kind=TooLargeError,
                stream=stream,
                expected=f"a header row of at most {limit:,} bytes",
                found=f"more than {limit:,} bytes",
            )
        try:
            text = line.decode("utf-8-sig").rstrip("\r")
        except UnicodeDecodeError as error:
            self._wrong_encoding(f"byte 0x{line[error.start]:02x} in the header", stream)
        return self._parse_header(text, stream)

    def _parse_header(self, text: str, stream: str | None) -> tuple[str, ...]:
        if "\r" in text:
            refuse(self.file, "lines end with CR alone; expected LF or CR LF", stream=stream, expected="LF", found="CR")
        try:
            names = tuple(name.strip() for name in next(csv.reader([text], strict=True), []))
        except csv.Error as error:
            refuse(self.file, f"the header row cannot be read: {error}", stream=stream, found=shown(text))
        if len(names) > self.limits.max_columns:
            limit = self.limits.max_columns
            refuse(
                self.file,
                f"expected at most {limit} columns; found {len(names)}",
                kind=TooLargeError,
                stream=stream,
                expected=f"at most {limit} columns",
                found=len(names),
            )
        if not text.strip():
            refuse(
                self.file,
                "the first line is blank; expected a header row",
                stream=stream,
                expected="a header row",
                found="a blank line",
            )
        if len(names) == 1 and any(mark in text for mark in ";\t"):
            refuse(
                self.file,
                f"columns must be separated by commas; found the header {shown(text)}",
                stream=stream,
                expected="commas",
                found=shown(text),
            )
        for name in names:
            if not name or not name.isprintable():
                refuse(
                    self.file,
                    f"expected a name for each column; found {shown(text)}",
                    stream=stream,
                    expected="column names",
                    found=shown(text),
                )
            if names.count(name) > 1:
                refuse(
                    self.file,
                    f"column {name!r} is there {names.count(name)} times",
                    stream=stream,
                    column=name,
                    expected="each column once",
                    found=f"{names.count(name)} times",
                )
        return names

    def _check_lines(self, stream: str | None) -> bool:
        """Refuse a line that is too long; whether there is any quote."""
        # A line that is longer than two blocks covers a whole block: one short search per block finds it, and the
        # engine never has to hold it.
        block = self.limits.max_line_bytes
        with self.path.open("rb") as f, mmap.mmap(f.fileno(), 0, access=mmap.ACCESS_READ) as data:
            for start in range(0, len(data) - block, block):
                if data.find(b"\n", start, start + block) < 0:
                    refuse(
                        self.file,
                        f"a line is longer than {block:,} bytes",
                        kind=TooLargeError,
                        stream=stream,
                        row=self._row_at(start),
                        expected=f"lines of at most {block:,} bytes",
                        found=f"more than {block:,} bytes",
                    )
        buffer = bytearray(QUOTE_BUFFER)  # one, reused: fresh ones cost more than the search
        with self.path.open("rb", buffering=0) as raw:
            while n := raw.readinto(buffer):
                if buffer.find(b'"', 0, n) >= 0:
                    return True
        return False

    def _check_encoding(self, stream: str | None) -> None:
        """Raise at the first byte that is not UTF-8 text, NUL included."""
        decoder = codecs.getincrementaldecoder("utf-8")()
        offset = 0
        with self.path.open("rb") as f:
            while chunk := f.read(CHUNK):
                pending = len(decoder.getstate()[0])
                bad = chunk.find(b"\0")
                try:
                    decoder.decode(chunk if bad < 0 else chunk[:bad])
                except UnicodeDecodeError as error:
                    bad = max(0, error.start - pending)
                if bad >= 0:
                    found = "a NUL byte" if chunk[bad] == 0 else f"byte 0x{chunk[bad]:02x}"
                    self._wrong_encoding(found, stream, self._row_at(offset + bad))
                offset += len(chunk)

    def _find_text(self, stream: str | None) -> None:
        for name in self._numbers:
            cells = self._texts("row").select("row", name)
            try:
                found = _not_numbers(pl.col(name), cells).head(1).collect(engine="streaming")
            except ENGINE_ERRORS:
                continue
            if found.height:
                text = shown(found[name][0])
                refuse(
                    self.file,
                    f"expected {NUMBER}; found {text}",
                    stream=stream,
                    row=int(found["row"][0]) + 1,
                    column=name,
                    expected=NUMBER,
                    found=text,
                )

    def _ragged(self, row: int, line: Mapping[str, Any], stream: str | None) -> NoReturn:
        text, fields, expected = line["line"], line["fields"], f"{len(self.names)} fields"
        found = f"{fields} field{'s' * (fields != 1)}: {shown(text)}"
        if not text.strip():
            found = "a blank line"
        if line["unclosed"]:
            found = f"a quote that does not end in its line: {shown(text)}"
        what = f"expected {expected}; found {found}"
        refuse(self.file, what, stream=stream, row=row, expected=expected, found=found)

    def _unreadable(self, error: BaseException, stream: str | None) -> NoReturn:
        reason = shown((str(error).strip() or type(error).__name__).splitlines()[0], 200)
        refuse(self.file, f"the table cannot be read: {reason}", stream=stream, expected="a CSV table", found=reason)

    def _wrong_encoding(self, found: str, stream: str | None, row: int | None = None) -> NoReturn:
        refuse(
            self.file, f"expected UTF-8 text; found {found}", stream=stream, row=row, expected="UTF-8 text", found=found
        )

    def _row_at(self, offset: int) -> int | None:
        """Data row that holds the byte at `offset`; None in the header."""
        lines = 0
        with self.path.open("rb") as f:
            while offset > 0 and (chunk := f.read(min(CHUNK, offset))):
                lines, offset = lines + chunk.count(b"\n"), offset - len(chunk)
        return lines or None


def _not_numbers(cell: pl.Expr, frame: pl.LazyFrame) -> pl.LazyFrame:
    """The rows whose cell has text that the engine does not take for a number."""
    number = cell.str.strip_chars_start(" ").cast(pl.Float64, strict=False)
    return frame.filter(cell.is_not_null() & (cell != "") & number.is_null())


def open_csv(path: Path, opening: Opening) -> RunSource:
    """A run from one CSV file."""
    return open_single(path, opening, CsvTable, "csv")


FORMAT = Format(
    name="csv",
    label="CSV table",
    suffixes=(".csv",),
    sniff=lambda name, head: head is not None and b"," in head.partition(b"\n")[0] and b"\0" not in head,
    open=open_csv,
    table=CsvTable,
)
