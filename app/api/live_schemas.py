"""Live robots on the wire; the messages of WebSockets are in `app.live.protocol`."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal

from pydantic import Field

from app.api.schemas import Wire, example

QUALITY: dict[str, Any] = {
    "rate_hz": {"imu": 100.0, "wheels": 50.0},
    "batches_hz": 20.0,
    "latency_ms": 6.1,
    "latency_p99_ms": 14.0,
    "delay_ms": 6.3,
    "loss": 0.0,
    "late_rows": 0,
    "clock_offset_s": -0.0002,
    "offset_sd_s": 0.0006,
    "silent_s": 0.02,
    "backlog": 0,
}
ROBOT: dict[str, Any] = {
    "robot": "mill",
    "run_id": "5b1f0c2d9e8a7766",
    "name": "mill",
    "state": "live",
    "virtual": False,
    "started_at": "2026-03-01T09:30:00Z",
    "duration_s": 81.2,
    "viewers": 2,
    "driver": None,
    "rows": {"imu": 8120, "wheels": 4060},
    "quality": QUALITY,
}


class Quality(Wire):
    """How good a robot's connection is, over the last seconds."""

    model_config = example(QUALITY)
    rate_hz: dict[str, float] = Field(description="rows per second, per stream")
    batches_hz: float
    latency_ms: float | None = Field(description="median from sending a batch to its estimate, clock offset taken out")
    latency_p99_ms: float | None
    delay_ms: float | None = Field(description="the same by the two clocks as they are")
    loss: float = Field(description="share of batches sent again, or of rows dropped, whichever is more")
    late_rows: int = Field(description="rows not newer than their stream, dropped since the start")
    clock_offset_s: float | None = Field(description="robot's clock minus the server's")
    offset_sd_s: float | None = Field(description="half of the shortest round trip")
    silent_s: float
    backlog: int = Field(description="batches received and not yet estimated")


class LiveRobot(Wire):
    """A robot that is live."""

    model_config = example(ROBOT)
    robot: str
    run_id: str = Field(description="of the growing run; once it has ended, /runs/{run_id} is the stored run")
    name: str
    state: Literal["live", "silent"]
    virtual: bool
    started_at: datetime
    duration_s: float
    viewers: int
    driver: str | None
    rows: dict[str, int]
    quality: Quality


class LiveList(Wire):
    """All robots that are live."""

    model_config = example({"items": [ROBOT]})
    items: list[LiveRobot]


class RowsTaken(Wire):
    """What is on disk of a live run."""

    model_config = example({"run_id": "5b1f0c2d9e8a7766", "next": 12, "ended": False})
    run_id: str
    next: int = Field(description="number of the batch that is wanted next")
    ended: bool
