"""A map of fixes that is mirrored: they turn the other way round than wheels and gyro do.

Which axis is at fault the start pose tells, if it is known: laid there, the dead-reckoned path fits the fixes with one
of them turned. Where nobody knows the start, any does: y is taken.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import numpy.typing as npt

from core.estimation.assumptions import Assumptions
from core.estimation.fusion.events import FARTHEST
from core.estimation.fusion.start import fit_rigid
from core.estimation.sanity.units import ENOUGH, Mended, leading
from core.robot import Pose
from core.run import Run

Array = npt.NDArray[np.float64]

MOVED = 1.0  # m that the robot must have driven
CLEARLY = 5.0  # by how much the right assumption must fit better
FAR = 0.3  # m of misfit that is no noise
MIRRORS: dict[str, tuple[Array, float]] = {  # its matrix, and what its headings are subtracted from
    "the sign of its y is changed": (np.diag((1.0, -1.0)), 0.0),
    "the sign of its x is changed": (np.diag((-1.0, 1.0)), math.pi),
    "its x and y are exchanged": (np.array(((0.0, 1.0), (1.0, 0.0))), math.pi / 2),
}
FIRST = next(iter(MIRRORS))
NOTE = "The fixes' map is mirrored: they turn the other way round than wheels and gyro"


def mirrored(run: Run, numbers: Assumptions) -> Mended:
    """Fixes against the dead-reckoned path."""
    fixes = run.beacon
    stretch = leading(run, fixes.t) if fixes is not None else None
    if fixes is None or stretch is None:
        return run, ()
    at, rows = stretch
    xy = np.column_stack((fixes.x, fixes.y)).astype(np.float64)[rows]
    good = (np.abs(xy) <= FARTHEST).all(axis=1)
    if good.sum() < ENOUGH or np.ptp(at[good, :2], axis=0).max() < MOVED:
        return run, ()
    local, seen = at[good, :2], xy[good]
    plain, turned = (_misfit(local * np.array((1.0, sign)), seen, numbers.fix_xy) for sign in (1.0, -1.0))
    if plain < CLEARLY * max(turned, numbers.fix_xy) or plain < FAR:
        return run, ()
    if not two_witnesses(run):
        note = f"{NOTE}, or these are mistaken. The fixes are left out; check the sign of y in the beacon system."
        return dataclasses.replace(run, beacon=None), (note,)
    words, why = FIRST, "; nobody tells the axis, so the map may be turned"
    if run.meta.start is not None:
        left = {name: from_start(local, seen @ matrix.T, run.meta.start) for name, (matrix, _) in MIRRORS.items()}
        best = min(left, key=lambda name: left[name])
        if left[best] < max(FAR, 3 * numbers.fix_xy):
            words, why = best, ""
    return _turned(run, words, at[:, 2], rows), (f"{NOTE}. Put right: {words}{why}.",)


def two_witnesses(run: Run) -> bool:
    """Whether wheels and gyro both tell turns; one alone may be exchanged, or upside down, as well."""
    return run.imu is not None and run.meta.robot.track_width is not None


def from_start(local: Array, xy: Array, start: Pose) -> float:
    """Median distance [m] between fixes (N, 2) and the path (N, 2) laid at the start pose."""
    cos, sin = math.cos(start.theta), math.sin(start.theta)
    x, y = start.x + cos * local[:, 0] - sin * local[:, 1], start.y + sin * local[:, 0] + cos * local[:, 1]
    return float(np.median(np.hypot(x - xy[:, 0], y - xy[:, 1])))


def _misfit(local: Array, xy: Array, sd: float) -> float:
    """The same with the path laid over them as well as it can be."""
    pose, _ = fit_rigid(local, xy, sd)
    return from_start(local, xy, Pose(*pose))


def _turned(run: Run, words: str, reckoned: Array, rows: npt.NDArray[np.intp]) -> Run:
    """The run with its fixes mirrored, headings too unless these already turn as wheels and gyro do."""
    matrix, whole = MIRRORS[words]
    assert run.beacon is not None
    xy = np.column_stack((run.beacon.x, run.beacon.y)).astype(np.float64) @ matrix.T
    log = dataclasses.replace(run.beacon, x=xy[:, 0].copy(), y=xy[:, 1].copy())
    if log.theta is not None:
        theta = np.asarray(log.theta, np.float64)
        known = np.isfinite(theta[rows])

        def alike(angles: Array) -> float:
            apart = angles[rows][known] - reckoned[known]
            return float(np.abs(np.mean(np.exp(1j * apart)))) if apart.size else 0.0

        if alike(whole - theta) > alike(theta):
            log = dataclasses.replace(log, theta=whole - theta)
    return dataclasses.replace(run, beacon=log)
