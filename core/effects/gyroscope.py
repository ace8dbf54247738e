"""Gyroscope: what its reading adds to the true turn rate about z."""

from __future__ import annotations

from core.effects.base import Effect, Parameter

INF = float("inf")
GYRO = ("imu.gz",)

GYRO_BIAS = Effect(
    id="gyro_bias",
    family="gyroscope",
    label="gyro bias",
    equation="gz += bias",
    parameters=(Parameter("bias", "rad/s", 0.0, -1.0, 1.0, small=1e-4),),
    streams=GYRO,
    switch=("bias",),
)

GYRO_DRIFT = Effect(
    id="gyro_drift",
    family="gyroscope",
    label="gyro warm-up drift",
    equation="gz += amplitude * (1 - exp(-t/tau))",
    parameters=(
        Parameter("amplitude", "rad/s", 0.0, -1.0, 1.0, small=2e-4),
        Parameter("tau", "s", 0.0, 20.0, 1e5),
    ),
    streams=GYRO,
    switch=("amplitude",),
)

GYRO_WALK = Effect(
    id="gyro_walk",
    family="gyroscope",
    label="gyro bias walk",
    equation="gz += a random walk from 0, standard deviation density*sqrt(t)",
    parameters=(Parameter("density", "rad/s/√s", 0.0, 0.0, 0.1, small=2e-5),),
    streams=GYRO,
    switch=("density",),
    noise_only=True,
)

GYRO_TEMPERATURE = Effect(
    id="gyro_temperature",
    family="gyroscope",
    label="gyro temperature slope",
    equation="gz += slope * (temperature - first temperature)",
    parameters=(Parameter("slope", "rad/s/K", 0.0, -0.1, 0.1, small=4e-5),),
    streams=GYRO,
    switch=("slope",),
)

GYRO_SCALE = Effect(
    id="gyro_scale",
    family="gyroscope",
    label="gyro scale",
    equation="gz = scale * true rate",
    parameters=(Parameter("scale", "", 1.0, 0.5, 2.0, small=0.002),),
    streams=GYRO,
    switch=("scale",),
)

GYRO_NOISE = Effect(
    id="gyro_noise",
    family="gyroscope",
    label="gyro noise",
    equation="white noise of factor * the data sheet's density",
    parameters=(Parameter("factor", "", 1.0, 0.0, 100.0, small=0.06),),
    streams=GYRO,
    switch=("factor",),
    noise_only=True,
)

GYRO_CLIP = Effect(
    id="gyro_clip",
    family="gyroscope",
    label="gyro saturation",
    equation="gz = clip(gz, -limit, limit), noise included",
    parameters=(Parameter("limit", "rad/s", INF, 1e-3, INF, small=0.01, small_of_reach=True),),
    streams=GYRO,
    switch=("limit",),
    smooth=False,
)

GYRO_G_SENSITIVITY = Effect(
    id="gyro_g_sensitivity",
    family="gyroscope",
    label="gyro g-sensitivity",
    equation="gz += k * ay, ay the true specific force along the IMU's own y",
    parameters=(Parameter("k", "rad/s per m/s²", 0.0, -0.1, 0.1, small=4e-4),),
    streams=GYRO,
    switch=("k",),
)

EFFECTS = (
    GYRO_BIAS,
    GYRO_DRIFT,
    GYRO_WALK,
    GYRO_TEMPERATURE,
    GYRO_SCALE,
    GYRO_NOISE,
    GYRO_CLIP,
    GYRO_G_SENSITIVITY,
)
