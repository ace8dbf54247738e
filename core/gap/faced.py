"""Which way a reference faces: its heading may stand a little beside the way that the robot drives.

A marker is never mounted quite straight. Then all motion that it sees goes a little sideways, by the same angle, which
the body's filter would have to take for chance. What goes sideways with the way driven, beside what does with turning
and with side slip, all runs together, is that angle.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from core.effects import EFFECTS
from core.gap.floor import NORMAL_MEDIAN
from core.run import Run

Array = npt.NDArray[np.float64]

STEP = 0.4
"""Length of a step [s]."""
CLEAR = 5.0
"""So many deviations the angle must stand clear of chance."""
FEW = 40
"""Fewer steps that do not overlap say nothing."""
LEAST = 5e-4
"""An angle below this [rad] changes nothing, however clear."""
FAR = 4.0
"""Steps that miss by more than so many deviations are left out."""


def facing(runs: Sequence[Run]) -> float:
    """By how much truth's heading lies to the right of the way driven, all runs alike [rad]; 0 where that is not clear.

    Nor where it is more than an IMU's yaw may be off without mattering: then it is no matter of mounting alone.
    """
    parts = [part for part in (_steps(run) for run in runs) if part is not None]
    if not parts:
        return 0.0
    way, turn, sideways, seconds = np.concatenate(parts, axis=1)
    design = np.column_stack((way, turn, way * turn / seconds))
    kept = np.ones(len(way), dtype=bool)
    for _ in range(3):
        if kept.sum() < FEW:
            return 0.0
        rows = design[kept]
        size = np.sqrt(np.maximum((rows**2).sum(axis=0), 1e-12))
        inverse = np.linalg.pinv(rows.T @ rows / np.outer(size, size), rcond=1e-6) / np.outer(size, size)
        x = inverse @ (rows.T @ sideways[kept])
        left = sideways - design @ x
        sigma = max(float(np.median(np.abs(left[kept]))) / NORMAL_MEDIAN, 1e-9)
        kept = np.abs(left) < FAR * sigma
    angle, sd = float(x[0]), sigma * float(np.sqrt(inverse[0, 0]))
    return angle if max(CLEAR * sd, LEAST) < abs(angle) < MOST else 0.0


MOST = EFFECTS["imu_yaw"].parameter("angle").small or 0.0


def faced(runs: Sequence[Run]) -> tuple[list[Run], tuple[str, ...]]:
    """The runs with their truth turned to face the way driven, and what was set right."""
    angle = facing(runs)
    if angle == 0.0:
        return list(runs), ()
    side = "right" if angle > 0.0 else "left"
    told = f"truth faces {1e3 * abs(angle):.1f} mrad to the {side} of the way driven, and was set right"
    return [_turned(run, angle) for run in runs], (told,)


def _turned(run: Run, angle: float) -> Run:
    if run.truth is None or run.truth.theta is None:
        return run
    return dataclasses.replace(run, truth=dataclasses.replace(run.truth, theta=run.truth.theta + angle))


def _steps(run: Run) -> Array | None:
    """(4, N) way, turn, sideways motion and length of each step, in the body's own frame halfway turned."""
    truth = run.truth
    if truth is None or truth.x is None or truth.y is None or truth.theta is None or len(truth) < FEW:
        return None
    poses = np.column_stack((truth.x, truth.y, truth.theta)).astype(np.float64)
    known = np.isfinite(poses).all(axis=1)
    t, poses = truth.t[known], poses[known]
    if len(t) < FEW:
        return None
    m = max(round(STEP / float(np.median(np.diff(t)))), 1)
    t, poses = t[::m], poses[::m]
    theta = np.unwrap(poses[:, 2])
    dx, dy = np.diff(poses[:, :2], axis=0).T
    middle = 0.5 * (theta[1:] + theta[:-1])
    c, s = np.cos(middle), np.sin(middle)
    return np.stack((c * dx + s * dy, np.diff(theta), c * dy - s * dx, np.diff(t)))
