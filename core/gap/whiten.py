"""Residuals and columns of Jacobian in units of their noise, uncorrelated: one rule per kind of channel.

Wheels: the mean of each window is taken out (an angle's offset says nothing). IMU: divided by its noise. Poses (truth,
fixes, ranges): innovations of one filter over all of them, in which the pose may stray from the model a little.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.gap._pose_numba import SIDE, whiten_offset, whiten_poses
from core.gap.floor import Floor, wrap
from core.gap.reference import WINDOW
from core.gap.world import POSES, WHEELS, World
from core.simulation._batch_numba import Outputs

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

START_SD = np.array([0.005, 0.005, 0.005])
FREE_SD = np.array([1e3, 1e3, 10.0])
"""How well the start pose is known, where run.json gives one; where it does not [m, m, rad]."""
TIMING = 5e-4
"""Instants are known to half the tolerance of the IMU's clock [s]: edges of jumps count for no more than that."""
STILL = (0.0, 1.0)
OUTLIER = 5.0
"""A fix or range off by more than this many sigma is left out of the pose's filter."""


@dataclass(frozen=True)
class Events:
    """Pose readings of a run in order of time, with restarts between them, and how each sees the pose's error.

    order: index of each event into the concatenation of the channels' readings (restarts last). pose, rows, variance,
    restart, start: as `whiten_poses` takes them.
    """

    names: tuple[str, ...]
    sizes: tuple[int, ...]
    order: Indices
    pose: Array
    rows: Array
    variance: Array
    restart: npt.NDArray[np.bool_]
    start: Array


def residuals_of(world: World, wheels: Mapping[str, Array], body: Outputs) -> dict[str, Array]:
    """Recorded minus predicted (row 0), per channel."""
    out: dict[str, Array] = {}
    for name in world.channels:
        predicted = wheels[name][0, world.keep(name)] if name in WHEELS else world.channel(body, name)[0]
        far = world.readings[name] - predicted
        out[name] = wrap(far) if name.endswith("theta") else far
    return out


def windows_of(t: Array, window: float = WINDOW) -> Indices:
    """First index of each window of readings."""
    return np.flatnonzero(np.diff(np.floor(t / window), prepend=-1.0)).astype(np.int64)


def white_wheels(world: World, name: str, values: Array, floor: Floor) -> Array:
    """(M, N) residual and columns of one encoder."""
    t = world.times[name]
    first = windows_of(t)
    count = np.diff(np.append(first, len(t)))
    mean = np.add.reduceat(values, first, axis=1) / count
    return (values - np.repeat(mean, count, axis=1)) / floor.sigma[name]


def imu_sigma(world: World, name: str, body: Outputs, floor: Floor) -> Array:
    """(N,) noise of one IMU axis: white, vibration, and what an error of TIMING does where the signal jumps."""
    predicted = world.channel(body, name)[0]
    step = np.maximum(np.diff(world.times[name]), 1e-6)
    jump = np.abs(np.diff(predicted)) / step
    slope = np.maximum(np.append(jump, 0.0), np.append(0.0, jump))
    variance = floor.sigma[name] ** 2 + (TIMING * slope) ** 2
    if name != "imu.gz" and floor.vibration:
        variance = variance + (floor.vibration * body.speed[0, world.keep(name)]) ** 2
    sigma: Array = np.sqrt(variance)
    return sigma


def white_imu(world: World, name: str, values: Array, sigma: Array, floor: Floor) -> Array:
    """(M, N) residual and columns of one IMU axis; sigma (N,): its noise."""
    walk = floor.gyro_walk if name == "imu.gz" else 0.0
    sway, pace = floor.sway.get(name, STILL) if world.rough else STILL
    if walk > 0.0 or sway > 0.0:
        rows = np.array(values)
        whiten_offset(world.times[name], sigma, walk, sway, pace, rows)
        return rows
    return values / sigma


def events_of(world: World, body: Outputs, floor: Floor, residuals: Mapping[str, Array]) -> Events | None:
    """All pose readings along the predicted path (row 0 of `body`). None where the run has none."""
    names = tuple(name for name in POSES if name in world.readings)
    if not names:
        return None
    path = np.column_stack((body.x[0], body.y[0], body.theta[0]))
    index, order = np.concatenate([world.at[name] for name in names] + [world.ends]), world.order
    rows = np.concatenate([_rows(world, name, path[world.at[name]]) for name in names] + [world.restarts[:, 1:]])
    variance = np.concatenate(
        [_variance(name, residuals[name], floor) for name in names] + [np.full(len(world.ends), np.inf)]
    )
    sd = FREE_SD if world.run.meta.start is None or world.run.truth is not None else START_SD
    return Events(
        names=names,
        sizes=tuple(len(world.at[name]) for name in names),
        order=order,
        pose=np.ascontiguousarray(path[index][order]),
        rows=np.ascontiguousarray(rows[order]),
        variance=variance[order],
        restart=order >= len(index) - len(world.ends),
        start=np.diag(sd**2),
    )


def _variance(name: str, residual: Array, floor: Floor) -> Array:
    sigma = floor.sigma[name]
    variance = np.full(len(residual), sigma**2)
    if not name.startswith("truth"):
        middle = np.abs(residual - np.median(residual))
        scale = max(sigma, float(np.median(middle)) / 0.6745)
        variance[middle > OUTLIER * scale] = np.inf
    return variance


def _rows(world: World, name: str, pose: Array) -> Array:
    """(N, 3) derivative of a reading by the pose's error."""
    n = len(pose)
    c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    tag = world.run.meta.robot.tag
    tx, ty = c * tag.x - s * tag.y, s * tag.x + c * tag.y
    zero, one = np.zeros(n), np.ones(n)
    if name.endswith("theta"):
        return np.column_stack((zero, zero, one))
    if name == "ranges.range":
        place = world.body_inputs.anchors[world.body_inputs.anchor[world.keep(name)]]
        dx, dy, dz = pose[:, 0] + tx - place[:, 0], pose[:, 1] + ty - place[:, 1], tag.z - place[:, 2]
        far = np.maximum(np.sqrt(dx * dx + dy * dy + dz * dz), 1e-9)
        return np.column_stack((dx / far, dy / far, (dy * tx - dx * ty) / far))
    swing = zero if name.startswith("truth") else (-ty if name.endswith("x") else tx)
    return np.column_stack((one, zero, swing)) if name.endswith("x") else np.column_stack((zero, one, swing))


def jumps_of(world: World, body: Outputs) -> Array:
    """(K, 3) by how much the old stretch's end differs from the new stretch's start, at each restart, row 0."""
    return all_jumps(world, body)[0]


def all_jumps(world: World, body: Outputs) -> Array:
    """(B, K, 3) the same of every row."""
    ends = np.stack([column[:, world.ends] for column in (body.x, body.y, body.theta)], axis=-1)
    far: Array = ends - world.restarts[:, 1:]
    far[..., 2] = wrap(far[..., 2])
    return far


def white_poses(
    events: Events, values: Mapping[str, Array], jumps: Array, walk: float, side: float
) -> tuple[dict[str, Array], float]:
    """values: (M, N) residual and columns per channel; jumps (M, K, 3). (White values, sum of log variances).

    walk, side: as `Floor` has them.
    """
    sides = len(jumps)
    stacked = np.concatenate(
        [values[name] for name in events.names] + [np.zeros((sides, int(events.restart.sum())))], axis=1
    )
    readings = np.ascontiguousarray(stacked.T)[events.order]
    logs = whiten_poses(
        events.pose,
        events.rows,
        events.variance,
        events.restart,
        np.ascontiguousarray(jumps.transpose(1, 2, 0)),
        events.start,
        walk,
        side,
        readings,
    )
    back = np.empty_like(stacked)
    back[:, events.order] = readings.T
    cut = np.cumsum((0, *events.sizes))
    white = {name: back[:, a:b] for name, a, b in zip(events.names, cut[:-1], cut[1:], strict=True)}
    return white, float(logs.sum())


WALKS = (1e-5, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2)
FINER = (0.5, 0.7, 1.0, 1.4)
SIDES = (0.1, 0.2, SIDE, 0.5)
"""Walks of the heading that are tried, then these shares of the best, and walks of the position per walk of the
heading."""


def best_walk(events: Sequence[tuple[Events, Mapping[str, Array], Array]]) -> tuple[float, float]:
    """The walk and side that make the residuals of all runs likeliest: (events, residuals (N,) per channel, jumps)."""

    def cost(walk: float, side: float) -> float:
        out = 0.0
        for one, residuals, jumps in events:
            rows = {name: residuals[name][None, :] for name in one.names}
            white, logs = white_poses(one, rows, jumps[None], walk, side)
            out += logs + sum(float(np.sum(np.minimum(value**2, 25.0))) for value in white.values())
        return out

    walk = min(WALKS, key=lambda one: cost(one, SIDE))
    if walk == WALKS[0]:
        return walk, SIDE
    return min(((walk * share, side) for share in FINER for side in SIDES), key=lambda pair: cost(*pair))
