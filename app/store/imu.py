"""Results of the IMU room in the database, a row per part of a run's analysis."""

from __future__ import annotations

import secrets
from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from app.db.tables import ImuResult, Run, now
from app.errors import NotFoundError

_COPIED = ("config", "code_version", "runtime_s", "arrays", "figures", "notes", "error")


def save_parts(session: Session, run_id: str, job_id: str | None, made: Sequence[Mapping[str, Any]]) -> list[str]:
    """Store what `app.jobs.imu.analyse` made; a part of the same name is replaced and keeps its id. The parts."""
    run = session.get(Run, run_id)
    if run is None:
        raise NotFoundError(f"run {run_id!r} was deleted meanwhile", what="run", id=run_id)
    known = {row.part: row for row in session.scalars(select(ImuResult).filter_by(run_id=run_id))}
    for part in made:
        row = known.get(part["part"]) or ImuResult(id=secrets.token_hex(8), run_id=run_id, part=part["part"])
        for name in _COPIED:
            setattr(row, name, part[name])
        row.job_id, row.run_sha256, row.created_at = job_id, run.sha256, now()
        session.add(row)
    session.flush()
    return [part["part"] for part in made]


def parts_of(session: Session, run_id: str) -> dict[str, ImuResult]:
    """All parts of a run by name; none where it was not analysed."""
    rows = session.scalars(select(ImuResult).filter_by(run_id=run_id).order_by(ImuResult.part))
    return {row.part: row for row in rows}


def find_part(session: Session, run_id: str, part: str) -> ImuResult | None:
    """One part of a run's analysis, if it was made."""
    return session.scalars(select(ImuResult).filter_by(run_id=run_id, part=part)).one_or_none()
