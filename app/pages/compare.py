"""`/compare?runs=a,b`: two to eight runs over each other, by one method; their errors, figures and descriptions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from fastapi import APIRouter, Request, Response
from sqlalchemy.orm import Session

from app.db.session import reading
from app.db.tables import Estimate, Run
from app.figures.units import length
from app.pages.base import Page, render, route
from app.store import results
from app.store.runs import get_run
from core.errors import ParameterError
from core.estimation.pipeline import METHODS

router = APIRouter()

LEAST, MOST = 2, 8
LETTERS = "ABCDEFGH"


@dataclass(frozen=True)
class Compared:
    """One run of the comparison; `estimates` by method with id, metrics {name: {value, unit}} and configuration."""

    id: str
    letter: str
    name: str
    robot: str | None
    duration_s: float
    t0: float
    t1: float
    streams: list[str]
    estimates: dict[str, dict[str, Any]]
    description: dict[str, Any]


@dataclass(frozen=True)
class ComparePage(Page):
    """`method` is the one that is drawn; `methods` those that at least one of the runs has."""

    template: ClassVar[str] = "compare.html"
    place: ClassVar[str] = "compare"
    method: str | None
    methods: list[str]
    runs: list[Compared]


def flatten(value: Any, path: str = "") -> dict[str, Any]:
    """Nested data as {dotted key: leaf}; lists of plain values stay whole."""
    if isinstance(value, Mapping) and value:
        parts = [flatten(v, f"{path}.{k}" if path else str(k)) for k, v in value.items()]
        return {key: leaf for part in parts for key, leaf in part.items()}
    return {path: value}


def _described(estimate: Estimate) -> dict[str, Any]:
    return {
        "id": estimate.id,
        "metrics": results.metrics_of(estimate),
        "config": flatten(estimate.config) if estimate.config else {},
        "code_version": estimate.code_version,
        "runtime_s": estimate.runtime_s,
    }


def _compared(session: Session, run: Run, letter: str) -> Compared:
    streams = {s.name: {"rows": s.rows, "rate_hz": s.rate_hz} for s in run.streams}
    return Compared(
        id=run.id,
        letter=letter,
        name=run.name,
        robot=run.robot.name if run.robot else None,
        duration_s=run.duration_s,
        t0=run.t0,
        t1=run.t1,
        streams=[s.name for s in run.streams],
        estimates={m: _described(e) for m, e in results.latest_by_method(session, run.id).items()},
        description=flatten({**run.meta, "streams": streams, "tags": ", ".join(t.tag for t in run.tags)}),
    )


def _chosen(method: str | None, runs: Sequence[Compared]) -> tuple[str | None, list[str]]:
    """The method to draw, and all to choose from: the asked one, else what most runs have, the best first."""
    order = [*results.PREFERENCE, *METHODS]
    had = {m for run in runs for m in run.estimates}
    methods = sorted(had, key=lambda m: list(METHODS).index(m) if m in METHODS else len(METHODS))
    if method is not None and method not in METHODS:
        raise ParameterError(
            f"there is no method {method!r}", parameter="method", found=method, expected=", ".join(METHODS)
        )
    if method in had:
        return method, methods
    by_use = sorted(had, key=lambda m: (-sum(m in run.estimates for run in runs), order.index(m)))
    return (by_use[0] if by_use else None), methods


def sentence(method: str | None, runs: Sequence[Compared]) -> str:
    """Which run went best by the method, and how far the others are from it."""
    if not runs:
        return "Choose two to eight runs in the list, then Compare."
    if method is None:
        return "Nothing to compare yet: none of these runs has an estimate."
    label = method.replace("+", " + ")
    errors = [(e["metrics"].get("ate_rmse_m", {}).get("value"), r) for r in runs if (e := r.estimates.get(method))]
    judged = sorted(((ate, run) for ate, run in errors if ate is not None), key=lambda pair: pair[0])
    if not judged:
        return f"By {label}: {len(errors)} of {len(runs)} runs have a path; none has a truth to be measured against."
    best, worst = judged[0], judged[-1]
    head = f"By {label}, “{best[1].name}” stays closest to its truth, {length(best[0])} off on average"
    return f"{head}; “{worst[1].name}” is {length(worst[0])} off." if worst is not best else f"{head}."


@route(router, "/compare")
def compare(request: Request, runs: str = "", method: str | None = None) -> Response:
    ids = list(dict.fromkeys(i for i in runs.split(",") if i))
    if ids and not LEAST <= len(ids) <= MOST:
        raise ParameterError(
            f"{len(ids)} run{'s' if len(ids) > 1 else ''} to compare, expected {LEAST} to {MOST}",
            parameter="runs",
            expected=f"{LEAST} to {MOST} run ids, commas between",
            found=len(ids),
        )
    with reading(request.app.state.engine) as session:
        compared = [_compared(session, get_run(session, i), LETTERS[k]) for k, i in enumerate(ids)]
    chosen, methods = _chosen(method, compared)
    page = ComparePage("Compare", sentence(chosen, compared), chosen, methods, compared)
    return render(request, page)
