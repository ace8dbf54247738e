"""A file becomes arrays and a manifest: read in batches, checked, hashed and written as it streams by. No database."""

from __future__ import annotations

import contextlib
import hashlib
import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt
import polars as pl

from app.errors import DiskFullError, NotFoundError
from app.store import arrays, beside
from core.errors import NeedsMappingError
from core.formats import UNITS, Limits, RunSource, StreamSource, meta_to_json, open_run, sniff, suggest_mapping
from core.formats.source import Batch
from core.imu.stamps import onward, told
from core.robot import RobotParams
from core.sensors import STREAMS
from core.timing import gaps, rate

Progress = Callable[[float, str], None]
GAPS_KEPT = 100
SPARKLINE_POINTS = 64
ROWS_SHOWN = 8
TABLES = ("csv", "parquet")  # formats that are one table
TEXT_TYPES = ("String", "Categorical", "Enum", "Binary")
FREE_MARGIN = 64 << 20  # bytes of disk that an ingest leaves free


@dataclass(frozen=True)
class IngestOptions:
    """What the sender says about the file, beside the file itself."""

    file_name: str
    name: str | None = None
    robot: str | None = None
    tags: tuple[str, ...] = ()
    mapping: Mapping[str, Any] | None = None
    in_order: bool = False  # rows whose stamps go back are left out, and told, where the file would be refused
    max_unpacked_bytes: int | None = None

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> IngestOptions:
        """From a job's parameters."""
        return cls(**{**plain, "tags": tuple(plain.get("tags") or ())})


def ingest_file(
    data: Path, path: Path, options: IngestOptions, progress: Progress = lambda fraction, message: None
) -> dict[str, Any]:
    """Store the readings of one file or folder; the manifest for `app.store.runs.add_run`.

    All or nothing: arrays get their names only when every stream has been read to its end without a fault. Raises
    the errors of `core.formats`, DiskFullError before starting where there is no room, OSError(ENOSPC) when it ends
    on the way, and whatever `progress` raises.
    """
    if not path.exists():
        raise NotFoundError(f"the bytes of {options.file_name} are gone: upload it again", what="upload")
    check_room(data, _size(path))
    limits = Limits(unordered=frozenset(STREAMS) if options.in_order else frozenset())
    if options.max_unpacked_bytes:
        limits = replace(limits, max_unpacked_bytes=options.max_unpacked_bytes)
    with contextlib.ExitStack() as stack:
        source = stack.enter_context(
            open_run(path, limits=limits, mapping=options.mapping, tmp=_unpacking(data), name=options.file_name)
        )
        streams = list(source.streams())
        written = []
        left_out: list[str] = []
        for i, stream in enumerate(streams):
            step = _part_of(progress, i, len(streams))
            written.append(_write(data, stream, stack, step, left_out))
        aside = beside.write(data, source, stack)
        described = [_describe(data, stream, writers) for stream, writers in zip(streams, written, strict=True)]
        simulated = beside.describe(source, aside)
    progress(1.0, "stored")
    manifest = _manifest(data, source, described, options, path, simulated)
    return {**manifest, "warnings": [*left_out, *manifest["warnings"]]}


def look_inside(path: Path, file_name: str) -> dict[str, Any]:
    """What an uploaded table holds: its columns, first rows as text, and a guess at a mapping (`UploadColumns`).

    Raises the errors of `core.formats` for what can't be read at all.
    """
    kind, needs_mapping = sniff(path, file_name).name, False
    types: dict[str, str] = {}
    try:
        with open_run(path, name=file_name) as source:
            if kind in TABLES:
                types = {name: str(dtype) for name, dtype in source.sources[0].table.dtypes().items()}
    except NeedsMappingError as error:
        needs_mapping = True
        types.update(cast("dict[str, str]", error.where["types"]))
    return {
        "file_name": file_name,
        "needs_mapping": needs_mapping,
        "columns": [{"name": n, "type": "text" if t in TEXT_TYPES else "number"} for n, t in types.items()],
        "rows": _first_rows(path, kind),
        "suggested": suggest_mapping(types).to_json(),
        "units": {si: list(units) for si, units in UNITS.items()},
    }


def _first_rows(path: Path, kind: str) -> list[dict[str, str | None]]:
    if kind not in TABLES:
        return []
    if kind == "csv":
        frame = pl.read_csv(path, n_rows=ROWS_SHOWN, infer_schema=False, truncate_ragged_lines=True, glob=False)
    else:
        head = pl.scan_parquet(path, glob=False).head(ROWS_SHOWN)
        frame = head.select(pl.all().cast(pl.String, strict=False)).collect()
    rows: list[dict[str, str | None]] = frame.to_dicts()
    return rows


def check_room(data: Path, needed: int) -> None:
    """DiskFullError unless the disk of the data folder has room for that many bytes and a margin."""
    data.mkdir(parents=True, exist_ok=True)
    free = shutil.disk_usage(data).free
    if free < needed + FREE_MARGIN:
        raise DiskFullError(
            f"the data folder's disk has {free >> 20} MiB free, {(needed + FREE_MARGIN) >> 20} MiB are needed; "
            "nothing was stored",
            needed_bytes=needed + FREE_MARGIN,
            free_bytes=free,
        )


def _unpacking(data: Path) -> Path:
    """Where archives are unpacked: on the disk that was checked for room."""
    folder = data / "tmp"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _size(path: Path) -> int:
    return sum(f.stat().st_size for f in path.iterdir() if f.is_file()) if path.is_dir() else path.stat().st_size


def _part_of(progress: Progress, i: int, n: int) -> Progress:
    return lambda fraction, message: progress((i + fraction) / n, message)


def _write(
    data: Path, stream: StreamSource, stack: contextlib.ExitStack, progress: Progress, left_out: list[str]
) -> dict[str, arrays.Writer]:
    writers = {name: stack.enter_context(arrays.Writer(data)) for name in stream.columns}
    rows = 0
    for batch in _in_order(stream, left_out) if stream.name in stream.limits.unordered else stream.batches():
        for name, column in batch.items():
            writers[name].append(column)
        rows += len(batch["t"])
        # the number of rows is known only at the end: approach 1 without reaching it
        progress(rows / (rows + 5_000_000), f"{stream.name}: {rows:,} rows")
    for writer in writers.values():
        writer.sync()
    return writers


def _in_order(stream: StreamSource, left_out: list[str]) -> Iterator[Batch]:
    """The stream's batches without the rows whose stamps do not go on; a note on them goes into `left_out`."""
    t = np.concatenate([np.asarray(batch["t"], np.float64) for batch in stream.batches()])
    kept = onward(t)
    left_out += [f"{stream.table.file}, stream {stream.name}: {note}" for note in told(t, kept)]
    row = 0
    for batch in stream.batches():
        wanted = kept[row : row + len(batch["t"])]
        row += len(wanted)
        if wanted.any():
            yield batch if wanted.all() else {name: column[wanted] for name, column in batch.items()}


def _describe(data: Path, stream: StreamSource, writers: Mapping[str, arrays.Writer]) -> dict[str, Any]:
    return described(data, stream.name, {name: writer.commit() for name, writer in writers.items()}, stream.names)


def described(data: Path, name: str, columns: Mapping[str, str], names: Sequence[str]) -> dict[str, Any]:
    """A stream's row, given the keys of its stored columns and the names that its codes stand for."""
    t = arrays.open(data, columns["t"])
    pauses = gaps(t)
    longest = np.sort(np.argsort(pauses[:, 0] - pauses[:, 1], kind="stable")[:GAPS_KEPT])
    return {
        "name": name,
        "rows": int(t.shape[0]),
        "t0": float(t[0]),
        "t1": float(t[-1]),
        "rate_hz": rate(t),
        "gaps": pauses[longest].tolist(),
        "columns": dict(columns),
        "names": list(names),
    }


def _manifest(
    data: Path,
    source: RunSource,
    streams: list[dict[str, Any]],
    options: IngestOptions,
    path: Path,
    simulated: Mapping[str, Any],
) -> dict[str, Any]:
    meta = meta_to_json(source.meta)
    sha256 = run_hash(meta, streams)
    t0, t1 = min(s["t0"] for s in streams), max(s["t1"] for s in streams)
    columns = {s["name"]: {n: arrays.open(data, key) for n, key in s["columns"].items()} for s in streams}
    return {
        "id": sha256[:16],
        "sha256": sha256,
        "name": options.name or source.meta.name or Path(options.file_name).stem or "run",
        "robot": options.robot,
        "tags": list(options.tags),
        "t0": t0,
        "t1": t1,
        "duration_s": t1 - t0,
        "size_bytes": sum(a.nbytes for group in columns.values() for a in group.values()),
        "meta": meta,
        "source": {
            "file_name": options.file_name,
            "format": source.format,
            "size_bytes": _size(path),
            "mapping": dict(options.mapping) if options.mapping else None,
            **simulated,
        },
        "warnings": list(source.warnings),
        "sparkline": sparkline(columns, source.meta.robot),
        "streams": streams,
    }


def run_hash(meta: Mapping[str, Any], streams: list[dict[str, Any]]) -> str:
    """The identity of a run: its description and the hashes of its columns. Its name is a label and not part of it."""
    described = {k: v for k, v in meta.items() if k != "name"}
    held = {s["name"]: {"columns": s["columns"], "names": s["names"]} for s in streams}
    text = json.dumps([described, held], sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


Columns = Mapping[str, npt.NDArray[Any]]


def sparkline(columns: Mapping[str, Columns], robot: RobotParams) -> list[list[float]]:
    """At most 64 points [x, y] [m] of the path: truth, else beacon fixes, else plain dead reckoning, else none."""
    for stream in ("truth", "beacon"):
        found = columns.get(stream, {})
        if "x" in found and "y" in found:
            xy = _thinned(found["x"], found["y"], 20 * SPARKLINE_POINTS)
            xy = xy[np.isfinite(xy).all(axis=1)]
            if len(xy) > 1:
                return _rounded(xy)
    wheels = columns.get("wheels")
    if wheels is None or not robot.wheel_radius or not robot.track_width:
        return []
    return _rounded(_reckoned(wheels, robot.wheel_radius, robot.track_width))


def _reckoned(wheels: Columns, r: float, b: float) -> npt.NDArray[np.float64]:
    angles = r * _thinned(wheels["left"], wheels["right"], 20_000)
    steps = np.diff(angles[np.isfinite(angles).all(axis=1)], axis=0)
    theta = np.concatenate(([0.0], np.cumsum((steps[:, 1] - steps[:, 0]) / b)))
    middle, forward = (theta[:-1] + theta[1:]) / 2, steps.mean(axis=1)
    path = np.cumsum(np.column_stack((forward * np.cos(middle), forward * np.sin(middle))), axis=0)
    return np.vstack((np.zeros((1, 2)), path))


def _thinned(x: npt.NDArray[Any], y: npt.NDArray[Any], points: int) -> npt.NDArray[np.float64]:
    index = np.unique(np.linspace(0, len(x) - 1, min(points, len(x))).astype(np.int64))
    return np.column_stack((x[index], y[index])).astype(np.float64)


def _rounded(xy: npt.NDArray[np.float64]) -> list[list[float]]:
    points: list[list[float]] = _thinned(xy[:, 0], xy[:, 1], SPARKLINE_POINTS).round(3).tolist()
    return points
