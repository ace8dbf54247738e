"""Runs: list, look at, change, delete and bring back."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Query

from app.api import schemas
from app.api.deps import ReadSession, RunId, SettingsDep, WriteSession
from app.db.tables import Run
from app.store import arrays, beside
from app.store import jobs as job_store
from app.store import results as result_store
from app.store import runs as store

router = APIRouter(tags=["runs"])


@router.get("/runs", summary="List runs")
def list_runs(
    session: ReadSession,
    q: Annotated[
        str,
        Query(
            max_length=1000, description="words, and `robot:x tag:y has:imu gap:none`", examples=["corridor has:imu"]
        ),
    ] = "",
    robot: Annotated[list[str], Query(description="any of these robots")] = [],  # noqa: B006
    tag: Annotated[list[str], Query(description="all of these tags")] = [],  # noqa: B006
    has: Annotated[list[str], Query(description="all of these streams", examples=[["imu"]])] = [],  # noqa: B006
    sort: Annotated[
        str,
        Query(description=f"one of {', '.join(store.SORTS)}; `-` before it for descending", examples=["-created_at"]),
    ] = "-created_at",
    limit: Annotated[int, Query(ge=1, le=store.MAX_LIMIT)] = 50,
    cursor: Annotated[str | None, Query(max_length=1000, description="`next` of the page before")] = None,
) -> schemas.RunPage:
    """Stored runs that match all conditions, a page of them, with counts by robot, tag and stream over all matches.

    Runs without a value for the sorting key come last in either direction.
    """
    query = store.RunQuery(
        q=q, robots=tuple(robot), tags=tuple(tag), has=tuple(has), sort=sort, limit=limit, cursor=cursor
    )
    page = store.list_runs(session, query)
    return schemas.RunPage(
        items=[summary(run) for run in page.items], total=page.total, next=page.next, facets=page.facets
    )


@router.get("/runs/deleted", summary="List deleted runs")
def list_deleted_runs(session: ReadSession) -> list[schemas.RunSummary]:
    """Runs that can still be restored, last deleted first."""
    return [summary(run) for run in store.deleted_runs(session)]


@router.get("/runs/{run_id}", summary="Get a run")
def get_run(session: ReadSession, settings: SettingsDep, run_id: RunId) -> schemas.RunDetail:
    """All about one run but its readings: description, streams, estimates, methods that can run, jobs at work."""
    return detail(session, settings, store.get_run(session, run_id))


@router.patch("/runs/{run_id}", summary="Change name, robot, tags or notes")
def update_run(
    session: WriteSession, settings: SettingsDep, run_id: RunId, change: schemas.RunChange
) -> schemas.RunDetail:
    """Change what people write about a run. Its readings never change."""
    run = store.update_run(session, run_id, **change.model_dump())
    return detail(session, settings, run)


@router.delete("/runs/{run_id}", summary="Delete a run")
def delete_run(session: WriteSession, run_id: RunId) -> schemas.RunSummary:
    """Delete a run; for a day it can be restored."""
    return summary(store.delete_run(session, run_id))


@router.post("/runs/{run_id}/restore", summary="Restore a deleted run")
def restore_run(session: WriteSession, run_id: RunId) -> schemas.RunSummary:
    """Undo a deletion."""
    return summary(store.restore_run(session, run_id))


def summary(run: Run) -> schemas.RunSummary:
    """A run's row on the wire."""
    return schemas.RunSummary(**_summary(run))


def _summary(run: Run) -> dict[str, Any]:
    copied = ("id", "name", "created_at", "deleted_at", "duration_s", "size_bytes", "is_example", "is_live", "warnings")
    best = schemas.Best(method=run.best_method, ate_rmse_m=run.best_ate_m) if run.best_method else None
    return {
        **{k: getattr(run, k) for k in copied},
        "robot": run.robot.name if run.robot else None,
        "streams": [
            schemas.StreamInfo(
                name=s.name, rows=s.rows, t0=s.t0, t1=s.t1, rate_hz=s.rate_hz,
                gaps=len(s.gaps), columns=list(s.columns), names=s.names,
            )
            for s in run.streams
        ],
        "tags": [t.tag for t in run.tags],
        "best": best,
        "bias_drift_rad_s": run.bias_drift,
        "verdict": run.verdict,
        "sparkline": run.sparkline,
    }  # fmt: skip


def detail(session: ReadSession, settings: SettingsDep, run: Run) -> schemas.RunDetail:
    """A run with its estimates, methods and active jobs on the wire."""
    from core.estimation.pipeline import available  # compiled kernels: not needed to start the server

    loaded = arrays.run_from_manifest(settings.data, store.manifest(session, run.id))
    estimates = [
        schemas.EstimateSummary(
            id=e.id,
            method=e.method,
            created_at=e.created_at,
            runtime_s=e.runtime_s,
            final=e.final,
            metrics={name: schemas.MetricValue(**value) for name, value in result_store.metrics_of(e).items()},
        )
        for e in result_store.list_estimates(session, run.id)
    ]
    active = job_store.list_jobs(session, states=job_store.ACTIVE, run_id=run.id)
    copied = ("sha256", "t0", "t1", "meta", "notes")
    return schemas.RunDetail(
        **_summary(run),
        source=beside.told(run.source),
        **{k: getattr(run, k) for k in copied},
        estimates=estimates,
        methods=dict(available(loaded)),
        jobs=[job_store.as_dict(job) for job in active],
    )
