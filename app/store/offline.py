"""The store without a server: for the command line. A server on the same data folder may run meanwhile."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Any, Self

from app.db.migrate import migrate
from app.db.session import make_engine, reading, writing
from app.db.tables import Run
from app.ingest import IngestOptions, Progress, ingest_file
from app.settings import Settings
from app.store import jobs, runs
from core.run import Run as CoreRun


class Store:
    """A data folder, opened; `create=False` raises FileNotFoundError where there is none yet."""

    def __init__(self, settings: Settings, *, create: bool = True) -> None:
        if create:
            settings.data.mkdir(parents=True, exist_ok=True)
        elif not settings.data.is_dir() or not (settings.database_url or (settings.data / "driftscope.db").is_file()):
            raise FileNotFoundError(settings.data)
        self._settings = settings
        self._engine = make_engine(settings.url)
        migrate(self._engine)

    def add(self, path: Path, progress: Progress = lambda fraction, message: None) -> dict[str, Any]:
        """Store a file's run: {"id", "name", "new"}; a server, running now or started later, will estimate it."""
        options = IngestOptions(file_name=path.name, max_unpacked_bytes=self._settings.max_unpacked_bytes)
        manifest = ingest_file(self._settings.data, path, options, progress)
        with writing(self._engine) as session:
            new = session.get(Run, manifest["id"]) is None
            run = runs.add_run(session, manifest)
            jobs.first_jobs(session, run.id)
            return {"id": run.id, "name": run.name, "new": new}

    def load(self, run_id: str) -> CoreRun:
        """The stored run of that id; NotFoundError if there is none."""
        with reading(self._engine) as session:
            return runs.load_run(session, self._settings, run_id)

    def load_simulated(self, run_id: str) -> CoreRun | None:
        """The simulated run that was stored beside it, None without; NotFoundError if there is no such run."""
        with reading(self._engine) as session:
            return runs.load_simulated(session, self._settings, run_id)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, tb: TracebackType | None) -> None:
        self._engine.dispose()
