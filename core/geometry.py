"""SE(2), the group of planar poses, on arrays of any leading shape.

A pose is (..., 3): x [m], y [m], theta [rad]; a twist is (..., 3): forward [m], sideways [m], turn [rad], what a body
moving with constant velocity does in its own frame. Headings are kept unwrapped: `compose` adds turns and never folds
them, so that a path of many laps stays continuous. Wrap only differences. Source: Solà, Deray, Atchuthan, "A micro Lie
theory for state estimation in robotics", 2018.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

_SMALL = 1e-4  # rad: below it the series are exact to rounding


def wrap_angle(angle: npt.ArrayLike) -> Array:
    """The same angle in (-pi, pi] [rad]."""
    folded = np.remainder(np.asarray(angle, np.float64), 2 * np.pi)
    return np.where(folded > np.pi, folded - 2 * np.pi, folded)


def compose(a_T_b: Array, b_T_c: Array) -> Array:
    """Pose of c in a (..., 3), from the pose of b in a and of c in b; theta is the plain sum."""
    cos, sin = np.cos(a_T_b[..., 2]), np.sin(a_T_b[..., 2])
    x, y = b_T_c[..., 0], b_T_c[..., 1]
    return np.stack(
        (a_T_b[..., 0] + cos * x - sin * y, a_T_b[..., 1] + sin * x + cos * y, a_T_b[..., 2] + b_T_c[..., 2]), axis=-1
    )


def inverse(a_T_b: Array) -> Array:
    """Pose of a in b (..., 3)."""
    cos, sin = np.cos(a_T_b[..., 2]), np.sin(a_T_b[..., 2])
    x, y = a_T_b[..., 0], a_T_b[..., 1]
    return np.stack((-cos * x - sin * y, sin * x - cos * y, -a_T_b[..., 2]), axis=-1)


def between(a: Array, b: Array) -> Array:
    """Pose of b seen from a (..., 3): `compose(a, between(a, b)) == b`."""
    return compose(inverse(a), b)


def _arc_factors(turn: Array) -> tuple[Array, Array]:
    """sin(w)/w and (1 - cos(w))/w, finite at zero."""
    small = np.abs(turn) < _SMALL
    w = np.where(small, 1.0, turn)
    return (
        np.where(small, 1 - turn**2 / 6, np.sin(w) / w),
        np.where(small, turn / 2 - turn**3 / 24, 2 * np.sin(w / 2) ** 2 / w),
    )


def exp(twist: Array) -> Array:
    """Pose reached by one unit of a constant twist (..., 3): an exact circular arc."""
    a, b = _arc_factors(twist[..., 2])
    u, v = twist[..., 0], twist[..., 1]
    return np.stack((a * u - b * v, b * u + a * v, twist[..., 2]), axis=-1)


def log(pose: Array) -> Array:
    """The twist (..., 3) whose `exp` is the pose, by the shorter way round: its turn lies in (-pi, pi]."""
    turn = wrap_angle(pose[..., 2])
    a, b = _arc_factors(turn)
    scale = 1.0 / (a**2 + b**2)
    x, y = pose[..., 0], pose[..., 1]
    return np.stack((scale * (a * x + b * y), scale * (a * y - b * x), turn), axis=-1)


def adjoint(pose: Array) -> Array:
    """(..., 3, 3) matrix that carries a twist from the pose's frame to its parent: pose exp(t) = exp(Ad t) pose."""
    cos, sin = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    zero, one = np.zeros_like(cos), np.ones_like(cos)
    rows = ((cos, -sin, pose[..., 1]), (sin, cos, -pose[..., 0]), (zero, zero, one))
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def rotation(theta: Array) -> Array:
    """(..., 3, 3) matrix that turns (x, y, theta) vectors of the body into the map's axes."""
    cos, sin = np.cos(theta), np.sin(theta)
    zero, one = np.zeros_like(cos), np.ones_like(cos)
    rows = ((cos, -sin, zero), (sin, cos, zero), (zero, zero, one))
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def to_map(covariance_b: Array, theta: Array) -> Array:
    """(..., 3, 3) covariance in the map's axes of one stated in the body's."""
    R = rotation(np.asarray(theta, np.float64))
    return R @ covariance_b @ np.swapaxes(R, -1, -2)


def to_body(covariance: Array, theta: Array) -> Array:
    """(..., 3, 3) covariance in the body's axes (along, across, heading) of one stated in the map's."""
    return to_map(covariance, -np.asarray(theta, np.float64))


def compose_covariance(a_T_b: Array, cov_a: Array, b_T_c: Array, cov_b: Array) -> Array:
    """(..., 3, 3) first-order covariance of `compose(a_T_b, b_T_c)` where the two errors are independent.

    Errors are additive in (x, y, theta), each in its own parent's axes: J_a cov_a J_a' + R cov_b R'.
    """
    step = compose(a_T_b, b_T_c)
    J = np.broadcast_to(np.eye(3), (*step.shape[:-1], 3, 3)).copy()
    J[..., 0, 2] = -(step[..., 1] - a_T_b[..., 1])
    J[..., 1, 2] = step[..., 0] - a_T_b[..., 0]
    return J @ cov_a @ np.swapaxes(J, -1, -2) + to_map(cov_b, a_T_b[..., 2])
