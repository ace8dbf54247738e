"""An engine with a real embedded cluster."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from job_kinds import KINDS, database

from app.jobs.engine import JobEngine
from app.settings import Settings


@pytest.fixture(scope="session")
def job_settings(tmp_path_factory: pytest.TempPathFactory) -> Settings:
    return Settings(data=tmp_path_factory.mktemp("jobs") / "data", workers=1, worker_memory_bytes=450 << 20)


@pytest.fixture(scope="session")
def jobs(job_settings: Settings) -> Iterator[JobEngine]:
    """One engine for all tests: its cluster takes a second or two to start."""
    engine = JobEngine(job_settings, database(job_settings), KINDS)
    engine.start()
    yield engine
    engine.stop()


@pytest.fixture
def pid_file(job_settings: Settings) -> Path:
    path = job_settings.data / "pid"
    path.unlink(missing_ok=True)
    return path
