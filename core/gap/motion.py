"""What the robot does, in blocks of time: speeds from what drives it, and the regimes of the heat map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.gap.energy import SPAN, block_count
from core.gap.world import World

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

REGIMES = ("still", "straight", "turning", "accelerating", "braking", "fast", "slow", "reverse")
MOVING, TURNING, SLOW = 0.05, 0.1, 0.12
"""Speeds [m/s], [rad/s] and [m/s] beyond which the robot moves, turns, and below which it is slow."""
CHANGING, TOP, CURVED = 0.25, 0.7, 0.6
"""Shares of the strongest acceleration, speed and turn rate beyond which a block counts as such."""


@dataclass(frozen=True)
class Motion:
    """(B,) blocks of SPAN: middle [s], forward speed [m/s], turn rate [rad/s], change of the faster rim's speed [m/s²],
    and where the body is (NaN where nothing tells).
    """

    t: Array
    v: Array
    w: Array
    a: Array
    x: Array
    y: Array


def motion(world: World) -> Motion:
    """What a run's robot does."""
    inputs, track = world.body_inputs, world.run.meta.robot.track_width or 1.0
    t: Array = (np.arange(block_count(world), dtype=np.float64) + 0.5) * SPAN

    def at(values: Array, when: Array) -> Array:
        return np.interp(when, inputs.times, values[:, 0])

    offsets = np.linspace(-0.4, 0.4, 5) * SPAN
    left, right = (np.mean([at(side, t + d) for d in offsets], axis=0) for side in (inputs.left, inputs.right))
    sides = [
        np.abs(np.mean([at(s, t + d + e) for d in offsets], axis=0))
        for e in (-SPAN, SPAN)
        for s in (inputs.left, inputs.right)
    ]
    a = np.maximum(sides[2], sides[3]) - np.maximum(sides[0], sides[1])
    places = world.restarts if len(world.restarts) else np.full((1, 4), np.nan)
    x, y = (
        np.interp(t, places[:, 0], places[:, k]) if len(world.restarts) else np.full(len(t), np.nan) for k in (1, 2)
    )
    if "truth.x" in world.readings and "truth.y" in world.readings:
        x, y = (np.interp(t, world.times[name], world.readings[name]) for name in ("truth.x", "truth.y"))
    return Motion(t, 0.5 * (left + right), (right - left) / track, a / (2.0 * SPAN), x, y)


def regimes(moved: Motion) -> dict[str, Mask]:
    """Blocks in which the robot is in each regime; a block may be in several."""
    v, w = np.abs(moved.v), np.abs(moved.w)
    moving, turning = v > MOVING, w > TURNING
    top, bend = _high(v), _high(np.abs(moved.a))
    return {
        "still": ~(moving | turning),
        "straight": moving & ~turning,
        "turning": turning,
        "accelerating": moved.a > CHANGING * bend,
        "braking": moved.a < -CHANGING * bend,
        "fast": v > TOP * top,
        "slow": (v < SLOW) & (moving | turning),
        "reverse": moved.v < -MOVING,
    }


def wider(moved: Motion) -> dict[str, Mask]:
    """Regimes in the words of `where`, from wide to narrow."""
    v, w, t = np.abs(moved.v), np.abs(moved.w), moved.t
    moving, turning = v > MOVING, w > TURNING
    end = float(t[-1]) if len(t) else 1.0
    return {
        "moving": moving | turning,
        "turning": turning,
        "turning while moving": turning & moving,
        "straight": moving & ~turning,
        "fast turning": w > CURVED * _high(w),
        "accelerating": np.abs(moved.a) > CHANGING * _high(np.abs(moved.a)),
        "slow": (v < SLOW) & (moving | turning),
        "fast": v > TOP * _high(v),
        "still": ~(moving | turning),
        "early": t < 0.3 * end,
        "late": t > 0.5 * end,
    }


def _high(values: Array) -> float:
    """What is reached, but for the last fiftieth."""
    return max(float(np.quantile(values, 0.98)), 1e-6) if len(values) else 1e-6
