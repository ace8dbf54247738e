"""Arrays on disk, found by the hash of what they hold: `data/arrays/ab/<sha256>.npy`, written once, mapped to read.

The hash is over the element type, the shape after the first axis and the bytes, so equal columns of two runs are one
file. A file is complete when it has its name: writers append to `data/arrays/tmp`, sync, and rename.
"""

from __future__ import annotations

import contextlib
import dataclasses
import fcntl
import hashlib
import os
import re
import secrets
import time
from collections.abc import Iterator, Mapping, Set
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from app.store import growing
from core.formats.run_json import meta_from_json
from core.run import Run
from core.sensors import STREAMS

KEY = re.compile(r"[0-9a-f]{64}")
GRACE_S = 24 * 3600.0  # an array is written before the row that names it; the collector waits this long
KINDS = "biuf"
HEAD = re.compile(r"\{'descr': '(?P<descr>[<|]\w\d+)', 'fortran_order': False, 'shape': \((?P<shape>[\d, ]*)\), \}\s*")


def path_of(data: Path, key: str) -> Path:
    """The file of an array; ValueError if the key isn't one."""
    if not KEY.fullmatch(key):
        raise ValueError(f"not an array key: {key!r}")
    return data / "arrays" / key[:2] / f"{key}.npy"


def open(data: Path, key: str) -> npt.NDArray[Any]:  # noqa: A001
    """The array, mapped read-only: its pages come from disk as they are touched. FileNotFoundError if absent."""
    if key.startswith("live-"):
        return growing.open_column(data, key)
    path = path_of(data, key)
    dtype, shape, offset = _head(path)
    if 0 in shape:  # nothing can't be mapped
        empty = np.zeros(shape, dtype)
        empty.flags.writeable = False
        return empty
    mapped = np.memmap(path, dtype, mode="r", offset=offset, shape=shape)
    return mapped.view(np.ndarray)  # compiled kernels take plain arrays; the view keeps the map alive


def _head(path: Path) -> tuple[np.dtype[Any], tuple[int, ...], int]:
    """Element type, shape and start of the elements; ValueError if the file is none of ours.

    `np.load` has Python parse the head, which in Python 3.11 fails now and then when two threads do so at once
    (https://github.com/python/cpython/issues/106905).
    """
    with path.open("rb") as file:
        major, _ = np.lib.format.read_magic(file)
        text = file.read(int.from_bytes(file.read(2 if major == 1 else 4), "little")).decode("latin1")
        found = HEAD.fullmatch(text)
        if found is None:
            raise ValueError(f"{path.name}: not the head of a stored array: {text[:80]!r}")
        return np.dtype(found["descr"]), tuple(int(n) for n in found["shape"].split(",") if n.strip()), file.tell()


def put(data: Path, array: npt.NDArray[Any]) -> str:
    """Store one array; its key. Durable on return; an array already there is not written again."""
    with Writer(data) as writer:
        writer.append(array)
        return writer.commit()


class Writer:
    """Streams one array to disk, hashing as it goes; `commit` makes it durable and gives its key.

    Left by an exception, or without `commit`, it leaves nothing behind.
    """

    def __init__(self, data: Path) -> None:
        self._data = data
        folder = data / "arrays" / "tmp"
        folder.mkdir(parents=True, exist_ok=True)
        self._path = folder / secrets.token_hex(16)
        self._file = self._path.open("wb")
        self._dtype: np.dtype[Any] | None = None
        self._tail: tuple[int, ...] = ()
        self._header = 0
        self._hash = hashlib.sha256()
        self._synced = False
        self.rows = 0

    def append(self, array: npt.NDArray[Any]) -> None:
        """Add rows; type and inner shape must be those of the first batch."""
        if self._dtype is None:
            self._begin(array)
        if array.dtype != self._dtype or array.shape[1:] != self._tail:
            raise ValueError(f"a batch of {array.dtype}{array.shape} after {self._dtype}{self._tail}")
        raw = np.ascontiguousarray(array).reshape(-1).view(np.uint8).data
        self._hash.update(raw)
        self._file.write(raw)
        self.rows += array.shape[0]

    def _begin(self, array: npt.NDArray[Any]) -> None:
        if array.dtype.kind not in KINDS or array.ndim < 1 or not array.dtype.isnative:
            raise ValueError(f"cannot store an array of {array.dtype} with {array.ndim} axes")
        self._dtype, self._tail = array.dtype, array.shape[1:]
        self._hash.update(f"{array.dtype.str}{list(self._tail)}:".encode())
        self._write_header()
        self._header = self._file.tell()

    def _write_header(self) -> None:
        # numpy leaves room in the header for the first axis to grow, so that it can be written again at the end
        assert self._dtype is not None
        shape = (self.rows, *self._tail)
        header = {"descr": np.lib.format.dtype_to_descr(self._dtype), "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(self._file, header)

    def sync(self) -> str:
        """Finish the file and force it to disk, still under its temporary name; the key it will have."""
        if self._dtype is None:
            raise ValueError("nothing was appended")
        if not self._synced:
            self._file.seek(0)
            self._write_header()
            if self._file.tell() != self._header:
                raise AssertionError("the header of an array changed its length")
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()
            self._synced = True
        return self._hash.hexdigest()

    def commit(self) -> str:
        """Give the array its name, durably; its key."""
        key = self.sync()
        final = path_of(self._data, key)
        with _lock(self._data, fcntl.LOCK_SH):
            if final.exists():
                os.utime(final)
                self._path.unlink(missing_ok=True)
                return key
            final.parent.mkdir(exist_ok=True)
            self._path.replace(final)
        _sync_folder(final.parent)
        _sync_folder(final.parent.parent)
        return key

    def abort(self) -> None:
        """Drop what was written, unless it was committed."""
        self._file.close()
        self._path.unlink(missing_ok=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self.abort()


def collect(data: Path, referenced: Set[str], *, older_than: float = GRACE_S) -> int:
    """Delete arrays that no row names, and what crashed writers left, once older than that many seconds; bytes freed.

    A writer that meets an existing array touches it under the shared lock, so none is taken while being reused.
    """
    root = data / "arrays"
    if not root.is_dir():
        return 0
    limit, freed = time.time() - older_than, 0
    for path in root.glob("*/*"):
        if path.suffix == ".npy" and path.stem in referenced:
            continue
        with _lock(data, fcntl.LOCK_EX), contextlib.suppress(FileNotFoundError):
            status = path.stat()
            if status.st_mtime < limit:
                path.unlink()
                freed += status.st_size
    return freed


def run_from_manifest(data: Path, manifest: Mapping[str, Any]) -> Run:
    """The run that a manifest (`app.ingest.ingest_file`, `app.store.runs.manifest`) describes, columns mapped."""
    logs: dict[str, Any] = {}
    for stream in manifest["streams"]:
        kind = STREAMS[stream["name"]].log
        values: dict[str, Any] = {name: open(data, key) for name, key in stream["columns"].items()}
        if "names" in {f.name for f in dataclasses.fields(kind)}:
            values["names"] = tuple(stream["names"])
        logs[stream["name"]] = kind(**values)
    return Run(meta=meta_from_json(manifest["meta"], file="run.json"), **logs)


@contextlib.contextmanager
def _lock(data: Path, kind: int) -> Iterator[None]:
    with (data / "arrays" / ".lock").open("ab") as handle:
        fcntl.flock(handle, kind)
        yield


def _sync_folder(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
