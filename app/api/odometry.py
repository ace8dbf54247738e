"""Odometry calibration of a run: wheel radii, track width, gyro scale, mounts and clocks, each with its deviation."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal

from fastapi import APIRouter
from pydantic import ConfigDict, Field

from app.api import schemas
from app.api.deps import JobsDep, ReadSession, RunId
from app.api.schemas import Wire, example
from app.store import odometry as store
from app.store import runs as run_store
from core.errors import MissingStreamError

router = APIRouter(tags=["odometry"])

VALUE = {"value": 0.0748, "sd": 0.0001, "unit": "m"}
SHOWN = {
    "run_ids": ["9f2c1ab84e5d7703"],
    "created_at": "2026-03-01T09:30:04Z",
    "runtime_s": 1.3,
    "code_version": "0.1.0+core.2f1c09ab77de",
    "reference": "beacon",
    "parameters": {"left_radius": VALUE, "tag_x": None},
    "reasons": {"tag_x": "the runs leave an sd of 0.2: turn on the spot in view of the beacons"},
    "correlation": {},
    "noise": {"slip": 0.003, "side": 0.001},
    "notes": [],
    "robot": {"wheel_radius": 0.0748, "track_width": 0.322},
}


class OdometryRequest(Wire):
    """What to calibrate by: `auto` is truth, else fixes, else ranges. `runs`: more runs of the same robot."""

    model_config = ConfigDict(extra="forbid", **example({"reference": "auto"}))
    reference: Literal["auto", "truth", "beacon", "ranges"] = "auto"
    runs: list[str] = Field(default_factory=list, max_length=50)
    own_clocks: bool = Field(False, description="each run's reference has a delay of its own")


class Parameter(Wire):
    """A parameter in SI with one standard deviation."""

    model_config = example(VALUE)
    value: float
    sd: float | None
    unit: str


class OdometryCalibration(Wire):
    """`parameters`: null where the runs do not show it, and `reasons` says why and what would. `robot`: the section of
    run.json with what was found, the radius being the mean of both wheels."""

    model_config = example(SHOWN)
    run_ids: list[str]
    created_at: datetime
    runtime_s: float
    code_version: str
    reference: str
    parameters: dict[str, Parameter | None]
    reasons: dict[str, str]
    correlation: dict[str, float]
    noise: dict[str, float]
    notes: list[str]
    robot: dict[str, Any]


class RunOdometry(Wire):
    """What is known of a run's odometry."""

    model_config = example({"run_id": "9f2c1ab84e5d7703", "calibration": SHOWN})
    run_id: str
    calibration: OdometryCalibration | None


@router.post("/runs/{run_id}/odometry", status_code=202, summary="Calibrate the odometry")
def create_odometry_calibration(
    session: ReadSession, jobs: JobsDep, run_id: RunId, wanted: OdometryRequest
) -> schemas.Job:
    """Queue a job that finds radii, track width, gyro scale, mounts and clocks at once. It replaces an earlier one."""
    for one in (run_id, *wanted.runs):
        streams = {s.name for s in run_store.get_run(session, one).streams}
        missing = [] if "wheels" in streams else ["wheels"]
        missing += [] if streams & {"truth", "beacon", "ranges"} else ["truth, beacon or ranges"]
        if missing:
            raise MissingStreamError(
                f"run {one!r} cannot be used: it has no {' and no '.join(missing)}",
                method="calibrate_odometry",
                missing=missing,
            )
    params = {"runs": list(dict.fromkeys((run_id, *wanted.runs))), **wanted.model_dump(exclude={"runs"})}
    return schemas.Job(**jobs.get(jobs.submit("odometry", run_id, params)))


@router.get("/runs/{run_id}/odometry", summary="The odometry calibration of a run")
def get_odometry_calibration(session: ReadSession, run_id: RunId) -> RunOdometry:
    """The latest one; null where none was made."""
    run_store.get_run(session, run_id)
    row = store.find(session, run_id)
    if row is None:
        return RunOdometry(run_id=run_id, calibration=None)
    kept = ("run_ids", "created_at", "runtime_s", "code_version", "robot")
    told = {k: v for k, v in row.result.items() if k in OdometryCalibration.model_fields}
    made = OdometryCalibration(**{name: getattr(row, name) for name in kept}, **told)
    return RunOdometry(run_id=run_id, calibration=made)
