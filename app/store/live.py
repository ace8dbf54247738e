"""Live runs in the database: a run like any other from its first second, under an id that later leads to the stored
run. Its readings grow in `data/live/<id>`; when it has ended, an ordinary job stores them under their content's hash,
the growing row goes, and `live_runs` keeps which run it became."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from app.db.tables import Job, LiveRun, Run, Stream, now
from app.store import runs

LIVE, ENDED, STORED = "live", "ended", "stored"


def begin(session: Session, run_id: str, robot: str, key: str, run: Mapping[str, Any], *, virtual: bool) -> None:
    """A run has begun: its row, still without streams. key: the robot's name for it."""
    if session.get(LiveRun, run_id) is not None:
        return
    started = now()
    name = str(run.get("name") or f"{robot} {started:%Y-%m-%d %H:%M:%S}")
    manifest = {
        "id": run_id,
        "sha256": hashlib.sha256(f"live {run_id}".encode()).hexdigest(),
        "name": name[: runs.NAME_LENGTH],
        "robot": robot,
        "tags": [],
        "t0": 0.0,
        "t1": 0.0,
        "duration_s": 0.0,
        "size_bytes": 0,
        "meta": dict(run),
        "source": {"file_name": f"live from {robot}", "format": "live", "size_bytes": 0, "mapping": None},
        "warnings": [],
        "sparkline": [],
        "streams": [],
    }
    row = runs.add_run(session, manifest)
    row.is_live = True
    session.add(LiveRun(id=run_id, robot=robot, key=key, virtual=virtual, state=LIVE, started_at=started))


def grow(session: Session, run_id: str, streams: Sequence[Mapping[str, Any]], sparkline: list[list[float]]) -> None:
    """The streams as they are by now."""
    run = session.get(Run, run_id)
    if run is None or not streams:
        return
    held = {s.name: s for s in run.streams}
    for described in streams:
        row = held.get(described["name"])
        if row is None:
            run.streams.append(Stream(**described))
        else:
            for key in ("rows", "t0", "t1", "rate_hz", "gaps", "columns", "names"):
                setattr(row, key, described[key])
    run.t0, run.t1 = min(s["t0"] for s in streams), max(s["t1"] for s in streams)
    run.duration_s = run.t1 - run.t0
    run.size_bytes = sum(8 * s["rows"] * len(s["columns"]) for s in streams)
    run.stream_names = " ".join(sorted(s["name"] for s in streams))
    run.sparkline = sparkline


def end(session: Session, run_id: str) -> None:
    """The robot has said so, or has been silent for too long."""
    row = session.get(LiveRun, run_id)
    if row is not None and row.state == LIVE:
        row.state, row.ended_at = ENDED, now()


def stored(session: Session, run_id: str, final: Run | None) -> None:
    """The run is stored under its final id, with what people wrote about it meanwhile; None: nothing was left of it."""
    row, grown = session.get(LiveRun, run_id), session.get(Run, run_id)
    if grown is not None:
        if final is not None:
            tags = [t.tag for t in (*final.tags, *grown.tags)]
            runs.update_run(session, final.id, name=grown.name, tags=tags, notes=grown.notes or final.notes)
            final.deleted_at, final.created_at = grown.deleted_at, grown.created_at
        session.delete(grown)
    if row is not None:
        row.state, row.run_id = STORED, final.id if final is not None else None


def get(session: Session, run_id: str) -> LiveRun | None:
    """The row of a live run."""
    return session.get(LiveRun, run_id)


def became(session: Session, run_id: str) -> str | None:
    """The id of the stored run that a live one became; None where it is no such id."""
    row = session.get(LiveRun, run_id)
    return row.run_id if row is not None else None


def unfinished(session: Session) -> Sequence[LiveRun]:
    """Those that are not stored yet, oldest first."""
    return session.scalars(select(LiveRun).where(LiveRun.state != STORED).order_by(LiveRun.started_at)).all()


def set_job(session: Session, run_id: str, job_id: str) -> None:
    """The job that stores the run."""
    row = session.get(LiveRun, run_id)
    if row is not None:
        row.job_id = job_id


def being_stored(session: Session, run_id: str) -> bool:
    """Whether a job that stores the run waits, works or has done so."""
    row = session.get(LiveRun, run_id)
    job = session.get(Job, row.job_id) if row is not None and row.job_id else None
    return job is not None and job.state in ("queued", "running", "done")
