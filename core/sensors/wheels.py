"""Wheel encoders: the cumulative angle that each wheel reports, positive forward, rounded down to ticks."""

from __future__ import annotations

from dataclasses import dataclass

from core.sensors.base import Column, Floats, Log, StreamSpec


@dataclass(frozen=True)
class WheelLog(Log):
    """left, right (N,) [rad], cumulative."""

    left: Floats
    right: Floats


WHEELS = StreamSpec(
    name="wheels",
    label="wheel encoders",
    columns=(
        Column("t", "s", "time"),
        Column("left", "rad", "left wheel angle"),
        Column("right", "rad", "right wheel angle"),
    ),
    log=WheelLog,
)
