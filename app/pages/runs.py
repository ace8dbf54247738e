"""`/runs`: all runs, with search, facets, and the place where new ones come in."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import RedirectResponse
from sqlalchemy import func, select

from app.api.runs import summary
from app.db.session import reading
from app.db.tables import Run
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


def sentence(page: RunPage, stored: int, q: str) -> str:
    """What a colleague could repeat of the list."""
    if stored == 0:
        return "No runs yet: drop a recording here and see where the robot was, by every method."
    if page.total == 0:
        return f"None of {_some(stored, 'run')} matches."
    robots, truth = len(page.facets["robots"]), page.facets["streams"].get("truth", 0)
    head = f"{page.total:,} of {_some(stored, 'run')} match" if q else _some(page.total, "run")
    if page.total == 1 and q:
        head = f"One of {_some(stored, 'run')} matches"
    of_robots = (
        f" of {_some(robots, 'robot')}" if robots and not q else f", of {_some(robots, 'robot')}" if robots else ""
    )
    measured = f"{'all' if truth == page.total else f'{truth:,}'} with a truth to be measured against"
    return f"{head}{of_robots}, {measured if truth else 'none with a truth to be measured against'}."


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
    return render(request, RunsPage("Runs", sentence(page, stored, q), stored, data, catalogue["streams"]))


@router.get("/", include_in_schema=False)
def home() -> RedirectResponse:
    return RedirectResponse("/runs", 307)
