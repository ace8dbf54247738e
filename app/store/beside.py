"""The simulated run that lies in `sim/` beside a real one: stored with it, in its `source`, and gone with it."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from app.store import arrays
from core.formats import RunSource, meta_to_json
from core.run import Run

KEY = "simulated"
"""Where a run's `source` says what lies beside it: {"meta", "streams": [{"name", "rows", "columns", "names"}]}."""
Written = dict[str, dict[str, arrays.Writer]]


def write(data: Path, source: RunSource, stack: contextlib.ExitStack) -> Written:
    """Its readings under temporary names, stream by stream. Raises the errors of `core.formats`."""
    written: Written = {}
    for stream in source.simulated.streams() if source.simulated else ():
        writers = {name: stack.enter_context(arrays.Writer(data)) for name in stream.columns}
        for batch in stream.batches():
            for name, column in batch.items():
                writers[name].append(column)
        for writer in writers.values():
            writer.sync()
        written[stream.name] = writers
    return written


def describe(source: RunSource, written: Written) -> dict[str, Any]:
    """Give the arrays their names; what to keep in the run's `source`, nothing where nothing lies beside."""
    if source.simulated is None:
        return {}
    streams = [
        {
            "name": stream.name,
            "rows": written[stream.name]["t"].rows,
            "columns": {name: writer.commit() for name, writer in written[stream.name].items()},
            "names": list(stream.names),
        }
        for stream in source.simulated.streams()
    ]
    return {KEY: {"meta": meta_to_json(source.simulated.meta), "streams": streams}}


def keys(source: Mapping[str, Any]) -> Iterator[str]:
    """Keys of the arrays that a run's `source` names."""
    for stream in (source.get(KEY) or {}).get("streams", ()):
        yield from stream["columns"].values()


def load(data: Path, source: Mapping[str, Any]) -> Run | None:
    """The simulated run, its columns mapped; None where none lies beside."""
    found = source.get(KEY)
    return None if found is None else arrays.run_from_manifest(data, found)


def told(source: Mapping[str, Any]) -> dict[str, Any]:
    """A run's `source` for people: of the simulated run only which streams it has."""
    beside = source.get(KEY)
    return {**source, KEY: [stream["name"] for stream in beside["streams"]]} if beside else dict(source)
