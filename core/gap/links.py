"""The chain of links: how far each one is off, predicted from the recorded stream before it, before and after."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy import stats

from core.gap.curves import unit_of
from core.gap.energy import FLOOR_SD
from core.gap.evidence import LinkGap, NoiseLevel
from core.gap.explain import Search
from core.gap.floor import Floor
from core.gap.linear import Normal, linearise
from core.gap.world import CHANNELS

LINKS = {
    "commands to wheels": ("wheels.left", "wheels.right"),
    "wheels to body": ("truth.x", "truth.y", "truth.theta"),
    "body to gyro": ("imu.gz",),
    "body to accelerometer": ("imu.ax", "imu.ay"),
    "body to beacons": ("beacon.x", "beacon.y", "beacon.theta", "ranges.range"),
}
"""Links of the chain and the channels that show them. Without truth the body is seen through the beacons alone."""


def links(found: Search) -> tuple[LinkGap, ...]:
    """Every link that these runs have."""
    before: dict[str, tuple[float, float]] = {}
    after: dict[str, tuple[float, float]] = {}
    for one in found.links:
        after |= _squares(one.fit.normal)
        bare = linearise(one.problem, {}, (), one.fit.scope, own=False)
        before |= _squares(bare)
    out = []
    for name, channels in LINKS.items():
        here = tuple(c for c in channels if c in after and after[c][0] > 0.0)
        if not here:
            continue
        n = sum(before[c][0] for c in here)
        excess = sum(before[c][1] for c in here) - n
        p = float(stats.norm.sf(excess / np.sqrt(2.0 * n + (2.0 * FLOOR_SD * n) ** 2)))
        sizes = [float(np.sqrt(np.mean([part[c][1] / part[c][0] for c in here]))) for part in (before, after)]
        out.append(LinkGap(name, here, sizes[0], sizes[1], 1.0, max(p, 1e-300)))
    return tuple(out)


def _squares(normal: Normal) -> dict[str, tuple[float, float]]:
    """Readings and sum of white squares (Huber's beyond five sigma) per channel."""
    n, c = normal.n.sum(axis=1), normal.c.sum(axis=1)
    return {name: (float(n[i]), float(c[i])) for i, name in enumerate(normal.channels)}


def noise_floor(floor: Floor, stated: Mapping[str, float]) -> tuple[NoiseLevel, ...]:
    """Each channel's noise as the data show it, with its uncertainty, beside what is stated."""
    out = []
    for name in (c for c in CHANNELS if c in floor.sigma):
        sheet = stated.get(name)
        ratio = None if not sheet else floor.sigma[name] / sheet
        sd = None if ratio is None else ratio * floor.sd.get(name, 1.0)
        out.append(NoiseLevel(name, floor.sigma[name], unit_of(name), sheet, ratio, sd))
    return tuple(out)
