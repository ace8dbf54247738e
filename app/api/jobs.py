"""Jobs: list, look at, cancel, start again, and hear of them as they move (server-sent events)."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Header, Path, Query
from fastapi.sse import EventSourceResponse, ServerSentEvent

from app.api import schemas
from app.api.deps import JobsDep, ReadSession
from app.api.estimate_schemas import JobList
from app.store import jobs as store

router = APIRouter(tags=["jobs"])

JobId = Annotated[str, Path(description="the job's id", examples=["5b1e9c0d7a2f4e66"], max_length=64)]
RETRY_MS = 2000
EVENTS: dict[int | str, dict[str, Any]] = {
    200: {"description": "`event: job` with a Job as `data`, for as long as the reader stays"}
}


@router.get("/jobs", summary="List jobs")
def list_jobs(
    session: ReadSession,
    state: Annotated[
        list[str], Query(description=f"any of {', '.join(store.STATES)}; `active` is queued or running")
    ] = [],  # noqa: B006
    run: Annotated[str | None, Query(description="of this run only", max_length=64)] = None,
    limit: Annotated[int, Query(ge=1, le=store.MAX_LISTED)] = 100,
) -> JobList:
    """Jobs, newest first."""
    states = [part for text in state for part in text.split(",") if part]
    found = store.list_jobs(session, states=states, run_id=run, limit=limit)
    return JobList(items=[schemas.Job(**store.as_dict(job)) for job in found])


@router.get("/jobs/events", summary="Hear of all jobs", response_class=EventSourceResponse, responses=EVENTS)
async def job_events(
    jobs: JobsDep, last_event_id: Annotated[str | None, Header(description="where a reader left off")] = None
) -> AsyncIterator[ServerSentEvent]:
    """Server-sent events: first the jobs at work (or what changed since `Last-Event-ID`), then every change.

    A reader that is slower than the changes gets the latest state of each job. A comment comes every 15 s.
    """
    with jobs.events.reader() as reader:
        missed = jobs.events.since(last_event_id)
        for news in missed or ():
            yield _event(news.job, news.id)
        if missed is None:
            for job in await asyncio.to_thread(jobs.active):
                yield _event(job)
        async for news in reader.news():
            yield _event(news.job, news.id)


@router.get("/jobs/{job_id}", summary="Get a job")
def get_job(session: ReadSession, job_id: JobId) -> schemas.Job:
    """One job as it is now."""
    return schemas.Job(**store.as_dict(store.get_job(session, job_id)))


@router.get("/jobs/{job_id}/events", summary="Follow a job", response_class=EventSourceResponse, responses=EVENTS)
async def follow_job(
    jobs: JobsDep, job_id: JobId, known: Annotated[schemas.Job, Depends(get_job)]
) -> AsyncIterator[ServerSentEvent]:
    """Server-sent events: the job now, every change, and the end of the stream once it is done, failed or cancelled.

    An unknown job is a 404 before the stream begins.
    """
    async for job in jobs.follow(job_id):
        yield _event(job)


@router.post("/jobs/{job_id}/cancel", summary="Cancel a job")
def cancel_job(jobs: JobsDep, job_id: JobId) -> schemas.Job:
    """Cancel a queued job at once, a running one within seconds; 409 if it has ended."""
    return schemas.Job(**jobs.cancel(job_id))


@router.post("/jobs/{job_id}/retry", summary="Start a job again")
def retry_job(jobs: JobsDep, job_id: JobId) -> schemas.Job:
    """Queue a failed or cancelled job again; 409 in any other state."""
    return schemas.Job(**jobs.retry(job_id))


def _event(job: dict[str, Any], event_id: str | None = None) -> ServerSentEvent:
    return ServerSentEvent(data=job, event="job", id=event_id, retry=RETRY_MS)
