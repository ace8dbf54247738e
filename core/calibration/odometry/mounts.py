"""Where the IMU sits and how it is turned, from its accelerometers against the motion that wheels and gyro tell.

In the body's axes the IMU at (x, y) feels  a_x = v' - w^2 x - w' y,  a_y = v w + w' x - w^2 y,  and reads them turned
by its yaw, plus an offset. Both sides are averaged over the same short spans, so that encoder steps do not matter.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from core.calibration.odometry.chain import Chain
from core.calibration.odometry.model import GYRO, IMU_CLOCK, TABLE
from core.estimation.cleaning import filled, gyro_readings
from core.estimation.result import Value

Array = npt.NDArray[np.float64]

SPAN, HALF = 0.4, 0.05  # s: one average, and either side of its ends
NAMES = ("imu_yaw", "imu_x", "imu_y")
WIDTH = {p.name: p.width for p in TABLE}
ADVICE = {p.name: p.advice for p in TABLE}
SHOWN = 0.3
ROUNDS = 8


def imu_mount(chains: Sequence[Chain], shared: Array) -> tuple[dict[str, Value | None], dict[str, str]]:
    """imu_yaw [rad], imu_x, imu_y [m] or None, and the reasons."""
    parts = [_averages(c, shared) for c in chains if c.run.imu is not None and _accelerometers(c)]
    if not parts:
        return dict.fromkeys(NAMES), dict.fromkeys(NAMES, "no run has an imu with ax and ay")
    read = np.concatenate([read for read, _ in parts])
    terms = np.concatenate([terms for _, terms in parts])
    run_of = np.concatenate([np.full(len(read), i) for i, (read, _) in enumerate(parts)])
    p, covariance = _fit(read, terms, run_of, len(parts))
    sd = np.sqrt(np.diag(covariance)[:3])
    values: dict[str, Value | None] = {}
    reasons = {}
    for i, name in enumerate(NAMES):
        if sd[i] < SHOWN * WIDTH[name]:
            values[name] = Value(float(p[i]), float(sd[i]), "rad" if i == 0 else "m")
        else:
            values[name] = None
            reasons[name] = f"the runs leave an sd of {sd[i]:.2g}, plausible is {WIDTH[name]:.2g}: {ADVICE[name]}"
    return values, reasons


def _accelerometers(chain: Chain) -> bool:
    imu = chain.run.imu
    return imu is not None and imu.ax is not None and imu.ay is not None


def _averages(chain: Chain, shared: Array) -> tuple[Array, Array]:
    """Averages (M, 2) of what was read, and (M, 4) of v', v w, w^2, w' over SPANs."""
    imu, wheels = chain.run.imu, chain.run.wheels
    assert imu is not None and imu.ax is not None and imu.ay is not None and wheels is not None
    raw, gz = gyro_readings(imu)
    t = raw - shared[IMU_CLOCK]
    bias = np.interp(t, chain.nodes(), shared[chain.columns])
    w = (gz - bias) / (1 + shared[GYRO])
    pose, _ = chain.path(shared, wheels.t)
    step = np.diff(pose, axis=0)
    forward = step[:, 0] * np.cos(pose[:-1, 2]) + step[:, 1] * np.sin(pose[:-1, 2])
    travelled = np.concatenate(([0.0], np.cumsum(forward)))
    begin, end = max(t[0], wheels.t[0]) + HALF, min(t[-1], wheels.t[-1]) - HALF
    edges = np.arange(begin, end, SPAN)
    if len(edges) < 3:
        return np.zeros((0, 2)), np.zeros((0, 4))

    def mean_rate(stamps: Array, total: Array) -> Array:
        """Mean of a rate around each edge, from its running integral."""
        return (np.interp(edges + HALF, stamps, total) - np.interp(edges - HALF, stamps, total)) / (2 * HALF)

    def integral(values: Array) -> Array:
        return np.concatenate(([0.0], np.cumsum((values[1:] + values[:-1]) / 2 * np.diff(t))))

    def average(values: Array) -> Array:
        """Over each span, ends blurred by HALF as the speeds' are."""
        return np.diff(mean_rate(t, integral(integral(values)))) / SPAN

    speed = np.interp(t, edges, mean_rate(wheels.t, travelled))
    read = np.column_stack([average(filled(raw, c, "imu")) for c in (imu.ax, imu.ay)])
    terms = np.column_stack(
        (
            np.diff(mean_rate(wheels.t, travelled)) / SPAN,
            average(speed * w),
            average(w**2),
            np.diff(mean_rate(t, integral(w))) / SPAN,
        )
    )
    return read, terms


def _fit(read: Array, terms: Array, run_of: npt.NDArray[np.intp], runs: int) -> tuple[Array, Array]:
    """Robust least squares for yaw, x, y and two offsets a run; covariance from the residuals' own scatter."""
    p = np.zeros(3 + 2 * runs)
    weight = np.ones(len(read))
    covariance = np.full((len(p), len(p)), np.inf)
    if len(read) < len(p) + 5:
        return p, covariance
    dv, vw, w2, dw = terms.T
    for _ in range(ROUNDS):
        yaw, x, y = p[:3]
        cos, sin = np.cos(yaw), np.sin(yaw)
        bx, by = dv - w2 * x - dw * y, vw + dw * x - w2 * y
        offset = p[3:].reshape(runs, 2)[run_of]
        e = np.column_stack((cos * bx + sin * by, -sin * bx + cos * by)) + offset - read
        J = np.zeros((len(read), 2, len(p)))
        J[:, 0, 0], J[:, 1, 0] = -sin * bx + cos * by, -cos * bx - sin * by
        J[:, 0, 1], J[:, 1, 1] = -cos * w2 + sin * dw, sin * w2 + cos * dw
        J[:, 0, 2], J[:, 1, 2] = -cos * dw - sin * w2, sin * dw - cos * w2
        for axis in (0, 1):
            J[np.arange(len(read)), axis, 3 + 2 * run_of + axis] = 1.0
        sd = np.maximum(1.4826 * np.median(np.abs(e - np.median(e, axis=0)), axis=0), 1e-6)
        weight = np.minimum(1.0, (3.0 / np.maximum(np.sqrt(np.sum((e / sd) ** 2, axis=1)), 1e-9)) ** 2)
        W = weight[:, None] / sd**2
        H = np.einsum("mia,mi,mib->ab", J, W, J, optimize=True) + 1e-9 * np.eye(len(p))
        p = p - np.linalg.solve(H, np.einsum("mia,mi,mi->a", J, W, e, optimize=True))
        covariance = np.linalg.inv(H)
    return p, covariance * _memory(e / sd, weight)


def _memory(e: Array, weight: Array) -> float:
    """By how much residuals that follow each other agree makes a mean's variance larger."""
    kept = e * np.sqrt(weight)[:, None]
    rho = float(np.sum(kept[1:] * kept[:-1]) / max(float(np.sum(kept**2)), 1e-12))
    rho = min(max(rho, 0.0), 0.9)
    return max(1.0, float(np.mean(kept**2)) / max(float(np.mean(weight)), 1e-9)) * (1 + rho) / (1 - rho)
