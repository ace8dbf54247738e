"""Estimates: ask for them, read their figures, series and files; the paths of a run for a map."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, Response
from pydantic_core import to_json

from app.api import schemas
from app.api.deps import JobsDep, ReadSession, RunId, SettingsDep
from app.api.estimate_schemas import Estimate, EstimateList, EstimateRequest, PathFigure
from app.api.streams import ARROW_RESPONSE, Columns, Form, From, Points, To, answer
from app.db.tables import Estimate as Row
from app.figures import errors as figures
from app.figures import path as path_figure
from app.figures.understood import understood
from app.store import arrays, results
from app.store import runs as run_store
from core.errors import MissingStreamError, ParameterError

router = APIRouter(tags=["estimates"])

EstimateId = Annotated[str, Path(description="the estimate's id", examples=["7c40e2a95d1b8f36"], max_length=64)]


@router.post("/runs/{run_id}/estimates", status_code=202, summary="Estimate paths")
def create_estimates(
    session: ReadSession, settings: SettingsDep, jobs: JobsDep, run_id: RunId, wanted: EstimateRequest
) -> schemas.Job:
    """Queue a job that estimates the run by each method. A result by the same method and config is replaced."""
    run = arrays.run_from_manifest(settings.data, run_store.manifest(session, run_id))
    check_methods(run, wanted.methods)
    check_config(run, wanted.config)
    params = {"methods": wanted.methods, "config": wanted.config}
    return schemas.Job(**jobs.get(jobs.submit("estimate", run_id, params)))


def check_methods(run: Any, methods: list[str] | None) -> None:
    """What would fail in the job fails here: ParameterError for an unknown method, MissingStreamError for an unfit."""
    from core.estimation.pipeline import available  # compiled kernels: not needed to start the server

    reasons = available(run)
    if methods is not None and not methods:
        raise ParameterError(
            "no method was asked for; null means all that can run", parameter="methods", expected=[*reasons]
        )
    for method in methods or ():
        if method not in reasons:
            raise ParameterError(
                f"unknown method {method!r}; methods are {', '.join(reasons)}",
                parameter="methods",
                expected=[*reasons],
                found=method,
            )
        if reasons[method] is not None:
            raise MissingStreamError(f"{method} cannot run: {reasons[method]}", method=method, missing=reasons[method])


def check_config(run: Any, config: dict[str, Any] | None) -> None:
    """ParameterError for an option that no method has, or a value that none takes."""
    from core.estimation.assumptions import assume

    assume(run, config)


@router.get("/runs/{run_id}/estimates", summary="List a run's estimates")
def list_estimates(session: ReadSession, settings: SettingsDep, run_id: RunId) -> EstimateList:
    """All estimates of a run, in the order of the methods."""
    run_store.get_run(session, run_id)
    return EstimateList(items=[wire(settings.data, row) for row in results.list_estimates(session, run_id)])


@router.get("/estimates/{estimate_id}", summary="Get an estimate")
def get_estimate(session: ReadSession, settings: SettingsDep, estimate_id: EstimateId) -> Estimate:
    """Figures, events, what was learnt and assumed, and what makes it again; not the path itself."""
    return wire(settings.data, results.get_estimate(session, estimate_id))


@router.get(
    "/estimates/{estimate_id}/series", summary="An estimate over time, thinned for a plot", responses=ARROW_RESPONSE
)
def get_estimate_series(
    session: ReadSession,
    settings: SettingsDep,
    estimate_id: EstimateId,
    columns: Columns = None,
    t0: From = None,
    t1: To = None,
    points: Points = 2000,
    form: Form = "json",
) -> Response:
    """Path, claimed deviations, gyro bias and errors against truth between `t0` and `t1`, thinned like streams.

    Errors have a value per stamp of the truth, the bias per stamp of its own. `columns` of the estimate lists them all;
    one that other estimates have and this one lacks is left out.
    """
    row = results.get_estimate(session, estimate_id)
    made = figures.estimate_series(settings.data, row.arrays, columns, t0=t0, t1=t1, points=points)
    return answer(row.method, made, [], form)


@router.get("/runs/{run_id}/path", summary="Paths for a map", responses={200: {"model": PathFigure}})
def get_path(
    session: ReadSession,
    settings: SettingsDep,
    run_id: RunId,
    methods: Annotated[
        str | None,
        Query(description="names with commas, `truth` and `fixes` too; default: all", max_length=500),
    ] = None,
    t0: From = None,
    t1: To = None,
    points: Annotated[int, Query(ge=path_figure.MIN_POINTS, le=path_figure.MAX_POINTS)] = 4000,
) -> Response:
    """Truth, fixes and the newest estimate of each method, at most `points` poses each, chosen to keep the shape.

    Beacons and fixes are where the estimates take them to be: their notes say what was put right.
    """
    run = understood(run_id, arrays.run_from_manifest(settings.data, run_store.manifest(session, run_id)))
    wanted = {m.strip() for m in methods.split(",")} if methods is not None else None
    sources = [
        *path_figure.of_run(run),
        *(path_figure.of_estimate(settings.data, e) for e in results.latest_by_method(session, run_id).values()),
    ]
    kept = [s for s in sources if wanted is None or s.method in wanted]
    return Response(to_json(path_figure.figure(run, kept, t0=t0, t1=t1, points=points)), media_type="application/json")


def wire(data: Any, row: Row) -> Estimate:
    """A row of the table on the wire."""
    copied = (
        "id", "run_id", "method", "created_at", "runtime_s", "final", "config", "config_hash", "seed", "code_version",
        "run_sha256", "job_id", "parameters", "events", "notes",
    )  # fmt: skip
    return Estimate(
        **{name: getattr(row, name) for name in copied},
        metrics={name: schemas.MetricValue(**value) for name, value in results.metrics_of(row).items()},
        columns=[name for name in row.arrays if figures.quantity(name) is not None],
        rows=len(arrays.open(data, row.arrays["t"])),
    )
