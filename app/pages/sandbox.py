"""`/sandbox?run=...` or `?scenario=...`: effects on sliders, and what a run becomes of them, at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from fastapi import APIRouter, Request, Response
from sqlalchemy import select

from app.db.session import reading
from app.db.tables import Run
from app.exports.effects import TARGETS
from app.pages.base import Page, render, route
from app.simulators import OURS, RECORDED
from app.store import beside
from app.store.runs import get_run
from core.errors import ParameterError
from core.simulation.foreign import Foreign
from core.simulation.scenarios import SCENARIOS

router = APIRouter()
OFFERED = 200
FIRST = "square-ccw"
HELD = Foreign(RECORDED, lambda run, effects, seed: run, finished=True)
"""What any recorded simulated run can take."""


@dataclass(frozen=True)
class SandboxPage(Page):
    """source: {"run": id} or {"scenario": name}; runs, scenarios, simulators, targets: what can be chosen.

    refused: by simulator, the effects that it neither models nor can have put around it, with the reason.
    """

    template: ClassVar[str] = "sandbox.html"
    place: ClassVar[str] = "sandbox"
    source: dict[str, str]
    runs: list[dict[str, str]]
    scenarios: list[dict[str, str]]
    simulators: list[str]
    refused: dict[str, dict[str, str]]
    targets: list[dict[str, str]]


@route(router, "/sandbox")
def sandbox(request: Request, run: str | None = None, scenario: str | None = None) -> Response:
    if scenario is not None and scenario not in SCENARIOS:
        raise ParameterError(
            f"there is no scenario {scenario!r}", parameter="scenario", expected=list(SCENARIOS), found=scenario
        )
    with reading(request.app.state.engine) as session:
        newest = select(Run).where(Run.deleted_at.is_(None)).order_by(Run.created_at.desc()).limit(OFFERED)
        runs = [{"id": row.id, "name": row.name} for row in session.scalars(newest)]
        if run is not None and all(one["id"] != run for one in runs):
            runs.insert(0, {"id": run, "name": get_run(session, run).name})
        simulated = run is not None and beside.KEY in get_run(session, run).source
    foreign = {**({RECORDED: HELD} if simulated else {}), **request.app.state.sandbox.simulators()}
    source: dict[str, Any] = {"run": run} if run else {"scenario": scenario or FIRST}
    page = SandboxPage(
        "Sandbox",
        "Move an effect: the path, every stream and the gap follow.",
        source,
        runs,
        [{"name": s.name, "label": s.label} for s in SCENARIOS.values()],
        [OURS, *foreign],
        {name: one.refuses() for name, one in foreign.items()},
        [{"name": name, "label": t.label, "what": t.what} for name, t in TARGETS.items()],
    )
    return render(request, page)
