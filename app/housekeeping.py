"""Drops for good what has waited long enough: deleted runs, forgotten uploads, arrays that nothing names."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import shutil
import time
from collections.abc import AsyncIterator

from fastapi import FastAPI
from sqlalchemy import Engine

from app.db.session import reading, writing
from app.settings import Settings
from app.store import diagnoses, runs, uploads

log = logging.getLogger("driftscope")
EVERY_S = 3600.0
TEMPORARY_S = 24 * 3600.0


@contextlib.asynccontextmanager
async def service(app: FastAPI) -> AsyncIterator[None]:
    """Tidy at the start and every hour, in the background."""
    await asyncio.to_thread(uploads.purge_strays, app.state.engine, app.state.settings)
    task = asyncio.create_task(_hourly(app.state.engine, app.state.settings))
    try:
        yield
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


async def _hourly(engine: Engine, settings: Settings) -> None:
    while True:
        try:
            await asyncio.to_thread(tidy, engine, settings)
        except Exception:  # a full disk or a busy database now must not end it for good
            log.exception("housekeeping failed; it is tried again in an hour")
        await asyncio.sleep(EVERY_S)


def tidy(engine: Engine, settings: Settings) -> None:
    """One round."""
    with writing(engine) as session:
        purged = runs.purge(session, settings.undo_hours)
        diagnoses.purge(session, settings.undo_hours)
    dropped = uploads.purge(engine, settings)
    with reading(engine) as session:
        freed = runs.collect_arrays(session, settings.data)
    for path in (settings.data / "tmp").glob("*"):
        if time.time() - path.stat().st_mtime > TEMPORARY_S:
            shutil.rmtree(path, ignore_errors=True)
    if purged or dropped or freed:
        log.info("tidied: %d runs, %d uploads, %d MiB of arrays", purged, dropped, freed >> 20)
