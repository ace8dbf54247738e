"""Diagnoses in the database: what was found, on which runs, and all that makes it again. Deleted ones can come back.

Each run carries the verdict of the newest diagnosis that it took part in (`runs.verdict`), kept up to date here.
"""

from __future__ import annotations

import secrets
from collections.abc import Mapping, Sequence
from datetime import timedelta
from typing import Any

from sqlalchemy import Select, delete, select, update
from sqlalchemy.orm import Session, undefer

from app.db.tables import Diagnosis, DiagnosisRun, Run, now
from app.errors import NotFoundError
from core.errors import ParameterError

NAME_LENGTH = 200
NOTES_LENGTH = 20_000
MAX_LISTED = 500
VERDICTS = ("none", "explained", "partly_explained", "unknown")


def list_diagnoses(
    session: Session,
    *,
    run: str | None = None,
    robot: str | None = None,
    verdict: str | None = None,
    limit: int = 100,
    deleted: bool = False,
) -> Sequence[Diagnosis]:
    """Newest first; those of one run (fitted or held out), robot, verdict. ParameterError for an unknown verdict."""
    if verdict is not None and verdict not in VERDICTS:
        raise ParameterError(
            f"unknown verdict {verdict!r}; verdicts are {', '.join(VERDICTS)}",
            parameter="verdict",
            expected=list(VERDICTS),
            found=verdict,
        )
    query = select(Diagnosis).order_by(Diagnosis.created_at.desc(), Diagnosis.id.desc()).limit(min(limit, MAX_LISTED))
    query = query.where(Diagnosis.deleted_at.is_not(None) if deleted else Diagnosis.deleted_at.is_(None))
    if run is not None:
        query = query.where(Diagnosis.runs.any(DiagnosisRun.run_id == run))
    if robot is not None:
        query = query.where(Diagnosis.robot == robot)
    if verdict is not None:
        query = query.where(Diagnosis.verdict == verdict)
    return session.scalars(query).all()


def get_diagnosis(session: Session, diagnosis_id: str, *, evidence: bool = False, deleted: bool = False) -> Diagnosis:
    """The row of a diagnosis, with its evidence where that is wanted; NotFoundError if there is none."""
    row = session.get(Diagnosis, diagnosis_id, options=[undefer(Diagnosis.evidence)] if evidence else [])
    if row is None or (row.deleted_at is not None and not deleted):
        hint = "; it is deleted and can be restored" if row is not None else ""
        raise NotFoundError(f"there is no diagnosis {diagnosis_id!r}{hint}", what="diagnosis", id=diagnosis_id)
    return row


def add_diagnosis(
    session: Session,
    run_ids: Sequence[str],
    held_out: Sequence[str],
    made: Mapping[str, Any],
    *,
    job_id: str,
    name: str | None = None,
) -> Diagnosis:
    """Store what `app.jobs.diagnose.diagnose` made of these runs. NotFoundError where one is gone for good."""
    rows = {run.id: run for run in session.scalars(select(Run).where(Run.id.in_([*run_ids, *held_out])))}
    gone = [run_id for run_id in (*run_ids, *held_out) if run_id not in rows]
    if gone:
        raise NotFoundError(f"run {gone[0]!r} was deleted meanwhile", what="run", id=gone[0])
    fitted = [rows[run_id] for run_id in run_ids]
    robot = next((run.robot.name for run in fitted if run.robot), None)
    row = Diagnosis(
        id=secrets.token_hex(8),
        name=_checked_name(name or _default_name(robot, fitted)),
        robot=robot,
        job_id=job_id,
        created_at=now(),
        run_ids=list(run_ids),
        run_sha256=[run.sha256 for run in fitted],
        verdict=made["result"]["verdict"],
        notes="",
        runs=[
            DiagnosisRun(
                position=k, run_id=run.id, sha256=run.sha256, name=run.name, duration_s=run.duration_s,
                held_out=k >= len(fitted),
            )
            for k, run in enumerate([*fitted, *(rows[run_id] for run_id in held_out)])
        ],
        **{key: made[key] for key in ("simulator", "config", "seed", "code_version", "runtime_s")},
        **{key: made[key] for key in ("result", "model", "evidence")},
    )  # fmt: skip
    session.add(row)
    session.flush()
    _tell_runs(session, row)
    return row


def update_diagnosis(
    session: Session, diagnosis_id: str, *, name: str | None = None, notes: str | None = None
) -> Diagnosis:
    """Change what people write about it; None leaves a field."""
    row = get_diagnosis(session, diagnosis_id)
    if name is not None:
        row.name = _checked_name(name)
    if notes is not None:
        if len(notes) > NOTES_LENGTH:
            raise ParameterError(f"the notes have {len(notes)} characters, at most {NOTES_LENGTH}", parameter="notes")
        row.notes = notes
    session.flush()
    return row


def delete_diagnosis(session: Session, diagnosis_id: str) -> Diagnosis:
    """Mark as deleted; `purge` ends it after a day."""
    row = get_diagnosis(session, diagnosis_id)
    row.deleted_at = now()
    session.flush()
    _tell_runs(session, row)
    return row


def restore_diagnosis(session: Session, diagnosis_id: str) -> Diagnosis:
    """Undo the deletion."""
    row = get_diagnosis(session, diagnosis_id, deleted=True)
    row.deleted_at = None
    session.flush()
    _tell_runs(session, row)
    return row


def purge(session: Session, undo_hours: float) -> int:
    """End those that were deleted longer ago than that; how many."""
    limit = now() - timedelta(hours=undo_hours)
    ids = session.scalars(select(Diagnosis.id).where(Diagnosis.deleted_at < limit)).all()
    if ids:
        session.execute(delete(DiagnosisRun).where(DiagnosisRun.diagnosis_id.in_(ids)))
        session.execute(delete(Diagnosis).where(Diagnosis.id.in_(ids)))
    return len(ids)


def _tell_runs(session: Session, row: Diagnosis) -> None:
    """Give each run of this diagnosis the verdict of its newest one, or none."""
    for part in row.runs:
        verdict = session.scalar(_of_run(part.run_id))
        session.execute(update(Run).where(Run.id == part.run_id).values(verdict=verdict))


def _of_run(run_id: str) -> Select[Any]:
    newest = select(Diagnosis.verdict).join(DiagnosisRun).where(DiagnosisRun.run_id == run_id)
    return newest.where(Diagnosis.deleted_at.is_(None)).order_by(Diagnosis.created_at.desc(), Diagnosis.id).limit(1)


def _default_name(robot: str | None, runs: Sequence[Run]) -> str:
    of = runs[0].name if len(runs) == 1 else f"{runs[0].name} and {len(runs) - 1} more"
    return f"{robot}: {of}"[:NAME_LENGTH] if robot else of


def _checked_name(name: str) -> str:
    name = " ".join(name.split())
    if not name or len(name) > NAME_LENGTH:
        raise ParameterError(
            f"the name has {len(name)} characters, expected 1 to {NAME_LENGTH}",
            parameter="name",
            expected=f"1 to {NAME_LENGTH} characters",
            found=len(name),
        )
    return name
