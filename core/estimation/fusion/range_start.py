"""A start pose from ranges alone: the dead-reckoned stretch as a rigid body, fitted to its ranges from many poses.

Unknowns: x, y, theta of the stretch in the map, and the ranges' scale. Levenberg-Marquardt on every candidate together
(one batched array), Huber weights against readings through walls. The fit says whether another pose would do as well:
beacons on one line, or a straight drive, leave a mirrored one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.geometry import wrap_angle

Array = npt.NDArray[np.float64]

PLACES, HEADINGS = 7, 12  # candidates per axis of the beacons' box, and round the compass
FEW = 48  # readings of the coarse fit
COARSE, FINE = 12, 15  # steps
KEPT = 24  # candidates that are refined
APART_M, APART_RAD = 1.0, 0.35  # minima nearer than this are one
CLEARLY = 16.0  # by how much of a chi-square the best must win
HEADING_KNOWN = 0.1  # rad


@dataclass(frozen=True)
class RangeFit:
    """pose (3,), covariance (3, 3), whether no other pose explains the ranges nearly as well; misfit [m]: what
    four fifths of the ranges stay under."""

    pose: Array
    covariance: Array
    unique: bool
    misfit: float


def fit_ranges(local: Array, anchors: Array, ranges: Array, tag_z: float, sd: float, scale_sd: float) -> RangeFit:
    """Fit the pose of a stretch: tag positions local (N, 2) in its own frame, anchors (N, 3), ranges (N,) [m]."""
    some = np.unique(np.linspace(0, len(ranges) - 1, min(FEW, len(ranges))).astype(np.intp))
    q = _candidates(anchors, ranges)
    q, cost, _ = _refine(q, local[some], anchors[some], ranges[some], tag_z, sd, scale_sd, COARSE)
    q = q[np.argsort(cost)[:KEPT]]
    q, cost, _ = _refine(q, local, anchors, ranges, tag_z, sd, scale_sd, FINE)
    noise = max(sd, _residual_sd(q[np.argmin(cost)], local, anchors, ranges, tag_z))
    q, cost, normal = _refine(q, local, anchors, ranges, tag_z, noise, scale_sd, FINE)
    best = int(np.argmin(cost))
    off = np.hypot(*(q[:, :2] - q[best, :2]).T)
    other = (off > APART_M) | (np.abs(wrap_angle(q[:, 2] - q[best, 2])) > APART_RAD)
    rivals = other & (cost < cost[best] + CLEARLY)
    misfit = float(np.quantile(np.abs(ranges - _predict(q[best, None], local, anchors, tag_z)[0][0]), 0.8))
    P = np.linalg.inv(normal[best])[:3, :3]
    if rivals.any():
        spread = q[rivals, :3] - q[best, :3]
        spread[:, 2] = wrap_angle(spread[:, 2])
        P = P + spread.T @ spread / len(spread)
    return RangeFit(q[best, :3], P, bool(not rivals.any() and P[2, 2] <= HEADING_KNOWN**2), misfit)


def _candidates(anchors: Array, ranges: Array) -> Array:
    low, high = anchors[:, :2].min(axis=0), anchors[:, :2].max(axis=0)
    pad = max(0.25 * float(np.max(high - low)), 0.5 * float(np.median(ranges)))
    x, y = (np.linspace(low[i] - pad, high[i] + pad, PLACES) for i in range(2))
    theta = np.arange(HEADINGS) * (2 * np.pi / HEADINGS)
    grid = np.stack(np.meshgrid(x, y, theta, np.zeros(1), indexing="ij"), axis=-1)
    return grid.reshape(-1, 4)


def _predict(q: Array, local: Array, anchors: Array, tag_z: float) -> tuple[Array, Array]:
    """Ranges (C, N) expected by candidates q (C, 4), and their derivatives (C, N, 4)."""
    cos, sin = np.cos(q[:, 2])[:, None], np.sin(q[:, 2])[:, None]
    dx, dy = cos * local[:, 0] - sin * local[:, 1], sin * local[:, 0] + cos * local[:, 1]
    ex, ey = q[:, 0, None] + dx - anchors[:, 0], q[:, 1, None] + dy - anchors[:, 1]
    distance = np.maximum(np.sqrt(ex**2 + ey**2 + (tag_z - anchors[:, 2]) ** 2), 1e-6)
    scale = (1 + q[:, 3, None]) / distance
    J = np.stack((scale * ex, scale * ey, scale * (ey * dx - ex * dy), distance), axis=-1)
    return (1 + q[:, 3, None]) * distance, J


def _cost(q: Array, miss: Array, sd: float, scale_sd: float) -> Array:
    """Huber cost (C,), chi-square for small misses."""
    z = np.abs(miss) / sd
    return np.sum(np.where(z <= 2, z * z, 4 * z - 4), axis=1) + (q[:, 3] / scale_sd) ** 2


def _refine(
    q: Array, local: Array, anchors: Array, ranges: Array, tag_z: float, sd: float, scale_sd: float, steps: int
) -> tuple[Array, Array, Array]:
    """Levenberg-Marquardt on all candidates; their end, cost (C,) and normal matrices (C, 4, 4)."""
    damping = np.full(len(q), 1e-2)
    predicted, J = _predict(q, local, anchors, tag_z)
    miss = ranges - predicted
    cost = _cost(q, miss, sd, scale_sd)
    prior = np.diag((0.0, 0.0, 0.0, 1 / scale_sd**2))
    for _ in range(steps):
        normal, right = _normal(J, miss, sd, prior, q)
        damped = normal + damping[:, None, None] * (
            np.einsum("cii->ci", normal)[:, :, None] * np.eye(4) + 1e-9 * np.eye(4)
        )
        tried = q + np.linalg.solve(damped, right[..., None])[..., 0]
        new_predicted, new_J = _predict(tried, local, anchors, tag_z)
        new_miss = ranges - new_predicted
        new_cost = _cost(tried, new_miss, sd, scale_sd)
        better = new_cost < cost
        q, cost = np.where(better[:, None], tried, q), np.where(better, new_cost, cost)
        J, miss = np.where(better[:, None, None], new_J, J), np.where(better[:, None], new_miss, miss)
        damping = np.clip(np.where(better, damping / 5, damping * 5), 1e-9, 1e9)
    return q, cost, _normal(J, miss, sd, prior, q)[0] + 1e-9 * np.eye(4)


def _normal(J: Array, miss: Array, sd: float, prior: Array, q: Array) -> tuple[Array, Array]:
    w = np.minimum(1.0, 2 * sd / np.maximum(np.abs(miss), 1e-12)) / sd**2
    weighted = J * w[..., None]
    normal = np.swapaxes(weighted, 1, 2) @ J + prior
    return normal, np.einsum("cni,cn->ci", weighted, miss) - q @ prior


def _residual_sd(q: Array, local: Array, anchors: Array, ranges: Array, tag_z: float) -> float:
    predicted, _ = _predict(q[None, :], local, anchors, tag_z)
    return 1.4826 * float(np.median(np.abs(ranges - predicted[0])))
