"""What drives a body without commands is a smooth curve through rounded wheel angles: it is off, and comes back.

Its error is no white noise in the IMU, nor a bias: the angle is known to its rounding at all times, so that the rate's
error sways at the smoothing's own pace and leaves slow changes alone. Taken for white it makes small effects loud, and
a walk of the gyro's bias out of nothing. Size and pace are those that make each axis' residuals likeliest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from core.gap._pose_numba import whiten_offset
from core.gap.floor import Floor
from core.gap.whiten import imu_sigma
from core.gap.world import IMU, World
from core.simulation._batch_numba import Outputs

Array = npt.NDArray[np.float64]

PACES = (5.0, 9.0, 16.0, 28.0, 50.0)
"""Angular frequencies tried [rad/s]."""
SIZES = (0.0, 0.35, 0.7, 1.4, 2.8, 5.6, 11.2)
"""Standard deviations tried, in units of the axis' white noise."""
FAR = 25.0
"""No squared innovation counts for more: edges are no noise."""
ENOUGH = 20.0
"""What a sway must bring, in -2 log likelihood."""


def sway_of(
    parts: Sequence[tuple[World, Outputs, Mapping[str, Array]]], floor: Floor
) -> dict[str, tuple[float, float]]:
    """(standard deviation, angular frequency) per IMU axis of the runs that smoothed wheels drive.

    parts: per run its world, a model's body, and the residuals.
    """
    rough = [part for part in parts if part[0].rough]
    out: dict[str, tuple[float, float]] = {}
    for name in IMU if rough else ():
        rows = [
            (world.times[name], imu_sigma(world, name, body, floor), residuals[name])
            for world, body, residuals in rough
            if name in residuals
        ]
        if not rows:
            continue
        walk, sigma = floor.gyro_walk if name == "imu.gz" else 0.0, floor.sigma[name]
        costs = {(size, pace): _cost(rows, walk, size * sigma, pace) for pace in PACES for size in SIZES[1:]}
        best = min(costs, key=lambda key: costs[key])
        if costs[best] < _cost(rows, walk, 0.0, 1.0) - ENOUGH:
            out[name] = (best[0] * sigma, best[1])
    return out


def _cost(rows: Sequence[tuple[Array, Array, Array]], walk: float, sway: float, pace: float) -> float:
    total = 0.0
    for t, sigma, residual in rows:
        white = residual[None, :].copy()
        total += whiten_offset(t, sigma, walk, sway, pace, white)
        total += float(np.sum(np.minimum(white**2, FAR)))
    return total
