"""Resumable uploads: bytes are acknowledged once they are on disk, and what was acknowledged survives a crash.

The file `data/uploads/<id>` may be longer than the row's `received` says (a crash between the two); what lies beyond
was never acknowledged, and is cut off when the upload goes on.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import secrets
from collections.abc import Callable, Mapping
from datetime import datetime, timedelta
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from sqlalchemy import Engine, delete, select, true
from sqlalchemy.orm import Session

from app.db.session import reading, writing
from app.db.tables import Job, Upload, now
from app.errors import ConflictError, NotFoundError
from app.ingest import IngestOptions, check_room
from app.settings import Settings
from app.store.runs import clean_tags
from core.errors import DriftscopeError, ParameterError, TooLargeError

FILE_NAME_LENGTH = 300
HASH_LENGTH = 64


class SizeMismatchError(DriftscopeError):
    """An upload has more or fewer bytes than announced. `where`: expected, found."""

    code = "size_mismatch"


class ChecksumMismatchError(DriftscopeError):
    """The bytes received are not those that were sent. `where`: expected, found."""

    code = "checksum_mismatch"


def path_of(settings: Settings, upload_id: str) -> Path:
    """Where the bytes are."""
    return settings.data / "uploads" / upload_id


def create(
    engine: Engine,
    settings: Settings,
    *,
    file_name: str,
    size: int | None = None,
    sha256: str | None = None,
    options: Mapping[str, Any] | None = None,
) -> Upload:
    """A new upload without bytes. TooLargeError, DiskFullError or ParameterError where it could not succeed."""
    if size is not None and size > settings.max_upload_bytes:
        raise too_large(settings, size)
    check_room(settings.data, size or 0)
    row = Upload(
        id=secrets.token_hex(8),
        file_name=_checked_file_name(file_name),
        size=size,
        sha256=_checked_sha256(sha256),
        received=0,
        options={**(options or {}), "tags": clean_tags((options or {}).get("tags") or ())},
        created_at=now(),
        touched_at=now(),
    )
    path = path_of(settings, row.id)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    try:
        with writing(engine) as session:
            session.add(row)
    except BaseException:
        path.unlink(missing_ok=True)
        raise
    return row


def get(engine: Engine, upload_id: str) -> Upload:
    """The row of an upload; NotFoundError if there is none (any more)."""
    with reading(engine) as session:
        return _row(session, upload_id)


def _row(session: Session, upload_id: str) -> Upload:
    row = session.get(Upload, upload_id)
    if row is None:
        raise NotFoundError(
            f"there is no upload {upload_id!r}; unfinished ones are dropped after a while", what="upload", id=upload_id
        )
    return row


class Appender:
    """Adds bytes to an upload from where it stands. `checkpoint` makes them durable and only then counts them.

    ConflictError if `offset` isn't where the upload stands, or if it is being read already.
    """

    def __init__(self, engine: Engine, settings: Settings, upload_id: str, offset: int) -> None:
        row = get(engine, upload_id)
        check_free(engine, upload_id)
        if offset != row.received:
            raise ConflictError(
                f"upload {upload_id!r} stands at byte {row.received}, not at {offset}",
                what="upload",
                id=upload_id,
                expected=row.received,
                found=offset,
            )
        self._engine, self._settings, self._row = engine, settings, row
        self.received = self._durable = row.received
        self._file = path_of(settings, upload_id).open("r+b")
        self._file.truncate(row.received)
        self._file.seek(row.received)

    def write(self, chunk: bytes) -> None:
        """Append; SizeMismatchError or TooLargeError if that is more than announced or allowed."""
        total = self.received + len(chunk)
        if self._row.size is not None and total > self._row.size:
            raise SizeMismatchError(
                f"more bytes came than the {self._row.size} announced", expected=self._row.size, found=total
            )
        if total > self._settings.max_upload_bytes:
            raise too_large(self._settings, total)
        self._file.write(chunk)
        self.received = total

    @property
    def unsaved(self) -> int:
        """Bytes that a crash would lose."""
        return self.received - self._durable

    def checkpoint(self) -> int:
        """Force what was written to disk, then acknowledge it; the count."""
        if self.unsaved:
            self._file.flush()
            os.fsync(self._file.fileno())
            with writing(self._engine) as session:
                row = _row(session, self._row.id)
                row.received, row.touched_at = self.received, now()
            self._durable = self.received
        return self._durable

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        with contextlib.suppress(OSError):  # a full disk: what Python still held was never acknowledged
            self._file.close()


def complete(engine: Engine, settings: Settings, upload_id: str) -> Upload:
    """The row of an upload all of whose bytes are there and have the announced hash."""
    row = get(engine, upload_id)
    if row.size is not None and row.received != row.size:
        raise SizeMismatchError(
            f"{row.file_name}: {row.received} bytes came, {row.size} were announced",
            file=row.file_name,
            expected=row.size,
            found=row.received,
        )
    if not row.received:
        raise SizeMismatchError(f"{row.file_name}: no bytes came", file=row.file_name, found=0)
    if row.sha256:
        with path_of(settings, upload_id).open("rb") as file:
            found = hashlib.file_digest(file, "sha256").hexdigest()
        if found != row.sha256:
            raise ChecksumMismatchError(
                f"{row.file_name}: the bytes received have SHA-256 {found}, announced was {row.sha256}",
                file=row.file_name,
                expected=row.sha256,
                found=found,
            )
    return row


def ingest_options(settings: Settings, row: Upload) -> dict[str, Any]:
    """The upload's options as plain data for `IngestOptions.from_plain`."""
    known = {k: row.options.get(k) for k in ("name", "robot", "mapping")}
    options = {
        **known,
        "in_order": bool(row.options.get("in_order")),
        "file_name": row.file_name,
        "tags": list(row.options.get("tags") or ()),
        "max_unpacked_bytes": settings.max_unpacked_bytes,
    }
    IngestOptions.from_plain(options)  # what a worker can't take must fail here
    return options


def hand_over(engine: Engine, upload_id: str, how: Mapping[str, Any], submit: Callable[[Upload], str]) -> str:
    """Give the upload to the job that `submit` starts, to be read in this way (`mapping`, `in_order`); the job's id.

    ConflictError if another job has it.
    """
    row = get(engine, upload_id)
    check_free(engine, upload_id)
    if how:
        row.options = {**row.options, **how}
    job_id = submit(row)
    with writing(engine) as session:
        kept = _row(session, upload_id)
        kept.job_id, kept.touched_at, kept.options = job_id, now(), row.options
    return job_id


def check_free(engine: Engine, upload_id: str) -> None:
    """ConflictError while a job reads the upload. A job that failed or was cancelled lets it go."""
    with reading(engine) as session:
        row = _row(session, upload_id)
        job = session.get(Job, row.job_id) if row.job_id else None
    if job is not None and job.state not in ("failed", "cancelled"):
        raise ConflictError(
            f"upload {upload_id!r} is complete, and job {job.id} reads it", what="upload", id=upload_id, job=job.id
        )


def discard(engine: Engine, settings: Settings, upload_id: str) -> None:
    """Forget an upload and its bytes; nothing happens if there is none."""
    with writing(engine) as session:
        session.execute(delete(Upload).where(Upload.id == upload_id))
    path_of(settings, upload_id).unlink(missing_ok=True)


def purge(engine: Engine, settings: Settings, at: datetime | None = None) -> int:
    """Drop uploads that are stored, and those that nobody touched for `settings.upload_hours`; how many."""
    limit = (at or now()) - timedelta(hours=settings.upload_hours)
    state = select(Job.state).where(Job.id == Upload.job_id).scalar_subquery()
    stale = (Upload.touched_at < limit) & state.in_(("queued", "running")).is_not(true())
    with writing(engine) as session:
        dropped = session.scalars(delete(Upload).where((state == "done") | stale).returning(Upload.id)).all()
    for upload_id in dropped:
        path_of(settings, upload_id).unlink(missing_ok=True)
    return len(dropped)


def purge_strays(engine: Engine, settings: Settings) -> None:
    """Delete files that no row names: a crash came between the two. Only before requests are served."""
    with reading(engine) as session:
        kept = set(session.scalars(select(Upload.id)))
    for path in (settings.data / "uploads").glob("*"):
        if path.name not in kept:
            path.unlink(missing_ok=True)


def too_large(settings: Settings, found: int) -> TooLargeError:
    """The refusal of an upload over the limit."""
    return TooLargeError(
        f"the file has {found:,} bytes; this server takes at most {settings.max_upload_bytes:,}",
        expected=settings.max_upload_bytes,
        found=found,
    )


def _checked_file_name(name: str) -> str:
    base = name.replace("\\", "/").rsplit("/", 1)[-1].strip()
    cleaned = "".join(c for c in base if c.isprintable())
    if not cleaned or cleaned in (".", ".."):
        raise ParameterError(f"a file needs a name, found {name[:100]!r}", parameter="file_name", found=name[:100])
    if len(cleaned) > FILE_NAME_LENGTH:
        raise ParameterError(
            f"the file's name has {len(cleaned)} characters, at most {FILE_NAME_LENGTH}", parameter="file_name"
        )
    return cleaned


def _checked_sha256(value: str | None) -> str | None:
    if value is None:
        return None
    lowered = value.strip().lower()
    if len(lowered) != HASH_LENGTH or set(lowered) - set("0123456789abcdef"):
        raise ParameterError(
            "a SHA-256 checksum is 64 hexadecimal digits", parameter="sha256", expected="64 hex digits", found=value
        )
    return lowered
