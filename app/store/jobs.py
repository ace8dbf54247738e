"""Jobs in the database: the only truth about long work. queued -> running -> done | failed | cancelled."""

from __future__ import annotations

import secrets
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from app.db.tables import Estimate, ImuResult, Job, Stream, now
from app.errors import ConflictError, NotFoundError
from core.errors import ParameterError

ACTIVE = ("queued", "running")
FINISHED = ("done", "failed", "cancelled")
STATES = (*ACTIVE, *FINISHED)
MAX_LISTED = 500
MESSAGE_LENGTH = 300


def create(session: Session, kind: str, run_id: str | None, params: Mapping[str, Any]) -> Job:
    """A new queued job."""
    job = Job(
        id=secrets.token_hex(8),
        kind=kind,
        run_id=run_id,
        params=dict(params),
        state="queued",
        attempt=0,
        progress=0.0,
        message="waiting",
        cancel_requested=False,
        created_at=now(),
    )
    session.add(job)
    session.flush()
    return job


def first_jobs(session: Session, run_id: str) -> list[Job]:
    """Queued jobs for a newly stored run: all estimates, and where it has an IMU its analysis.

    None of those that it has had, nor while any job on it waits or runs.
    """
    if list_jobs(session, states=["active"], run_id=run_id, limit=1):
        return []
    made = []
    if session.scalars(select(Estimate.id).filter_by(run_id=run_id).limit(1)).first() is None:
        made.append(create(session, "estimate", run_id, {"methods": None, "config": {}}))
    has_imu = session.scalars(select(Stream.id).filter_by(run_id=run_id, name="imu")).first() is not None
    if has_imu and session.scalars(select(ImuResult.id).filter_by(run_id=run_id).limit(1)).first() is None:
        made.append(create(session, "imu", run_id, {"axes": None, "methods": None, "config": {}}))
    return made


def get_job(session: Session, job_id: str, *, lock: bool = False) -> Job:
    """The row of a job, `lock`ed if it is to be changed; NotFoundError if there is none."""
    job = session.get(Job, job_id, with_for_update=lock or None)
    if job is None:
        raise NotFoundError(f"there is no job {job_id!r}", what="job", id=job_id)
    return job


def list_jobs(
    session: Session, *, states: Collection[str] = (), run_id: str | None = None, limit: int = 100
) -> Sequence[Job]:
    """Jobs, newest first; `states` empty means every state, "active" means queued and running."""
    wanted = {s for state in states for s in (ACTIVE if state == "active" else (state,))}
    unknown = wanted - set(STATES)
    if unknown:
        raise ParameterError(
            f"unknown job state {sorted(unknown)[0]!r}; states are {', '.join(STATES)}, or active",
            parameter="state",
            expected=[*STATES, "active"],
            found=sorted(unknown)[0],
        )
    query = select(Job).order_by(Job.created_at.desc(), Job.id.desc()).limit(min(max(limit, 1), MAX_LISTED))
    if wanted:
        query = query.where(Job.state.in_(wanted))
    if run_id is not None:
        query = query.where(Job.run_id == run_id)
    return session.scalars(query).all()


def next_queued(session: Session, limit: int) -> Sequence[Job]:
    """What to start next: files that somebody waits for first, then in the order of arrival."""
    query = select(Job).where(Job.state == "queued").order_by(Job.kind != "ingest", Job.created_at, Job.id)
    return session.scalars(query.limit(limit)).all()


def interrupted(session: Session) -> Sequence[Job]:
    """Jobs that were running when the server that ran them stopped, back in the queue."""
    jobs = session.scalars(select(Job).where(Job.state == "running")).all()
    for job in jobs:
        requeue(job, "the server stopped; queued again")
    return jobs


def start(job: Job) -> None:
    """queued -> running; counts the attempt."""
    job.state, job.attempt, job.started_at, job.finished_at = "running", job.attempt + 1, now(), None
    job.progress, job.message, job.error = 0.0, "starting", None


def requeue(job: Job, message: str) -> None:
    """Back to the queue, to be started again as a new attempt."""
    job.state, job.progress, job.message, job.finished_at = "queued", 0.0, message[:MESSAGE_LENGTH], None


def finish(
    job: Job, state: str, message: str, *, result: dict[str, Any] | None = None, error: dict[str, Any] | None = None
) -> None:
    """The end of a job."""
    job.state, job.message, job.result, job.error = state, message[:MESSAGE_LENGTH], result, error
    job.finished_at = now()
    if state == "done":
        job.progress = 1.0


def reset(job: Job) -> None:
    """A finished job, asked for again by its user."""
    if job.state in ACTIVE:
        raise ConflictError(f"job {job.id} is {job.state}: only a finished job can be started again", state=job.state)
    if job.state == "done":
        raise ConflictError(f"job {job.id} is done: there is nothing to retry", state=job.state)
    job.cancel_requested, job.error, job.result = False, None, None
    requeue(job, "waiting")


def as_dict(job: Job) -> dict[str, Any]:
    """The job as the API, the event stream and the pages show it."""
    return {
        "id": job.id,
        "kind": job.kind,
        "run_id": job.run_id,
        "state": job.state,
        "attempt": job.attempt,
        "progress": job.progress,
        "message": job.message,
        "error": job.error,
        "result": job.result,
        "created_at": _iso(job.created_at),
        "started_at": _iso(job.started_at),
        "finished_at": _iso(job.finished_at),
    }


def _iso(at: Any) -> str | None:
    return None if at is None else at.isoformat().replace("+00:00", "Z")
