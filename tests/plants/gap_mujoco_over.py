"""What is laid over the motion that MuJoCo gives: slip by law, a bump, causes of no list; what an IMU feels of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter, lsim

from core.robot import Pose, RobotParams
from tests.plants.gap_ordinary import Floats
from tests.plants.gap_plant import Plan, get, through_patch

G = 9.80665
H = 0.002  # s, of the physics
QUIET = 0.02  # s, over which contact's jitter is taken out before a law of slip differentiates it
MAGNET = (2.2, 2.3, 0.5)  # x, y, width [m]


@dataclass(frozen=True)
class Motion:
    """Per physics step (n,): t; pose (n, 3); wheels' angles; the IMU's gz, ax, ay as the physics has them."""

    t: Floats
    pose: Floats
    left: Floats
    right: Floats
    gz: Floats
    ax: Floats
    ay: Floats

    @staticmethod
    def of(record: Floats) -> Motion:
        """From MuJoCo's sensors, means of two steps, each as of its beginning."""
        theta = np.unwrap(np.arctan2(record[:, 10], record[:, 9]))
        left, right = (record[:, k] - record[0, k] for k in (12, 13))
        pose = np.column_stack((record[:, 6], record[:, 7], theta))
        return Motion((np.arange(len(record)) + 0.25) * H, pose, left, right, record[:, 2], record[:, 3], record[:, 4])


def calm(values: Floats, tau: float = QUIET) -> Floats:
    """The mean over a short while about each instant."""
    n = 2 * round(tau / H) + 1
    return np.convolve(np.pad(values, n // 2, mode="edge"), np.ones(n) / n, mode="valid")


def lagged(values: Floats, tau: float) -> Floats:
    """Through a lag."""
    share = H / (tau + H)
    out: Floats = lfilter([share], [1.0, share - 1.0], values)
    return out


def laid_over(plan: Plan, params: RobotParams, body: Motion) -> Motion:
    """The motion with what the plan asks for beyond physics."""
    e, out = plan.effects, plan.outside
    laws = ("side_slip", "wheel_slip", "bump", "slip_patch")
    if not any(name in e for name in laws) and not any(name in out for name in ("tyre_yields", "grain", "pull")):
        return body
    theta = body.pose[:, 2]
    dx, dy, w = (np.gradient(column, H) for column in body.pose.T)
    v, side = np.cos(theta) * dx + np.sin(theta) * dy, np.cos(theta) * dy - np.sin(theta) * dx
    v1, w1, side1 = v + 0.0, w + 0.0, side + 0.0
    radius, track = float(params.wheel_radius or 0), float(params.track_width or 1)
    if "wheel_slip" in e:
        k, lost = get(e, "wheel_slip", "k", 0.0), []
        for angle in (body.left, body.right):
            rim = calm(np.gradient(angle, H) * radius)
            lost.append(np.clip(k * np.gradient(rim, H) * np.sign(rim), -1.0, 1.0) * rim)
        v1, w1 = v1 - 0.5 * (lost[0] + lost[1]), w1 - (lost[1] - lost[0]) / track
    if "side_slip" in e:
        side1 = side1 - get(e, "side_slip", "k", 0.0) * calm(v) * calm(w)
    if "bump" in e:
        s = body.t - get(e, "bump", "time", 0.0)
        push = np.where((s > 0.0) & (s < 0.3), (1.0 - np.cos(2.0 * np.pi * s / 0.3)) / 0.3, 0.0)
        v1, w1 = v1 + get(e, "bump", "distance", 0.0) * push, w1 + get(e, "bump", "turn", 0.0) * push
    if "tyre_yields" in out:
        v1, w1 = lagged(v1, out["tyre_yields"]), lagged(w1, out["tyre_yields"])
    if "pull" in out:
        w1 = w1 + out["pull"] * calm(v) * np.abs(calm(v))
    if "grain" in out:
        v1 = v1 + out["grain"] * np.abs(calm(v)) * np.cos(theta)
    if "slip_patch" in e:
        v1, w1, side1 = through_patch(e, v1, w1, side1, Pose(*body.pose[0]))
    return _moved(params, body, (v, w, side), (v1, w1, side1))


def _moved(params: RobotParams, body: Motion, before: tuple[Floats, ...], after: tuple[Floats, ...]) -> Motion:
    """The motion with other speeds (forward, turning, sideways): its path, and the IMU by the difference."""
    (v, w, side), (v1, w1, side1) = before, after
    theta = body.pose[0, 2] + np.concatenate(([0.0], np.cumsum(w1[:-1] * H)))
    middle = theta + 0.5 * H * w1
    dx, dy = v1 * np.cos(middle) - side1 * np.sin(middle), v1 * np.sin(middle) + side1 * np.cos(middle)
    x, y = (at + np.concatenate(([0.0], np.cumsum(d[:-1] * H))) for at, d in zip(body.pose[0], (dx, dy), strict=False))
    px, py, yaw = params.imu.x, params.imu.y, params.imu.yaw
    turn, swing = np.gradient(w1 - w, H), w1**2 - w**2
    fx = np.gradient(v1 - v, H) - (w1 * side1 - w * side) - turn * py - swing * px
    fy = np.gradient(side1 - side, H) + (w1 * v1 - w * v) + turn * px - swing * py
    c, s = np.cos(yaw), np.sin(yaw)
    pose = np.column_stack((x, y, theta))
    return replace(body, pose=pose, gz=body.gz + w1 - w, ax=body.ax + c * fx + s * fy, ay=body.ay + c * fy - s * fx)


def felt_means(
    body: Motion, real: Floats, half: float, outside: Mapping[str, float]
) -> tuple[Floats, Floats, Floats, Floats]:
    """gz, ax, ay and forward speed as means over real -+ half, with what no list has."""
    gz, ax, ay = body.gz, body.ax, body.ay
    if "magnet" in outside:
        x, y, width = MAGNET
        near = np.exp(-0.5 * ((body.pose[:, 0] - x) ** 2 + (body.pose[:, 1] - y) ** 2) / width**2)
        gz = gz + outside["magnet"] * near
    gz = gz + outside.get("thermal_step", 0.0) * (body.t > 0.45 * body.t[-1]) + outside.get("one_way", 0.0) * np.abs(gz)
    ax = ax + outside.get("load_shift", 0.0) * (body.t > 0.55 * body.t[-1])
    if "mount_rings" in outside:
        natural = 2.0 * np.pi * outside["mount_rings"]
        swing = ([natural**2], [1.0, 0.2 * natural, natural**2])
        ax, ay = (lsim(swing, axis - axis[0], body.t)[1] + axis[0] for axis in (ax, ay))
    theta = body.pose[:, 2]
    speed = np.cos(theta) * np.gradient(body.pose[:, 0], H) + np.sin(theta) * np.gradient(body.pose[:, 1], H)

    def mean(rows: Floats, late: float = 0.0) -> Floats:
        total, t = np.concatenate(([0.0], np.cumsum(0.5 * (rows[1:] + rows[:-1]) * H))), body.t - late
        return (np.interp(real + half, t, total) - np.interp(real - half, t, total)) / (2 * half)

    half_step = 0.25 * H  # MuJoCo's velocity is that of the step before its instant
    return mean(gz, half_step), mean(ax), mean(ay), np.interp(real, body.t, speed)
