"""What routes ask for: settings, database sessions, the job engine."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

from fastapi import Depends, Path, Request
from sqlalchemy import Engine
from sqlalchemy.orm import Session

from app.db.session import reading, writing
from app.jobs.engine import JobEngine
from app.settings import Settings


def settings(request: Request) -> Settings:
    """The server's settings."""
    found: Settings = request.app.state.settings
    return found


def engine(request: Request) -> Engine:
    """The database."""
    found: Engine = request.app.state.engine
    return found


def jobs(request: Request) -> JobEngine:
    """The job engine."""
    found: JobEngine = request.app.state.jobs
    return found


def _reading(request: Request) -> Iterator[Session]:
    with reading(request.app.state.engine) as session:
        yield session


def _writing(request: Request) -> Iterator[Session]:
    with writing(request.app.state.engine) as session:
        yield session


# `function`: the transaction ends before the answer is sent, so an acknowledged change is a stored one
ReadSession = Annotated[Session, Depends(_reading, scope="function")]
WriteSession = Annotated[Session, Depends(_writing, scope="function")]
SettingsDep = Annotated[Settings, Depends(settings)]
EngineDep = Annotated[Engine, Depends(engine)]
JobsDep = Annotated[JobEngine, Depends(jobs)]
RunId = Annotated[str, Path(description="the run's id", examples=["9f2c1ab84e5d7703"], max_length=64)]
