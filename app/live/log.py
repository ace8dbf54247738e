"""The log of a live run: every accepted frame, appended, and on disk before it is acknowledged.

A record is its length (u32), the CRC-32 of kind and payload (u32), its kind (u8), the payload; all little-endian. After
a crash the log ends at its last whole record: what follows was never acknowledged, and is cut off.
One thread writes for all runs: what came while it was busy goes with the next round, one sync per run and round.
"""

from __future__ import annotations

import contextlib
import os
import struct
import threading
import zlib
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from pathlib import Path

HEAD = struct.Struct("<IIB")
HELLO, TEXT, BINARY, COMMAND, END = range(5)
"""Kinds: the robot's Hello as JSON, a Batch as JSON, a Batch as MessagePack, a command that the server sent, End."""

Done = Callable[[OSError | None], None]


def record(kind: int, payload: bytes) -> bytes:
    """A record as it stands in the log."""
    return HEAD.pack(len(payload), zlib.crc32(payload, kind), kind) + payload


def read(path: Path) -> Iterator[tuple[int, bytes]]:
    """Whole records from the start on; the file is cut after the last of them."""
    end = 0
    with path.open("rb") as file:
        size = path.stat().st_size
        while True:
            head = file.read(HEAD.size)
            if len(head) < HEAD.size:
                break
            length, check, kind = HEAD.unpack(head)
            if length > size - end:
                break
            payload = file.read(length)
            if len(payload) < length or zlib.crc32(payload, kind) != check:
                break
            end += HEAD.size + length
            yield kind, payload
    if end < size:
        os.truncate(path, end)


class Log:
    """One run's log, open for appending. `writer` does the work."""

    def __init__(self, path: Path, writer: Writer) -> None:
        new = not path.exists()
        self._file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
        if new:
            _sync_folder(path.parent)
            _sync_folder(path.parent.parent)
        self._writer = writer
        self.waiting: list[tuple[bytes, Done]] = []

    def append(self, kind: int, payload: bytes, done: Done) -> None:
        """Queue a record; `done(None)` is called by the writer's thread once it is on disk, or with what went wrong."""
        self._writer.submit(self, record(kind, payload), done)

    def write(self, data: bytes) -> None:
        """Write and sync, or raise; a write that failed half-way is cut off again."""
        end = os.fstat(self._file).st_size
        try:
            view = memoryview(data)
            while view:
                view = view[os.write(self._file, view) :]
            os.fdatasync(self._file)
        except OSError:
            with contextlib.suppress(OSError):
                os.ftruncate(self._file, end)
            raise

    def finish(self, kind: int) -> None:
        """A last record behind all that is queued, waited for; then close. OSError where it could not be written."""
        written: Future[OSError | None] = Future()
        self.append(kind, b"", written.set_result)
        error = written.result()
        self.close()
        if error is not None:
            raise error

    def close(self) -> None:
        """After the last record's `done`."""
        os.close(self._file)


class Writer:
    """The thread that writes the logs of all runs."""

    def __init__(self) -> None:
        self._turn = threading.Condition()
        self._dirty: dict[Log, None] = {}
        self._stop = False
        self._thread = threading.Thread(target=self._work, name="live-log", daemon=True)
        self._thread.start()

    def submit(self, log: Log, data: bytes, done: Done) -> None:
        """Queue bytes of a log."""
        with self._turn:
            log.waiting.append((data, done))
            self._dirty[log] = None
            self._turn.notify()

    def stop(self) -> None:
        """Write what is queued, then end."""
        with self._turn:
            self._stop = True
            self._turn.notify()
        self._thread.join()

    def _work(self) -> None:
        while True:
            with self._turn:
                while not self._dirty and not self._stop:
                    self._turn.wait()
                if not self._dirty:
                    return
                batch = []
                for log in self._dirty:
                    batch.append((log, log.waiting))
                    log.waiting = []
                self._dirty = {}
            for log, waiting in batch:
                error: OSError | None = None
                try:
                    log.write(b"".join(data for data, _ in waiting))
                except OSError as failure:
                    error = failure
                for _, done in waiting:
                    done(error)


def _sync_folder(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
