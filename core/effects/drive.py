"""Drive: the wheels do not turn as commanded; encoders see it. u is a rim set-point, v a rim speed, both [m/s]."""

from __future__ import annotations

from core.effects.base import DRIVE_STREAMS, Effect, Parameter

INF = float("inf")

COMMAND_DELAY = Effect(
    id="command_delay",
    family="drive",
    label="command delay",
    equation="u(t) = commanded(t - delay)",
    parameters=(Parameter("delay", "s", 0.0, 0.0, 2.0, small=0.004),),
    streams=DRIVE_STREAMS,
    switch=("delay",),
    smooth=False,
)

MOTOR_LAG = Effect(
    id="motor_lag",
    family="drive",
    label="motor lag",
    equation="tau * dv/dt = u - v",
    parameters=(Parameter("tau", "s", 0.0, 0.0, 3.0, small=0.005),),
    streams=DRIVE_STREAMS,
    switch=("tau",),
)

SPEED_LIMIT = Effect(
    id="speed_limit",
    family="drive",
    label="speed limit",
    equation="v = clip(v, -v_max, v_max)",
    parameters=(Parameter("v_max", "m/s", INF, 1e-3, INF, small=0.01, small_of_reach=True),),
    streams=DRIVE_STREAMS,
    switch=("v_max",),
    smooth=False,
)

ACCEL_LIMIT = Effect(
    id="accel_limit",
    family="drive",
    label="acceleration limit",
    equation="dv/dt = clip(dv/dt, -a_max, a_max), v following what comes before it",
    parameters=(Parameter("a_max", "m/s²", INF, 1e-3, INF, small=0.01, small_of_reach=True),),
    streams=DRIVE_STREAMS,
    switch=("a_max",),
    smooth=False,
)

DEADBAND = Effect(
    id="deadband",
    family="drive",
    label="dead band",
    equation="u = 0 where abs(u) < width",
    parameters=(Parameter("width", "m/s", 0.0, 0.0, 1.0, small=0.003),),
    streams=DRIVE_STREAMS,
    switch=("width",),
    smooth=False,
)

DRIVE_GAIN = Effect(
    id="drive_gain",
    family="drive",
    label="drive gain",
    equation="v = gain * u",
    parameters=(Parameter("gain", "", 1.0, 0.0, 3.0, small=0.001),),
    streams=DRIVE_STREAMS,
    switch=("gain",),
)

BATTERY_SAG = Effect(
    id="battery_sag",
    family="drive",
    label="battery sag",
    equation="v = exp(-rate * t) * u, t the run's",
    parameters=(Parameter("rate", "1/s", 0.0, 0.0, 0.02, small=6e-6),),
    streams=DRIVE_STREAMS,
    switch=("rate",),
)

EFFECTS = (COMMAND_DELAY, MOTOR_LAG, SPEED_LIMIT, ACCEL_LIMIT, DEADBAND, DRIVE_GAIN, BATTERY_SAG)
