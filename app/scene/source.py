"""Scenes out of the store: a run's truth, fixes and newest path by each method, as memory-mapped columns."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator

import numpy as np
from fastapi import FastAPI
from sqlalchemy import Engine

from app.db.session import reading
from app.figures import path as figures
from app.scene.data import SceneData, ScenePath, Spread, fixes_of, truth_path
from app.scene.pool import Scenes
from app.settings import Settings
from app.store import results, runs


@contextlib.asynccontextmanager
async def service(app: FastAPI) -> AsyncIterator[None]:
    """The application's scenes, none open at the start."""
    engine, settings = app.state.engine, app.state.settings
    app.state.scenes = Scenes(lambda run: load(engine, settings, run), lambda run: revision(engine, run))
    try:
        yield
    finally:
        app.state.scenes.stop()


def revision(engine: Engine, run_id: str) -> str:
    """Changes whenever the run's scene would: new estimates, another name. NotFoundError."""
    with reading(engine) as session:
        run = runs.get_run(session, run_id)
        estimates = results.latest_by_method(session, run_id)
        return " ".join([run.name, *(f"{e.id}@{e.created_at.isoformat()}" for e in estimates.values())])


def load(engine: Engine, settings: Settings, run_id: str) -> SceneData:
    """The scene of a stored run. NotFoundError."""
    current = revision(engine, run_id)  # before the data: what comes in between is seen as new next time
    with reading(engine) as session:
        name = runs.get_run(session, run_id).name
        run = runs.load_run(session, settings, run_id)
        estimates = results.latest_by_method(session, run_id).values()
        sources = [figures.of_estimate(settings.data, estimate) for estimate in estimates]
    truth = truth_path(run)
    paths = ([truth] if truth else []) + [_path(source) for source in sources if len(source.columns["t"])]
    t0, t1 = run.span
    return SceneData(run_id, name, t0, t1, tuple(paths), dict(run.meta.beacons), fixes_of(run), run.meta.robot, current)


def _path(source: figures.Source) -> ScenePath:
    columns = source.columns
    theta = columns.get("theta", np.broadcast_to(np.nan, len(columns["t"])))
    spread = None
    if "sd_x" in columns and "sd_y" in columns:
        spread = Spread(columns["sd_x"], columns["sd_y"], columns.get("cov_xy"))
    return ScenePath(source.method, source.label, columns["t"], columns["x"], columns["y"], theta, spread)
