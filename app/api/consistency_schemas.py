"""What goes over the wire about consistency and events. SI units."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from app.api.schemas import Wire, example

EVENT = {
    "method": "fused",
    "id": "slip-12100",
    "kind": "slip",
    "t0": 12.1,
    "t1": 12.6,
    "evidence": "wheels turn 0.80 rad/s more to the left than the gyro, 0.50 s, 9 sigma",
    "replaced": "encoder heading by gyro",
    "decision": "confirmed",
}


class Decision(BaseModel):
    """What a user says of an event."""

    model_config = ConfigDict(extra="forbid", json_schema_extra={"examples": [{"decision": "dismissed"}]})
    decision: Literal["confirmed", "dismissed"]


class RunEvent(Wire):
    """Something that happened, as one method found it, and what a user said of it."""

    model_config = example(EVENT)
    method: str
    id: str = Field(description="kind and begin in milliseconds")
    kind: str
    t0: float
    t1: float
    evidence: str
    replaced: str = Field(description="what stood in for the sensor that could not be believed")
    decision: Literal["confirmed", "dismissed"] | None


class EventList(Wire):
    """Events of a run, in the order of the methods, then of time."""

    model_config = example({"items": [EVENT]})
    items: list[RunEvent]


class WhitenessFigures(Wire):
    """Autocorrelation of the normal scores of NIS at lags 1, 2, ... and its Ljung-Box test."""

    autocorrelation: list[float]
    limit: float = Field(description="95 % of the lags lie within +- this where the readings are independent")
    p_value: float | None
    effective: float | None = Field(description="independent readings that the record is worth")


class NoiseFigures(Wire):
    """R should be about `factor` times what it is; its 95 % interval."""

    factor: float | None
    low: float | None
    high: float | None
    wide: float | None = Field(description="what the widest tenth of the readings call for")
    fits: bool
    single: bool = Field(description="false: bulk and tail call for such different R that no single one fits")


class RunningNis(Wire):
    """Means of NIS over `window` accepted readings each, in the range that was asked for."""

    t: list[float]
    mean: list[float | None]
    window: int
    band: tuple[float, float] = Field(description="holds 95 % of the means where the filter is right")
    readings: int
    rejected: int
    rejected_t: list[float] = Field(description="stamps of refused readings, the first 2,000")


class SensorFigures(Wire):
    """One sensor: figures over the whole run, running means over the range."""

    sensor: str
    label: str
    dof: int
    readings: int
    rejected: int
    at_rest: int = Field(description="readings of wheels that stood, which tell nothing and are left out")
    mean: float | None = Field(description="mean NIS of accepted readings")
    band: tuple[float, float] | None
    whiteness: WhitenessFigures | None
    advice: NoiseFigures | None
    running: RunningNis


class NeesFigures(Wire):
    """Squared error over claimed covariance at the truth's stamps; figures over the whole run, curve over the range."""

    dof: int
    mean: float | None
    band: tuple[float, float] = Field(description="holds 95 % of single values where the claim is right")
    inside: float = Field(description="share of stamps whose 95 % ellipse holds the truth")
    t: list[float]
    y: list[float | None]
    total: int
    shown: int


class ConsistencyFigure(Wire):
    """Does the method know its own errors?"""

    model_config = example(
        {
            "estimate": "7c40e2a95d1b8f36",
            "method": "fused",
            "sentence": "Every sensor is about as noisy as the filter expects.",
            "sensors": [
                {
                    "sensor": "beacon.position", "label": "fixes", "dof": 2, "readings": 612, "rejected": 3,
                    "at_rest": 0, "mean": 1.96, "band": [1.82, 2.18],
                    "whiteness": {"autocorrelation": [0.02], "limit": 0.08, "p_value": 0.61, "effective": 600.0},
                    "advice": {"factor": 0.97, "low": 0.88, "high": 1.06, "wide": 1.0, "fits": True, "single": True},
                    "running": {
                        "t": [1.0], "mean": [1.9], "window": 10, "band": [0.96, 3.42], "readings": 612, "rejected": 3,
                        "rejected_t": [4.2],
                    },
                }
            ],
            "nees": None,
        }
    )  # fmt: skip
    estimate: str
    method: str
    sentence: str
    sensors: list[SensorFigures]
    nees: NeesFigures | None
