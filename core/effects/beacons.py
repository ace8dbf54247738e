"""Beacons: fixes and ranges."""

from __future__ import annotations

from core.effects.base import FIX_STREAMS, Effect, Parameter

PLACE = 1e4
FIX = FIX_STREAMS[:3]

BEACON_DELAY = Effect(
    id="beacon_delay",
    family="beacons",
    label="beacon delay",
    equation="each fix or range is of the pose at t - delay",
    parameters=(Parameter("delay", "s", 0.0, 0.0, 5.0, small=0.025),),
    streams=FIX_STREAMS,
    switch=("delay",),
)

BEACON_SHIFT = Effect(
    id="beacon_shift",
    family="beacons",
    label="beacon map shift",
    equation="fix += (x, y)",
    parameters=(
        Parameter("x", "m", 0.0, -PLACE, PLACE, small=0.01),
        Parameter("y", "m", 0.0, -PLACE, PLACE, small=0.01),
    ),
    streams=FIX[:2],
    switch=("x", "y"),
)

BEACON_ROTATION = Effect(
    id="beacon_rotation",
    family="beacons",
    label="beacon map rotation",
    equation="fix = R(angle) * fix about the map's origin, theta += angle",
    parameters=(Parameter("angle", "rad", 0.0, -3.2, 3.2, small=0.003),),
    streams=FIX,
    switch=("angle",),
)

BEACON_SCALE = Effect(
    id="beacon_scale",
    family="beacons",
    label="beacon scale",
    equation="(x, y) *= scale about the map's origin, range *= scale",
    parameters=(Parameter("scale", "", 1.0, 0.5, 2.0, small=0.002),),
    streams=("beacon.x", "beacon.y", "ranges.range"),
    switch=("scale",),
)

TAG_OFFSET = Effect(
    id="tag_offset",
    family="beacons",
    label="tag mounting place",
    equation="the tag sits (x, y) beyond run.json, in the body frame",
    parameters=(
        Parameter("x", "m", 0.0, -5.0, 5.0, small=0.01),
        Parameter("y", "m", 0.0, -5.0, 5.0, small=0.01),
    ),
    streams=("beacon.x", "beacon.y", "ranges.range"),
    switch=("x", "y"),
)

BEACON_NOISE = Effect(
    id="beacon_noise",
    family="beacons",
    label="beacon noise",
    equation="white noise of positions, headings and ranges is factor * the data sheet's",
    parameters=(Parameter("factor", "", 1.0, 0.0, 100.0, small=0.1),),
    streams=FIX_STREAMS,
    switch=("factor",),
    noise_only=True,
)

BEACON_OUTLIERS = Effect(
    id="beacon_outliers",
    family="beacons",
    label="beacon outliers",
    equation="a share `rate` of fixes (x and y each) or ranges carries a further error of standard deviation size",
    parameters=(
        Parameter("rate", "", 0.0, 0.0, 1.0, small=0.015),
        Parameter("size", "m", 0.0, 0.0, 1e3),
    ),
    streams=("beacon.x", "beacon.y", "ranges.range"),
    switch=("rate",),
    noise_only=True,
)

BEACON_SHADOW = Effect(
    id="beacon_shadow",
    family="beacons",
    label="beacon shadow",
    equation="no fix and no range while the true tag is nearer to (x, y) than radius",
    parameters=(
        Parameter("x", "m", 0.0, -PLACE, PLACE),
        Parameter("y", "m", 0.0, -PLACE, PLACE),
        Parameter("radius", "m", 0.0, 0.0, PLACE, small=0.1),
    ),
    streams=FIX_STREAMS,
    switch=("radius",),
    noise_only=True,
    smooth=False,
)

ANCHOR_MOVED = Effect(
    id="anchor_moved",
    family="beacons",
    label="a beacon stands elsewhere",
    equation="one beacon stands (x, y) off its surveyed place",
    parameters=(
        Parameter("beacon", "", ""),
        Parameter("x", "m", 0.0, -100.0, 100.0, small=0.015),
        Parameter("y", "m", 0.0, -100.0, 100.0, small=0.015),
    ),
    streams=("ranges.range",),
    switch=("x", "y"),
)

RANGE_BIAS = Effect(
    id="range_bias",
    family="beacons",
    label="range bias",
    equation="range += bias",
    parameters=(Parameter("bias", "m", 0.0, -10.0, 10.0, small=0.008),),
    streams=("ranges.range",),
    switch=("bias",),
)

EFFECTS = (
    BEACON_DELAY,
    BEACON_SHIFT,
    BEACON_ROTATION,
    BEACON_SCALE,
    TAG_OFFSET,
    BEACON_NOISE,
    BEACON_OUTLIERS,
    BEACON_SHADOW,
    ANCHOR_MOVED,
    RANGE_BIAS,
)
