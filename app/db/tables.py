"""The tables: metadata and array keys, never arrays. Times are UTC; JSON columns hold plain data only."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

from sqlalchemy import JSON, BigInteger, DateTime, ForeignKey, Index, MetaData, String, Text, UniqueConstraint, false
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column, relationship
from sqlalchemy.types import TypeDecorator


def now() -> datetime:
    return datetime.now(UTC)


class UtcDateTime(TypeDecorator[datetime]):
    """Aware UTC in and out, on SQLite too."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Any) -> datetime | None:
        return None if value is None else value.astimezone(UTC)

    def process_result_value(self, value: datetime | None, dialect: Any) -> datetime | None:
        return None if value is None else (value if value.tzinfo else value.replace(tzinfo=UTC))


class Base(DeclarativeBase):
    metadata = MetaData(
        naming_convention={
            "ix": "ix_%(table_name)s_%(column_0_N_name)s",
            "uq": "uq_%(table_name)s_%(column_0_N_name)s",
            "fk": "fk_%(table_name)s_%(column_0_N_name)s_%(referred_table_name)s",
            "pk": "pk_%(table_name)s",
        }
    )
    type_annotation_map = {datetime: UtcDateTime, dict[str, Any]: JSON, list[Any]: JSON}  # noqa: RUF012


class Robot(Base):
    __tablename__ = "robots"
    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(String(200), unique=True)
    created_at: Mapped[datetime] = mapped_column(default=now)


class Run(Base):
    """One stored run. `id` is the first 16 hex digits of `sha256`, the hash of its description and readings."""

    __tablename__ = "runs"
    # Rows are wide. These hold all that counting and sorting need, so that a list reads only the rows it shows.
    __table_args__ = (
        Index("ix_runs_facets", "deleted_at", "stream_names", "robot_id", "id"),
        *(
            Index(f"ix_runs_by_{key}", "deleted_at", key, "id")
            for key in ("created_at", "name", "duration_s", "size_bytes", "best_ate_m", "bias_drift", "verdict")
        ),
    )
    id: Mapped[str] = mapped_column(String(16), primary_key=True)
    sha256: Mapped[str] = mapped_column(String(64), unique=True)
    name: Mapped[str] = mapped_column(String(200))
    robot_id: Mapped[int | None] = mapped_column(ForeignKey("robots.id"), index=True)
    created_at: Mapped[datetime] = mapped_column(default=now)
    deleted_at: Mapped[datetime | None]
    t0: Mapped[float]
    t1: Mapped[float]
    duration_s: Mapped[float]
    size_bytes: Mapped[int] = mapped_column(BigInteger)
    meta: Mapped[dict[str, Any]]  # run.json as stored
    source: Mapped[dict[str, Any]]  # file name, format, mapping, size, sha256 of the upload, provenance
    warnings: Mapped[list[Any]]  # sentences
    notes: Mapped[str] = mapped_column(Text, default="")
    sparkline: Mapped[list[Any]]  # [[x, y], ...], at most 64 points of the best path known
    stream_names: Mapped[str] = mapped_column(String(200), default="")  # the streams it has, sorted: "beacon imu"
    # what lists sort and filter by, kept by the store whenever results change
    best_method: Mapped[str | None] = mapped_column(String(40))
    best_ate_m: Mapped[float | None]
    bias_drift: Mapped[float | None]  # rad/s, last minus first of the best gyro bias curve
    verdict: Mapped[str | None] = mapped_column(String(40))
    is_example: Mapped[bool] = mapped_column(default=False)
    is_live: Mapped[bool] = mapped_column(default=False, server_default=false())  # still growing, see `LiveRun`

    robot: Mapped[Robot | None] = relationship(lazy="joined")
    streams: Mapped[list[Stream]] = relationship(
        back_populates="run", cascade="all, delete-orphan", order_by="Stream.id"
    )
    tags: Mapped[list[Tag]] = relationship(cascade="all, delete-orphan", order_by="Tag.tag")
    estimates: Mapped[list[Estimate]] = relationship(back_populates="run", cascade="all, delete-orphan")
    words: Mapped[RunWords | None] = relationship(cascade="all, delete-orphan")


class RunWords(Base):
    """What free text looks in, a narrow table of its own: name, robot, tags, file name, notes; case-folded."""

    __tablename__ = "run_words"
    run_id: Mapped[str] = mapped_column(ForeignKey("runs.id", ondelete="CASCADE"), primary_key=True)
    text: Mapped[str] = mapped_column(Text)


class Tag(Base):
    __tablename__ = "tags"
    run_id: Mapped[str] = mapped_column(ForeignKey("runs.id", ondelete="CASCADE"), primary_key=True)
    tag: Mapped[str] = mapped_column(String(60), primary_key=True)
    __table_args__ = (Index("ix_tags_tag_run_id", "tag", "run_id"),)


class Stream(Base):
    """One stream of a run. `columns`: {name: array key}; `t` is float64, the rest as the source has it."""

    __tablename__ = "streams"
    __table_args__ = (UniqueConstraint("run_id", "name"),)
    id: Mapped[int] = mapped_column(primary_key=True)
    run_id: Mapped[str] = mapped_column(ForeignKey("runs.id", ondelete="CASCADE"), index=True)
    name: Mapped[str] = mapped_column(String(20), index=True)
    rows: Mapped[int] = mapped_column(BigInteger)
    t0: Mapped[float]
    t1: Mapped[float]
    rate_hz: Mapped[float]
    gaps: Mapped[list[Any]]  # [[t0, t1], ...] where stamps pause for over ten typical steps; the longest 100
    columns: Mapped[dict[str, Any]]
    names: Mapped[list[Any]]  # text categories of the stream (beacon names), else []
    run: Mapped[Run] = relationship(back_populates="streams")


class Job(Base):
    """The truth about long work; survives restarts. state: queued, running, done, failed, cancelled."""

    __tablename__ = "jobs"
    __table_args__ = (Index("ix_jobs_state_created_at", "state", "created_at"),)
    id: Mapped[str] = mapped_column(String(16), primary_key=True)
    kind: Mapped[str] = mapped_column(String(20))  # ingest, estimate
    run_id: Mapped[str | None] = mapped_column(ForeignKey("runs.id", ondelete="CASCADE"), index=True)
    params: Mapped[dict[str, Any]]
    state: Mapped[str] = mapped_column(String(12), default="queued")
    attempt: Mapped[int] = mapped_column(default=0)
    progress: Mapped[float] = mapped_column(default=0.0)  # 0 to 1
    message: Mapped[str] = mapped_column(String(300), default="")
    cancel_requested: Mapped[bool] = mapped_column(default=False)
    error: Mapped[dict[str, Any] | None]  # problem+json
    result: Mapped[dict[str, Any] | None]  # ids of what it made
    created_at: Mapped[datetime] = mapped_column(default=now)
    started_at: Mapped[datetime | None]
    finished_at: Mapped[datetime | None]


class Estimate(Base):
    """A stored estimate with all that is needed to make it again: method, config, seed, code version, run hash."""

    __tablename__ = "estimates"
    __table_args__ = (UniqueConstraint("run_id", "method", "config_hash"),)
    id: Mapped[str] = mapped_column(String(16), primary_key=True)
    run_id: Mapped[str] = mapped_column(ForeignKey("runs.id", ondelete="CASCADE"), index=True)
    job_id: Mapped[str | None] = mapped_column(String(16))
    method: Mapped[str] = mapped_column(String(40), index=True)
    config: Mapped[dict[str, Any]]
    config_hash: Mapped[str] = mapped_column(String(64))
    seed: Mapped[int] = mapped_column(default=0)
    code_version: Mapped[str] = mapped_column(String(80))
    run_sha256: Mapped[str] = mapped_column(String(64))
    created_at: Mapped[datetime] = mapped_column(default=now)
    runtime_s: Mapped[float]
    arrays: Mapped[dict[str, Any]]  # {column: array key}: t, x, y, theta, sd_x, ..., bias_t, bias, bias_sd, error_...
    final: Mapped[dict[str, Any]]  # x, y, theta
    parameters: Mapped[dict[str, Any]]
    events: Mapped[list[Any]]
    notes: Mapped[list[Any]]
    consistency: Mapped[dict[str, Any] | None]  # {sensors: {name: figures}, nees: figures or null}; null: made before
    run: Mapped[Run] = relationship(back_populates="estimates")
    metrics: Mapped[list[Metric]] = relationship(cascade="all, delete-orphan", order_by="Metric.id")


class Metric(Base):
    """One figure of one estimate, SI."""

    __tablename__ = "metrics"
    __table_args__ = (UniqueConstraint("estimate_id", "name"),)
    id: Mapped[int] = mapped_column(primary_key=True)
    estimate_id: Mapped[str] = mapped_column(ForeignKey("estimates.id", ondelete="CASCADE"), index=True)
    name: Mapped[str] = mapped_column(String(60))
    value: Mapped[float | None]
    unit: Mapped[str] = mapped_column(String(20))


class EventDecision(Base):
    """A user's word on one event of a run by one method: confirmed or dismissed.

    It belongs to the event of that kind nearest to `t0`, so that it stays when the run is estimated again.
    """

    __tablename__ = "event_decisions"
    id: Mapped[int] = mapped_column(primary_key=True)
    run_id: Mapped[str] = mapped_column(ForeignKey("runs.id", ondelete="CASCADE"), index=True)
    method: Mapped[str] = mapped_column(String(40))
    kind: Mapped[str] = mapped_column(String(40))
    t0: Mapped[float]
    decision: Mapped[str] = mapped_column(String(12))
    decided_at: Mapped[datetime] = mapped_column(default=now)


class ImuResult(Base):
    """One part of a run's IMU analysis (`app.jobs.imu`): `allan.gz`, `segments.ax`, `bias.C`, ...; what makes it again.

    Where a part could not be computed, `error` says why ({code, detail, where}) and there are no arrays.
    """

    __tablename__ = "imu_results"
    __table_args__ = (UniqueConstraint("run_id", "part"),)
    id: Mapped[str] = mapped_column(String(16), primary_key=True)
    run_id: Mapped[str] = mapped_column(ForeignKey("runs.id", ondelete="CASCADE"), index=True)
    part: Mapped[str] = mapped_column(String(40))
    job_id: Mapped[str | None] = mapped_column(String(16))
    config: Mapped[dict[str, Any]]
    code_version: Mapped[str] = mapped_column(String(80))
    run_sha256: Mapped[str] = mapped_column(String(64))
    created_at: Mapped[datetime] = mapped_column(default=now)
    runtime_s: Mapped[float]
    arrays: Mapped[dict[str, Any]]  # {name: array key}
    figures: Mapped[dict[str, Any]]  # SI
    notes: Mapped[list[Any]]
    error: Mapped[dict[str, Any] | None]


class Calibration(Base):
    """A stored IMU error model (schema calibration/1), made from runs or uploaded, with what makes it again."""

    __tablename__ = "calibrations"
    id: Mapped[str] = mapped_column(String(16), primary_key=True)
    name: Mapped[str] = mapped_column(String(200), index=True)
    robot: Mapped[str | None] = mapped_column(String(200), index=True)
    created_at: Mapped[datetime] = mapped_column(default=now)
    job_id: Mapped[str | None] = mapped_column(String(16))
    run_ids: Mapped[list[Any]]  # none where it was uploaded
    run_sha256: Mapped[list[Any]]
    config: Mapped[dict[str, Any]]
    code_version: Mapped[str] = mapped_column(String(80))
    runtime_s: Mapped[float]
    result: Mapped[dict[str, Any]]  # calibration/1
    report: Mapped[dict[str, Any]]  # curves and figures of the report, SI
    notes: Mapped[list[Any]]


class OdometryCalibration(Base):
    """The latest odometry calibration of a run (schema odometry-calibration/1), with what makes it again."""

    __tablename__ = "odometry_calibrations"
    run_id: Mapped[str] = mapped_column(ForeignKey("runs.id", ondelete="CASCADE"), primary_key=True)
    job_id: Mapped[str | None] = mapped_column(String(16))
    run_ids: Mapped[list[Any]]  # of all runs that it was made from, this one first
    run_sha256: Mapped[list[Any]]
    config: Mapped[dict[str, Any]]
    code_version: Mapped[str] = mapped_column(String(80))
    created_at: Mapped[datetime] = mapped_column(default=now)
    runtime_s: Mapped[float]
    result: Mapped[dict[str, Any]]
    robot: Mapped[dict[str, Any]]  # the robot section of run.json with what was found


class Diagnosis(Base):
    """A stored sim-to-real diagnosis (schema gap/1) with all that is needed to make it again."""

    __tablename__ = "diagnoses"
    id: Mapped[str] = mapped_column(String(16), primary_key=True)
    name: Mapped[str] = mapped_column(String(200), server_default="")
    robot: Mapped[str | None] = mapped_column(String(200), index=True)
    verdict: Mapped[str] = mapped_column(String(40), server_default="none")  # of `result`, to filter by
    notes: Mapped[str] = mapped_column(Text, server_default="")  # people's own words
    job_id: Mapped[str | None] = mapped_column(String(16))
    simulator: Mapped[str | None] = mapped_column(String(100))  # registered by name; null: ours
    run_ids: Mapped[list[Any]]  # of the runs that were fitted
    run_sha256: Mapped[list[Any]]
    config: Mapped[dict[str, Any]]  # tolerances
    seed: Mapped[int] = mapped_column(default=0)
    code_version: Mapped[str] = mapped_column(String(80))
    created_at: Mapped[datetime] = mapped_column(default=now, index=True)
    deleted_at: Mapped[datetime | None]
    runtime_s: Mapped[float]
    result: Mapped[dict[str, Any]]  # gap/1
    model: Mapped[dict[str, Any]] = mapped_column(server_default="{}")  # every effect that was fitted
    evidence: Mapped[dict[str, Any] | None] = mapped_column(deferred=True)  # gap-evidence/1; large
    runs: Mapped[list[DiagnosisRun]] = relationship(
        cascade="all, delete-orphan", order_by="DiagnosisRun.position", lazy="selectin"
    )


class DiagnosisRun(Base):
    """A run that a diagnosis is of, as it was then: the run may be deleted, the diagnosis stays."""

    __tablename__ = "diagnosis_runs"
    diagnosis_id: Mapped[str] = mapped_column(ForeignKey("diagnoses.id", ondelete="CASCADE"), primary_key=True)
    position: Mapped[int] = mapped_column(primary_key=True)  # those to fit first, then those held out
    run_id: Mapped[str] = mapped_column(String(16), index=True)
    sha256: Mapped[str] = mapped_column(String(64))
    name: Mapped[str] = mapped_column(String(200))
    duration_s: Mapped[float]
    held_out: Mapped[bool]


class LiveRun(Base):
    """A run that a robot streams, or streamed: `id` is that of the growing row in `runs` while it does; `run_id` the
    stored run that it became. state: live, ended, stored."""

    __tablename__ = "live_runs"
    id: Mapped[str] = mapped_column(String(16), primary_key=True)
    robot: Mapped[str] = mapped_column(String(64), index=True)
    key: Mapped[str] = mapped_column(String(64))  # the robot's name for this run: `session` of the protocol
    virtual: Mapped[bool] = mapped_column(default=False)
    state: Mapped[str] = mapped_column(String(12), index=True)
    run_id: Mapped[str | None] = mapped_column(String(16))
    job_id: Mapped[str | None] = mapped_column(String(16))  # the job that stores it
    started_at: Mapped[datetime] = mapped_column(default=now)
    ended_at: Mapped[datetime | None]


class Upload(Base):
    """A resumable upload in progress: bytes acknowledged so far are on disk in `data/uploads/<id>`."""

    __tablename__ = "uploads"
    id: Mapped[str] = mapped_column(String(16), primary_key=True)
    file_name: Mapped[str] = mapped_column(String(300))
    size: Mapped[int | None] = mapped_column(BigInteger)
    sha256: Mapped[str | None] = mapped_column(String(64))
    received: Mapped[int] = mapped_column(BigInteger, default=0)
    options: Mapped[dict[str, Any]]  # name, robot, tags, mapping
    job_id: Mapped[str | None] = mapped_column(String(16))  # the job that reads it; none while bytes may still come
    created_at: Mapped[datetime] = mapped_column(default=now)
    touched_at: Mapped[datetime] = mapped_column(default=now, index=True)


class ColumnMapping(Base):
    """A remembered mapping of a foreign CSV's columns to streams, units and signs."""

    __tablename__ = "column_mappings"
    name: Mapped[str] = mapped_column(String(100), primary_key=True)
    mapping: Mapped[dict[str, Any]]
    updated_at: Mapped[datetime] = mapped_column(default=now)
