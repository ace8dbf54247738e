"""Estimates in the database, each with what makes it again, and the run's summary that lists sort by."""

from __future__ import annotations

import secrets
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from sqlalchemy import select
from sqlalchemy.orm import Session, selectinload

from app.db.tables import Estimate, Metric, Run, now
from app.errors import NotFoundError
from app.store import arrays
from app.store.provenance import config_hash

SPARKLINE_POINTS = 64
PREFERENCE = ("fused", "smoothed", "published", "encoders+gyro", "encoders", "beacon")
"""Which path speaks for a run where no truth ranks them."""

_COPIED = (
    "config", "seed", "code_version", "runtime_s", "arrays", "final", "parameters", "events", "notes", "consistency",
)  # fmt: skip


def save_estimates(
    session: Session, data: Path, run_id: str, job_id: str | None, outcomes: Sequence[Mapping[str, Any]]
) -> list[str]:
    """Store what `app.jobs.tasks.estimate` made and refresh the run's summary; the estimates' ids.

    An estimate by the same method and configuration is replaced and keeps its id, so links to it stay good.
    """
    run = session.get(Run, run_id)
    if run is None:
        raise NotFoundError(f"run {run_id!r} was deleted meanwhile", what="run", id=run_id)
    ids = [_save(session, run, job_id, outcome).id for outcome in outcomes]
    session.flush()
    refresh_summary(session, data, run)
    return ids


def _save(session: Session, run: Run, job_id: str | None, outcome: Mapping[str, Any]) -> Estimate:
    key = {"run_id": run.id, "method": outcome["method"], "config_hash": config_hash(outcome["config"])}
    row = session.scalars(select(Estimate).filter_by(**key)).one_or_none()
    if row is None:
        row = Estimate(id=secrets.token_hex(8), **key)
        session.add(row)
    for name in _COPIED:
        setattr(row, name, outcome[name])
    row.job_id, row.run_sha256, row.created_at = job_id, run.sha256, now()
    row.metrics.clear()
    session.flush()  # the old figures go before the new ones come: a name is unique within an estimate
    row.metrics.extend(Metric(**metric) for metric in outcome["metrics"])
    return row


def get_estimate(session: Session, estimate_id: str) -> Estimate:
    """The row of an estimate whose run isn't deleted; NotFoundError if there is none."""
    query = select(Estimate).join(Run).where(Estimate.id == estimate_id, Run.deleted_at.is_(None))
    row = session.scalars(query.options(selectinload(Estimate.metrics))).one_or_none()
    if row is None:
        raise NotFoundError(f"there is no estimate {estimate_id!r}", what="estimate", id=estimate_id)
    return row


def list_estimates(session: Session, run_id: str, methods: Collection[str] | None = None) -> list[Estimate]:
    """The estimates of a run, in the order of the methods' table, newest first within a method."""
    query = select(Estimate).where(Estimate.run_id == run_id).options(selectinload(Estimate.metrics))
    if methods is not None:
        query = query.where(Estimate.method.in_(methods))
    rows = session.scalars(query.order_by(Estimate.created_at.desc())).all()
    return sorted(rows, key=lambda e: _rank(e.method))


def latest_by_method(session: Session, run_id: str, methods: Collection[str] | None = None) -> dict[str, Estimate]:
    """One estimate per method: the newest."""
    found: dict[str, Estimate] = {}
    for row in list_estimates(session, run_id, methods):
        found.setdefault(row.method, row)
    return found


def notes_by_run(session: Session, run_ids: Collection[str], method: str = "fused") -> dict[str, list[str]]:
    """What the newest estimate by a method remarked on each run; runs without one are left out."""
    rows = select(Estimate.run_id, Estimate.notes).where(Estimate.run_id.in_(run_ids), Estimate.method == method)
    return dict(session.execute(rows.order_by(Estimate.created_at, Estimate.id)).tuples().all())


def _rank(method: str) -> int:
    from core.estimation.pipeline import METHODS

    order = list(METHODS)
    return order.index(method) if method in order else len(order)


def metrics_of(estimate: Estimate) -> dict[str, dict[str, Any]]:
    """{name: {value, unit}}."""
    return {m.name: {"value": m.value, "unit": m.unit} for m in estimate.metrics}


def refresh_summary(session: Session, data: Path, run: Run) -> None:
    """best_method, best_ate_m, bias_drift and sparkline of a run, from its estimates."""
    rows = list(session.scalars(select(Estimate).filter_by(run_id=run.id).options(selectinload(Estimate.metrics))))
    best = best_of(rows)
    if best is None:
        run.best_method = run.best_ate_m = run.bias_drift = None
        return
    run.best_method, run.best_ate_m = best.method, _metric(best, "ate_rmse_m")
    with_bias = [e for e in [best, *_by_preference(rows)] if _metric(e, "bias_drift_rad_s") is not None]
    run.bias_drift = _metric(with_bias[0], "bias_drift_rad_s") if with_bias else None
    run.sparkline = sparkline(data, best)


def best_of(rows: Sequence[Estimate]) -> Estimate | None:
    """The smallest error against truth; without truth, what PREFERENCE puts first."""
    judged = [(ate, e) for e in rows if (ate := _metric(e, "ate_rmse_m")) is not None]
    if judged:
        return min(judged, key=lambda pair: pair[0])[1]
    return next(iter(_by_preference(rows)), None)


def _by_preference(rows: Sequence[Estimate]) -> list[Estimate]:
    return sorted(rows, key=lambda e: PREFERENCE.index(e.method) if e.method in PREFERENCE else len(PREFERENCE))


def _metric(estimate: Estimate, name: str) -> float | None:
    return next((m.value for m in estimate.metrics if m.name == name), None)


def sparkline(data: Path, estimate: Estimate) -> list[list[float]]:
    """At most SPARKLINE_POINTS of its path, [[x, y], ...] in metres."""
    x, y = (arrays.open(data, estimate.arrays[name]) for name in ("x", "y"))
    if not len(x):
        return []
    picked = np.unique(np.linspace(0, len(x) - 1, SPARKLINE_POINTS).astype(int))
    xy = np.column_stack((x[picked], y[picked])).astype(float)
    return [[round(float(a), 4), round(float(b), 4)] for a, b in xy[np.isfinite(xy).all(axis=1)]]
