"""Kinds of jobs that misbehave, and waiting for what becomes of them."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import job_tasks
from sqlalchemy import Engine
from sqlalchemy.orm import Session

from app.db.session import make_engine
from app.db.tables import Base, Job
from app.jobs.engine import JobEngine
from app.jobs.kinds import Kind, Saved
from app.settings import Settings


def kind(task: Callable[..., Any]) -> Kind:
    """A kind whose parameters are the task's arguments and whose result is what the task returns."""
    return Kind(task.__name__, task, lambda session, settings, job: job.params, save)


def save(session: Session, settings: Settings, job: Job, made: dict[str, Any]) -> Saved:
    return Saved(made, "finished", job.run_id)


TASKS = (job_tasks.nap, job_tasks.deaf, job_tasks.die, job_tasks.swallow, job_tasks.refuse, job_tasks.crash)
KINDS = {task.__name__: kind(task) for task in TASKS}


def database(settings: Settings) -> Engine:
    settings.data.mkdir(parents=True, exist_ok=True)
    engine = make_engine(settings.url)
    Base.metadata.create_all(engine)
    return engine


def until(engine: JobEngine, job_id: str, *states: str, timeout: float = 60.0) -> dict[str, Any]:
    """The job once it is in one of these states."""
    end = time.monotonic() + timeout
    while (job := engine.get(job_id))["state"] not in states:
        assert time.monotonic() < end, f"still {job}"
        time.sleep(0.01)
    return job


def read_pid(path: Path) -> int:
    """The process that runs the task, once it does."""
    end = time.monotonic() + 30
    while not (path.exists() and (text := path.read_text())):
        assert time.monotonic() < end
        time.sleep(0.01)
    return int(text)
