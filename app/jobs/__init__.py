"""Long work: given to worker processes (Dask), followed in the database, told to whoever listens."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator

from fastapi import FastAPI


@contextlib.asynccontextmanager
async def service(app: FastAPI) -> AsyncIterator[None]:
    """Run the engine beside the server, as `app.state.jobs`."""
    from app.jobs.engine import JobEngine

    app.state.jobs = JobEngine(app.state.settings, app.state.engine)
    app.state.jobs.start()
    try:
        yield
    finally:
        app.state.jobs_stopped = await asyncio.to_thread(app.state.jobs.stop)
