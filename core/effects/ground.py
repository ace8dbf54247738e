"""Ground: what happens between wheel and floor, and to the body as a whole."""

from __future__ import annotations

from core.effects.base import BODY_STREAMS, Effect, Parameter

PLACE = 1e4

WHEEL_SLIP = Effect(
    id="wheel_slip",
    family="ground",
    label="wheel slip",
    equation="ground speed = (1 - clip(k*a*sign(v), -1, 1)) * v per wheel, a = dv/dt of the rim",
    parameters=(Parameter("k", "s²/m", 0.0, 0.0, 2.0, small=0.004),),
    streams=BODY_STREAMS,
    switch=("k",),
)

SIDE_SLIP = Effect(
    id="side_slip",
    family="ground",
    label="side slip",
    equation="v_y = -k * v * w",
    parameters=(Parameter("k", "s", 0.0, -2.0, 2.0, small=0.003),),
    streams=("imu.ax", "imu.ay", "beacon.x", "beacon.y", "ranges.range", "truth.x", "truth.y"),
    switch=("k",),
)

SLIP_PATCH = Effect(
    id="slip_patch",
    family="ground",
    label="slippery patch",
    equation="ground speeds = (1 - slip) * rim speeds while (body - (x, y)) is shorter than radius",
    parameters=(
        Parameter("x", "m", 0.0, -PLACE, PLACE),
        Parameter("y", "m", 0.0, -PLACE, PLACE),
        Parameter("radius", "m", 0.0, 0.0, PLACE),
        Parameter("slip", "", 0.0, -1.0, 1.0, small=0.03),
    ),
    streams=BODY_STREAMS,
    switch=("slip",),
    smooth=False,
)

BUMP = Effect(
    id="bump",
    family="ground",
    label="bump",
    equation="(v, w) += (distance, turn) * (1 - cos(2*pi*s/0.3))/0.3, s = t - time in 0 .. 0.3 s",
    parameters=(
        Parameter("time", "s", 0.0, 0.0, 1e6),
        Parameter("distance", "m", 0.0, -2.0, 2.0, small=0.002),
        Parameter("turn", "rad", 0.0, -3.2, 3.2, small=0.005),
    ),
    streams=BODY_STREAMS,
    switch=("distance", "turn"),
    smooth=False,
)

FLOOR_TILT = Effect(
    id="floor_tilt",
    family="ground",
    label="tilted floor",
    equation="ax += g*(sx*cos(theta) + sy*sin(theta)), ay += g*(sy*cos(theta) - sx*sin(theta)) in the body",
    parameters=(
        Parameter("slope_x", "", 0.0, -0.5, 0.5, small=6e-4),
        Parameter("slope_y", "", 0.0, -0.5, 0.5, small=6e-4),
    ),
    streams=("imu.ax", "imu.ay"),
    switch=("slope_x", "slope_y"),
)

EFFECTS = (WHEEL_SLIP, SIDE_SLIP, SLIP_PATCH, BUMP, FLOOR_TILT)
