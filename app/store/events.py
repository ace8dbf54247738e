"""Events of a run as users judged them: each of the newest estimates' events with its id and what was decided."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from app.db.tables import EventDecision, now
from app.errors import NotFoundError
from app.store import results

CONFIRMED, DISMISSED = "confirmed", "dismissed"
SAME_S = 0.25  # an event found again may begin this much earlier or later

Event = dict[str, Any]


def list_events(session: Session, run_id: str, methods: Iterable[str] | None = None) -> list[Event]:
    """Events by the newest estimate of each method: method, id, kind, t0, t1, evidence, replaced, decision or None."""
    found = results.latest_by_method(session, run_id, None if methods is None else list(methods))
    by_method = decided(session, run_id, {m: e.events for m, e in found.items()})
    return [{"method": method, **event} for method, events in by_method.items() for event in events]


def decided(session: Session, run_id: str, events: Mapping[str, Sequence[Event]]) -> dict[str, list[Event]]:
    """The same events by method, each with `id` and `decision`."""
    rows = _rows(session, run_id)
    return {method: _with_decisions(listed, rows.get(method, [])) for method, listed in events.items()}


def _with_decisions(events: Sequence[Event], rows: Sequence[EventDecision]) -> list[Event]:
    word = {i: row.decision for row in rows if (i := _index(events, row)) is not None}
    return [{"id": event_id(e), **e, "decision": word.get(i)} for i, e in enumerate(events)]


def event_id(event: Event) -> str:
    """Kind and begin in milliseconds: `slip-12100`."""
    return f"{event['kind']}-{round(event['t0'] * 1000)}"


def decide(session: Session, run_id: str, method: str, key: str, decision: str | None) -> Event:
    """Confirm or dismiss an event, or take that back (None); the event as it is then. NotFoundError."""
    estimate = results.latest_by_method(session, run_id, [method]).get(method)
    events = estimate.events if estimate else []
    at = next((i for i, e in enumerate(events) if event_id(e) == key), None)
    if at is None:
        raise NotFoundError(f"run {run_id!r} has no event {key!r} by {method}", what="event", id=key)
    for row in _rows(session, run_id).get(method, []):
        if _index(events, row) == at:
            session.delete(row)
    event = events[at]
    if decision is not None:
        known = {"run_id": run_id, "method": method, "kind": event["kind"], "t0": event["t0"]}
        session.add(EventDecision(**known, decision=decision, decided_at=now()))
    session.flush()
    return {"method": method, "id": key, **event, "decision": decision}


def _rows(session: Session, run_id: str) -> dict[str, list[EventDecision]]:
    """Decisions on a run by method, the oldest first."""
    rows: dict[str, list[EventDecision]] = {}
    for row in session.scalars(select(EventDecision).filter_by(run_id=run_id).order_by(EventDecision.id)):
        rows.setdefault(row.method, []).append(row)
    return rows


def _index(events: Sequence[Event], row: EventDecision) -> int | None:
    """Which of the events the decision is on: the nearest of its kind, within SAME_S."""
    near = [(abs(e["t0"] - row.t0), i) for i, e in enumerate(events) if e["kind"] == row.kind]
    apart, i = min(near, default=(SAME_S + 1, 0))
    return i if apart <= SAME_S else None
