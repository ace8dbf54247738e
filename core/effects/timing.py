"""Timing: the IMU's clock against the run's."""

from __future__ import annotations

from core.effects.base import Effect, Parameter

IMU = ("imu.gz", "imu.ax", "imu.ay")

IMU_CLOCK = Effect(
    id="imu_clock",
    family="timing",
    label="IMU clock offset",
    equation="stamp = t + offset",
    parameters=(Parameter("offset", "s", 0.0, -5.0, 5.0, small=0.001),),
    streams=IMU,
    switch=("offset",),
)

CLOCK_DRIFT = Effect(
    id="clock_drift",
    family="timing",
    label="IMU clock drift",
    equation="stamp = t * (1 + skew) + offset",
    parameters=(Parameter("skew", "", 0.0, -0.1, 0.1, small=2e-5),),
    streams=IMU,
    switch=("skew",),
)

EFFECTS = (IMU_CLOCK, CLOCK_DRIFT)
