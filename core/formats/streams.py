"""From an opened table to a stream of the run format: header checked against the spec, engine failures explained."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from typing import Any

import numpy as np
import polars as pl

from core.formats.base import ENGINE_ERRORS, RunSource
from core.formats.checks import refuse, shown
from core.formats.limits import Limits
from core.formats.source import StreamSource, Table
from core.run import Run
from core.sensors import STREAMS, RangeLog, StreamSpec


def native_stream(spec: StreamSpec, table: Table, limits: Limits) -> StreamSource:
    """The stream of a table whose columns are named as in the run format. FormatError where they are not."""
    check_header(spec, table)
    present = tuple(c.name for c in spec.columns if c.name in table.names)
    texts = tuple(n for n in present if n in spec.text_columns)
    numbers = tuple(n for n in present if n not in spec.text_columns)
    sources = {n: n for n in present}

    def frames() -> Iterator[pl.DataFrame]:
        return batches_of(table.scan(numbers, texts), table, spec.name)

    return StreamSource(spec, table, column_dtypes(spec, table, sources), frames, limits, sources)


def batches_of(frame: pl.LazyFrame, table: Table, stream: str) -> Iterator[pl.DataFrame]:
    """The frame in batches, in order; what makes the engine fail comes out as a FormatError with its place."""
    try:
        yield from frame.collect_batches(maintain_order=True, engine="streaming")
    except ENGINE_ERRORS as error:
        table.explain(error, stream)
        raise


def column_dtypes(spec: StreamSpec, table: Table, sources: Mapping[str, str]) -> dict[str, np.dtype[np.generic]]:
    """The dtype of each column of a stream, t first: float64 for t, the source's float type for readings.

    `sources` maps the stream's columns to the table's. FormatError where a number is expected and the table says text.
    """
    types = table.dtypes() if table.typed else {}
    out: dict[str, np.dtype[np.generic]] = {}
    for name, source in sources.items():
        found = types.get(source, pl.String() if name in spec.text_columns else pl.Float64())
        if name in spec.text_columns:
            fits, expected = found.is_integer() or found in (pl.String, pl.Categorical, pl.Enum), "text"
            out[name] = np.dtype(np.int16)
        else:
            fits, expected = (found.is_numeric() and not found.is_decimal()) or found == pl.Null, "numbers"
            narrow = name != "t" and found in (pl.Float32, pl.Float16)
            out[name] = np.dtype(np.float32 if narrow else np.float64)
        if not fits:
            refuse(
                table.file,
                f"expected {expected}; found {found}",
                stream=spec.name,
                column=source,
                expected=expected,
                found=str(found),
            )
    return out


def check_header(spec: StreamSpec, table: Table) -> None:
    """Every required column is there, none is unknown."""
    known = [c.name for c in spec.columns]
    for name in table.names:
        if name not in known:
            close = get_close_matches(name.lower(), known, 1)
            hint = f"; did you mean {close[0]!r}?" if close else ""
            refuse(
                table.file,
                f"unknown column {shown(name)}; {spec.name} has {', '.join(known)}{hint}",
                stream=spec.name,
                column=name,
                expected=known,
                found=name,
            )
    for column in spec.columns:
        if column.required and column.name not in table.names:
            _missing(spec, table, column.name)
    if spec.at_least_one_of and not set(spec.at_least_one_of) & set(table.names):
        _missing(spec, table, " or ".join(spec.at_least_one_of))


def _missing(spec: StreamSpec, table: Table, column: str) -> None:
    names = ", ".join(table.names)
    refuse(
        table.file,
        f"the column is missing; found {shown(names, 200)}",
        stream=spec.name,
        column=column,
        expected=column,
        found=list(table.names[:50]),
    )


def read_all(source: RunSource) -> Run:
    """The whole run in memory."""
    logs: dict[str, Any] = {}
    for stream in source.streams():
        parts: dict[str, list[Any]] = {n: [] for n in stream.columns}
        for batch in stream.batches():
            for name, values in batch.items():
                parts[name].append(values)
        columns: dict[str, Any] = {name: np.concatenate(arrays) for name, arrays in parts.items()}
        if stream.spec.log is RangeLog:
            columns["names"] = stream.names
        logs[stream.name] = STREAMS[stream.name].log(**columns)
    return Run(meta=source.meta, **logs)
