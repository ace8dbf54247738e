"""`/runs`: all runs, with search, facets, and the place where new ones come in."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import RedirectResponse
from sqlalchemy import func, select
from sqlalchemy.orm import Session

from app.api.runs import summary
from app.db.session import reading
from app.db.tables import Run
from app.figures.units import length
from app.pages.base import Page, render, route
from app.store.run_list import MAX_LIMIT, RunPage, RunQuery, list_runs
from core.formats.mapping import UNITS
from core.sensors import STREAMS

router = APIRouter()

FIRST_ROWS = 100


@dataclass(frozen=True)
class RunsPage(Page):
    """`data` is what the table shows first; `stored` how many runs there are before any search."""

    template: ClassVar[str] = "runs.html"
    place: ClassVar[str] = "runs"
    stored: int
    data: dict[str, Any]
    format: list[dict[str, Any]]


def _some(n: int, what: str) -> str:
    return f"{n:,} {what}" if n == 1 else f"{n:,} {what}s"


def sentence(page: RunPage, stored: int, q: str, best: Run | None) -> str:
    """What a colleague could repeat of the list; `best` is the run whose path is closest to its truth."""
    if stored == 0:
        return "No runs yet: drop a recording here and see where the robot was, by every method."
    if q:
        if page.total == 0:
            return f"None of {_some(stored, 'run')} matches."
        return f"{page.total:,} of {_some(stored, 'run')} {'matches' if page.total == 1 else 'match'}."
    robots, truth = len(page.facets["robots"]), page.facets["streams"].get("truth", 0)
    head = f"{_some(page.total, 'run')} of {_some(robots, 'robot')}" if robots else _some(page.total, "run")
    if truth == 0:
        return f"{head}, none with a truth to be measured against."
    measured = f"{head}, {'all' if truth == page.total else f'{truth:,}'} with a truth to be measured against"
    if best is None or best.best_ate_m is None:
        return f"{measured}."
    return f"{measured}; the best path is {length(best.best_ate_m)} off, “{best.name}” by {best.best_method}."


STOOD = 1e-6  # m: a robot that never moved is no best path


def _best(session: Session) -> Run | None:
    judged = select(Run).where(Run.deleted_at.is_(None), Run.best_ate_m > STOOD)
    return session.scalars(judged.order_by(Run.best_ate_m).limit(1)).unique().first()


def mapping_catalogue() -> dict[str, Any]:
    """What the mapping step offers: every stream's columns, and the units that each SI unit can come in."""
    streams = [
        {
            "name": s.name,
            "label": s.label,
            "columns": [dataclasses.asdict(c) for c in s.columns],
            "at_least_one_of": s.at_least_one_of,
        }
        for s in STREAMS.values()
    ]
    units = {si: {name: dataclasses.asdict(unit) for name, unit in known.items()} for si, known in UNITS.items()}
    return {"streams": streams, "units": units}


@route(router, "/runs")
def runs(
    request: Request,
    q: str = "",
    sort: str = "-created_at",
    limit: Annotated[int, Query(ge=1, le=MAX_LIMIT)] = FIRST_ROWS,
) -> Response:
    settings = request.app.state.settings
    with reading(request.app.state.engine) as session:
        page = list_runs(session, RunQuery(q=q, sort=sort, limit=limit))
        stored = session.scalar(select(func.count()).select_from(Run).where(Run.deleted_at.is_(None))) or 0
        items = [summary(run) for run in page.items]
        said = sentence(page, stored, q, None if q else _best(session))
    data = {
        "q": q,
        "sort": sort,
        "items": items,
        "total": page.total,
        "stored": stored,
        "next": page.next,
        "facets": page.facets,
        "undo_hours": settings.undo_hours,
        "max_upload_bytes": settings.max_upload_bytes,
    }
    catalogue = mapping_catalogue()
    if not request.url.path.endswith(".json"):
        data["mapping"] = catalogue
    return render(request, RunsPage("Runs", said, stored, data, catalogue["streams"]))


@router.get("/", include_in_schema=False)
def home() -> RedirectResponse:
    return RedirectResponse("/runs", 307)
