"""What the readings of one axis say against themselves: stuck at a limit, or never at rest."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

WIDE = {"g": 0.2, "a": 5.0}  # rad/s, m/s^2: a record that spans less is far from any sensor's limits
UNITS = {"g": "rad/s", "a": "m/s²"}
RESTLESS = 10.0  # times their own noise that readings at rest do not wander, be it filtered or drifting


def saturated(values: npt.NDArray[np.floating], axis: str) -> tuple[str, ...]:
    """A note where readings (N,) of an axis (gx ... az) are stuck at the record's limits; else nothing."""
    from core.imu.bias._blocks_numba import at_limit

    least, most = float(np.nanmin(values)), float(np.nanmax(values))
    stuck = at_limit(values, least, most) if most - least > WIDE[axis[0]] else 0
    if stuck < 3:
        return ()
    lost = "what it turned meanwhile is lost" if axis[0] == "g" else "what it felt meanwhile is lost"
    sensor = "gyro" if axis[0] == "g" else "accelerometer"
    return (
        f"{stuck} readings sit at the record's limits, {least:.4g} and {most:.4g} {UNITS[axis[0]]}: "
        f"the {sensor} was saturated, and {lost}.",
    )


def wander(deviation: float, values: npt.NDArray[np.floating]) -> float:
    """How many times their own noise, from reading to reading, values (N,) deviate; 0 where they hardly have any."""
    steps = np.diff(np.asarray(values, np.float64))
    noise = float(np.sqrt(np.nanmean(steps**2) / 2)) if len(steps) else 0.0
    return deviation / noise if noise > 0 else 0.0
