"""A robot to which things happen: the plant that the detectors of `core.estimation.events` are judged on.

Planar rigid body on two driven wheels with tyres (force in proportion to creep, limited by grip), motors with lag and a
force limit, a wall that is a spring, floors that shake; 1 kHz, from scratch, shares nothing with the library's
simulator. Ordinary flaws (tyres, track, gyro, accelerometer, mounting, stream delays) are in every run, faults or not.
Sizes of faults are drawn and kept in their labels: nothing is too small to be listed.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from core.robot import ImuMount, Noise, Pose, RobotParams
from core.run import Run, RunMeta
from core.sensors import CommandLog, ImuLog, TruthLog, WheelLog

Floats = npt.NDArray[np.float64]

DT = 1e-3
RADIUS, TRACK, TICKS = 0.075, 0.32, 2048
MASS, INERTIA, RIM, G = 12.0, 0.45, 2.5, 9.81  # kg, kg m^2, kg at each rim, m/s^2
MOTOR, BRAKE, LIMIT = 130.0, 600.0, 60.0  # N per m/s of speed error when driving and when holding, N, at each rim
FAULTS = (
    "spin_up", "brake_slide", "patch", "one_wheel", "turn_slip", "collision", "bounce", "pushed", "stuck",
    "dead_encoder",
)  # fmt: skip
SLIPS = FAULTS[:5]
CREEPING = 0.05  # m/s of a rim over its ground: from here on a wheel slips
GRIP_L, GRIP_R, DRAG, FX, FY, MZ, WALL, JAM, DEAD_L, DEAD_R, HEAVE, PITCH, SURGE = range(13)
COLUMNS = 13


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


@dataclass
class _Mission:
    """Commands by the millisecond, and what is done to the robot: (column, from, shape)."""

    rng: np.random.Generator
    v: list[Floats] = field(default_factory=list)
    w: list[Floats] = field(default_factory=list)
    done: list[tuple[int, int, Floats]] = field(default_factory=list)
    walls: list[tuple[float, float, float]] = field(default_factory=list)
    marks: list[tuple[str, int, int]] = field(default_factory=list)  # fault, from, to
    n: int = 0

    def go(self, seconds: float, v: float, w: float = 0.0, accel: float = 0.8, spin: float = 2.5) -> None:
        """Ramp from the last command to v [m/s], w [rad/s], and hold."""
        k = max(round(seconds / DT), 1)
        v0, w0 = (float(self.v[-1][-1]), float(self.w[-1][-1])) if self.v else (0.0, 0.0)
        t = np.arange(1, k + 1) * DT
        self.v.append(v0 + np.sign(v - v0) * np.minimum(accel * t, abs(v - v0)))
        self.w.append(w0 + np.sign(w - w0) * np.minimum(spin * t, abs(w - w0)))
        self.n += k

    def hold(self, column: int, begin: float, end: float, value: float) -> None:
        """Something between two times from now [s]."""
        k = round((end - begin) / DT)
        self.done.append((column, self.n + round(begin / DT), np.full(k, value)))

    def pulse(self, column: int, begin: float, seconds: float, peak: float) -> None:
        """Half a sine."""
        k = max(round(seconds / DT), 2)
        self.done.append((column, self.n + round(begin / DT), peak * np.sin(np.pi * (np.arange(k) + 0.5) / k)))

    def ring(self, column: int, begin: float, peak: float, hertz: float, decay: float) -> None:
        """A damped oscillation."""
        t = np.arange(round(5 * decay / DT)) * DT
        self.done.append(
            (column, self.n + round(begin / DT), peak * np.exp(-t / decay) * np.sin(2 * np.pi * hertz * t))
        )

    def stop(self) -> None:
        self.go(self.rng.uniform(1.0, 5.0), 0.0, 0.0, self.rng.uniform(0.5, 1.2))

    def usual(self) -> None:
        """A leg of ordinary work: straight, arc or turn on the spot, now and then a stop."""
        r = self.rng
        speed, accel = r.uniform(0.2, 0.9), r.uniform(0.4, 1.4)
        what = r.integers(4)
        if what == 0:
            self.go(r.uniform(2, 6), speed, 0.0, accel)
        elif what == 1:
            self.go(r.uniform(2, 6), speed, r.uniform(-1.0, 1.0), accel, r.uniform(1.5, 4))
        elif what == 2:
            self.go(0.9, 0.0, 0.0, accel)
            self.go(r.uniform(1, 3), 0.0, r.choice((-1, 1)) * r.uniform(0.4, 1.6), accel, r.uniform(1.5, 5))
        else:
            self.go(r.uniform(0.8, 2), -r.uniform(0.1, 0.3), 0.0, accel)
        if r.random() < 0.45:
            self.stop()


@njit(cache=True)
def _drive(cmd: Any, ext: Any, walls: Any, tyres: Any, b: float, out: Any) -> None:
    """out (N, 12): x, y, theta, u, s, w, rims left and right, creep left and right, acceleration along and across."""
    x = y = th = u = s = w = rl = rr = pen = 0.0
    for i in range(cmd.shape[0]):
        e = ext[i]
        gain = 130.0 if abs(cmd[i, 0]) + abs(cmd[i, 1]) > 1e-9 else 600.0
        load = max(0.0, 1.0 + e[10] / 9.81) * 12.0 * 9.81 / 2
        gl, gr = u - w * b / 2, u + w * b / 2
        fl = min(max(2500.0 * (rl - gl), -e[0] * load), e[0] * load)
        fr = min(max(2500.0 * (rr - gr), -e[1] * load), e[1] * load)
        side = (e[0] + e[1]) * load
        fx = fl + fr + e[3] - e[2] * np.tanh(u / 0.02)
        fy = min(max(-3000.0 * s, -side), side) + e[4]
        mz = (fr - fl) * b / 2 + e[5] - 0.4 * w
        if e[6] >= 1.0:
            k = int(e[6]) - 1
            pen = max(pen + u * 1e-3, 0.0)
            if pen > 0.0:
                push = max(walls[k, 0] * pen + walls[k, 1] * u, 0.0)
                fx -= push
                mz += push * walls[k, 2]
        else:
            pen = 0.0
        au, ay, aw = fx / 12.0, fy / 12.0, mz / 0.45
        u, s, w = u + (au + w * s) * 1e-3, s + (ay - w * u) * 1e-3, w + aw * 1e-3
        for side_of in range(2):
            rim, f = (rl, fl) if side_of == 0 else (rr, fr)
            aim = (cmd[i, 0] + (side_of - 0.5) * 0.32 * cmd[i, 1]) * (1.0 + tyres[side_of])
            rim += (min(max(gain * (aim - rim), -60.0), 60.0) - f) / 2.5 * 1e-3
            if e[7] > 0.0:
                rim = 0.0
            if side_of == 0:
                rl = rim
            else:
                rr = rim
        th += w * 1e-3
        x += (u * np.cos(th) - s * np.sin(th)) * 1e-3
        y += (u * np.sin(th) + s * np.cos(th)) * 1e-3
        row = out[i]
        row[0], row[1], row[2], row[3], row[4], row[5] = x, y, th, u, s, w
        row[6], row[7], row[8], row[9], row[10], row[11] = rl, rr, rl - gl, rr - gr, au, ay


def _log(r: np.random.Generator, low: float, high: float) -> float:
    return float(low * (high / low) ** r.random())


def _spin_up(m: _Mission) -> None:
    r = m.rng
    m.stop()
    grip, accel, speed = r.uniform(0.02, 0.1), r.uniform(1.0, 2.5), r.uniform(0.3, 0.9)
    seconds = _log(r, 0.1, 1.0)
    for side in (GRIP_L, GRIP_R):
        m.hold(side, 0.0, seconds, grip)
    m.go(speed / accel + r.uniform(1, 2.5), speed, 0.0, accel)


def _brake_slide(m: _Mission) -> None:
    r = m.rng
    m.go(r.uniform(2, 3), r.uniform(0.4, 1.0))
    grip, seconds = r.uniform(0.02, 0.08), _log(r, 0.1, 1.5)
    for side in (GRIP_L, GRIP_R):
        m.hold(side, 0.0, seconds, grip)
    m.go(2.5, 0.0, 0.0, r.uniform(1.5, 4.0))


def _patch(m: _Mission) -> None:
    """Slippery and heavy ground (mud, a mat that gives way): wheels turn on, the body is held back."""
    r = m.rng
    m.go(r.uniform(2, 3), r.uniform(0.3, 0.8), r.choice((0.0, 1.0)) * r.uniform(-0.6, 0.6))
    grip, seconds = r.uniform(0.03, 0.15), _log(r, 0.15, 1.5)
    for side in (GRIP_L, GRIP_R):
        m.hold(side, -seconds - 0.2, -0.2, grip)
    m.hold(DRAG, -seconds - 0.2, -0.2, grip * MASS * G * r.uniform(0.9, 2.0))
    m.go(1.5, float(m.v[-1][-1]), float(m.w[-1][-1]))


def _one_wheel(m: _Mission) -> None:
    """One wheel on ice while the robot speeds up or climbs."""
    r = m.rng
    seconds, side = _log(r, 0.1, 1.5), int(r.choice((GRIP_L, GRIP_R)))
    if r.random() < 0.5:
        m.stop()
        m.hold(side, 0.0, seconds, r.uniform(0.0, 0.08))
        m.go(seconds + 1.5, r.uniform(0.3, 0.9), 0.0, r.uniform(0.8, 2.0))
    else:
        m.go(2.5, r.uniform(0.3, 0.8))
        m.hold(side, 0.0, seconds, r.uniform(0.0, 0.05))
        m.hold(DRAG, 0.0, seconds, r.uniform(8.0, 25.0))
        m.go(seconds + 1.0, float(m.v[-1][-1]))


def _turn_slip(m: _Mission) -> None:
    r = m.rng
    m.stop()
    seconds = _log(r, 0.1, 1.2)
    for side in (GRIP_L, GRIP_R):
        m.hold(side, 0.0, seconds, r.uniform(0.005, 0.05))
    m.go(2.5, 0.0, r.choice((-1, 1)) * r.uniform(0.6, 1.8), 0.8, r.uniform(3, 8))


def _collision(m: _Mission) -> None:
    r = m.rng
    speed = r.uniform(0.2, 1.0)
    m.go(speed / 0.8 + r.uniform(0.8, 2.0), speed)
    contact, zeta = r.uniform(0.015, 0.05), r.uniform(0.1, 0.9)
    omega = np.pi / contact
    m.walls.append((MASS * omega**2, 2 * zeta * MASS * omega, float(r.uniform(-0.1, 0.1))))
    react = r.choice((r.uniform(0.05, 0.4), r.uniform(0.8, 2.5)))
    hold = react + 1.0
    m.hold(WALL, 0.0, hold + 1.0, len(m.walls))
    jolt = speed * omega * 0.6
    m.ring(HEAVE, 0.004, jolt * r.uniform(0.05, 0.3), r.uniform(15, 35), r.uniform(0.03, 0.08))
    m.ring(SURGE, 0.004, jolt * r.uniform(0.05, 0.2), r.uniform(15, 35), r.uniform(0.03, 0.08))
    m.go(react, speed)
    m.go(1.0, 0.0, 0.0, 4.0)
    m.go(1.5, -0.2)
    m.stop()


def _bounce(m: _Mission) -> None:
    """Over a threshold: each axle is thrown up, the body rocks; grip comes and goes with the load."""
    r = m.rng
    speed, peak = r.uniform(0.2, 0.8), r.uniform(2.5, 14.0)
    m.go(speed / 0.8 + r.uniform(0.8, 2.0), speed)
    for k, at in enumerate((0.0, min(0.25 / speed, 0.8))):
        size = peak * (1.0 if k == 0 else r.uniform(0.4, 1.0))
        m.pulse(HEAVE, at, r.uniform(0.02, 0.05), size)
        m.ring(HEAVE, at + 0.03, -size * r.uniform(0.3, 0.7), r.uniform(5, 14), r.uniform(0.06, 0.2))
        m.ring(PITCH, at, (-1) ** k * size * r.uniform(0.03, 0.1), r.uniform(4, 9), r.uniform(0.08, 0.2))
        m.pulse(FX, at, 0.04, -MASS * size * r.uniform(0.05, 0.3))
        m.pulse(MZ, at, 0.04, size * r.uniform(-0.15, 0.15))
    m.go(2.0, speed)


def _pushed(m: _Mission) -> None:
    r = m.rng
    m.stop()
    m.go(1.5, 0.0)
    seconds = r.uniform(0.15, 0.8)
    m.hold(JAM, -0.2, 3.0, 1.0)
    way = r.integers(3)
    grip = 0.7 * MASS * G
    if way == 0:
        m.hold(FX, 0.0, seconds, r.choice((-1, 1)) * grip * r.uniform(1.03, 1.3))
    elif way == 1:
        m.hold(FY, 0.0, seconds, r.choice((-1, 1)) * grip * r.uniform(1.03, 1.3))
    else:
        m.hold(MZ, 0.0, seconds, r.choice((-1, 1)) * grip * TRACK / 2 * r.uniform(1.03, 1.25))
    m.go(3.0, 0.0)


def _stuck(m: _Mission) -> None:
    r = m.rng
    m.stop()
    m.go(1.0, 0.0)
    seconds = r.uniform(1.0, 5.0)
    m.hold(JAM, -0.3, seconds, 1.0)
    m.go(seconds + 1.5, r.uniform(0.15, 0.6), r.choice((0.0, 0.6)))
    m.stop()


def _dead_encoder(m: _Mission) -> None:
    r = m.rng
    m.go(r.uniform(2, 3), r.uniform(0.2, 0.8), r.choice((0.0, 1.0)) * r.uniform(-0.6, 0.6))
    seconds, side = r.uniform(0.5, 6.0), r.integers(3)
    for k, column in enumerate((DEAD_L, DEAD_R)):
        if side in (k, 2):
            m.hold(column, 0.0, seconds, 1.0)
    v = float(m.v[-1][-1])
    m.go(seconds + 1.5, v, r.uniform(-0.5, 0.5))


ACTS = {
    "spin_up": _spin_up, "brake_slide": _brake_slide, "patch": _patch, "one_wheel": _one_wheel,
    "turn_slip": _turn_slip, "collision": _collision, "bounce": _bounce, "pushed": _pushed, "stuck": _stuck,
    "dead_encoder": _dead_encoder,
}  # fmt: skip


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
    m = _Mission(rng)
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


def _labels(mark: tuple[str, int, int], m: _Mission, ext: Floats, motion: Floats) -> list[Label]:
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
    rates = np.stack(
        (0.3 * np.gradient(uneven, DT) * 0, ext[:, PITCH], w * (1 + flaws.gyro_scale * rng.standard_normal()))
    )
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
