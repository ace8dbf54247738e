"""Kinematics: the wheels turn as reported, the body moves otherwise; encoders do not see it."""

from __future__ import annotations

from core.effects.base import BODY_STREAMS, Effect, Parameter

WHEEL_RADIUS = Effect(
    id="wheel_radius",
    family="kinematics",
    label="wheel radius",
    equation="true radii = scale * r",
    parameters=(Parameter("scale", "", 1.0, 0.5, 2.0, small=0.001),),
    streams=BODY_STREAMS,
    switch=("scale",),
)

UNEQUAL_WHEELS = Effect(
    id="unequal_wheels",
    family="kinematics",
    label="unequal wheels",
    equation="left = 2*r/(1 + ratio), right = 2*r*ratio/(1 + ratio)",
    parameters=(Parameter("ratio", "", 1.0, 0.5, 2.0, small=6e-4),),
    streams=BODY_STREAMS,
    switch=("ratio",),
)

TRACK_WIDTH = Effect(
    id="track_width",
    family="kinematics",
    label="track width",
    equation="w = (v_right - v_left)/(scale * b)",
    parameters=(Parameter("scale", "", 1.0, 0.3, 3.0, small=0.002),),
    streams=BODY_STREAMS,
    switch=("scale",),
)

EFFECTS = (WHEEL_RADIUS, UNEQUAL_WHEELS, TRACK_WIDTH)
