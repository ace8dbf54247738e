"""What goes over the wire about calibrations. SI units."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from app.api.schemas import Wire, example

UNKNOWN: dict[str, Any] = {
    "static_bias": [None, None, None],
    "drift_amplitude": [None, None, None],
    "drift_tau": [None, None, None],
    "matrix": [[None, None, None]] * 3,
    "noise_sd": [None, None, None],
}
MODEL: dict[str, Any] = {
    "schema": "calibration/1",
    "gyro": {**UNKNOWN, "static_bias": [0.011, -0.004, 0.02], "noise_sd": [2e-4, 2e-4, 2e-4]},
    "accel": UNKNOWN,
    "sd": {"gyro": {**UNKNOWN, "static_bias": [1e-5, 1e-5, 1e-5]}, "accel": UNKNOWN},
}
SUMMARY: dict[str, Any] = {
    "id": "41d0c8a3e7b25f96",
    "name": "mill, 2026-03-01",
    "robot": "mill",
    "created_at": "2026-03-01T09:30:00Z",
    "source": "runs",
    "runs": [{"id": "9f2c1ab84e5d7703", "name": "rest 1 h", "kind": "rest", "rate_hz": 100.0}],
    "sentence": "Gyro z: 4,125 °/h at switching on; no drift shown.",
    "knows": ["gyro static bias", "gyro noise"],
}


class CalibrationRun(Wire):
    """A run that a calibration was made from, or could be."""

    model_config = example(SUMMARY["runs"][0])
    id: str
    name: str
    kind: str | None = Field(description="of its procedure: rest, six_position, rate_table")
    rate_hz: float | None = Field(description="of its IMU")


class CalibrationSummary(Wire):
    """A stored calibration without its numbers."""

    model_config = example(SUMMARY)
    id: str
    name: str
    robot: str | None
    created_at: datetime
    source: str = Field(description="`runs` or `upload`")
    runs: list[CalibrationRun]
    sentence: str
    knows: list[str] = Field(description="which errors it holds numbers of")


class CalibrationList(Wire):
    """Calibrations, newest first."""

    model_config = example({"items": [SUMMARY]})
    items: list[CalibrationSummary]


class CalibrationDetail(CalibrationSummary):
    """A stored calibration whole."""

    model_config = example(
        {
            **SUMMARY,
            "calibration": MODEL,
            "report": {"axes": {}, "lines": [], "left_out": []},
            "spectrum": {"gz": {"f": [0.001, 0.01], "density": [1e-6, 1e-8]}},
            "bode": {"rate_hz": 100.0, "window": 40, "f": [0.1, 1.0], "gain": [0.99, 0.76], "phase": [-0.1, -1.2],
                     "delay": 0.195},
            "notes": [],
            "code_version": "0.1.0+core.2f1c09ab77de",
            "run_sha256": ["9f2c1ab84e5d7703" * 4],
            "runtime_s": 12.0,
            "job_id": None,
        }
    )  # fmt: skip
    calibration: dict[str, Any] = Field(description="the model in schema calibration/1")
    report: dict[str, Any] = Field(
        description="characteristic lines, drift per block with its fit, the paper's figures, segments left out"
    )
    spectrum: dict[str, Any] = Field(description="by axis: density [u²/Hz] of the fitted drift at f [Hz] (eq. 5)")
    bode: dict[str, Any] = Field(description="of the moving average at `rate_hz` (eq. 8)")
    notes: list[str]
    code_version: str
    run_sha256: list[str]
    runtime_s: float
    job_id: str | None


class CalibrateRequest(BaseModel):
    """Which runs to calibrate from."""

    model_config = ConfigDict(
        extra="forbid", json_schema_extra={"examples": [{"runs": ["9f2c1ab84e5d7703"], "name": "mill, spring"}]}
    )
    runs: list[str] = Field(min_length=1, max_length=50)
    name: str | None = Field(default=None, min_length=1, max_length=200, description="default: robot and date")
    robot: str | None = Field(default=None, max_length=200, description="default: the runs' own")


class CalibrationChange(BaseModel):
    """What people write about a calibration; what is absent stays as it is."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"examples": [{"name": "mill, after repair"}]})
    name: str | None = Field(default=None, min_length=1, max_length=200)
    robot: str | None = Field(default=None, max_length=200, description="empty text takes the robot away")


class CorrectRequest(BaseModel):
    """With which calibration."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"examples": [{"calibration": "41d0c8a3e7b25f96"}]})
    calibration: str = Field(min_length=1, max_length=64)


class Correction(Wire):
    """How good a calibration is on a run, at its longest rest; lists in the order of `axes`, SI, null where unknown."""

    model_config = example(
        {
            "calibration": "41d0c8a3e7b25f96",
            "figures": {"axes": ["ax", "ay", "az", "gx", "gy", "gz"], "raw": {"sd": [0.02] * 6}},
            "notes": [],
            "error": None,
        }
    )
    calibration: str
    figures: dict[str, Any] = Field(description="raw, online, offline: start, asymptote, mean, sd; correlation, ...")
    notes: list[str]
    error: dict[str, Any] | None = Field(description="why it could not be judged on this run")
