"""A rest too large to pass over, though no search gave it a shape: where runs have no IMU, or many things act at once.

The last word on a verdict: a stream that stays several times above its noise, by a size that nobody would call small,
is told as unknown with what it follows best, whatever was found beside it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from core.gap.curves import rated, samples, told_by, unit_of
from core.gap.floor import Floor
from core.gap.shrink import Shown
from core.gap.types import Unexplained
from core.gap.where import Ground
from core.gap.world import IMU
from core.robot import EffectSet

TIMES = 4.0
"""A stream's rest is large where it is so many times the noise, root mean square over the runs,"""
LARGE = {
    "wheels.left": 5e-3, "wheels.right": 5e-3, "imu.gz": 5e-3, "imu.ax": 0.1, "imu.ay": 0.1, "beacon.x": 0.02,
    "beacon.y": 0.02, "beacon.theta": 0.015, "ranges.range": 0.02, "truth.x": 5e-3, "truth.y": 5e-3,
    "truth.theta": 5e-3,
}  # fmt: skip
"""and larger than this [rad, rad/s, m/s², m]: several times what is immaterial there,"""
WIDELY, MOSTLY, STRONG = 0.05, 0.5, 4.0
"""and, in the IMU and in fixes, not only in a few: in this share of the blocks it is above the noise by this factor."""
PART = 0.05
"""and more than this share of what was there before: no model of a large effect (a patch's edge) is exact."""
FOLLOWS = 0.1
"""What it depends on is told where that takes this share of it."""
SURE = 0.9
"""Probability that such a rest is of something in no list."""
WORDS = {
    "speed": "truth.v", "turn rate": "truth.w", "acceleration": "truth.a", "turn acceleration": "truth.alpha",
    "speed times turn rate": "truth.v", "time": "t", "temperature": "imu.temperature", "heading": "truth.theta",
    "x": "truth.x", "y": "truth.y", "velocity along x": "truth.theta", "velocity along y": "truth.theta",
    "left rim speed": "wheels.left", "right rim speed": "wheels.right", "left wheel angle": "wheels.left",
    "right wheel angle": "wheels.right",
}  # fmt: skip
"""Regressors in the words of gap/1."""


def remainder(ground: Ground, shown: Sequence[Shown], floor: Floor, noises: EffectSet) -> Unexplained | None:
    """The loudest stream whose rest is large; None where none is. noises: those that are told, outliers among them."""
    rests = {name: _times(ground, name) for name in ground.channels}
    large = {name: times for name, times in rests.items() if _is_large(ground, name, times, floor, noises)}
    if not large:
        return None
    name = max(large, key=lambda one: large[one])
    size = large[name] * floor.sigma[name]
    told = (
        f"{name} stays {large[name]:.0f} times its noise off ({size:.2g} {unit_of(name)}, root mean square), and no "
        "listed effect explains it"
    )
    found = samples(ground.worlds, ground.moved, [(one.full,) for one in shown], name, floor)
    best = told_by(found, found.values[0])[:1] if found is not None else []
    if not best or best[0][1] < FOLLOWS:
        return Unexplained(name, (), f"{told}; it follows nothing that the robot does", 1.0)
    regressor, share = best[0]
    rate = "its rate" if rated(name) else "it"
    return Unexplained(name, (WORDS[regressor],), f"{told}; {rate} follows {regressor} best ({share:.0%} of it)", 1.0)


def _times(ground: Ground, name: str) -> float:
    left, dof = float(ground.all(name, "left").sum()), float(ground.all(name, "dof").sum())
    return float(np.sqrt(max(left, 0.0) / max(dof, 1.0)))


def _is_large(ground: Ground, name: str, times: float, floor: Floor, noises: EffectSet) -> bool:
    if times < TIMES or name not in floor.sigma or times * floor.sigma[name] < LARGE[name]:
        return False
    if name in OUTLYING and times * floor.sigma[name] < BY_OUTLIERS * _outlying(noises.get("beacon_outliers", {})):
        return False
    if ground.all(name, "left").sum() < PART * ground.all(name, "excess").sum():
        return False
    if name.startswith(("wheels", "truth")):
        return True
    left, dof = ground.all(name, "left"), ground.all(name, "dof")
    some = dof > 0.5
    wide = WIDELY if name in IMU else MOSTLY  # single fixes and ranges far off are outliers
    return bool(np.mean(left[some] > STRONG * dof[some]) > wide)


def _outlying(outliers: Mapping[str, float | str]) -> float:
    """Root mean square [m] of what outliers of this rate and size add to a reading."""
    return float(np.sqrt(float(outliers.get("rate", 0.0)))) * float(outliers.get("size", 0.0))


OUTLYING, BY_OUTLIERS = ("beacon.x", "beacon.y", "ranges.range"), 1.5
"""Streams that outliers are in, and how many times what they add on average is still theirs."""
