"""Beacon fixes: the tag's position in the map, optionally the body's heading."""

from __future__ import annotations

from dataclasses import dataclass

from core.sensors.base import Column, Floats, Log, StreamSpec


@dataclass(frozen=True)
class BeaconLog(Log):
    """x, y (N,) [m] of the tag in the map; theta (N,) [rad] heading of the body."""

    x: Floats
    y: Floats
    theta: Floats | None = None


BEACON = StreamSpec(
    name="beacon",
    label="beacon pose fixes",
    columns=(
        Column("t", "s", "time"),
        Column("x", "m", "tag position x"),
        Column("y", "m", "tag position y"),
        Column("theta", "rad", "heading", required=False),
    ),
    log=BeaconLog,
)
