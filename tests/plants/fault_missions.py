"""Missions of tests/plants/faults.py: legs of ordinary work, and one act per fault, its size drawn.

An act writes commands by the millisecond and what is done to the robot meanwhile (grip, drag, forces, a wall, a jam).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]

DT = 1e-3
TRACK, MASS, G = 0.32, 12.0, 9.81  # m, kg, m/s^2
FAULTS = (
    "spin_up", "brake_slide", "patch", "one_wheel", "turn_slip", "collision", "bounce", "pushed", "stuck",
    "dead_encoder",
)  # fmt: skip
GRIP_L, GRIP_R, DRAG, FX, FY, MZ, WALL, JAM, DEAD_L, DEAD_R, HEAVE, PITCH, SURGE = range(13)
COLUMNS = 13


@dataclass
class Mission:
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


def _log(r: np.random.Generator, low: float, high: float) -> float:
    return float(low * (high / low) ** r.random())


def _spin_up(m: Mission) -> None:
    r = m.rng
    m.stop()
    grip, accel, speed = r.uniform(0.02, 0.1), r.uniform(1.0, 2.5), r.uniform(0.3, 0.9)
    seconds = _log(r, 0.1, 1.0)
    for side in (GRIP_L, GRIP_R):
        m.hold(side, 0.0, seconds, grip)
    m.go(speed / accel + r.uniform(1, 2.5), speed, 0.0, accel)


def _brake_slide(m: Mission) -> None:
    r = m.rng
    m.go(r.uniform(2, 3), r.uniform(0.4, 1.0))
    grip, seconds = r.uniform(0.02, 0.08), _log(r, 0.1, 1.5)
    for side in (GRIP_L, GRIP_R):
        m.hold(side, 0.0, seconds, grip)
    m.go(2.5, 0.0, 0.0, r.uniform(1.5, 4.0))


def _patch(m: Mission) -> None:
    """Slippery and heavy ground (mud, a mat that gives way): wheels turn on, the body is held back."""
    r = m.rng
    m.go(r.uniform(2, 3), r.uniform(0.3, 0.8), r.choice((0.0, 1.0)) * r.uniform(-0.6, 0.6))
    grip, seconds = r.uniform(0.03, 0.15), _log(r, 0.15, 1.5)
    for side in (GRIP_L, GRIP_R):
        m.hold(side, -seconds - 0.2, -0.2, grip)
    m.hold(DRAG, -seconds - 0.2, -0.2, grip * MASS * G * r.uniform(0.9, 2.0))
    m.go(1.5, float(m.v[-1][-1]), float(m.w[-1][-1]))


def _one_wheel(m: Mission) -> None:
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


def _turn_slip(m: Mission) -> None:
    r = m.rng
    m.stop()
    seconds = _log(r, 0.1, 1.2)
    for side in (GRIP_L, GRIP_R):
        m.hold(side, 0.0, seconds, r.uniform(0.005, 0.05))
    m.go(2.5, 0.0, r.choice((-1, 1)) * r.uniform(0.6, 1.8), 0.8, r.uniform(3, 8))


def _collision(m: Mission) -> None:
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


def _bounce(m: Mission) -> None:
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


def _pushed(m: Mission) -> None:
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


def _stuck(m: Mission) -> None:
    r = m.rng
    m.stop()
    m.go(1.0, 0.0)
    seconds = r.uniform(1.0, 5.0)
    m.hold(JAM, -0.3, seconds, 1.0)
    m.go(seconds + 1.5, r.uniform(0.15, 0.6), r.choice((0.0, 0.6)))
    m.stop()


def _dead_encoder(m: Mission) -> None:
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
