"""Clocks first: a reference whose stamps are late against the wheels' turns every bend into an error of motion.

Motion over short steps, seen by the reference, is that of the wheels, a moment earlier: distance and turning of each
step are regressed on the wheels' own (the scale of each free), on what a delay would change, and on what slip in
acceleration would, for that looks much the same. Delays that stand clear of both are taken out of the stamps.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from core.gap.floor import NORMAL_MEDIAN
from core.gap.smoothing import smooth_wheels
from core.run import Run

Array = npt.NDArray[np.float64]

STEP = 0.2
"""Length of a step [s]."""
LEAST, CLEAR, MOST = 0.008, 5.0, 0.5
"""Delays are taken out where they are of this size [s] and stand so many deviations clear, all runs together; none is
larger than the last [s]."""
ROUNDS = 5
FEW = 60
"""Fewer steps than this say nothing."""
TOLERATED = 4.0
"""Residuals beyond so many deviations count less."""


@dataclasses.dataclass(frozen=True)
class Clock:
    """A reference's stamps against the wheels' clock: late by `values` [s] at the run's begin and its end, covariance.

    In between it is linear.
    """

    begin: float
    end: float
    values: Array
    covariance: Array

    def late(self, t: Array) -> Array:
        """(N,) by how much stamps are late [s]."""
        share = (t - self.begin) / max(self.end - self.begin, 1e-9)
        out: Array = self.values[0] + share * (self.values[1] - self.values[0])
        return out


def aligned(runs: Sequence[Run]) -> tuple[list[Run], tuple[str, ...]]:
    """The runs with their truth on the wheels' clock, where delays stand clear of chance; and what was set right.

    Each delay is drawn towards 0 by as much as its own deviation asks for, given how far all of them spread.
    """
    found = [reference_clock(run) for run in runs]
    clocks = [one for one in found if one is not None]
    values = np.array([one.values for one in clocks]).reshape(-1)
    weight = np.array([1.0 / np.diag(one.covariance) for one in clocks]).reshape(-1) ** 2
    spread = float(np.sum(weight * values**2 - np.sqrt(weight)) / np.sum(weight)) if clocks else 0.0
    far = sum(float(one.values @ np.linalg.solve(one.covariance, one.values)) for one in clocks)
    dof = 2.0 * len(clocks)
    if spread < LEAST**2 or far < dof + CLEAR * np.sqrt(2.0 * dof) + CLEAR**2:
        return list(runs), ()
    out, notes = [], []
    for run, one in zip(runs, found, strict=True):
        if one is None or run.truth is None:
            out.append(run)
            continue
        drawn = np.asarray(spread * np.linalg.solve(one.covariance + spread * np.eye(2), one.values), dtype=np.float64)
        clock = dataclasses.replace(one, values=drawn)
        out.append(
            dataclasses.replace(run, truth=dataclasses.replace(run.truth, t=run.truth.t - clock.late(run.truth.t)))
        )
        if np.abs(drawn).max() > LEAST:
            first, last = (f"{1e3 * value:+.0f}" for value in drawn)
            notes.append(f"{run.meta.name or 'a run'} by {first} ms at its begin and {last} ms at its end")
    told = "the stamps of truth are late against the wheels, and were set right: " + ", ".join(notes)
    return out, (told,) if notes else ()


def reference_clock(run: Run) -> Clock | None:
    """By how much truth is late against the wheels; None where either is missing or says too little."""
    truth, wheels, robot = run.truth, run.wheels, run.meta.robot
    if truth is None or wheels is None or robot.wheel_radius is None or not robot.track_width or len(wheels) < FEW:
        return None
    if truth.x is None or truth.y is None or truth.theta is None:
        return None
    poses = np.column_stack((truth.x, truth.y, truth.theta)).astype(np.float64)
    known = np.isfinite(poses).all(axis=1)
    t, poses = truth.t[known], poses[known]
    tick = 2.0 * np.pi / robot.ticks_per_rev if robot.ticks_per_rev else None
    smoothed = smooth_wheels(wheels, tick)
    rims = robot.wheel_radius * np.column_stack((smoothed.left, smoothed.right)).astype(np.float64)
    if len(t) < FEW or not np.isfinite(rims).all():
        return None
    m = max(round(STEP / float(np.median(np.diff(t)))), 1)
    seen = _steps(poses, m)
    clock = Clock(float(t[0]), float(t[-1]), np.zeros(2), np.eye(2))
    for _ in range(ROUNDS):
        further = _fitted(t - clock.late(t), m, seen, (wheels.t, rims, robot.track_width))
        if further is None or np.abs(clock.values + further[0]).max() > MOST:
            return None
        clock = dataclasses.replace(clock, values=clock.values + further[0], covariance=further[1])
        if np.abs(further[0]).max() < 0.1 * np.sqrt(np.diag(further[1]).min()):
            break
    return clock


def _steps(poses: Array, m: int) -> Array:
    """(2, N) forward way and turn over m readings, in the body's own frame halfway turned."""
    theta = np.unwrap(poses[:, 2])
    turn, (dx, dy) = theta[m:] - theta[:-m], (poses[m:, :2] - poses[:-m, :2]).T
    middle = 0.5 * (theta[m:] + theta[:-m])
    return np.stack((np.cos(middle) * dx + np.sin(middle) * dy, turn))


def _fitted(t: Array, m: int, seen: Array, driven: tuple[Array, Array, float]) -> tuple[Array, Array] | None:
    """The further delay at begin and end, and its covariance, beside scales and slip. driven: stamps, rims, track.

    t: the reference's stamps, set right as far as is known.
    """
    at, rims, track = driven
    inside = (t[:-m] > at[0]) & (t[m:] < at[-1])
    if inside.sum() < FEW:
        return None
    speed = np.gradient(rims, at, axis=0)
    ways = []
    for values in (rims, speed, 0.5 * speed * np.abs(speed)):
        now = np.column_stack([np.interp(t, at, side) for side in values.T])
        left, right = (now[m:] - now[:-m]).T
        ways.append(np.stack((0.5 * (left + right), (right - left) / track))[:, inside])
    share = np.clip((t[m:][inside] - t[0]) / max(float(t[-1] - t[0]), 1e-9), 0.0, 1.0)
    seen, weight = seen[:, inside], np.ones((2, int(inside.sum())))
    design = [
        np.column_stack((ways[0][k], -ways[1][k] * (1.0 - share), -ways[1][k] * share, -ways[2][k])) for k in (0, 1)
    ]
    inverse, x = np.eye(5), np.zeros(5)
    for _ in range(3):
        a, b = np.zeros((5, 5)), np.zeros(5)
        for k in (0, 1):  # unknowns: two scales, the delay at begin and end, the slip
            place = [k, 2, 3, 4]
            weighted = design[k] * weight[k][:, None]
            a[np.ix_(place, place)] += weighted.T @ design[k]
            b[place] += weighted.T @ seen[k]
        size = np.sqrt(np.maximum(np.diag(a), 1e-12))
        inverse = np.linalg.pinv(a / np.outer(size, size), rcond=1e-10) / np.outer(size, size)
        x = inverse @ b
        left_over = np.stack([seen[k] - design[k] @ x[[k, 2, 3, 4]] for k in (0, 1)])
        sigma = np.maximum(np.median(np.abs(left_over), axis=1) / NORMAL_MEDIAN, 1e-9)[:, None]
        weight = TOLERATED / np.maximum(np.abs(left_over) / sigma, TOLERATED) / sigma**2
    covariance = inverse[2:4, 2:4] * m + 1e-12 * np.eye(2)  # steps that overlap repeat each other
    informed = np.diag(a)[2:4].min() > 0.0
    return (x[2:4], covariance) if informed else None
