"""The hub beside the server, from its start to its end."""

from __future__ import annotations

import contextlib
import functools
import sys
from collections.abc import AsyncIterator

from fastapi import FastAPI

from app.live.hub import Hub

SWITCH_S = 1e-3  # the loop waits no longer for a thread that computes; Python's own is 5 ms


@contextlib.asynccontextmanager
async def service(app: FastAPI) -> AsyncIterator[None]:
    """Live runs beside the server, as `app.state.live`."""
    sys.setswitchinterval(SWITCH_S)
    app.state.live = Hub(app.state.settings, app.state.engine, functools.partial(_submit, app))
    app.state.live.start()
    try:
        yield
    finally:
        await app.state.live.stop()


def _submit(app: FastAPI, run_id: str) -> str:
    job: str = app.state.jobs.submit("live", None, {"live": run_id})
    return job
