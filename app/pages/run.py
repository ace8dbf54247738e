"""`/runs/{id}`: one run. The verdict first, then the paths, the errors, the signals, and where every number is from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from fastapi import APIRouter, Request, Response
from fastapi.responses import RedirectResponse
from sqlalchemy import select
from sqlalchemy.orm import Session

from app.db.session import reading
from app.db.tables import Estimate, Run
from app.figures.verdict import READINGS, Case, Judged, events_of, faults, lead_of, verdict
from app.pages.base import Page, render, route
from app.store import arrays, events, live, results, runs
from app.store import jobs as job_store
from core.estimation.pipeline import METHODS, available
from core.sensors import STREAMS

router = APIRouter()

EXPORTS = (
    ("run-csv.zip", "Run folder, CSV", "run.json and one CSV per stream: the run format"),
    ("run-parquet.zip", "Run folder, Parquet", "the same with Parquet tables: exact and small"),
)
TRUTH_EXPORTS = (
    ("truth.tum", "Truth, TUM", "t x y z qx qy qz qw per line"),
    ("truth.kitti", "Truth, KITTI", "3 x 4 pose matrix per line"),
)


@dataclass(frozen=True)
class RunPage(Page):
    """`run`, `estimates` (newest per method), `methods` (why each cannot run, else None), `jobs` (newest first), `lead`
    (the method that speaks for the run), `event_method` (whose events are the run's), `faults` (what is wrong with its
    readings), `neighbours` (ids of the newer
    and the older run), `exports`.
    """

    template: ClassVar[str] = "run.html"
    place: ClassVar[str] = "runs"
    run: dict[str, Any]
    estimates: list[dict[str, Any]]
    methods: list[dict[str, Any]]
    jobs: list[dict[str, Any]]
    lead: str | None
    event_method: str | None
    faults: list[str]
    neighbours: dict[str, str | None]
    exports: list[dict[str, str]]


@route(router, "/runs/{run_id}")
def run_page(request: Request, run_id: str) -> Response:
    settings = request.app.state.settings
    with reading(request.app.state.engine) as session:
        if (stored := live.became(session, run_id)) is not None:
            return RedirectResponse(request.url.path.replace(run_id, stored), 307)
        row = runs.get_run(session, run_id)
        estimates = list(results.latest_by_method(session, run_id).values())
        jobs = [job_store.as_dict(j) for j in job_store.list_jobs(session, run_id=run_id, limit=5)]
        reasons = available(runs.load_run(session, settings, run_id))
        found = events.decided(session, run_id, {e.method: e.events for e in estimates})
        case = _case(row, estimates, found, reasons, jobs, settings.data)
        speaks = events_of(case.estimates)
        page = RunPage(
            title=row.name,
            sentence=_so_far(row) if row.is_live else verdict(case),
            run=_run(row),
            estimates=[_estimate(e, found[e.method]) for e in estimates],
            methods=[_method(name, reason) for name, reason in reasons.items()],
            jobs=jobs,
            lead=lead_of(case.estimates).method if case.estimates else None,
            event_method=speaks.method if speaks else None,
            faults=faults([note for e in estimates if e.method == "fused" for note in e.notes], READINGS),
            neighbours=_neighbours(session, row),
            exports=_exports(row),
        )
    return render(request, page)


def _so_far(row: Run) -> str:
    streams = sum(s.rows > 0 for s in row.streams)
    return f"This run is still going on: {row.duration_s:.0f} s of {streams} streams so far."


def _case(
    row: Run,
    estimates: list[Estimate],
    found: dict[str, list[events.Event]],
    reasons: dict[str, str | None],
    jobs: list[dict[str, Any]],
    data: Path,
) -> Case:
    return Case(
        duration_s=row.duration_s,
        estimates=[
            Judged(e.method, {m.name: m.value for m in e.metrics}, found[e.method], _final_sd(e, data), e.notes)
            for e in estimates
        ],
        reasons=reasons,
        has_truth=any(s.name == "truth" for s in row.streams),
        job=next((j for j in jobs if j["kind"] == "estimate"), None),
    )


def _final_sd(estimate: Estimate, data: Path) -> float | None:
    """The standard deviation of position that the method claims at its last pose [m]."""
    keys = [estimate.arrays.get(name) for name in ("sd_x", "sd_y")]
    if None in keys:
        return None
    last = [arrays.open(data, str(key))[-1:] for key in keys]
    return float((last[0][0] ** 2 + last[1][0] ** 2) ** 0.5) if all(a.size for a in last) else None


def _run(row: Run) -> dict[str, Any]:
    copied = ("id", "sha256", "name", "t0", "t1", "duration_s", "size_bytes", "meta", "source", "warnings", "notes")
    return {
        **{name: getattr(row, name) for name in copied},
        "robot": row.robot.name if row.robot else None,
        "created_at": row.created_at.isoformat(),
        "is_example": row.is_example,
        "is_live": row.is_live,
        "tags": [t.tag for t in row.tags],
        "streams": [_stream(s) for s in row.streams],
    }


def _stream(stream: Any) -> dict[str, Any]:
    spec = STREAMS[stream.name]
    return {
        "name": stream.name,
        "label": spec.label,
        "rows": stream.rows,
        "rate_hz": stream.rate_hz,
        "t0": stream.t0,
        "t1": stream.t1,
        "gaps": stream.gaps,
        "names": stream.names,
        "columns": [
            {"name": c.name, "unit": c.unit, "label": c.label, "array": stream.columns[c.name]}
            for c in spec.columns
            if c.name in stream.columns
        ],
    }


def _estimate(row: Estimate, found: list[events.Event]) -> dict[str, Any]:
    copied = ("id", "method", "config", "seed", "code_version", "run_sha256", "runtime_s", "final", "parameters")
    return {
        **{name: getattr(row, name) for name in copied},
        "created_at": row.created_at.isoformat(),
        "events": found,
        "notes": row.notes,
        "columns": sorted(row.arrays),
        "sensors": sorted((row.consistency or {}).get("sensors", ())),
        "metrics": results.metrics_of(row),
    }


def _method(name: str, reason: str | None) -> dict[str, Any]:
    method = METHODS[name]
    told = {k: getattr(method, k) for k in ("label", "needs", "causal", "source", "summary")}
    return {"name": name, **told, "reason": reason}


def _neighbours(session: Session, row: Run) -> dict[str, str | None]:
    """The runs just above and just below in the list, newest first."""
    alive = select(Run.id).where(Run.deleted_at.is_(None), Run.id != row.id)
    newer = (Run.created_at > row.created_at) | ((Run.created_at == row.created_at) & (Run.id > row.id))
    above = alive.where(newer).order_by(Run.created_at.asc(), Run.id.asc()).limit(1)
    below = alive.where(~newer).order_by(Run.created_at.desc(), Run.id.desc()).limit(1)
    return {"newer": session.scalar(above), "older": session.scalar(below)}


def _exports(row: Run) -> list[dict[str, str]]:
    held = {s.name: s.columns for s in row.streams}
    rows = [*EXPORTS, *(TRUTH_EXPORTS if {"x", "y"} <= set(held.get("truth", ())) else ())]
    return [{"path": f"/api/v1/runs/{row.id}/files/{f}", "label": label, "what": what} for f, label, what in rows]
