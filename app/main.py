"""`create_app`: the server, put together. What it serves and what runs beside it is listed in the tables below."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, AsyncExitStack
from typing import Any

from fastapi import APIRouter, FastAPI
from starlette.middleware import Middleware
from starlette.middleware.gzip import DEFAULT_EXCLUDED_CONTENT_TYPES, GZipMiddleware
from starlette.responses import Response
from starlette.staticfiles import StaticFiles

from app import errors, examples, housekeeping, jobs, login, openapi, paths, virtual_robot
from app.api import (
    calibrations,
    consistency,
    diagnoses,
    estimates,
    files,
    imu,
    mappings,
    odometry,
    runs,
    sandbox,
    streams,
    uploads,
)
from app.api import jobs as job_api
from app.api import live as live_api
from app.api import virtual as virtual_api
from app.db.migrate import migrate
from app.db.session import make_engine
from app.live import service as live
from app.pages import PAGES
from app.sandbox import cache as sandbox_cache
from app.scene import api as scene_api
from app.scene import proxy, source
from app.security import Guard
from app.settings import Settings

API_ROUTERS: tuple[APIRouter, ...] = (  # under /api/v1
    scene_api.router,  # before files: it knows one more of them
    runs.router,
    uploads.router,
    streams.router,
    files.router,
    mappings.router,
    estimates.router,
    consistency.router,
    imu.router,
    calibrations.router,
    diagnoses.router,
    odometry.router,
    sandbox.router,
    job_api.router,
    live_api.router,
    virtual_api.router,
)
PAGE_ROUTERS: tuple[APIRouter, ...] = (login.router, proxy.router, *PAGES.values())  # at the root
# What runs beside the server, entered in this order at its start and left in the reverse order at its end.
SERVICES: tuple[Callable[[FastAPI], AbstractAsyncContextManager[None]], ...] = (
    jobs.service,
    housekeeping.service,
    examples.service,
    source.service,
    sandbox_cache.service,
    live.service,
    virtual_robot.service,
)

NOT_COMPRESSED = (*DEFAULT_EXCLUDED_CONTENT_TYPES, "application/vnd.apache.arrow.stream", "application/octet-stream")


class FreshFiles(StaticFiles):
    """Static files that a browser asks for again, by ETag: an upgrade never mixes old and new modules."""

    def file_response(self, *args: Any, **kwargs: Any) -> Response:
        response = super().file_response(*args, **kwargs)
        response.headers["Cache-Control"] = "no-cache"
        return response


def create_app(settings: Settings) -> FastAPI:
    """The application for these settings; nothing is touched on disk before it starts."""
    app = FastAPI(
        title="Driftscope",
        version=openapi.VERSION,
        summary=openapi.SUMMARY,
        description=openapi.DESCRIPTION,
        openapi_url="/api/v1/openapi.json",
        docs_url=None,  # the bundled viewers load scripts from elsewhere
        redoc_url=None,
        lifespan=_lifespan,
        generate_unique_id_function=lambda route: route.name,
        middleware=[
            Middleware(Guard, settings=settings),
            Middleware(GZipMiddleware, compresslevel=4, exclude_content_types=NOT_COMPRESSED),
        ],
    )
    app.state.settings = settings
    app.state.busy_uploads, app.state.followers = set(), set()
    errors.install(app)
    for router in API_ROUTERS:
        app.include_router(router, prefix="/api/v1")
    for router in PAGE_ROUTERS:
        app.include_router(router, include_in_schema=False)
    app.mount("/static", FreshFiles(directory=paths.STATIC), name="static")
    openapi.install(app)
    return app


@contextlib.asynccontextmanager
async def _lifespan(app: FastAPI) -> AsyncIterator[None]:
    settings: Settings = app.state.settings
    settings.data.mkdir(parents=True, exist_ok=True)
    app.state.engine = make_engine(settings.url)
    try:
        migrate(app.state.engine)
        async with AsyncExitStack() as stack:
            for service in SERVICES:
                await stack.enter_async_context(service(app))
            yield
    finally:
        app.state.engine.dispose()
