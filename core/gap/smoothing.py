"""A smooth curve through noisy readings: penalised third differences, as strong as the noise allows.

Whittaker 1923, "On a new method of graduation"; the weight is the strongest at which what is left is still noise.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.linalg import solveh_banded

from core.sensors import WheelLog

Array = npt.NDArray[np.float64]

WEIGHTS = np.geomspace(1e10, 1e-2, 25)
"""Penalties tried, strongest first."""
LEFT = 1.15
"""What a curve leaves may exceed the noise's variance by this factor."""


def smooth(values: Array, sigma: float) -> Array:
    """(N,) the smoothest curve that leaves no more than noise of this sigma; evenly spaced readings."""
    n = len(values)
    if n < 8:
        return values
    bands = _penalty(n)
    curve = values
    for weight in WEIGHTS:
        system = weight * bands
        system[-1] += 1.0
        curve = solveh_banded(system, values)
        if float(np.mean((values - curve) ** 2)) <= LEFT * sigma**2:
            break
    return curve


def _penalty(n: int) -> Array:
    """(4, n) upper bands of D'D, D the third difference."""
    row = np.array([-1.0, 3.0, -3.0, 1.0])
    bands = np.zeros((4, n))
    for i in range(4):
        for j in range(i, 4):
            bands[3 - (j - i), j : n - 3 + j] += row[i] * row[j]
    return bands


def smooth_wheels(wheels: WheelLog, tick: float | None) -> WheelLog:
    """Encoders' angles as smooth as their rounding to `tick` [rad] allows: what drives a body where no command does."""
    sides = []
    for angle in (wheels.left, wheels.right):
        values = np.asarray(angle, dtype=np.float64)
        if not np.isfinite(values).all() or len(values) < SHORT:
            return wheels
        noise = float(np.median(np.abs(np.diff(values, 3)))) / 0.67449 / np.sqrt(20.0)
        sides.append(smooth(values, max(tick / np.sqrt(12.0) if tick else 0.0, noise, 1e-9)))
    return WheelLog(t=wheels.t, left=sides[0], right=sides[1])


SHORT = 8
"""Fewer readings than this are left as they are."""
