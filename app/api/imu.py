"""The IMU of a run: noise by Allan deviation, statistics of a stretch, gyro bias and heading by every method."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Path, Query, Response
from pydantic import BaseModel
from sqlalchemy.orm import Session

from app.api import imu_schemas as wire
from app.api import schemas
from app.api.deps import JobsDep, ReadSession, RunId, SettingsDep
from app.api.streams import ARROW_RESPONSE, Columns, From, Points, To, answer, split
from app.db.tables import ImuResult
from app.errors import NotFoundError
from app.figures import imu as figures
from app.figures.imu_units import noise_table, unit_of
from app.figures.imu_verdict import sentence
from app.figures.series import numbers, table
from app.figures.signals import stream_of
from app.jobs.imu import AXES, axes_of, plain
from app.store import imu as store
from app.store import jobs as job_store
from app.store import runs as run_store
from core.errors import DriftscopeError, MissingStreamError, NotEnoughDataError, ParameterError

router = APIRouter(tags=["imu"])

MOST = 4_000_000  # readings that statistics are made of while a request waits
CSV = "text/csv; charset=utf-8"
CSV_RESPONSE: dict[str, Any] = {"text/csv": {"schema": {"type": "string"}}}
Axis = Annotated[Literal["gx", "gy", "gz", "ax", "ay", "az"], Query(description="an axis of the IMU")]
TextForm = Annotated[Literal["json", "csv"], Query(alias="format")]
SeriesForm = Annotated[Literal["json", "arrow", "csv"], Query(alias="format")]
Method = Annotated[str, Path(description="a bias method", examples=["C"], max_length=40)]
SERIES_RESPONSE: dict[int | str, dict[str, Any]] = {
    200: {**ARROW_RESPONSE[200], "content": {**ARROW_RESPONSE[200]["content"], **CSV_RESPONSE}}
}


@router.post("/runs/{run_id}/imu", status_code=202, summary="Analyse the IMU")
def create_imu_analysis(session: ReadSession, jobs: JobsDep, run_id: RunId, wanted: wire.ImuRequest) -> schemas.Job:
    """Queue a job: Allan deviation and segments of each axis, bias and heading by each method.

    New runs are analysed by themselves; ask again with other segments. Parts of the same name are replaced.
    """
    columns = _columns(run_store.manifest(session, run_id))
    _check(wanted.axes, axes_of(columns), "axes")
    if wanted.methods is not None:
        from core.imu.bias import METHODS

        _check(wanted.methods, list(METHODS), "methods")
    given = wanted.model_dump(include={"length", "n"}, exclude_none=True)
    params = {"axes": wanted.axes, "methods": wanted.methods, "config": given}
    return schemas.Job(**jobs.get(jobs.submit("imu", run_id, params)))


def _columns(manifest: dict[str, Any]) -> list[str]:
    return list(stream_of(manifest, "imu")["columns"])


def _check(asked: list[str] | None, known: list[str], parameter: str) -> None:
    unknown = [name for name in asked or () if name not in known]
    if unknown or asked == []:
        found = unknown[0] if unknown else "none"
        raise ParameterError(
            f"{parameter}: {found!r} is not among {', '.join(known)}; null means all",
            parameter=parameter,
            expected=known,
            found=found,
        )


@router.get("/runs/{run_id}/imu", summary="What is known of a run's IMU")
def get_imu(session: ReadSession, run_id: RunId) -> wire.ImuOverview:
    """The sentence, the methods in figures, the noise of each axis, and for whatever is missing the reason."""
    return overview(session, run_id)


def overview(session: Session, run_id: str) -> wire.ImuOverview:
    """The overview of a run, for this route and for its page."""
    run = run_store.get_run(session, run_id)
    parts = store.parts_of(session, run_id)
    columns = next((list(s.columns) for s in run.streams if s.name == "imu"), [])
    truth = next((list(s.columns) for s in run.streams if s.name == "truth"), [])
    newest = next((j for j in job_store.list_jobs(session, run_id=run_id) if j.kind == "imu"), None)
    return wire.ImuOverview(
        run_id=run_id,
        sentence=_sentence(parts, columns, run.duration_s, newest),
        axes=axes_of(columns),
        has_temperature="temperature" in columns,
        has_heading="theta" in truth,
        procedure=(run.meta.get("procedure") or {}).get("kind"),
        analysed=bool(parts),
        job=schemas.Job(**job_store.as_dict(newest)) if newest else None,
        rest=_rest(parts),
        methods=_methods(parts),
        noise={axis: _noise(parts[f"allan.{axis}"]) for axis in AXES if f"allan.{axis}" in parts},
        refusals={name: wire.Refusal(**row.error) for name, row in parts.items() if row.error},
    )


def _sentence(parts: dict[str, ImuResult], columns: list[str], duration_s: float, job: Any) -> str:
    if not columns:
        return "This run has no IMU."
    if not parts:
        at_work = job is not None and job.state in job_store.ACTIVE
        return "The IMU is being analysed." if at_work else "The IMU of this run has not been analysed yet."
    return sentence(parts, duration_s)


def _rest(parts: dict[str, ImuResult]) -> list[float] | None:
    made = (parts[name] for name in ("bias.best", "bias.C", "bias.B") if name in parts)
    row = next((row for row in made if not row.error), None)
    rest = None if row is None else row.figures.get("rest")
    return None if rest is None else list(rest)


def _noise(row: ImuResult) -> dict[str, float | None]:
    terms = row.figures.get("terms") or {}
    return {name: (terms.get(name) or {}).get("value") for name in ("N", "B", "K")}


def _methods(parts: dict[str, ImuResult]) -> list[wire.BiasMethod]:
    from core.imu.bias import METHODS

    rows = [(METHODS[m], parts[f"bias.{m}"]) for m in METHODS if f"bias.{m}" in parts]
    return [
        wire.BiasMethod(
            method=method.name,
            label=method.label,
            causal=method.causal,
            source=method.source,
            summary=row.figures,
            notes=row.notes,
            columns=[c for c, what in figures.BIAS.items() if (what.array or c) in row.arrays],
            error=wire.Refusal(**row.error) if row.error else None,
            provenance=wire.Provenance.model_validate(row),
        )
        for method, row in rows
    ]


@router.get("/runs/{run_id}/imu/bias", summary="Gyro bias by every method, in figures")
def list_imu_bias(session: ReadSession, run_id: RunId) -> wire.BiasList:
    """Per method: segments accepted and rejected by either test, drift, heading error against truth, notes."""
    run_store.get_run(session, run_id)
    return wire.BiasList(items=_methods(store.parts_of(session, run_id)))


@router.get(
    "/runs/{run_id}/imu/bias/{method}/series", summary="Gyro bias and heading over time", responses=SERIES_RESPONSE
)
def get_imu_bias_series(
    session: ReadSession,
    settings: SettingsDep,
    run_id: RunId,
    method: Method,
    columns: Columns = None,
    t0: From = None,
    t1: To = None,
    points: Points = 2000,
    form: SeriesForm = "json",
) -> Response:
    """Bias, heading, their deviations, the error against truth, and the segments by the verdict on them, each thinned
    by itself. `total` and `shown` say how much is left out.
    """
    row = _part(session, run_id, f"bias.{method}")
    made = figures.bias_series(settings.data, row.arrays, split(columns), t0=t0, t1=t1, points=points)
    return _series(method, made, form)


@router.get("/runs/{run_id}/imu/segments", summary="Segments of an axis over time", responses=SERIES_RESPONSE)
def get_imu_segments(
    session: ReadSession,
    settings: SettingsDep,
    run_id: RunId,
    axis: Axis = "gz",
    columns: Columns = None,
    t0: From = None,
    t1: To = None,
    points: Points = 2000,
    form: SeriesForm = "json",
) -> Response:
    """Mean, deviation, quartiles, extremes, skewness and kurtosis of each segment (Cechowicz, Fig. 5)."""
    row = _part(session, run_id, f"segments.{axis}")
    made = figures.segment_series(settings.data, row.arrays, axis, split(columns), t0=t0, t1=t1, points=points)
    return _series(axis, made, form)


def _series(name: str, made: list[Any], form: str) -> Response:
    if form != "csv":
        return answer(name, made, [], form)
    import io

    import polars as pl

    return Response(pl.read_ipc_stream(io.BytesIO(table(made))).write_csv(), media_type=CSV)


@router.get(
    "/runs/{run_id}/imu/allan",
    summary="Allan deviation of an axis with fitted noise",
    responses={200: {"model": wire.Allan, "content": CSV_RESPONSE}},
)
def get_imu_allan(
    session: ReadSession,
    settings: SettingsDep,
    run_id: RunId,
    axis: Axis = "gz",
    kind: Annotated[
        Literal["allan", "hadamard", "whole"],
        Query(description="`whole`: Allan deviation of all readings where the default takes those at rest"),
    ] = "allan",
    form: TextForm = "json",
) -> Response:
    """Overlapping deviation with its band (one sigma), the fitted terms in SI (two-sided densities) and as data sheets
    write them, with the conversion. A term that this record does not show is null.
    """
    row = _part(session, run_id, f"allan.{axis}")
    if kind not in row.arrays:
        raise NotFoundError(f"the analysis of {axis} has no curve {kind!r}", what="curve", id=kind)
    curve = figures.allan_curve(settings.data, row.arrays[kind])
    if form == "csv":
        return _csv(curve)
    fitted = row.figures
    body = wire.Allan(
        axis=axis,
        kind=kind,
        unit=unit_of(axis),
        readings="whole" if kind == "whole" else fitted["readings"],
        rest_share=fitted.get("rest_share"),
        curve=wire.AllanColumns(**curve),
        confidence=0.683,
        noise=[wire.NoiseTerm(**term) for term in noise_table(axis, fitted.get("terms") or {})],
        fit={name: fitted.get(name) for name in ("chi2", "dof", "tau0", "duration", "jitter")},
        notes=row.notes,
        provenance=wire.Provenance.model_validate(row),
    )
    return _json(body)


@router.get(
    "/runs/{run_id}/imu/statistics",
    summary="Statistics of a stretch of an axis",
    responses={200: {"model": wire.Statistics, "content": CSV_RESPONSE}},
)
def get_imu_statistics(
    session: ReadSession,
    settings: SettingsDep,
    run_id: RunId,
    axis: Axis = "gz",
    t0: From = None,
    t1: To = None,
    bins: Annotated[int | None, Query(ge=1, le=1000, description="of the histogram; default by the readings")] = None,
    form: TextForm = "json",
) -> Response:
    """Least, quartiles, mean, deviation, skewness and kurtosis of all readings between `t0` and `t1`, their histogram
    with the Gaussian, their normal probability plot. Of at most 4,000,000 readings.
    """
    from core.imu.statistics import describe

    stream = stream_of(run_store.manifest(session, run_id), "imu")
    if axis not in stream["columns"]:
        raise MissingStreamError(f"the run has no imu.{axis}", missing=f"imu.{axis}")
    values = figures.readings(settings.data, stream, axis, t0, t1, MOST)
    told = dataclasses.asdict(describe(values))
    if form == "csv":
        return _csv({"statistic": list(told), f"value [{unit_of(axis)}]": list(told.values())})
    histogram, probability, notes = _drawn(values, bins)
    body = wire.Statistics(
        axis=axis,
        unit=unit_of(axis),
        t0=t0,
        t1=t1,
        description=wire.Describes(**plain(told)),
        histogram=histogram,
        probability=probability,
        notes=notes,
    )
    return _json(body)


def _drawn(
    values: Any, bins: int | None
) -> tuple[wire.HistogramColumns | None, wire.ProbabilityColumns | None, list[str]]:
    from core.imu.statistics import histogram, probability_plot

    try:
        counts, plot = histogram(values, bins), probability_plot(values)
    except NotEnoughDataError as error:
        return None, None, [error.message]
    bars = wire.HistogramColumns(
        edges=counts.edges.tolist(), counts=counts.counts.tolist(), gaussian=numbers(counts.gaussian)
    )
    line = wire.ProbabilityColumns(
        quantiles=plot.quantiles.tolist(),
        ordered=plot.ordered.tolist(),
        slope=plot.slope,
        intercept=plot.intercept,
        correlation=plot.correlation,
        total=len(values),
        shown=len(plot.ordered),
    )
    return bars, line, []


@router.get("/runs/{run_id}/imu/temperature", summary="Gyro bias against temperature")
def get_imu_temperature(
    session: ReadSession, settings: SettingsDep, run_id: RunId, points: Points = 2000
) -> wire.TemperatureFigure:
    """Mean temperature and mean reading of every segment that method C took for rest, and a line through them."""
    row = _part(session, run_id, "temperature")
    columns, total = figures.temperature_points(settings.data, row.arrays["points"], points)
    method = str(row.figures.get("method", "C"))
    return wire.TemperatureFigure(
        method=method, **columns, total=total, shown=len(columns["t"]), summary=dict(row.figures)
    )


def _part(session: Session, run_id: str, part: str) -> ImuResult:
    """A stored part; NotFoundError where it was not made, its own refusal where it could not be."""
    run_store.get_run(session, run_id)
    row = store.find_part(session, run_id, part)
    if row is None:
        known = ", ".join(store.parts_of(session, run_id)) or "none"
        raise NotFoundError(
            f"there is no result {part!r} of this run's IMU (it has: {known}); POST /runs/{run_id}/imu makes it",
            what="imu",
            id=part,
        )
    if row.error:
        refusal = DriftscopeError(row.error["detail"], **row.error.get("where") or {})
        refusal.code = row.error["code"]
        raise refusal
    return row


def _json(body: BaseModel) -> Response:
    return Response(body.model_dump_json(), media_type="application/json")


def _csv(columns: Mapping[str, Iterable[Any]]) -> Response:
    import polars as pl

    return Response(pl.DataFrame(dict(columns), strict=False).write_csv(), media_type=CSV)
