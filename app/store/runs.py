"""Runs in the database: add, find, change, delete with a day to think again."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import nullcontext
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

from sqlalchemy import Engine, delete, select
from sqlalchemy.orm import Session, selectinload

from app.db.session import reading
from app.db.tables import Estimate, ImuResult, LiveRun, Robot, Run, RunWords, Stream, Tag, now
from app.errors import ConflictError, NotFoundError
from app.settings import Settings
from app.store import arrays, beside
from app.store.run_list import MAX_LIMIT, SORTS, RunPage, RunQuery, list_runs
from core.errors import ParameterError
from core.run import Run as CoreRun

__all__ = ["MAX_LIMIT", "SORTS", "RunPage", "RunQuery", "list_runs"]

NAME_LENGTH, TAG_LENGTH, TAGS, NOTES_LENGTH = 200, 60, 50, 100_000


def add_run(session: Session, manifest: Mapping[str, Any], *, is_example: bool = False) -> Run:
    """The row of an ingested run (`app.ingest.ingest_file`). The same readings again give the row already there.

    A run met again while it waits for deletion comes back; tags given with it are added.
    """
    run = session.get(Run, manifest["id"])
    if run is None:
        run = _new_row(session, manifest)
        session.add(run)
    elif beside.KEY in manifest["source"]:  # the same readings, with a simulated run beside them now
        run.source = {**run.source, beside.KEY: manifest["source"][beside.KEY]}
    run.deleted_at = None
    run.is_example = run.is_example or is_example
    _set_tags(run, [*(t.tag for t in run.tags), *manifest.get("tags", ())])
    _index(run)
    session.flush()
    return run


def _new_row(session: Session, manifest: Mapping[str, Any]) -> Run:
    copied = ("id", "sha256", "t0", "t1", "duration_s", "size_bytes", "meta", "source", "warnings", "sparkline")
    return Run(
        **{k: manifest[k] for k in copied},
        name=_checked_name(manifest["name"]),
        robot=_robot(session, manifest.get("robot")),
        created_at=now(),
        notes="",
        is_example=False,
        streams=[Stream(**s) for s in manifest["streams"]],
        stream_names=" ".join(sorted(s["name"] for s in manifest["streams"])),
    )


def get_run(session: Session, run_id: str, *, deleted: bool = False) -> Run:
    """The row of a run; NotFoundError if there is none, or it is deleted and that isn't asked for."""
    loads = [selectinload(Run.streams), selectinload(Run.tags)]
    run = session.get(Run, run_id, options=loads)
    if run is None and (live := session.get(LiveRun, run_id)) is not None and live.run_id is not None:
        run = session.get(Run, live.run_id, options=loads)  # the id that it had while it was live
    if run is None or (run.deleted_at is not None and not deleted):
        hint = "; it is deleted and can be restored" if run is not None else ""
        raise NotFoundError(f"there is no run {run_id!r}{hint}", what="run", id=run_id)
    return run


def manifest(session: Session, run_id: str) -> dict[str, Any]:
    """All that a worker needs to load the run from the data folder alone (`arrays.run_from_manifest`)."""
    run = get_run(session, run_id)
    streams = [
        {k: getattr(s, k) for k in ("name", "rows", "t0", "t1", "rate_hz", "gaps", "columns", "names")}
        for s in run.streams
    ]
    return {
        "id": run.id,
        "sha256": run.sha256,
        "name": run.name,
        "robot": run.robot.name if run.robot else None,
        "tags": [t.tag for t in run.tags],
        "t0": run.t0,
        "t1": run.t1,
        "duration_s": run.duration_s,
        "size_bytes": run.size_bytes,
        "meta": {**run.meta, "name": run.name},
        "source": run.source,
        "warnings": run.warnings,
        "sparkline": run.sparkline,
        "streams": streams,
    }


def load_run(source: Session | Engine, settings: Settings, run_id: str) -> CoreRun:
    """The run with its columns memory-mapped: opening costs the same for a minute and for a day."""
    with nullcontext(source) if isinstance(source, Session) else reading(source) as session:
        found = manifest(session, run_id)
    return arrays.run_from_manifest(settings.data, found)


def load_simulated(source: Session | Engine, settings: Settings, run_id: str) -> CoreRun | None:
    """The simulated run that was stored beside a run (its folder `sim/`), None without."""
    with nullcontext(source) if isinstance(source, Session) else reading(source) as session:
        found = get_run(session, run_id).source
    return beside.load(settings.data, found)


def update_run(
    session: Session,
    run_id: str,
    *,
    name: str | None = None,
    robot: str | None = None,
    tags: Iterable[str] | None = None,
    notes: str | None = None,
) -> Run:
    """Change what people write about a run; None leaves a field, an empty `robot` takes it away."""
    run = get_run(session, run_id)
    if name is not None:
        run.name = _checked_name(name)
    if robot is not None:
        run.robot = _robot(session, robot)
    if tags is not None:
        _set_tags(run, tags)
    if notes is not None:
        if len(notes) > NOTES_LENGTH:
            raise ParameterError(f"notes have {len(notes)} characters, at most {NOTES_LENGTH}", parameter="notes")
        run.notes = notes
    _index(run)
    session.flush()
    return run


def delete_run(session: Session, run_id: str) -> Run:
    """Mark as deleted; `restore_run` undoes it until `purge` comes by."""
    run = get_run(session, run_id)
    run.deleted_at = now()
    return run


def restore_run(session: Session, run_id: str) -> Run:
    """Undo a deletion."""
    run = get_run(session, run_id, deleted=True)
    if run.deleted_at is None:
        raise ConflictError(f"run {run_id!r} is not deleted", what="run", id=run_id)
    run.deleted_at = None
    return run


def deleted_runs(session: Session) -> Sequence[Run]:
    """Runs that can still be restored, last deleted first."""
    query = select(Run).where(Run.deleted_at.is_not(None)).order_by(Run.deleted_at.desc(), Run.id)
    return session.scalars(query.options(selectinload(Run.streams), selectinload(Run.tags))).all()


def purge(session: Session, undo_hours: float, at: datetime | None = None) -> int:
    """Delete for good what was deleted longer ago than that; how many runs. Arrays go with `collect_arrays`."""
    limit = (at or now()) - timedelta(hours=undo_hours)
    ids = session.scalars(select(Run.id).where(Run.deleted_at < limit)).all()
    if ids:
        session.execute(delete(Run).where(Run.id.in_(ids)))
        session.execute(delete(Robot).where(~Robot.id.in_(select(Run.robot_id).where(Run.robot_id.is_not(None)))))
    return len(ids)


def collect_arrays(session: Session, data: Path, *, older_than: float = arrays.GRACE_S) -> int:
    """Delete the arrays that no stored run, estimate or IMU result names; bytes freed."""
    referenced: set[str] = set()
    for table in (Stream.columns, Estimate.arrays, ImuResult.arrays):
        for columns in session.scalars(select(table)):
            referenced.update(columns.values())
    for source in session.scalars(select(Run.source)):
        referenced.update(beside.keys(source))
    return arrays.collect(data, referenced, older_than=older_than)


def _checked_name(name: str) -> str:
    name = " ".join(name.split())
    if not name:
        raise ParameterError("a run needs a name", parameter="name", found=name)
    if len(name) > NAME_LENGTH:
        raise ParameterError(f"the name has {len(name)} characters, at most {NAME_LENGTH}", parameter="name")
    return name


def _robot(session: Session, name: str | None) -> Robot | None:
    if not name or not name.strip():
        return None
    name = _checked_name(name)
    found = session.scalar(select(Robot).where(Robot.name == name))
    return found or Robot(name=name, created_at=now())


def clean_tags(tags: Iterable[str]) -> list[str]:
    """Tags without surrounding blanks or repeats, sorted; ParameterError if one is too long or there are too many."""
    cleaned = sorted({" ".join(t.split()) for t in tags} - {""})
    if len(cleaned) > TAGS:
        raise ParameterError(f"{len(cleaned)} tags, at most {TAGS}", parameter="tags", found=len(cleaned))
    for tag in cleaned:
        if len(tag) > TAG_LENGTH:
            raise ParameterError(f"the tag {tag[:20]!r}… is longer than {TAG_LENGTH}", parameter="tags", found=tag)
    return cleaned


def _set_tags(run: Run, tags: Iterable[str]) -> None:
    wanted, had = clean_tags(tags), {t.tag: t for t in run.tags}
    run.tags = [had.get(tag) or Tag(tag=tag) for tag in wanted]


def _index(run: Run) -> None:
    words = (
        run.name,
        run.robot.name if run.robot else "",
        *(t.tag for t in run.tags),
        str(run.source.get("file_name", "")),
        run.notes,
    )
    text = "\n".join(words).casefold()
    if run.words is None:
        run.words = RunWords(text=text)
    else:
        run.words.text = text
