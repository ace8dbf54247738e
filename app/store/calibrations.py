"""Calibrations in the database: made from runs or uploaded, named, kept by robot."""

from __future__ import annotations

import secrets
from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session, selectinload

from app.db.tables import Calibration, Run, now
from app.errors import NotFoundError
from app.store.provenance import code_version
from core.calibration.imu import ImuCalibration
from core.errors import ParameterError

NAME_LENGTH = 200
PROCEDURES = ("rest", "six_position", "rate_table")
"""What `procedure.kind` of a run.json says of a run that was made to calibrate from."""


def list_calibrations(session: Session, robot: str | None = None) -> Sequence[Calibration]:
    """All of them, or those of one robot, newest first."""
    query = select(Calibration).order_by(Calibration.created_at.desc(), Calibration.id)
    if robot is not None:
        query = query.where(Calibration.robot == robot)
    return session.scalars(query).all()


def get_calibration(session: Session, calibration_id: str) -> Calibration:
    """The row of a calibration; NotFoundError if there is none."""
    row = session.get(Calibration, calibration_id)
    if row is None:
        raise NotFoundError(f"there is no calibration {calibration_id!r}", what="calibration", id=calibration_id)
    return row


def add_uploaded(session: Session, data: object, *, name: str, robot: str | None) -> Calibration:
    """Store a calibration/1 object; FormatError, naming the key, where it is none."""
    checked = ImuCalibration.from_json(data).to_json()
    return _add(
        session,
        name=name,
        robot=robot,
        job_id=None,
        runs=[],
        made={"result": checked, "report": {}, "notes": [], "runtime_s": 0.0, "config": {"source": "upload"}},
    )


def add_made(
    session: Session,
    run_ids: Sequence[str],
    made: Mapping[str, Any],
    *,
    job_id: str,
    name: str | None,
    robot: str | None,
) -> Calibration:
    """Store what `app.jobs.calibration.calibrate` made of these runs; their robot's, unless another is named."""
    runs = list(session.scalars(select(Run).where(Run.id.in_(run_ids))))
    runs.sort(key=lambda run: list(run_ids).index(run.id))
    if len(runs) < len(set(run_ids)):
        raise NotFoundError("a run of this calibration was deleted meanwhile", what="run")
    owner = robot or next((run.robot.name for run in runs if run.robot), None)
    return _add(session, name=name or _default_name(owner), robot=owner, job_id=job_id, runs=runs, made=made)


def _default_name(robot: str | None) -> str:
    return f"{robot or 'IMU'}, {now():%Y-%m-%d}"


def _add(
    session: Session,
    *,
    name: str,
    robot: str | None,
    job_id: str | None,
    runs: Sequence[Run],
    made: Mapping[str, Any],
) -> Calibration:
    row = Calibration(
        id=secrets.token_hex(8),
        name=_checked(name, "name"),
        robot=_checked(robot, "robot") if robot and robot.strip() else None,
        job_id=job_id,
        created_at=now(),
        run_ids=[run.id for run in runs],
        run_sha256=[run.sha256 for run in runs],
        code_version=made.get("code_version") or code_version(),
        **{key: made[key] for key in ("config", "runtime_s", "result", "report", "notes")},
    )
    session.add(row)
    session.flush()
    return row


def update_calibration(
    session: Session, calibration_id: str, *, name: str | None = None, robot: str | None = None
) -> Calibration:
    """Change name or robot; None leaves it, an empty `robot` takes it away."""
    row = get_calibration(session, calibration_id)
    if name is not None:
        row.name = _checked(name, "name")
    if robot is not None:
        row.robot = _checked(robot, "robot") if robot.strip() else None
    session.flush()
    return row


def delete_calibration(session: Session, calibration_id: str) -> None:
    """Forget; runs that were corrected by it stay."""
    session.delete(get_calibration(session, calibration_id))


def _checked(text: str, what: str) -> str:
    text = " ".join(text.split())
    if not text or len(text) > NAME_LENGTH:
        raise ParameterError(
            f"the {what} has {len(text)} characters, expected 1 to {NAME_LENGTH}",
            parameter=what,
            expected=f"1 to {NAME_LENGTH} characters",
            found=len(text),
        )
    return text


def calibration_runs(session: Session, robot: str | None = None, limit: int = 200) -> Sequence[Run]:
    """Runs that were made to calibrate from, by their `procedure`, newest first."""
    kind = Run.meta["procedure"]["kind"].as_string()
    query = select(Run).where(Run.deleted_at.is_(None), Run.stream_names.contains("imu"), kind.in_(PROCEDURES))
    if robot is not None:
        query = query.where(Run.robot.has(name=robot))
    query = query.options(selectinload(Run.streams)).order_by(Run.created_at.desc(), Run.id).limit(limit)
    return session.scalars(query).all()
