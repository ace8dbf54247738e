"""Commands: the body twist that the controller asked for; linear between samples, held past the ends."""

from __future__ import annotations

from dataclasses import dataclass

from core.sensors.base import Column, Floats, Log, StreamSpec


@dataclass(frozen=True)
class CommandLog(Log):
    """v (N,) [m/s] forward, w (N,) [rad/s] counter-clockwise."""

    v: Floats
    w: Floats


COMMANDS = StreamSpec(
    name="commands",
    label="commanded body twist",
    columns=(
        Column("t", "s", "time"),
        Column("v", "m/s", "commanded forward speed"),
        Column("w", "rad/s", "commanded turn rate"),
    ),
    log=CommandLog,
)
