"""Scenes out of the store: a run's truth, fixes and newest path by each method, as memory-mapped columns."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator
from typing import TYPE_CHECKING

import numpy as np
from fastapi import FastAPI
from sqlalchemy import Engine

from app.db.session import reading
from app.figures import path as figures
from app.figures.understood import understood
from app.scene.data import SceneData, SceneEvent, ScenePath, Spread, events_on, fixes_of, truth_path
from app.scene.pool import Scenes
from app.scene.style import primary
from app.settings import Settings
from app.store import events, results, runs
from core.simulation import simulate
from core.simulation.scenarios import SCENARIOS

if TYPE_CHECKING:
    from app.scene.live import Feed


SCENARIO = "scenario-"
"""A drive of the scenario library has a scene too (the sandbox's): this and its name are its run id."""


@contextlib.asynccontextmanager
async def service(app: FastAPI) -> AsyncIterator[None]:
    """The application's scenes, none open at the start."""
    engine, settings = app.state.engine, app.state.settings

    def feed(run_id: str) -> Feed | None:
        found: Feed | None = app.state.live.feed(run_id)
        return found

    app.state.scenes = Scenes(
        lambda run: load(engine, settings, run),
        lambda run: "live" if feed(run) else revision(engine, run),
        feed,
    )
    try:
        yield
    finally:
        app.state.scenes.stop()


def revision(engine: Engine, run_id: str) -> str:
    """Changes whenever the run's scene would: new estimates, another name, an event dismissed. NotFoundError."""
    if scenario_of(run_id):
        return SCENARIO
    with reading(engine) as session:
        run = runs.get_run(session, run_id)
        estimates = results.latest_by_method(session, run_id)
        gone = [f"{e['method']}:{e['id']}" for e in events.list_events(session, run_id) if e["decision"] == "dismissed"]
        return " ".join([run.name, *(f"{e.id}@{e.created_at.isoformat()}" for e in estimates.values()), *gone])


def load(engine: Engine, settings: Settings, run_id: str) -> SceneData:
    """The scene of a stored run. NotFoundError."""
    if name := scenario_of(run_id):
        return _scenario(run_id, name)
    current = revision(engine, run_id)  # before the data: what comes in between is seen as new next time
    with reading(engine) as session:
        name = runs.get_run(session, run_id).name
        run = understood(run_id, runs.load_run(session, settings, run_id))
        estimates = results.latest_by_method(session, run_id).values()
        sources = [figures.of_estimate(settings.data, estimate) for estimate in estimates]
        found = events.list_events(session, run_id)
    truth = truth_path(run)
    paths = ([truth] if truth else []) + [_path(source) for source in sources if len(source.columns["t"])]
    t0, t1 = run.span
    shown = _events([p for p in paths if p.method != "truth"], found)
    return SceneData(
        run_id, name, t0, t1, tuple(paths), dict(run.meta.beacons), fixes_of(run), run.meta.robot, current, shown
    )


def scenario_of(run_id: str) -> str | None:
    """The scenario's name, where that is what is asked for."""
    name = run_id.removeprefix(SCENARIO)
    return name if name != run_id and name in SCENARIOS else None


def _scenario(run_id: str, name: str) -> SceneData:
    """Where the nominal simulator drives a scenario, as if that were its truth."""
    run = simulate(SCENARIOS[name].run(), {}, 0, noise=False)
    path = truth_path(run)
    t0, t1 = run.span
    paths = (path,) if path else ()
    return SceneData(
        run_id,
        SCENARIOS[name].label,
        t0,
        t1,
        paths,
        dict(run.meta.beacons),
        fixes_of(run)[:0],
        run.meta.robot,
        SCENARIO,
        (),
    )


def _events(paths: list[ScenePath], found: list[events.Event]) -> tuple[SceneEvent, ...]:
    """The run's events on the path of the method that found them; those dismissed are left out."""
    having = [p for p in paths if any(e["method"] == p.method for e in found)]
    method = primary([p.method for p in having])
    kept = [e for e in found if e["method"] == method and e["decision"] != "dismissed"]
    return next((events_on(p, kept) for p in having if p.method == method), ())


def _path(source: figures.Source) -> ScenePath:
    columns = source.columns
    theta = columns.get("theta", np.broadcast_to(np.nan, len(columns["t"])))
    spread = None
    if "sd_x" in columns and "sd_y" in columns:
        spread = Spread(columns["sd_x"], columns["sd_y"], columns.get("cov_xy"))
    return ScenePath(source.method, source.label, columns["t"], columns["x"], columns["y"], theta, spread)
