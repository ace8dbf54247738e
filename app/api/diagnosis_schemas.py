"""What goes over the wire about diagnoses. SI units; gaps in units of the stated noise."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from app.api.schemas import Wire, example

RunIdText = Annotated[str, Field(min_length=1, max_length=64)]
Tolerance = Annotated[float, Field(gt=0, allow_inf_nan=False)]
MAX_SEED = 2**31 - 1

RUN: dict[str, Any] = {
    "id": "9f2c1ab84e5d7703",
    "name": "corridor lap 3",
    "sha256": "9f2c1ab84e5d7703" * 4,
    "duration_s": 120.0,
    "held_out": False,
    "stored": True,
}
GAP: dict[str, Any] = {
    "before": 3.2,
    "after": 1.05,
    "floor": 1.0,
    "shrink": 0.98,
    "shrink_ci": [0.95, 1.0],
    "held_out": True,
    "by_stream": {"imu.gz": {"before": 5.1, "after": 1.02, "floor": 1.0}},
}
CAUSE: dict[str, Any] = {
    "effect": "track_width",
    "probability": 0.97,
    "share": 0.98,
    "parameters": {"scale": {"value": 1.021, "std": 0.0004}},
    "confusable_with": [],
}
SUMMARY: dict[str, Any] = {
    "id": "41d0c8a3e7b25f96",
    "name": "mill: corridor lap 3",
    "robot": "mill",
    "created_at": "2026-03-01T09:30:00Z",
    "deleted_at": None,
    "verdict": "explained",
    "sentence": "Your simulator turns 2.1 % more than the robot. Track width explains 96 % of the gap "
    "(probability 0.97); add `track_width: 1.021` and the held-out error falls from 3.2 to 1.05 times the noise.",
    "headline": "track width 96 %",
    "gap": GAP,
    "runs": [RUN],
    "simulator": None,
}
RESULT: dict[str, Any] = {
    "schema": "gap/1",
    "verdict": "explained",
    "where": [{"stream": "imu.gz", "regime": "turning", "share": 0.61, "p_value": 1e-9}],
    "causes": [CAUSE],
    "gap": GAP,
    "immaterial": [],
    "unexplained": None,
    "next_experiment": None,
    "runtime_s": 2.1,
}
EVIDENCE: dict[str, Any] = {
    "schema": "gap-evidence/1",
    "noise_floor": [
        {"stream": "imu.gz", "sigma": 0.002, "unit": "rad/s", "stated": 0.002, "ratio": 1.0, "ratio_sd": 0.02}
    ],
    "links": [],
    "cells": [],
    "runs": [],
    "signatures": {},
    "sets": [],
    "considered": [],
    "cannot_see": [],
    "unexplained": None,
    "next": None,
}


class DiagnoseOptions(BaseModel):
    """What the user may set."""

    model_config = ConfigDict(
        extra="forbid", json_schema_extra={"examples": [{"tolerances": {"track_width.scale": 0.005}, "seed": 1}]}
    )
    tolerances: dict[str, Tolerance] = Field(
        default_factory=dict, description='what matters: a size below which "effect.parameter" is immaterial'
    )
    seed: int = Field(default=0, ge=0, le=MAX_SEED, description="of every random draw")
    simulator: str | None = Field(
        default=None,
        max_length=100,
        description="ours (`nominal`, the default: with what the runs' simulator.effects say), or a registered one",
    )
    name: str | None = Field(default=None, min_length=1, max_length=200, description="default: robot and runs")


class DiagnoseRequest(BaseModel):
    """Runs of one robot: those to fit, and those that only judge."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={"examples": [{"runs": ["9f2c1ab84e5d7703"], "held_out": [], "options": {"seed": 1}}]},
    )
    runs: list[RunIdText] = Field(min_length=1, max_length=20)
    held_out: list[RunIdText] = Field(default_factory=list, max_length=20)
    options: DiagnoseOptions = Field(default_factory=DiagnoseOptions)


class DiagnosisChange(BaseModel):
    """What people write about a diagnosis; what is absent stays as it is."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"examples": [{"name": "mill, after repair"}]})
    name: str | None = Field(default=None, min_length=1, max_length=200)
    notes: str | None = Field(default=None, max_length=20_000)


class DiagnosedRun(Wire):
    """A run that a diagnosis is of."""

    model_config = example(RUN)
    id: str
    name: str
    sha256: str
    duration_s: float
    held_out: bool
    stored: bool = Field(description="whether it is still here")


class DiagnosisSummary(Wire):
    """A stored diagnosis in a row of the list."""

    model_config = example(SUMMARY)
    id: str
    name: str
    robot: str | None
    created_at: datetime
    deleted_at: datetime | None
    verdict: Literal["none", "explained", "partly_explained", "unknown"]
    sentence: str = Field(description="what a colleague could repeat; code in backticks")
    headline: str = Field(description="the same in a few words")
    gap: dict[str, Any] = Field(description="before, after, floor, shrink, shrink_ci, held_out, by_stream")
    runs: list[DiagnosedRun] = Field(description="those to fit first, then those held out")
    simulator: str | None


class DiagnosisList(Wire):
    """Diagnoses, newest first."""

    model_config = example({"items": [SUMMARY]})
    items: list[DiagnosisSummary]


class DiagnosisDetail(DiagnosisSummary):
    """A stored diagnosis whole but for its evidence, with all that makes it again."""

    model_config = example(
        {
            **SUMMARY,
            "result": RESULT,
            "effects": {"track_width": {"scale": 1.021}},
            "model": {"track_width": {"scale": 1.021}},
            "notes": "",
            "config": {"tolerances": {}},
            "seed": 0,
            "code_version": "0.1.0+core.2f1c09ab77de",
            "runtime_s": 2.1,
            "job_id": "5b1e9c0d7a2f4e66",
        }
    )
    result: dict[str, Any] = Field(description="the answer in schema gap/1, as `driftscope diagnose --json` writes it")
    effects: dict[str, Any] = Field(description="the joint explanation: what to add to the simulator")
    model: dict[str, Any] = Field(description="every effect that was fitted, immaterial ones too")
    notes: str
    config: dict[str, Any] = Field(description="tolerances that were set")
    seed: int
    code_version: str
    runtime_s: float
    job_id: str | None


class Evidence(Wire):
    """What stands behind a diagnosis, for plots (schema gap-evidence/1). What is not known is empty."""

    model_config = ConfigDict(
        from_attributes=True, extra="allow", populate_by_name=True, json_schema_extra={"examples": [EVIDENCE]}
    )
    document: str = Field(alias="schema")
    noise_floor: list[dict[str, Any]]
    links: list[dict[str, Any]]
    cells: list[dict[str, Any]]
    runs: list[dict[str, Any]]
    signatures: dict[str, dict[str, Any]]
    sets: list[list[str]]
    considered: list[dict[str, Any]]
    cannot_see: list[dict[str, Any]]
    unexplained: dict[str, Any] | None
    next: dict[str, Any] | None
