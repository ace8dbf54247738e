"""What goes over the wire about the IMU of a run. SI units and radians; data-sheet forms stand beside them."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from app.api.schemas import Job, Wire, example

PROVENANCE: dict[str, Any] = {
    "part": "allan.gz",
    "created_at": "2026-03-01T09:30:04Z",
    "runtime_s": 0.6,
    "config": {},
    "code_version": "0.1.0+core.2f1c09ab77de",
    "run_sha256": "9f2c1ab84e5d7703" * 4,
    "job_id": "5b1e9c0d7a2f4e66",
}
FORM: dict[str, Any] = {"unit": "°/√h", "value": 0.46, "sd": 0.003, "conversion": "× 180/π × 60"}
TERM: dict[str, Any] = {
    "name": "N",
    "label": "white noise (angle random walk)",
    "value": 1.34e-4,
    "sd": 9.5e-7,
    "unit": "rad/s/√Hz",
    "forms": [FORM],
}
METHOD: dict[str, Any] = {
    "method": "C",
    "label": "range test and band",
    "causal": True,
    "source": "Cechowicz, Acta Mechanica et Automatica 11(2), 2017",
    "summary": {"accepted": 11, "segments": 92, "bias_drift": 0.0062, "final_rad": 0.05},
    "notes": [],
    "columns": ["bias", "sd", "theta", "accepted", "rejected_by_range", "rejected_by_average"],
    "error": None,
    "provenance": {**PROVENANCE, "part": "bias.C"},
}


class ImuRequest(BaseModel):
    """What to analyse, and with which segments."""

    model_config = ConfigDict(
        extra="forbid", json_schema_extra={"examples": [{"axes": None, "methods": None, "length": 3.0, "n": 10}]}
    )
    axes: list[str] | None = Field(default=None, max_length=6, description="null: all that the run has")
    methods: list[str] | None = Field(default=None, max_length=20, description="null: all methods of bias")
    length: float | None = Field(
        default=None, gt=0, le=3600, allow_inf_nan=False, description="of a segment [s]; default 3"
    )
    n: int | None = Field(default=None, ge=1, le=10_000, description="earlier segments that C averages; default 10")


class Provenance(Wire):
    """What makes a result again."""

    part: str
    created_at: datetime
    runtime_s: float
    config: dict[str, Any]
    code_version: str
    run_sha256: str
    job_id: str | None


class Refusal(Wire):
    """Why a part of the analysis could not be computed."""

    code: str
    detail: str
    where: dict[str, Any] = Field(default_factory=dict)


class Form(Wire):
    """A figure as data sheets write it: `value` is SI times what `conversion` says."""

    unit: str
    value: float | None
    sd: float | None
    conversion: str


class NoiseTerm(Wire):
    """A fitted noise term; null where this record does not show it."""

    name: str
    label: str
    value: float | None
    sd: float | None
    unit: str = Field(description="SI; densities are two-sided")
    forms: list[Form]


class AllanColumns(Wire):
    """A curve: averaging time tau [s]; the deviation, its band lo to hi and the fitted model, in the axis' unit."""

    tau: list[float | None]
    deviation: list[float | None]
    lo: list[float | None]
    hi: list[float | None]
    model: list[float | None]
    pairs: list[float | None] = Field(description="differences that entered")
    edf: list[float | None] = Field(description="equivalent degrees of freedom")
    alpha: list[float | None] = Field(description="noise type as the exponent of the spectrum: 2, 0, -1, -2")


class Allan(Wire):
    """Allan or Hadamard deviation of one axis, and the noise fitted to the Allan deviation."""

    model_config = example(
        {
            "axis": "gz",
            "kind": "allan",
            "unit": "rad/s",
            "readings": "rest",
            "rest_share": 0.37,
            "curve": {
                "tau": [0.01, 0.02], "deviation": [1.3e-3, 9.5e-4], "lo": [1.3e-3, 9.4e-4], "hi": [1.4e-3, 9.6e-4],
                "model": [1.3e-3, 9.5e-4], "pairs": [27780.0, 27778.0], "edf": [9000.0, 6000.0], "alpha": [0.0, 0.0],
            },
            "confidence": 0.683,
            "noise": [TERM],
            "fit": {"chi2": 20.1, "dof": 22, "tau0": 0.01, "duration": 277.2},
            "notes": ["K is not identifiable from this record"],
            "provenance": PROVENANCE,
        }
    )  # fmt: skip
    axis: str
    kind: str
    unit: str
    readings: str = Field(description="`rest`: those at rest only, since the robot moved; `whole`: all")
    rest_share: float | None
    curve: AllanColumns
    confidence: float
    noise: list[NoiseTerm]
    fit: dict[str, float | None]
    notes: list[str]
    provenance: Provenance


class Describes(Wire):
    """Descriptive statistics, in the axis' unit; kurtosis is 3 for a Gaussian."""

    count: int
    left_out: int = Field(description="readings that are not finite")
    minimum: float | None
    quartile_1: float | None
    median: float | None
    quartile_3: float | None
    maximum: float | None
    mean: float | None
    sd: float | None
    skewness: float | None
    kurtosis: float | None


class HistogramColumns(Wire):
    """Bins by their `edges`, one more than `counts`; `gaussian`: what a Gaussian of that mean and sd would count."""

    edges: list[float]
    counts: list[int]
    gaussian: list[float | None]


class ProbabilityColumns(Wire):
    """Ordered readings against a Gaussian's quantiles, and the straight line through all of them."""

    quantiles: list[float]
    ordered: list[float]
    slope: float
    intercept: float
    correlation: float
    total: int
    shown: int


class Statistics(Wire):
    """What one stretch of one axis looks like (Cechowicz, Tab. 2, Fig. 3 and 4)."""

    model_config = example(
        {
            "axis": "gz",
            "unit": "rad/s",
            "t0": 0.0,
            "t1": 6.0,
            "description": {
                "count": 600, "left_out": 0, "minimum": -0.004, "quartile_1": -9e-4, "median": 0.0, "quartile_3": 9e-4,
                "maximum": 0.004, "mean": 1e-5, "sd": 0.0013, "skewness": 0.02, "kurtosis": 2.97,
            },
            "histogram": {"edges": [-0.004, 0.0, 0.004], "counts": [299, 301], "gaussian": [300.0, 300.0]},
            "probability": {
                "quantiles": [-3.0, 0.0, 3.0], "ordered": [-0.004, 0.0, 0.004], "slope": 0.0013, "intercept": 1e-5,
                "correlation": 0.999, "total": 600, "shown": 3,
            },
            "notes": [],
        }
    )  # fmt: skip
    axis: str
    unit: str
    t0: float | None
    t1: float | None
    description: Describes
    histogram: HistogramColumns | None
    probability: ProbabilityColumns | None
    notes: list[str] = Field(description="why a histogram or a plot is missing")


class BiasMethod(Wire):
    """One method's bias and heading in figures, SI; its curves come from `series`."""

    model_config = example(METHOD)
    method: str
    label: str
    causal: bool
    source: str
    summary: dict[str, Any] = Field(description="accepted, rejected_by_range, final_rad, max_rad, net_rate, ...")
    notes: list[str]
    columns: list[str] = Field(description="what `series` can show")
    error: Refusal | None
    provenance: Provenance


class BiasList(Wire):
    """Every bias method of a run."""

    model_config = example({"items": [METHOD]})
    items: list[BiasMethod]


class TemperatureFigure(Wire):
    """Segments at rest: their mean temperature and mean reading, and a straight line through them."""

    model_config = example(
        {
            "method": "C",
            "t": [1.5, 4.5],
            "temperature": [23.6, 24.1],
            "bias": [0.0040, 0.0043],
            "total": 11,
            "shown": 2,
            "summary": {"from": 23.6, "to": 32.1, "slope": 7.1e-4, "correlation": 0.997},
        }
    )
    method: str
    t: list[float | None]
    temperature: list[float | None] = Field(description="°C")
    bias: list[float | None] = Field(description="rad/s")
    total: int
    shown: int
    summary: dict[str, Any] = Field(description="slope [rad/s/K], correlation, range of temperatures")


class ImuOverview(Wire):
    """What is known of a run's IMU, and what is not and why."""

    model_config = example(
        {
            "run_id": "9f2c1ab84e5d7703",
            "sentence": "Gyro z: 0.0077 °/s/√Hz white (two-sided), bias instability 8.0 °/h.",
            "axes": ["gx", "gy", "gz", "ax", "ay", "az"],
            "has_temperature": True,
            "has_heading": True,
            "procedure": "drive",
            "analysed": True,
            "job": None,
            "rest": [12.0, 47.0],
            "methods": [METHOD],
            "noise": {"gz": {"N": 1.34e-4, "B": None, "K": None}},
            "refusals": {"allan.ax": {"code": "not_enough_data", "detail": "all readings are equal", "where": {}}},
        }
    )
    run_id: str
    sentence: str
    axes: list[str]
    has_temperature: bool
    has_heading: bool = Field(description="whether a reference heading can judge the methods")
    procedure: str | None = Field(description="of a calibration run: rest, six_position, rate_table, ...")
    analysed: bool
    job: Job | None = Field(description="the newest analysis: queued, running, failed, ...")
    rest: list[float] | None = Field(description="the longest rest [t0, t1]: what statistics are best made of")
    methods: list[BiasMethod]
    noise: dict[str, dict[str, float | None]] = Field(description="N, B, K by axis, SI, two-sided")
    refusals: dict[str, Refusal] = Field(description="parts that could not be computed, and why")
