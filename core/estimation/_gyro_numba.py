"""Compiled walk of `encoders+gyro`: pose, gyro bias and their covariance, sample by sample. Plain arrays in and out."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

N = 5  # x, y, theta, bias, gyro scale (its error is carried, never corrected)


@njit(cache=True, nogil=True)
def walk(
    dt: Any, turn: Any, distance: Any, gz: Any, still: Any, q_turn: Any, q_distance: Any, q_bias: float, r_gyro: float,
    gate: float, patience: int, refused: Any, x: Any, P: Any, pose: Any, covariance: Any, bias: Any, bias_var: Any,
) -> None:  # fmt: skip
    """Fill pose (N, 3), covariance (N, 3, 3), bias and bias_var (N,); step k leads from row k - 1 to row k.

    turn, distance (N,): gyro's raw turn and wheels' distance of the step; q_*: their variances. refused (1,), x (5,),
    P (5, 5): where it begins, and where it was left.
    """
    for k in range(dt.shape[0]):
        if k > 0:
            P[3, 3] += q_bias * dt[k]
            resting = False
            if still[k]:
                nu = gz[k] - x[3]
                S = P[3, 3] + r_gyro
                refused[0] = refused[0] + 1 if nu * nu > gate * S else 0
                resting = refused[0] == 0 or refused[0] > patience
                if resting:
                    for i in range(N):
                        x[i] += P[i, 3] / S * nu
                    for i in range(N):
                        if i != 3:
                            for j in range(N):
                                if j != 3:
                                    P[i, j] -= P[i, 3] * P[3, j] / S
                    for i in range(N):
                        if i != 3:
                            P[i, 3] *= r_gyro / S
                            P[3, i] = P[i, 3]
                    P[3, 3] *= r_gyro / S
            if not resting:
                _step(x, P, turn[k], dt[k], distance[k])
                P[2, 2] += q_turn[k]
                c, s = np.cos(x[2]), np.sin(x[2])
                P[0, 0] += c * c * q_distance[k]
                P[0, 1] += c * s * q_distance[k]
                P[1, 0] = P[0, 1]
                P[1, 1] += s * s * q_distance[k]
        for i in range(3):
            pose[k, i] = x[i]
            for j in range(3):
                covariance[k, i, j] = P[i, j]
        bias[k] = x[3]
        bias_var[k] = P[3, 3]


@njit(cache=True, nogil=True, inline="always")
def _step(x: Any, P: Any, turn: float, dt: float, d: float) -> None:
    """Exact arc of length d and turn (turn - bias dt)(1 - scale), and F P F' row by row."""
    w = (turn - x[3] * dt) * (1.0 - x[4])
    half = 0.5 * w
    chord = d * (np.sin(half) / half if abs(half) > 1e-6 else 1.0)
    dx, dy = chord * np.cos(x[2] + half), chord * np.sin(x[2] + half)
    x[0] += dx
    x[1] += dy
    x[2] += w
    for j in range(N):
        change = -dt * P[3, j] - turn * P[4, j]
        P[0, j] -= dy * (P[2, j] + 0.5 * change)
        P[1, j] += dx * (P[2, j] + 0.5 * change)
        P[2, j] += change
    for i in range(N):
        change = -dt * P[i, 3] - turn * P[i, 4]
        P[i, 0] -= dy * (P[i, 2] + 0.5 * change)
        P[i, 1] += dx * (P[i, 2] + 0.5 * change)
        P[i, 2] += change
