"""What goes over the wire, shared by all routes. SI units; times of day in UTC."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field


class Wire(BaseModel):
    """Base of all wire types."""

    model_config = ConfigDict(from_attributes=True)


class Problem(Wire):
    """Every error of every route (RFC 9457)."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "type": "urn:driftscope:problem:format",
                    "title": "Unprocessable Content",
                    "status": 422,
                    "detail": "imu.csv: row 17, column gz: expected a number, found 'abc'",
                    "code": "format",
                    "where": {"file": "imu.csv", "stream": "imu", "row": 17, "column": "gz", "found": "abc"},
                    "instance": "/api/v1/runs",
                }
            ]
        }
    )
    type: str
    title: str
    status: int
    detail: str
    code: str = Field(description="stable slug of the kind of error")
    where: dict[str, Any] = Field(description="what the detail says, as data: file, stream, row, column, ...")
    instance: str = Field(description="the path that was asked for")


def example(value: dict[str, Any]) -> ConfigDict:
    """Settings of a wire type with one example."""
    return ConfigDict(from_attributes=True, json_schema_extra={"examples": [value]})


STREAM: dict[str, Any] = {
    "name": "imu",
    "rows": 720000,
    "t0": 0.0,
    "t1": 1200.0,
    "rate_hz": 600.0,
    "gaps": 1,
    "columns": ["t", "gz"],
    "names": [],
}
SUMMARY: dict[str, Any] = {
    "id": "9f2c1ab84e5d7703",
    "name": "corridor lap 3",
    "robot": "mill",
    "created_at": "2026-03-01T09:30:00Z",
    "deleted_at": None,
    "duration_s": 1200.0,
    "streams": [STREAM],
    "tags": ["wet"],
    "best": {"method": "fused", "ate_rmse_m": 0.021},
    "bias_drift_rad_s": 6.8e-5,
    "verdict": None,
    "sparkline": [[0.0, 0.0], [1.2, 0.1]],
    "size_bytes": 11520000,
    "is_example": False,
    "is_live": False,
    "warnings": [],
}


class StreamInfo(Wire):
    """One stream of a run, without its readings."""

    model_config = example(STREAM)
    name: str
    rows: int
    t0: float = Field(description="first stamp [s]")
    t1: float = Field(description="last stamp [s]")
    rate_hz: float = Field(description="typical sampling rate")
    gaps: int = Field(description="pauses of over ten typical steps (at most 100 are kept)")
    columns: list[str]
    names: list[str] = Field(description="beacons of `ranges`; else empty")


class Best(Wire):
    """The method that did best on a run, by its error against truth where there is one."""

    method: str
    ate_rmse_m: float | None = Field(description="root mean square of the position error [m]")


class RunSummary(Wire):
    """One row of the list of runs."""

    model_config = example(SUMMARY)
    id: str = Field(description="first 16 hex digits of the run's SHA-256: the same readings have the same id")
    name: str
    robot: str | None
    created_at: datetime
    deleted_at: datetime | None
    duration_s: float
    streams: list[StreamInfo]
    tags: list[str]
    best: Best | None
    bias_drift_rad_s: float | None = Field(description="last minus first gyro bias [rad/s]")
    verdict: str | None = Field(description="of the last sim-to-real diagnosis")
    sparkline: list[list[float]] = Field(description="at most 64 points [x, y] of the path [m]")
    size_bytes: int
    is_example: bool
    is_live: bool = Field(default=False, description="a robot still streams it")
    warnings: list[str]


class RunPage(Wire):
    """One page of the list. `facets`: how many of all that match, by robot, tag, stream and verdict."""

    model_config = example(
        {
            "items": [SUMMARY],
            "total": 1,
            "next": None,
            "facets": {"robots": {"mill": 1}, "tags": {"wet": 1}, "streams": {"imu": 1}, "verdicts": {}},
        }
    )
    items: list[RunSummary]
    total: int
    next: str | None = Field(description="`cursor` of the next page; null on the last")
    facets: dict[str, dict[str, int]]


class MetricValue(Wire):
    """One figure with its SI unit."""

    value: float | None
    unit: str


class EstimateSummary(Wire):
    """One method's result on a run, without its path."""

    id: str
    method: str
    created_at: datetime
    runtime_s: float
    final: dict[str, float | None] = Field(description="pose at the end: x, y [m], theta [rad]")
    metrics: dict[str, MetricValue]


class RunDetail(RunSummary):
    """All about one run, without its readings."""

    model_config = example(
        {
            **SUMMARY,
            "sha256": "9f2c1ab84e5d7703" * 4,
            "t0": 0.0,
            "t1": 1200.0,
            "meta": {"format": "run/1", "robot": {"wheel_radius": 0.075, "track_width": 0.32}},
            "source": {"file_name": "lap3.zip", "format": "run-zip", "size_bytes": 10400000},
            "notes": "",
            "estimates": [],
            "methods": {"fused": None, "beacon": "the run has no beacon stream"},
            "jobs": [],
        }
    )
    sha256: str
    t0: float
    t1: float
    meta: dict[str, Any] = Field(description="run.json as stored")
    source: dict[str, Any] = Field(description="the file it came from: name, format, size, mapping")
    notes: str
    estimates: list[EstimateSummary]
    methods: dict[str, str | None] = Field(description="by method: null, or the reason why it can't run on this run")
    jobs: list[dict[str, Any]] = Field(description="jobs on this run that are queued or running")


class RunChange(BaseModel):
    """What people write about a run; what is absent stays as it is."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"examples": [{"name": "lap 3, wet", "tags": ["wet"]}]})
    name: str | None = Field(default=None, min_length=1, max_length=200)
    robot: str | None = Field(default=None, max_length=200, description="empty text takes the robot away")
    tags: list[str] | None = Field(default=None, max_length=50)
    notes: str | None = Field(default=None, max_length=100_000)


class Job(Wire):
    """Long work, and how far it is."""

    model_config = example(
        {
            "id": "5b1e9c0d7a2f4e66",
            "kind": "ingest",
            "run_id": None,
            "state": "running",
            "attempt": 1,
            "progress": 0.4,
            "message": "imu: 2,000,000 rows",
            "error": None,
            "result": None,
            "created_at": "2026-03-01T09:30:00Z",
            "started_at": "2026-03-01T09:30:00Z",
            "finished_at": None,
        }
    )
    id: str
    kind: str
    run_id: str | None
    state: Literal["queued", "running", "done", "failed", "cancelled"]
    attempt: int
    progress: float = Field(description="0 to 1")
    message: str
    error: dict[str, Any] | None = Field(description="a Problem, where the job failed")
    result: dict[str, Any] | None = Field(description="ids of what it made")
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None


MAPPING: dict[str, Any] = {
    "streams": {
        "imu": {
            "t": {"column": "time_ms", "unit": "ms", "sign": 1},
            "gz": {"column": "gyro_z", "unit": "deg/s", "sign": -1},
        }
    },
    "t0": "first",
}


class UploadStart(BaseModel):
    """What is going to be uploaded."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={"examples": [{"file_name": "lap3.zip", "size": 10400000, "robot": "mill", "tags": ["wet"]}]},
    )
    file_name: str = Field(min_length=1, max_length=300)
    size: int = Field(ge=0, description="bytes")
    sha256: str | None = Field(default=None, description="of the whole file; checked before it is read")
    name: str | None = Field(default=None, max_length=200, description="the run's name; else the file's own")
    robot: str | None = Field(default=None, max_length=200)
    tags: list[str] = Field(default_factory=list, max_length=50)
    mapping: dict[str, Any] | None = Field(default=None, description="how a foreign table's columns become streams")


class UploadState(Wire):
    """An upload in progress. `received` bytes are safe on the server's disk; go on from there."""

    model_config = example(
        {
            "id": "0d4c7be1a5f29386",
            "file_name": "lap3.zip",
            "size": 10400000,
            "received": 8388608,
            "created_at": "2026-03-01T09:30:00Z",
            "job_id": None,
        }
    )
    id: str
    file_name: str
    size: int | None
    received: int
    created_at: datetime
    job_id: str | None


class UploadFinish(BaseModel):
    """How to read the upload."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"examples": [{"mapping": MAPPING}]})
    mapping: dict[str, Any] | None = None
    in_order: bool = Field(default=False, description="leave out rows whose stamps go back; the run's warnings say so")


class TableColumn(Wire):
    """One column of an uploaded table."""

    name: str
    type: str = Field(description="number or text")


class UploadColumns(Wire):
    """What an uploaded table holds, for a column mapping."""

    model_config = example(
        {
            "file_name": "log.csv",
            "needs_mapping": True,
            "columns": [{"name": "time_ms", "type": "number"}, {"name": "gyro_z", "type": "number"}],
            "rows": [{"time_ms": "0", "gyro_z": "0.12"}, {"time_ms": "10", "gyro_z": "0.15"}],
            "suggested": MAPPING,
            "units": {"rad/s": ["rad/s", "deg/s"]},
        }
    )
    file_name: str
    needs_mapping: bool = Field(description="whether the names of the columns don't say what they are")
    columns: list[TableColumn]
    rows: list[dict[str, str | None]] = Field(description="the first rows, as text")
    suggested: dict[str, Any] = Field(description="a mapping guessed from common names; it may lack columns")
    units: dict[str, list[str]] = Field(description="units that can be chosen, by the SI unit of the target column")


class Mapping(Wire):
    """A remembered column mapping."""

    model_config = example({"name": "lab logger", "mapping": MAPPING, "updated_at": "2026-03-01T09:30:00Z"})
    name: str
    mapping: dict[str, Any]
    updated_at: datetime


class Series(Wire):
    """One column over time, thinned to what a plot can show."""

    column: str
    unit: str
    label: str
    t: list[float]
    y: list[float | None]
    total: int = Field(description="readings in the time asked for")
    shown: int = Field(description="readings in this answer")


class StreamSeries(Wire):
    """Columns of one stream. Each series is thinned by itself, keeping minima and maxima, so stamps differ."""

    model_config = example(
        {
            "stream": "imu",
            "total": 720000,
            "shown": 3,
            "gaps": [[10.0, 12.5]],
            "series": [
                {
                    "column": "gz",
                    "unit": "rad/s",
                    "label": "turn rate about z",
                    "t": [0.0, 0.5, 1.0],
                    "y": [0.01, None, 0.02],
                    "total": 720000,
                    "shown": 3,
                }
            ],
        }
    )
    stream: str
    total: int
    shown: int = Field(description="of the series that shows most")
    gaps: list[tuple[float, float]] = Field(description="pauses of over ten typical steps, [t0, t1] [s]")
    series: list[Series]
