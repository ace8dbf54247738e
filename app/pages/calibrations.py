"""`/calibrations`: the stored IMU calibrations, and what a new one can be made from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from fastapi import APIRouter, Request, Response

from app.api.calibrations import calibration_run, summary
from app.db.session import reading
from app.pages.base import Page, render, route
from app.store import calibrations as store

router = APIRouter()


@dataclass(frozen=True)
class CalibrationsPage(Page):
    """`calibrations`, newest first; `runs` that were made to calibrate from; each run's `robots` by its id."""

    template: ClassVar[str] = "calibrations.html"
    place: ClassVar[str] = "calibrations"
    calibrations: list[dict[str, Any]]
    runs: list[dict[str, Any]]
    robots: dict[str, str | None]


@route(router, "/calibrations")
def calibrations(request: Request) -> Response:
    with reading(request.app.state.engine) as session:
        rows = store.list_calibrations(session)
        runs = store.calibration_runs(session)
        page = CalibrationsPage(
            title="Calibrations",
            sentence=sentence(len(rows), len({row.robot for row in rows if row.robot}), len(runs)),
            calibrations=[summary(row).model_dump(mode="json") for row in rows],
            runs=[calibration_run(run).model_dump(mode="json") for run in runs],
            robots={run.id: run.robot.name if run.robot else None for run in runs},
        )
    return render(request, page)


def sentence(stored: int, robots: int, runs: int) -> str:
    """What there is and what could be made."""
    ready = f"{runs} {'run is' if runs == 1 else 'runs are'} there to calibrate from"
    if not stored:
        return f"No calibration yet; {ready if runs else 'record a rest, six positions or a rate table to make one'}."
    of = f" of {robots} {'robot' if robots == 1 else 'robots'}" if robots else ""
    return f"{stored} {'calibration' if stored == 1 else 'calibrations'}{of}; {ready}."
