"""IMU: turn rate about the vertical, optionally all six axes and the die's temperature, in the IMU's own frame."""

from __future__ import annotations

from dataclasses import dataclass

from core.sensors.base import Column, Floats, Log, StreamSpec


@dataclass(frozen=True)
class ImuLog(Log):
    """gz (N,) [rad/s]; ax, ay, az (N,) specific force [m/s^2]; gx, gy (N,) [rad/s]; temperature (N,) [deg C]."""

    gz: Floats
    ax: Floats | None = None
    ay: Floats | None = None
    az: Floats | None = None
    gx: Floats | None = None
    gy: Floats | None = None
    temperature: Floats | None = None


IMU = StreamSpec(
    name="imu",
    label="inertial measurement unit",
    columns=(
        Column("t", "s", "time"),
        Column("gz", "rad/s", "turn rate about z"),
        Column("ax", "m/s²", "specific force along x", required=False),
        Column("ay", "m/s²", "specific force along y", required=False),
        Column("az", "m/s²", "specific force along z", required=False),
        Column("gx", "rad/s", "turn rate about x", required=False),
        Column("gy", "rad/s", "turn rate about y", required=False),
        Column("temperature", "°C", "die temperature", required=False),
    ),
    log=ImuLog,
)
