"""What goes over the wire about estimates and paths. SI units and radians."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from app.api.schemas import EstimateSummary, Job, Wire, example

ESTIMATE: dict[str, Any] = {
    "id": "7c40e2a95d1b8f36",
    "run_id": "9f2c1ab84e5d7703",
    "method": "fused",
    "created_at": "2026-03-01T09:30:04Z",
    "runtime_s": 0.21,
    "final": {"x": 4.02, "y": -0.31, "theta": 1.57},
    "metrics": {"ate_rmse_m": {"value": 0.021, "unit": "m"}, "nees": {"value": 2.8, "unit": ""}},
    "config": {},
    "config_hash": "44136fa355b3678a1146ad16f7e8649e94fb4fc21fe77e8310c060f61caaff8a",
    "seed": 0,
    "code_version": "0.1.0+core.2f1c09ab77de",
    "run_sha256": "9f2c1ab84e5d7703" * 4,
    "job_id": "5b1e9c0d7a2f4e66",
    "parameters": {"gyro_bias": {"value": 0.0012, "sd": 2e-5, "unit": "rad/s"}},
    "events": [{"kind": "slip", "t0": 12.1, "t1": 12.6, "evidence": "wheels turn, gyro does not", "replaced": ""}],
    "notes": ["No beacon_xy in run.json: 0.05 m is assumed."],
    "columns": ["x", "y", "theta", "sd_x", "sd_y", "sd_theta", "bias", "bias_sd", "error_xy", "error_theta"],
    "rows": 120000,
}


class EstimateRequest(BaseModel):
    """Which methods to run, and with what."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"examples": [{"methods": ["fused"], "config": {}}]})
    methods: list[str] | None = Field(default=None, max_length=20, description="null: all that can run on this run")
    config: dict[str, Any] = Field(default_factory=dict, description="numbers that replace those assumed, by name")


class Estimate(EstimateSummary):
    """One method's result on a run, with all that makes it again; its path comes from `series` or `files`."""

    model_config = example(ESTIMATE)
    run_id: str
    config: dict[str, Any]
    config_hash: str
    seed: int
    code_version: str = Field(description="package version and hash of the estimating code")
    run_sha256: str = Field(description="hash of the readings that went in")
    job_id: str | None
    parameters: dict[str, Any] = Field(description="{name: {value, sd, unit}}: what the method learnt of the robot")
    events: list[dict[str, Any]] = Field(description="[{kind, t0, t1, evidence, replaced}]")
    notes: list[str] = Field(description="what was assumed, what could not be seen, in sentences")
    columns: list[str] = Field(description="what `series` can show")
    rows: int = Field(description="poses of the path")


class EstimateList(Wire):
    """Estimates of one run."""

    model_config = example({"items": [ESTIMATE]})
    items: list[Estimate]


class JobList(Wire):
    """Jobs, newest first."""

    items: list[Job]


class BeaconPoint(Wire):
    """A surveyed beacon in the map [m]."""

    name: str
    x: float
    y: float
    z: float


class StartPose(Wire):
    """The pose at t = 0 [m, rad]."""

    x: float
    y: float
    theta: float


class PathLine(Wire):
    """One line of the map, thinned to keep its shape. A column that the method doesn't state is absent."""

    method: str = Field(description="an estimator's name, `truth` or `fixes`")
    label: str
    causal: bool = Field(description="whether a pose uses only readings up to its stamp")
    estimate: str | None = Field(description="id of the estimate; null for truth and fixes")
    total: int
    shown: int
    t: list[float]
    x: list[float | None]
    y: list[float | None]
    theta: list[float | None] | None = None
    sd_x: list[float | None] | None = None
    sd_y: list[float | None] | None = None
    sd_theta: list[float | None] | None = None
    cov_xy: list[float | None] | None = None


class PathFigure(Wire):
    """Paths of a run in the map frame [m, rad]: truth and fixes where the run has them, then the methods."""

    model_config = example(
        {
            "frame": "map",
            "start": {"x": 0.0, "y": 0.0, "theta": 0.0},
            "beacons": [{"name": "B1", "x": 0.0, "y": 0.0, "z": 2.5}],
            "paths": [
                {
                    "method": "fused",
                    "label": "Fused",
                    "causal": True,
                    "estimate": "7c40e2a95d1b8f36",
                    "total": 120000,
                    "shown": 2,
                    "t": [0.0, 1200.0],
                    "x": [0.0, 4.02],
                    "y": [0.0, -0.31],
                    "theta": [0.0, 1.57],
                    "sd_x": [0.0, 0.02],
                    "sd_y": [0.0, 0.02],
                    "sd_theta": [0.0, 0.01],
                    "cov_xy": [0.0, 0.0001],
                }
            ],
        }
    )
    frame: str
    start: StartPose | None
    beacons: list[BeaconPoint]
    paths: list[PathLine]
