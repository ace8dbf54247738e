"""Stored diagnoses on the wire: a line of the list, and one whole."""

from __future__ import annotations

from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from app.api import diagnosis_schemas as wire
from app.db.tables import Diagnosis, Run
from app.figures import gap_sentence as words
from core.effects.chosen import effects_of


def summaries(session: Session, rows: Any) -> list[wire.DiagnosisSummary]:
    """Rows of the list on the wire."""
    stored = _stored(session, rows)
    return [wire.DiagnosisSummary(**_summary(row, stored)) for row in rows]


def detail(session: Session, row: Diagnosis) -> wire.DiagnosisDetail:
    """A diagnosis whole on the wire."""
    copied = ("result", "model", "notes", "config", "seed", "code_version", "runtime_s", "job_id")
    return wire.DiagnosisDetail(
        **_summary(row, _stored(session, [row])),
        effects=dict(effects_of(row.result)),
        **{name: getattr(row, name) for name in copied},
    )


def _stored(session: Session, rows: Any) -> set[str]:
    ids = {part.run_id for row in rows for part in row.runs}
    return set(session.scalars(select(Run.id).where(Run.id.in_(ids), Run.deleted_at.is_(None)))) if ids else set()


def _summary(row: Diagnosis, stored: set[str]) -> dict[str, Any]:
    runs = [
        wire.DiagnosedRun(
            id=part.run_id, name=part.name, sha256=part.sha256, duration_s=part.duration_s, held_out=part.held_out,
            stored=part.run_id in stored,
        )
        for part in row.runs
    ]  # fmt: skip
    copied = ("id", "name", "robot", "created_at", "deleted_at", "verdict", "simulator")
    return {
        **{name: getattr(row, name) for name in copied},
        "sentence": words.sentence(row.result),
        "headline": words.headline(row.result),
        "gap": row.result["gap"],
        "runs": runs,
    }
