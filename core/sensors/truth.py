"""Truth: the reference pose of the body origin, from a rig, a survey or motion capture; any part may be absent."""

from __future__ import annotations

from dataclasses import dataclass

from core.sensors.base import Column, Floats, Log, StreamSpec


@dataclass(frozen=True)
class TruthLog(Log):
    """x, y (N,) [m] of the body origin in the map; theta (N,) [rad]."""

    x: Floats | None = None
    y: Floats | None = None
    theta: Floats | None = None


TRUTH = StreamSpec(
    name="truth",
    label="reference pose",
    columns=(
        Column("t", "s", "time"),
        Column("x", "m", "reference x", required=False),
        Column("y", "m", "reference y", required=False),
        Column("theta", "rad", "reference heading", required=False),
    ),
    log=TruthLog,
    at_least_one_of=("x", "y", "theta"),
)
