"""Odometry calibrations in the database: the latest of each run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy.orm import Session

from app.db.tables import OdometryCalibration, Run, now
from app.errors import NotFoundError


def save(
    session: Session, run_ids: Sequence[str], made: Mapping[str, Any], *, job_id: str | None, config: Mapping[str, Any]
) -> OdometryCalibration:
    """Store what `app.jobs.odometry.calibrate` made, for the first of the runs; it replaces an earlier one."""
    runs = [session.get(Run, run_id) for run_id in run_ids]
    if runs[0] is None:
        raise NotFoundError(f"run {run_ids[0]!r} was deleted meanwhile", what="run", id=run_ids[0])
    row = find(session, run_ids[0]) or OdometryCalibration(run_id=run_ids[0])
    for name in ("result", "robot", "runtime_s", "code_version"):
        setattr(row, name, made[name])
    row.run_ids, row.run_sha256 = list(run_ids), [run.sha256 if run else None for run in runs]
    row.config, row.job_id, row.created_at = dict(config), job_id, now()
    session.add(row)
    session.flush()
    return row


def find(session: Session, run_id: str) -> OdometryCalibration | None:
    """A run's calibration, if it was made."""
    return session.get(OdometryCalibration, run_id)
