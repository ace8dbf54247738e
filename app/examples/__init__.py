"""The example runs, loaded once into a store that was started with `--demo`. Deleted ones stay deleted."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import TYPE_CHECKING

from app import paths

if TYPE_CHECKING:  # `mujoco_robot` is imported alone, by the process that holds it
    from fastapi import FastAPI

    from app.jobs.engine import JobEngine
    from app.settings import Settings

LOADED = "examples.txt"  # in the data folder: names of those that were loaded


@contextlib.asynccontextmanager
async def service(app: FastAPI) -> AsyncIterator[None]:
    """Load them in the background when asked to."""
    if app.state.settings.demo:
        await asyncio.to_thread(load_examples, app.state.settings, app.state.jobs)
    yield


def load_examples(settings: Settings, jobs: JobEngine) -> list[str]:
    """Submit a job for each example that this store has not seen; their ids."""
    marker = settings.data / LOADED
    seen = set(marker.read_text(encoding="utf-8").split("\n")) if marker.exists() else set()
    new = [folder for folder in sorted(paths.EXAMPLES.glob("*/")) if (folder / "run.json").is_file()]
    new = [folder for folder in new if folder.name not in seen]
    ids = [
        jobs.submit(
            "ingest",
            None,
            {"path": str(folder.resolve()), "options": {"file_name": folder.name}, "is_example": True},
        )
        for folder in new
    ]
    if new:
        marker.write_text("\n".join(sorted(seen | {folder.name for folder in new})), encoding="utf-8")
    return ids
