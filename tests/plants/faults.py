"""A robot to which things happen: the plant that the detectors of `core.estimation.events` are judged on.

Planar rigid body on two driven wheels with tyres (force in proportion to creep, limited by grip), motors with lag and a
force limit, a wall that is a spring, floors that shake; 1 kHz, from scratch, shares nothing with the library's
simulator. Ordinary flaws (tyres, track, gyro, accelerometer, mounting, stream delays) are in every run, faults or not.
Sizes of faults are drawn and kept in their labels: nothing is too small to be listed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from core.robot import ImuMount, Noise, Pose, RobotParams
from core.run import Run, RunMeta
from core.sensors import CommandLog, ImuLog, TruthLog, WheelLog
from tests.plants.fault_missions import (
    ACTS,
    COLUMNS,
    DEAD_L,
    DEAD_R,
    DRAG,
    DT,
    FAULTS,
    FX,
    FY,
    GRIP_L,
    GRIP_R,
    HEAVE,
    JAM,
    MASS,
    MZ,
    PITCH,
    SURGE,
    TRACK,
    WALL,
    G,
    Mission,
)  # fmt: skip

Floats = npt.NDArray[np.float64]

RADIUS, TICKS = 0.075, 2048
INERTIA, RIM = 0.45, 2.5  # kg m^2, kg at each rim
MOTOR, BRAKE, LIMIT = 130.0, 600.0, 60.0  # N per m/s of speed error when driving and when holding, N, at each rim
CREEP, SIDE = 2500.0, 3000.0  # N per m/s of creep along and across, up to the grip
SLIPS = FAULTS[:5]
CREEPING = 0.05  # m/s of a rim over its ground: from here on a wheel slips


@dataclass(frozen=True)
class Label:
    """What happened: kind of event, the fault that made it, onset and end [s], `over` when all its traces are gone,
    size: slip [m of rim over ground], collision and pushed [m/s], bounce [m/s^2], stuck and dead_encoder [s]."""

    kind: str
    fault: str
    t0: float
    t1: float
    over: float
    size: float


@dataclass(frozen=True)
class Flaws:
    """What the run does not say of the robot: one sigma of each, from which a run draws its own."""

    tyre: float = 0.003  # relative, each wheel
    track: float = 0.008
    gyro_bias: float = 4e-3  # rad/s
    gyro_scale: float = 0.005
    accel_bias: float = 0.04  # m/s^2
    mount: float = 0.010  # rad, each angle of the IMU
    delay: float = 0.050  # s, largest lag of a stream (uniform)
    shake: float = 0.6  # m/s^2 per axis at 0.5 m/s (log-uniform over a factor of two both ways)
    joints: float = 0.5  # m/s^2, peak at a joint of the floor
    slope: float = 0.004  # rad, how uneven the floor is


@dataclass(frozen=True)
class FaultRun:
    """The run, what happened in it, and what the body and the rims really did (N, 12) at 1 kHz, from t = 0."""

    run: Run
    labels: tuple[Label, ...]
    motion: Floats


@njit(cache=True)
def _drive(cmd: Any, ext: Any, walls: Any, tyres: Any, b: float, out: Any) -> None:
    """out (N, 12): x, y, theta, u, s, w, rims left and right, creep left and right, acceleration along and across."""
    x = y = th = u = s = w = rl = rr = pen = 0.0
    for i in range(cmd.shape[GRIP_L]):
        e = ext[i]
        gain = MOTOR if abs(cmd[i, 0]) + abs(cmd[i, 1]) > 1e-9 else BRAKE
        load = max(0.0, 1.0 + e[HEAVE] / G) * MASS * G / 2
        gl, gr = u - w * b / 2, u + w * b / 2
        fl = min(max(CREEP * (rl - gl), -e[GRIP_L] * load), e[GRIP_L] * load)
        fr = min(max(CREEP * (rr - gr), -e[GRIP_R] * load), e[GRIP_R] * load)
        side = (e[GRIP_L] + e[GRIP_R]) * load
        fx = fl + fr + e[FX] - e[DRAG] * np.tanh(u / 0.02)
        fy = min(max(-SIDE * s, -side), side) + e[FY]
        mz = (fr - fl) * b / 2 + e[MZ] - 0.4 * w
        if e[WALL] >= 1.0:
            k = int(e[WALL]) - 1
            pen = max(pen + u * DT, 0.0)
            if pen > 0.0:
                push = max(walls[k, 0] * pen + walls[k, 1] * u, 0.0)
                fx -= push
                mz += push * walls[k, 2]
        else:
            pen = 0.0
        au, ay, aw = fx / MASS, fy / MASS, mz / INERTIA
        u, s, w = u + (au + w * s) * DT, s + (ay - w * u) * DT, w + aw * DT
        for side_of in range(2):
            rim, f = (rl, fl) if side_of == 0 else (rr, fr)
            aim = (cmd[i, 0] + (side_of - 0.5) * TRACK * cmd[i, 1]) * (1.0 + tyres[side_of])
            rim += (min(max(gain * (aim - rim), -LIMIT), LIMIT) - f) / RIM * DT
            if e[JAM] > 0.0:
                rim = 0.0
            if side_of == 0:
                rl = rim
            else:
                rr = rim
        th += w * DT
        x += (u * np.cos(th) - s * np.sin(th)) * DT
        y += (u * np.sin(th) + s * np.cos(th)) * DT
        row = out[i]
        row[0], row[1], row[2], row[3], row[4], row[5] = x, y, th, u, s, w
        row[6], row[7], row[8], row[9], row[10], row[11] = rl, rr, rl - gl, rr - gr, au, ay


def fault_run(
    seed: int,
    seconds: float = 120.0,
    faults: tuple[str, ...] = FAULTS,
    flaws: Flaws = Flaws(),
    *,
    imu_rate: int = 100,
    wheel_rate: int = 50,
) -> FaultRun:
    """A mission of about that length with one fault every dozen seconds, drawn from `faults` (none: a clean run)."""
    rng = np.random.default_rng(seed)
    m = Mission(rng)
    m.go(2.0, 0.0)
    while m.n * DT < seconds:
        for _ in range(rng.integers(1, 3)):
            m.usual()
        if faults:
            fault, begin = str(rng.choice(faults)), m.n
            ACTS[fault](m)
            m.marks.append((fault, begin, m.n))
            m.go(1.0, 0.0)
    m.go(2.0, 0.0)
    ext = np.zeros((m.n, COLUMNS))
    ext[:, GRIP_L] = ext[:, GRIP_R] = 0.7
    for column, begin, shape in m.done:
        shape = shape[: max(m.n - begin, 0)]
        if column in (HEAVE, PITCH, SURGE, FX, MZ):
            ext[begin : begin + len(shape), column] += shape
        else:
            ext[begin : begin + len(shape), column] = shape
    cmd = np.column_stack((np.concatenate(m.v), np.concatenate(m.w)))
    motion = np.zeros((m.n, 12))
    walls = np.array(m.walls or [(0.0, 0.0, 0.0)])
    tyres, track = flaws.tyre * rng.standard_normal(2), TRACK * (1 + flaws.track * rng.standard_normal())
    _drive(cmd, ext, walls, tyres, track, motion)
    labels = tuple(one for mark in m.marks for one in _labels(mark, m, ext, motion))
    run = Run(
        RunMeta(
            name=f"faults {seed}",
            robot=RobotParams(RADIUS, TRACK, TICKS, imu=ImuMount(0.05, 0.0, 0.0)),
            start=Pose(),
            noise=Noise(gyro_density=3e-4, accel_density=2e-3),
        ),
        commands=_commands(rng, cmd),
        wheels=_wheels(rng, motion, ext, tyres, flaws, wheel_rate),
        imu=_imu(rng, motion, ext, flaws, imu_rate),
        truth=TruthLog(np.arange(0, m.n, 50) * DT, *(motion[::50, k].copy() for k in range(3))),
    )
    return FaultRun(run, labels, motion)


def _labels(mark: tuple[str, int, int], m: Mission, ext: Floats, motion: Floats) -> list[Label]:
    """Onset and end from what really happened between two milliseconds."""
    fault, begin, end = mark
    part, done = motion[begin:end], ext[begin:end]
    creep = np.maximum(np.abs(part[:, 8]), np.abs(part[:, 9]))
    if fault in SLIPS:
        kind, rows = "slip", _main(creep, CREEPING)
        size = float(np.max(np.sum(np.abs(part[rows, 8:10]), 0)) * DT) if rows.size else 0.0
    elif fault == "collision":
        hit = np.flatnonzero((done[:, WALL] > 0) & (part[:, 10] < -1.5))
        if not hit.size:
            return []
        rows, kind = hit[hit < hit[0] + 200], "collision"
        size = float(part[max(hit[0] - 1, 0), 3])
    elif fault == "bounce":
        kind, rows = "bounce", np.flatnonzero(np.abs(done[:, HEAVE]) > 0.5)
        size = float(np.max(np.abs(done[:, HEAVE])))
    elif fault == "pushed":
        moves = np.hypot(part[:, 3], part[:, 4]) + 0.16 * np.abs(part[:, 5])
        kind, rows, size = "pushed", np.flatnonzero((moves > 0.01) & (done[:, JAM] > 0)), 0.0
        size = float(np.max(moves[rows])) if rows.size else 0.0
    else:
        column = done[:, JAM] if fault == "stuck" else np.maximum(done[:, DEAD_L], done[:, DEAD_R])
        asked = np.abs(np.concatenate(m.v)[begin:end]) + np.abs(np.concatenate(m.w)[begin:end]) > 0
        kind, rows = fault, np.flatnonzero((column > 0) & asked)
        size = len(rows) * DT
    if not rows.size:
        return []
    return [Label(kind, fault, (begin + rows[0]) * DT, (begin + rows[-1] + 1) * DT, end * DT, size)]


def _main(size: Floats, least: float) -> npt.NDArray[np.intp]:
    """Rows of the stretch with the largest sum in which `size` is above `least`, gaps of 0.2 s bridged."""
    rows = np.flatnonzero(size > least)
    if not rows.size:
        return rows
    group = np.concatenate(([0], np.cumsum(np.diff(rows) > 200)))
    best = np.argmax(np.bincount(group, weights=size[rows]))
    mine = rows[group == best]
    return np.arange(mine[0], mine[-1] + 1)


def _commands(rng: np.random.Generator, cmd: Floats) -> CommandLog:
    rows = np.arange(0, len(cmd), 50)
    return CommandLog(rows * DT, cmd[rows, 0].copy(), cmd[rows, 1].copy())


def _late(rng: np.random.Generator, n: int, rate: int, delay: float) -> tuple[npt.NDArray[np.intp], Floats]:
    """Rows that a stream reads and the stamps that it gives them: late by a constant, shaken by half a millisecond."""
    step = round(1 / rate / DT)
    rows = np.arange(step, n, step)
    stamps = rows * DT + rng.uniform(0, delay) + np.clip(5e-4 * rng.standard_normal(rows.size), -2e-3, 2e-3)
    return rows, stamps


def _wheels(rng: np.random.Generator, motion: Floats, ext: Floats, tyres: Floats, flaws: Flaws, rate: int) -> WheelLog:
    rows, stamps = _late(rng, len(motion), rate, flaws.delay)
    step = 2 * np.pi / TICKS
    angles = []
    for k, dead in ((0, DEAD_L), (1, DEAD_R)):
        speed = np.where(ext[:, dead] > 0, 0.0, motion[:, 6 + k]) / (RADIUS * (1 + tyres[k]))
        angles.append(np.floor((np.cumsum(speed) * DT + rng.uniform(0, 6)) / step)[rows] * step)
    return WheelLog(stamps, *angles)


def _imu(rng: np.random.Generator, motion: Floats, ext: Floats, flaws: Flaws, rate: int) -> ImuLog:
    """Specific force and rates at the IMU, averaged over each sample, in its own crooked axes."""
    from scipy.ndimage import gaussian_filter1d
    from scipy.signal import lfilter

    n, width = len(motion), round(1 / rate / DT)
    u, w, s = motion[:, 3], motion[:, 5], motion[:, 4]
    aw = gaussian_filter1d(np.gradient(w, DT), 2.0)
    shake = flaws.shake * 2 ** rng.uniform(-1, 1)
    speed = np.abs(u) + np.abs(s) + 0.08 * np.abs(w)
    along = np.cumsum(np.abs(u)) * DT
    uneven = np.interp(
        along,
        np.arange(0, along[-1] + 2, 0.7),
        flaws.slope * rng.standard_normal(int(along[-1] / 0.7) + 4)[: len(np.arange(0, along[-1] + 2, 0.7))],
    )
    force = np.empty((3, n))
    joints = np.interp(along, *_joints(rng, along[-1] + 1.0, flaws.joints)) * np.minimum(speed / 0.4, 1.5)
    for k, gain in enumerate((0.8, 0.7, 1.2)):
        hum = np.zeros(n)
        for hertz in (18.0, 31.0, 43.0):
            f, q = hertz * rng.uniform(0.85, 1.15), 0.985
            hum += lfilter([1.0], [1.0, -2 * q * np.cos(2 * np.pi * f * DT), q * q], rng.standard_normal(n))
        force[k] = gain * shake * hum / np.std(hum) * speed / 0.5 + joints * (0.4, 0.2, 1.0)[k]
    force[0] += motion[:, 10] - 0.05 * w * w + ext[:, SURGE] + G * uneven
    force[1] += motion[:, 11] + 0.05 * aw
    force[2] += G + ext[:, HEAVE]
    rates = np.stack((np.zeros(n), ext[:, PITCH], w * (1 + flaws.gyro_scale * rng.standard_normal())))
    rates += (
        np.array((0.02, 0.03, 0.004))[:, None] * shake * lfilter([0.3], [1, -0.7], rng.standard_normal((3, n))) * speed
    )
    yaw, pitch, roll = flaws.mount * rng.standard_normal(3)
    turn = np.array(((1, yaw, -pitch), (-yaw, 1, roll), (pitch, -roll, 1)))
    rows, stamps = _late(rng, n, rate, flaws.delay)
    mean = np.stack([np.convolve(c, np.full(width, 1 / width))[:n][rows] for c in (*(turn @ force), *rates)])
    mean[:3] += flaws.accel_bias * rng.standard_normal((3, 1)) + 2e-3 * np.sqrt(rate / 2) * rng.standard_normal(
        (3, rows.size)
    )
    mean[3:] += flaws.gyro_bias * rng.standard_normal((3, 1)) + 3e-4 * np.sqrt(rate / 2) * rng.standard_normal(
        (3, rows.size)
    )
    ax, ay, az, gx, gy, gz = mean
    return ImuLog(stamps, gz, ax, ay, az, gx, gy)


def _joints(rng: np.random.Generator, length: float, peak: float) -> tuple[Floats, Floats]:
    """Places [m] and heights of floor joints: triangles 2 cm wide, every half metre or so."""
    at = np.cumsum(rng.uniform(0.3, 0.9, int(length / 0.3) + 2))
    size = peak * rng.standard_normal(at.size)
    place = np.column_stack((at - 0.01, at, at + 0.01)).ravel()
    return place, np.column_stack((0 * size, size, 0 * size)).ravel()
