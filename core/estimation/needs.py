"""What each method needs of a run, as None or the reason why it cannot run, with advice."""

from __future__ import annotations

import numpy as np

from core.run import Run
from core.sensors import Log


def _enough(log: Log | None, name: str, rows: int = 2) -> str | None:
    if log is None:
        return f"the run has no {name} stream"
    return None if len(log) >= rows else f"{name} has {len(log)} rows, at least {rows} are needed"


def _dimension(run: Run, name: str) -> str | None:
    value = getattr(run.meta.robot, name)
    if value is None:
        return f"robot.{name} is unknown: give it in run.json"
    return None if np.isfinite(value) and value > 0 else f"robot.{name} is {value}, expected a positive number"


def for_wheels(run: Run) -> str | None:
    """Distance from the wheels."""
    return _enough(run.wheels, "wheels") or _dimension(run, "wheel_radius")


def for_encoders(run: Run) -> str | None:
    """Distance and turn from the wheels."""
    return for_wheels(run) or _dimension(run, "track_width")


def for_encoders_gyro(run: Run) -> str | None:
    """Distance from the wheels, turn from the gyro."""
    return for_wheels(run) or _enough(run.imu, "imu")


def for_beacon(run: Run) -> str | None:
    """Fixes, or ranges to three surveyed beacons that do not stand on one line."""
    if run.beacon is not None and len(run.beacon):
        return None
    if run.ranges is None or not len(run.ranges):
        return "the run has neither beacon fixes nor ranges"
    known = sorted({run.ranges.names[i] for i in np.unique(run.ranges.beacon)} & set(run.meta.beacons))
    if len(known) < 3:
        return f"ranges to {len(known)} surveyed beacons ({', '.join(known) or 'none'}), at least 3 are needed"
    xy = np.array([run.meta.beacons[name][:2] for name in known])
    spread = np.linalg.svd(xy - xy.mean(axis=0), compute_uv=False)
    if spread[1] < 1e-3 * max(spread[0], 1e-9):
        return "the surveyed beacons stand on one line: ranges cannot tell its two sides apart"
    return None


def for_fused(run: Run) -> str | None:
    """Wheels for the distance, and turn from gyro, wheels or both."""
    return for_wheels(run) or (None if run.imu is not None and len(run.imu) >= 2 else _dimension(run, "track_width"))
