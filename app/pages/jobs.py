"""`/jobs`: what is being worked on, what waits, what failed and why."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any, ClassVar

from fastapi import APIRouter, Request, Response
from sqlalchemy import func, select

from app.db.session import reading
from app.db.tables import Job, Run
from app.pages.base import Page, render, route
from app.store import jobs as store

router = APIRouter()

SHOWN = 200


@dataclass(frozen=True)
class JobsPage(Page):
    """`jobs`, newest first, as the API has them, each with its run's name; `counts` by state over all."""

    template: ClassVar[str] = "jobs.html"
    place: ClassVar[str] = "jobs"
    counts: dict[str, int]
    jobs: list[dict[str, Any]]


def _are(n: int, what: str) -> str:
    return f"{n:,} {what}"


def sentence(counts: Counter[str]) -> str:
    """What a colleague could repeat of the queue."""
    if not counts:
        return "No jobs yet: they begin when a run is added."
    now = [_are(counts[s], word) for s, word in (("running", "running"), ("queued", "waiting")) if counts[s]]
    past = [_are(counts[s], s) for s in ("failed", "cancelled") if counts[s]]
    done = f"{counts['done']:,} done"
    return f"{' and '.join(now) if now else 'Nothing to wait for'}; {', '.join([done, *past])}."


@route(router, "/jobs")
def jobs(request: Request) -> Response:
    with reading(request.app.state.engine) as session:
        by_state = select(Job.state, func.count()).group_by(Job.state)
        counts = Counter(dict(session.execute(by_state).all()))
        rows = store.list_jobs(session, limit=SHOWN)
        runs = {job.run_id for job in rows} | {(job.result or {}).get("run_id") for job in rows}
        names = dict(session.execute(select(Run.id, Run.name).where(Run.id.in_(runs - {None}))).all())
        listed = [{**store.as_dict(job), "run_name": names.get(_run_of(job) or ""), "file": _file(job)} for job in rows]
    return render(request, JobsPage("Jobs", sentence(counts), dict(counts), listed))


def _run_of(job: Job) -> str | None:
    return job.run_id or (job.result or {}).get("run_id")


def _file(job: Job) -> str | None:
    """The name of the file that an ingest reads."""
    name = (job.params.get("options") or {}).get("file_name")
    return str(name) if name else None
