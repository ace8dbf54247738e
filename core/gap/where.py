"""Where the gap lies: each stream's excess over its floor, what the robot does there, when and at what place.

Streams are judged on the replay of the whole chain (what a user of the simulator sees). Excess is counted against
the floor and its own uncertainty; p-values of all streams are held under one false-discovery rate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt
from scipy import stats

from core.effects import EFFECTS
from core.gap.shrink import Replay
from core.gap.types import Place, Where
from core.gap.world import World
from core.robot import EffectSet

Array = npt.NDArray[np.float64]

SECOND = 1.0
RATE = 0.05
"""False-discovery rate over streams."""
STRONG = 12.0
"""A block whose mean square is this far above the floor, in its standard deviations, belongs to an interval."""
MOST = 0.6
"""Intervals that cover more than this share of the run say nothing."""
LEAST_SHARE = 0.002
"""Streams with less of the excess than this are left out."""
FLOOR_SD = 0.03
"""The floor of a stream is known to no better than this."""
INSIDE = 0.85
"""A regime is named if it holds this share of the excess."""


def where(
    worlds: Sequence[World],
    replays: Sequence[Replay],
    floors: Mapping[str, float],
    patch: Place | None,
    causes: EffectSet,
) -> tuple[Where, ...]:
    """Streams that leave their floor, strongest first."""
    found: list[tuple[str, float, float]] = []
    for name in worlds[0].channels:
        values = np.concatenate([one.values[name] for one in replays if name in one.values])
        if len(values) < 20:
            continue
        level = floors[name] ** 2
        clipped = values**2 / level
        excess = float(np.sum(values**2 - level))
        n = len(values)
        sd = np.sqrt(2.0 * n * _colour(name) + (2.0 * FLOOR_SD * n) ** 2)
        found.append((name, excess, float(stats.norm.sf((float(np.sum(clipped)) - n) / sd))))
    total = sum(max(excess, 0.0) for _, excess, _ in found)
    passed = _discoveries([p for _, _, p in found])
    rows = []
    for (name, excess, p), real in zip(found, passed, strict=True):
        if real and excess > LEAST_SHARE * total:
            regime, intervals = regime_of(worlds, replays, name, floors[name])
            regime = told(name, causes) or regime
            rows.append(Where(name, regime, excess / total, max(p, 1e-300), intervals, patch))
    return tuple(sorted(rows, key=lambda one: -one.share))


SIGNATURES = {
    "command_delay": "accelerating", "motor_lag": "accelerating", "speed_limit": "fast", "accel_limit": "accelerating",
    "deadband": "slow", "drive_gain": "moving", "battery_sag": "early to late", "wheel_radius": "moving",
    "unequal_wheels": "moving", "track_width": "turning", "wheel_slip": "accelerating",
    "side_slip": "turning while moving", "slip_patch": "place", "bump": "time", "floor_tilt": "heading",
    "gyro_bias": "always", "gyro_drift": "early to late", "gyro_walk": "early to late",
    "gyro_temperature": "early to late", "gyro_scale": "turning", "gyro_noise": "always", "gyro_clip": "fast turning",
    "gyro_g_sensitivity": "turning while moving", "accel_bias": "always", "accel_scale": "accelerating",
    "imu_yaw": "accelerating", "imu_offset": "turning", "vibration": "moving", "missed_ticks": "moving",
    "beacon_delay": "moving", "beacon_shift": "always", "beacon_rotation": "always", "beacon_scale": "always",
    "tag_offset": "heading", "beacon_noise": "always", "beacon_outliers": "always", "beacon_shadow": "place",
    "anchor_moved": "place", "range_bias": "always", "imu_clock": "accelerating", "clock_drift": "early to late",
}  # fmt: skip
"""Where each effect shows, by its equation."""


def told(stream: str, causes: EffectSet) -> str | None:
    """The regime of the causes that touch a stream; None where none does."""
    found = [SIGNATURES[name] for name in causes if stream in EFFECTS[name].streams]
    return ", ".join(dict.fromkeys(found)) if found else None


def _colour(name: str) -> float:
    """By how much more a stream's mean square varies than that of white noise: windows share their start's error."""
    return 100.0 if name.startswith(("truth", "wheels")) else 1.0


def _discoveries(p_values: Sequence[float]) -> list[bool]:
    """Benjamini and Hochberg's rule."""
    p = np.array(p_values)
    order = np.argsort(p)
    fine = p[order] <= RATE * (np.arange(len(p)) + 1) / max(len(p), 1)
    last = int(np.flatnonzero(fine).max(initial=-1))
    out = np.zeros(len(p), dtype=bool)
    out[order[: last + 1]] = True
    return out.tolist()


def regime_of(
    worlds: Sequence[World], replays: Sequence[Replay], name: str, floor: float
) -> tuple[str, tuple[tuple[float, float], ...]]:
    """What the robot does where a stream's excess lies, and the intervals of the first run that hold it."""
    parts, spans = [], []
    for k, (world, one) in enumerate(zip(worlds, replays, strict=True)):
        if name not in one.values:
            continue
        t, e, n = _blocks(one.times[name], one.values[name] ** 2 / floor**2 - 1.0)
        v, w, a = motion(world, t)
        parts.append(np.column_stack((e, n, v, w, a, t / max(float(t[-1]), 1.0))))
        if k == 0:
            spans = _intervals(t, e, n)
    rows = np.concatenate(parts)
    return _regime(rows), tuple(spans)


def motion(world: World, t: Array) -> tuple[Array, Array, Array]:
    """Mean size of forward speed [m/s], turn rate [rad/s] and rim acceleration [m/s²] in the second from each stamp."""
    inputs = world.body_inputs
    times = inputs.times
    left, right = inputs.left[:, 0], inputs.right[:, 0]
    v, w = 0.5 * (left + right), (right - left) / (world.run.meta.robot.track_width or 1.0)
    a = np.maximum(np.abs(inputs.left[:, 1]), np.abs(inputs.right[:, 1]))
    fine = t[:, None] + np.linspace(0.05, 0.95, 7)
    pick = [np.abs(np.interp(fine, times, part)) for part in (v, w, a)]
    return pick[0].mean(axis=1), pick[1].mean(axis=1), pick[2].mean(axis=1)


def _blocks(t: Array, excess: Array) -> tuple[Array, Array, Array]:
    number = np.floor(t / SECOND)
    first = np.flatnonzero(np.diff(number, prepend=-1.0))
    return number[first] * SECOND, np.add.reduceat(excess, first), np.diff(np.append(first, len(t))).astype(float)


def _intervals(t: Array, excess: Array, n: Array) -> list[tuple[float, float]]:
    strong = excess / np.sqrt(2.0 * np.maximum(n, 1.0)) > STRONG
    if not strong.any() or strong.mean() > MOST:
        return []
    edges = np.flatnonzero(np.diff(np.concatenate(([0], strong.astype(int), [0]))))
    spans = [[float(t[a]), float(t[b - 1]) + SECOND] for a, b in zip(edges[::2], edges[1::2], strict=True)]
    merged = [spans[0]]
    for a, b in spans[1:]:
        if a - merged[-1][1] <= 2.0:
            merged[-1][1] = b
        else:
            merged.append([a, b])
    return [(a, b) for a, b in merged] if len(merged) <= 40 else []


def _regime(rows: Array) -> str:
    """The narrowest of the named regimes that holds most of the excess: by how much its density exceeds the rest's."""
    e, n, v, w, a, t = rows.T
    e = np.maximum(e, 0.0)
    total = float(e.sum())
    if total <= 0.0:
        return "all"
    moving, turning = v > 0.05, w > 0.1
    masks = {
        "moving": moving | turning,
        "turning": turning,
        "turning while moving": turning & moving,
        "straight": moving & ~turning,
        "fast turning": w > 0.6 * np.quantile(w, 0.98),
        "accelerating": a > 0.25 * max(float(np.quantile(a, 0.98)), 1e-6),
        "slow": (v < 0.12) & (moving | turning),
        "fast": v > 0.7 * np.quantile(v, 0.98),
        "still": ~(moving | turning),
        "early": t < 0.3,
        "late": t > 0.5,
    }
    scores = {}
    for name, mask in masks.items():
        share, size = float(e[mask].sum()) / total, float(n[mask].sum()) / float(n.sum())
        if share > INSIDE and 0.0 < size < 0.97:
            scores[name] = (share - size) / (1.0 - size) - 0.25 * size
    return max(scores, key=lambda name: scores[name]) if scores else "all"
