"""Compiled steps of `encoders` and of `beacon` by fixes, row by row. Plain arrays in and out.

The same as `estimation.odometry.encoders` and `estimation.beacon` in closed form over the whole run, to rounding.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

STATE = 21  # pose (3), covariance (9), distance and turn so far, origin (3), swings by inequality and track (4)
POSE, COVARIANCE, D, TURN, ORIGIN, SWINGS = 0, 3, 12, 13, 14, 17
LIMITS = 6
TRACK, SLIP, QUANTUM, DISTANCE_SCALE, INEQUALITY, TRACK_SCALE = range(LIMITS)


@njit(cache=True, error_model="numpy")
def roll(d: Any, turn: Any, state: Any, limits: Any, pose: Any, covariance: Any) -> None:
    """Fill pose (N, 3) and covariance (N, 3, 3) at rows of the wheels' cumulative distance and turn (N,).

    Each step is an arc. An error in its turn swings all that follows about the step's middle; errors of scale,
    inequality and track width are the same all along, and so counted from the origin.
    """
    P, track = state[COVARIANCE:D].reshape(3, 3), limits[TRACK]
    swings = state[SWINGS:STATE].reshape(2, 2)
    F, arm, along = np.eye(3), np.zeros(3), np.zeros(3)
    ox, oy, oth = state[ORIGIN], state[ORIGIN + 1], state[ORIGIN + 2]
    for k in range(d.shape[0]):
        x, y, theta = state[0], state[1], state[2]
        step, turned = d[k] - state[D], turn[k] - state[TURN]
        half = turned / 2
        chord = step * (math.sin(half) / half if half != 0.0 else 1.0)
        cos, sin = math.cos(theta + half), math.sin(theta + half)
        dx, dy = chord * cos, chord * sin
        F[0, 2], F[1, 2] = -dy, dx
        P[:, :] = F @ P @ F.T
        rolled = limits[SLIP] ** 2 * (abs(step) + track / 2 * abs(turned))
        arm[0], arm[1], arm[2] = -dy / 2, dx / 2, 1.0
        along[0], along[1] = cos, sin
        by = (state[D] / track, theta - oth)
        state[0], state[1], state[2] = x + dx, y + dy, theta + turned
        state[D], state[TURN] = d[k], turn[k]
        now = (d[k] / track, state[2] - oth)
        for m in range(2):
            middle = (by[m] + now[m]) / 2
            swings[m, 0] -= middle * dy
            swings[m, 1] += middle * dx
        for i in range(3):
            pose[k, i] = state[i]
            for j in range(3):
                P[i, j] += 2 * rolled / track**2 * arm[i] * arm[j] + rolled / 2 * along[i] * along[j]
        quantum = limits[QUANTUM] ** 2
        cos, sin = math.cos(state[2]), math.sin(state[2])
        scale = (state[0] - ox, state[1] - oy, 0.0)
        ahead = (cos, sin, 0.0)
        for i in range(3):
            for j in range(3):
                value = P[i, j] + quantum / 24 * ahead[i] * ahead[j]
                value += limits[DISTANCE_SCALE] ** 2 * scale[i] * scale[j]
                for m in range(2):
                    sd = limits[INEQUALITY] if m == 0 else limits[TRACK_SCALE]
                    a = swings[m, i] if i < 2 else now[m]
                    b = swings[m, j] if j < 2 else now[m]
                    value += sd**2 * a * b
                covariance[k, i, j] = value
        covariance[k, 2, 2] += quantum / 6 / track**2


@njit(cache=True, error_model="numpy")
def fix(
    fixes: Any, tag_x: float, tag_y: float, sd_xy: float, sd_theta: float, last: Any, pose: Any, covariance: Any
) -> None:
    """Fill pose (N, 3) of the body and covariance from fixes (N, 6) of its tag: t, x, y, theta or NaN first. last (1,):
    heading that is gone on from, unwrapped."""
    off = (tag_x**2 + tag_y**2) / 2
    for k in range(fixes.shape[0]):
        theta, known = fixes[k, 3], not math.isnan(fixes[k, 3])
        arm_x, arm_y, swing = 0.0, 0.0, 0.0
        if known:
            theta -= 2 * math.pi * np.round((theta - last[0]) / (2 * math.pi))
            last[0] = theta
            cos, sin = math.cos(theta), math.sin(theta)
            arm_x, arm_y, swing = cos * tag_x - sin * tag_y, sin * tag_x + cos * tag_y, sd_theta**2
        pose[k, 0], pose[k, 1], pose[k, 2] = fixes[k, 1] - arm_x, fixes[k, 2] - arm_y, theta
        more = 0.0 if known else off
        covariance[k, 0, 0] = sd_xy**2 + arm_y**2 * swing + more
        covariance[k, 1, 1] = sd_xy**2 + arm_x**2 * swing + more
        covariance[k, 0, 1] = covariance[k, 1, 0] = -arm_x * arm_y * swing
        covariance[k, 0, 2] = covariance[k, 2, 0] = arm_y * swing
        covariance[k, 1, 2] = covariance[k, 2, 1] = -arm_x * swing
        covariance[k, 2, 2] = swing if known else math.nan
