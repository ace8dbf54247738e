"""Consistency of estimates, and their events: figures for a plot, decisions of users, exports."""

from __future__ import annotations

import csv
import io
import re
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Path, Query, Response
from pydantic_core import to_json

from app.api.consistency_schemas import ConsistencyFigure, Decision, EventList, RunEvent
from app.api.deps import ReadSession, RunId, SettingsDep, WriteSession
from app.api.estimates import EstimateId
from app.api.streams import From, Points, To
from app.figures import consistency as figures
from app.store import events as store
from app.store import results
from app.store import runs as run_store

router = APIRouter(tags=["estimates"])

Method = Annotated[str, Path(description="a method's name", examples=["fused"], max_length=40)]
EventId = Annotated[str, Path(description="the event's id", examples=["slip-12100"], max_length=80)]
COLUMNS = ("method", "kind", "t0", "t1", "evidence", "replaced", "decision")
UNITS = {"t0": "t0 [s]", "t1": "t1 [s]"}


@router.get(
    "/estimates/{estimate_id}/consistency",
    summary="Does a method know its own errors?",
    responses={200: {"model": ConsistencyFigure}},
)
def get_consistency(
    session: ReadSession,
    settings: SettingsDep,
    estimate_id: EstimateId,
    t0: From = None,
    t1: To = None,
    points: Points = 2000,
) -> Response:
    """NIS per sensor with its chi-square band, whiteness, advice on R, and NEES where there is truth.

    Figures are over the whole run; running means and NEES between `t0` and `t1`, windows finer the shorter that is.
    """
    row = results.get_estimate(session, estimate_id)
    made = figures.figure(settings.data, row.arrays, row.consistency, t0=t0, t1=t1, points=points)
    return Response(to_json({"estimate": row.id, "method": row.method, **made}), media_type="application/json")


@router.get(
    "/runs/{run_id}/events",
    summary="List or export a run's events",
    responses={200: {"model": EventList, "content": {"text/csv": {"schema": {"type": "string"}}}}},
)
def list_events(
    session: ReadSession,
    run_id: RunId,
    method: Annotated[str | None, Query(description="by this method alone", max_length=40)] = None,
    form: Annotated[Literal["json", "csv"], Query(alias="format")] = "json",
) -> Response:
    """What happened on the run by the newest estimate of each method, with what users decided; as JSON or CSV."""
    run = run_store.get_run(session, run_id)
    found = store.list_events(session, run_id, None if method is None else [method])
    if form == "json":
        return Response(to_json({"items": found}), media_type="application/json")
    name = re.sub(r"[^\w.+-]+", "-", f"{run.name}-events", flags=re.ASCII).strip("-") or "events"
    head = {"Content-Disposition": f'attachment; filename="{name}.csv"'}
    return Response(_csv(found), media_type="text/csv; charset=utf-8", headers=head)


def _csv(events: list[dict[str, Any]]) -> str:
    out = io.StringIO()
    writer = csv.writer(out)
    writer.writerow([UNITS.get(c, c) for c in COLUMNS])
    writer.writerows([e[c] if e[c] is not None else "" for c in COLUMNS] for e in events)
    return out.getvalue()


@router.put("/runs/{run_id}/events/{method}/{event_id}", summary="Confirm or dismiss an event")
def put_event_decision(
    session: WriteSession, run_id: RunId, method: Method, event_id: EventId, decision: Decision
) -> RunEvent:
    """Kept when the run is estimated again, for the event of that kind that begins within 0.25 s of this one."""
    run_store.get_run(session, run_id)
    return RunEvent(**store.decide(session, run_id, method, event_id, decision.decision))


@router.delete("/runs/{run_id}/events/{method}/{event_id}", summary="Take a decision on an event back")
def delete_event_decision(session: WriteSession, run_id: RunId, method: Method, event_id: EventId) -> RunEvent:
    """The event as it was found; nothing happens where nothing was decided."""
    run_store.get_run(session, run_id)
    return RunEvent(**store.decide(session, run_id, method, event_id, None))
