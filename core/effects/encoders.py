"""Encoders: what they report of a wheel's true angle."""

from __future__ import annotations

from core.effects.base import Effect, Parameter

MISSED_TICKS = Effect(
    id="missed_ticks",
    family="encoders",
    label="missed ticks",
    equation="reported angle = (1 - share) * angle, then rounded down to ticks",
    parameters=(
        Parameter("left", "", 0.0, -0.5, 0.9, small=6e-4),
        Parameter("right", "", 0.0, -0.5, 0.9, small=6e-4),
    ),
    streams=("wheels.left", "wheels.right"),
    switch=("left", "right"),
)

EFFECTS = (MISSED_TICKS,)
