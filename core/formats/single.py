"""One table by itself: a stream of the run format if its columns say so, else by a column mapping."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import polars as pl

from core.errors import NeedsMappingError
from core.formats.base import ENGINE_ERRORS, Opening, RunSource
from core.formats.checks import refuse, shown
from core.formats.limits import Limits
from core.formats.mapping import UNITS, ColumnMap, ColumnSource, spec_unit, suggest_mapping
from core.formats.source import StreamSource, Table
from core.formats.streams import batches_of, column_dtypes, native_stream
from core.run import RunMeta
from core.sensors import STREAMS, StreamSpec

ROW = "row of the table"
MakeTable = Callable[[Path, str, Limits, str | None], Table]


def open_single(path: Path, opening: Opening, make: MakeTable, kind: str) -> RunSource:
    """A run from one table. NeedsMappingError, with the columns and a suggestion, where they are not our own."""
    file = opening.name or path.name
    table = make(path, file, opening.limits, None)
    name = Path(file).stem
    if opening.mapping is not None:
        opening.mapping.check()
        streams = mapped_streams(table, opening.mapping, opening.limits)
        meta = opening.mapping.meta()
        return RunSource(file, kind, dataclasses.replace(meta, name=meta.name or name), streams)
    spec = fitting_stream(table, name)
    if spec is None:
        suggestion = suggest_mapping(table.names)
        raise NeedsMappingError(
            f"{file}: say which column is which; found {shown(', '.join(table.names), 300)}",
            file=file,
            columns=list(table.names),
            types={n: str(t) for n, t in table.dtypes().items()},
            suggestion=suggestion.to_json(),
        )
    return RunSource(file, kind, RunMeta(name=name), (native_stream(spec, table, opening.limits),))


def fitting_stream(table: Table, name: str) -> StreamSpec | None:
    """The stream that the table's columns are; where two fit (beacon, truth), the one named as the file's stem `name`.

    None where the columns are foreign and need a mapping.
    """
    names = set(table.names)
    fits = [
        spec
        for spec in STREAMS.values()
        if {c.name for c in spec.columns if c.required} <= names <= {c.name for c in spec.columns} and len(names) > 1
    ]
    named = [spec for spec in fits if spec.name == name]
    if named:
        return named[0]
    return fits[0] if len(fits) == 1 else None


def mapped_streams(table: Table, mapping: ColumnMap, limits: Limits) -> tuple[StreamSource, ...]:
    """The streams that a mapping makes of a table. A row belongs to a stream if it has any of its readings."""
    for stream, columns in mapping.streams.items():
        for name, source in columns.items():
            if source.column not in table.names:
                refuse(
                    table.file,
                    f"the mapping takes {stream}.{name} from it, but the table has no such column",
                    stream=stream,
                    column=source.column,
                    expected=source.column,
                    found=list(table.names[:50]),
                )
    table.check_shape(None)
    origins = _origins(table, mapping)
    wanted = [spec for name, spec in STREAMS.items() if name in mapping.streams]
    return tuple(_mapped_stream(spec, table, mapping, limits, origins) for spec in wanted)


def _mapped_stream(
    spec: StreamSpec, table: Table, mapping: ColumnMap, limits: Limits, origins: Mapping[str, float | int]
) -> StreamSource:
    given = mapping.streams[spec.name]
    sources = {c.name: given[c.name] for c in spec.columns if c.name in given}
    dtypes = column_dtypes(spec, table, {name: source.column for name, source in sources.items()})
    texts = tuple(s.column for n, s in sources.items() if n in spec.text_columns)
    numbers = tuple(dict.fromkeys(s.column for n, s in sources.items() if n not in spec.text_columns))
    values = [
        pl.col(source.column).alias(name)
        if name in spec.text_columns
        else _in_si(mapping, spec, name, source, origins).alias(name)
        for name, source in sources.items()
    ]
    readings = [n for n in sources if n != "t" and n not in spec.text_columns]

    def frames() -> Iterator[pl.DataFrame]:
        frame = table.scan(numbers, texts, count_rows=ROW).select(ROW, *values)
        present = pl.any_horizontal(pl.col(n).fill_nan(None).is_not_null() for n in readings)
        return batches_of(frame.filter(present), table, spec.name)

    columns = {name: source.column for name, source in sources.items()}
    return StreamSource(spec, table, dtypes, frames, limits, columns, ROW)


def _in_si(
    mapping: ColumnMap, spec: StreamSpec, name: str, source: ColumnSource, origins: Mapping[str, float | int]
) -> pl.Expr:
    unit = mapping.unit(spec.name, name, source)
    value = pl.col(source.column)
    if name == "t" and source.column in origins:
        value = value - origins[source.column]  # whole numbers (epochs in ns) are subtracted as such
    if source.unit not in (None, spec_unit(spec, name)):
        value = value.cast(pl.Float64) * unit.factor / unit.divisor + unit.offset
    return (-value if source.sign < 0 else value).cast(pl.Float64)


def _origins(table: Table, mapping: ColumnMap) -> dict[str, float | int]:
    """What to subtract from each time column, in its own unit, so that the earliest first stamp is 0."""
    if mapping.t0 == "zero":
        return {}
    units = {c["t"].column: c["t"].unit or "s" for c in mapping.streams.values()}
    firsts: dict[str, float | int] = {}
    for column in units:
        try:
            found = table.scan((column,), ()).drop_nulls().head(1).collect(engine="streaming")
        except ENGINE_ERRORS as error:
            table.explain(error, None)
            raise
        if found.height:
            firsts[column] = found.item()
    if len(set(units.values())) <= 1:
        earliest = min(firsts.values(), default=0)
        return dict.fromkeys(firsts, earliest)
    si = {c: value * UNITS["s"][units[c]].factor / UNITS["s"][units[c]].divisor for c, value in firsts.items()}
    earliest_s = min(si.values(), default=0.0)
    return {c: earliest_s * UNITS["s"][units[c]].divisor / UNITS["s"][units[c]].factor for c in firsts}
