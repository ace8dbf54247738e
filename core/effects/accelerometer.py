"""Accelerometer and the IMU's mounting: what its reading does to the true specific force."""

from __future__ import annotations

from core.effects.base import Effect, Parameter

ACCEL = ("imu.ax", "imu.ay")

ACCEL_BIAS = Effect(
    id="accel_bias",
    family="accelerometer",
    label="accelerometer bias",
    equation="(ax, ay) += (x, y)",
    parameters=(
        Parameter("x", "m/s²", 0.0, -5.0, 5.0, small=0.002),
        Parameter("y", "m/s²", 0.0, -5.0, 5.0, small=0.002),
    ),
    streams=ACCEL,
    switch=("x", "y"),
)

ACCEL_SCALE = Effect(
    id="accel_scale",
    family="accelerometer",
    label="accelerometer scale",
    equation="(ax, ay) = (x*ax, y*ay) in the IMU's own axes, before the bias",
    parameters=(Parameter("x", "", 1.0, 0.5, 2.0, small=0.01), Parameter("y", "", 1.0, 0.5, 2.0, small=0.01)),
    streams=ACCEL,
    switch=("x", "y"),
)

IMU_YAW = Effect(
    id="imu_yaw",
    family="accelerometer",
    label="IMU mounting angle",
    equation="the IMU is turned about z by angle beyond run.json",
    parameters=(Parameter("angle", "rad", 0.0, -3.2, 3.2, small=0.007),),
    streams=ACCEL,
    switch=("angle",),
)

IMU_OFFSET = Effect(
    id="imu_offset",
    family="accelerometer",
    label="IMU mounting place",
    equation="fx += -dw/dt*y - w²*x, fy += dw/dt*x - w²*y in the body, (x, y) beyond run.json",
    parameters=(
        Parameter("x", "m", 0.0, -2.0, 2.0, small=0.01),
        Parameter("y", "m", 0.0, -2.0, 2.0, small=0.01),
    ),
    streams=ACCEL,
    switch=("x", "y"),
)

VIBRATION = Effect(
    id="vibration",
    family="accelerometer",
    label="vibration",
    equation="(ax, ay) += white noise of standard deviation k*abs(v) per sample, v the body's true forward speed",
    parameters=(Parameter("k", "1/s", 0.0, 0.0, 50.0, small=0.012),),
    streams=ACCEL,
    switch=("k",),
    noise_only=True,
)

EFFECTS = (ACCEL_BIAS, ACCEL_SCALE, IMU_YAW, IMU_OFFSET, VIBRATION)
