"""Every plant effect against an independent integration: the definitions as an ODE, solved by scipy, tight.

The reference knows nothing of pieces: it restarts the solver at command knots and at events that scipy finds.
"""

from __future__ import annotations

import dataclasses
import math
from bisect import bisect_right
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from scipy.integrate import solve_ivp

from core.effects import EFFECTS
from core.robot import EffectSet
from core.run import Run
from core.simulation import simulate

Array = npt.NDArray[np.float64]
X, Y, TH = 0, 1, 2


class Reference:
    """The plant as an ODE over (x, y, theta, left speed state, right speed state), effect by effect."""

    def __init__(self, run: Run, effects: EffectSet) -> None:
        assert run.commands is not None and run.meta.start is not None
        self.run, self.commands = run, run.commands
        self.b = float(run.meta.robot.track_width or 0.0)
        rims = [self.commands.v + (side - 0.5) * self.commands.w * self.b for side in (0, 1)]
        self.table = [(self.commands.t.tolist(), rim.tolist()) for rim in rims]
        self.get: Callable[[str, str, float], float] = lambda e, p, d: float(effects.get(e, {}).get(p, d))
        self.delay = self.get("command_delay", "delay", 0.0)
        self.tau = self.get("motor_lag", "tau", 0.0)
        self.width, self.gain = self.get("deadband", "width", 0.0), self.get("drive_gain", "gain", 1.0)
        self.sag, self.slip = self.get("battery_sag", "rate", 0.0), self.get("wheel_slip", "k", 0.0)
        self.a_max = self.get("accel_limit", "a_max", math.inf)
        self.behind = [0.0, 0.0]  # sign of the acceleration limit that each wheel is at, 0: it follows
        start, patch = run.meta.start, [self.get("slip_patch", name, 0.0) for name in ("x", "y", "radius")]
        self.inside = math.hypot(start.x - patch[0], start.y - patch[1]) < patch[2]

    def set_point(self, t: float, side: int) -> float:
        at, (times, values) = t - self.delay, self.table[side]
        i = min(max(bisect_right(times, at) - 1, 0), len(times) - 2)
        share = min(max((at - times[i]) / (times[i + 1] - times[i]), 0.0), 1.0)
        u = values[i] + share * (values[i + 1] - values[i])
        return 0.0 if abs(u) < self.width else u * self.gain * math.exp(-self.sag * t)

    def slope(self, t: float, side: int) -> float:
        return (self.set_point(t + 1e-7, side) - self.set_point(t - 1e-7, side)) / 2e-7

    def rim(self, t: float, s: Array, side: int) -> tuple[float, float]:
        """Rim speed and rim acceleration."""
        if self.tau > 0.0:
            v, a = float(s[3 + side]), (self.set_point(t, side) - float(s[3 + side])) / self.tau
        elif self.behind[side] != 0.0:
            v, a = float(s[3 + side]), self.behind[side] * self.a_max
        else:
            v, a = self.set_point(t, side), self.slope(t, side) if self.slip else 0.0
        limit = self.get("speed_limit", "v_max", math.inf)
        return min(max(v, -limit), limit), a

    def speeds(self, t: float, s: Array) -> tuple[float, float, float]:
        scale, ratio = self.get("wheel_radius", "scale", 1.0), self.get("unequal_wheels", "ratio", 1.0)
        size = (2.0 / (1.0 + ratio), 2.0 * ratio / (1.0 + ratio))
        grip = 1.0 - self.get("slip_patch", "slip", 0.0) * self.inside
        ground = []
        for side in (0, 1):
            v, a = self.rim(t, s, side)
            lost = min(max(self.slip * a * math.copysign(1.0, v), -1.0), 1.0)
            ground.append((1.0 - lost) * v * scale * size[side] * grip)
        v, w = 0.5 * (ground[0] + ground[1]), (ground[1] - ground[0]) / (self.b * self.get("track_width", "scale", 1.0))
        vy = -self.get("side_slip", "k", 0.0) * v * w
        u = t - self.get("bump", "time", math.inf)
        if 0.0 < u < 0.3:
            profile = (1.0 - math.cos(2.0 * math.pi * u / 0.3)) / 0.3
            v, w = v + self.get("bump", "distance", 0.0) * profile, w + self.get("bump", "turn", 0.0) * profile
        return v, vy, w

    def rate(self, t: float, s: Array) -> list[float]:
        v, vy, w = self.speeds(t, s)
        c, n = math.cos(s[TH]), math.sin(s[TH])
        states = [0.0, 0.0]
        if self.tau > 0.0:
            states = [self.rim_state_rate(t, s, side) for side in (0, 1)]
        elif math.isfinite(self.a_max):
            states = [self.behind[side] * self.a_max for side in (0, 1)]
        return [v * c - vy * n, v * n + vy * c, w, *states]

    def rim_state_rate(self, t: float, s: Array, side: int) -> float:
        return (self.set_point(t, side) - float(s[3 + side])) / self.tau

    def breaks(self, end: float) -> Array:
        """Knots, and where a set-point's size passes a threshold, found on a fine grid and polished by bisection."""
        bump = self.get("bump", "time", 0.0)
        out = [*(self.commands.t + self.delay), bump, bump + 0.3]
        for level in (self.get("deadband", "width", 0.0), self.get("speed_limit", "v_max", 0.0), 0.0):
            for side in (0, 1):
                out += self.crossings(level, side, end)
        return np.unique(np.clip(np.round(np.asarray(out), 11), 0.0, end))

    def crossings(self, level: float, side: int, end: float) -> list[float]:
        v, w = self.commands.v, self.commands.w
        u = v + (side - 0.5) * w * self.b
        t, found = self.commands.t + self.delay, []
        for i in range(len(t) - 1):
            for at in (level, -level):
                if (u[i] - at) * (u[i + 1] - at) < 0.0:
                    found.append(float(t[i] + (at - u[i]) / (u[i + 1] - u[i]) * (t[i + 1] - t[i])))
        return found

    def solve(self, stamps: Array) -> Array:
        start = self.run.meta.start
        assert start is not None
        state = np.array([start.x, start.y, start.theta, 0.0, 0.0])
        end = float(stamps[-1])
        marks = [*self.breaks(end), end]
        rows: dict[float, Array] = {}
        t = 0.0
        for mark in marks:
            while mark - t > 1e-10:
                self.switch(t, state)
                inner = stamps[(stamps >= t) & (stamps <= mark)]
                result = solve_ivp(
                    self.rate, (t, mark), state, method="DOP853", rtol=1e-11, atol=1e-12,
                    events=self.events(), dense_output=True, max_step=0.5,
                )  # fmt: skip
                t, state = float(result.t[-1]), result.y[:, -1]
                rows |= {float(k): result.sol(k)[:3] for k in inner if k <= t}
                if result.status == 1:
                    self.happened(result.t_events)
        return np.array([rows[float(k)] for k in stamps])

    def switch(self, t: float, state: Array) -> None:
        """Which limit each wheel is at from t on."""
        if not math.isfinite(self.a_max):
            return
        for side in (0, 1):
            if self.behind[side] == 0.0:
                state[3 + side] = self.set_point(t, side)
            ahead = self.set_point(t + 1e-9, side) - state[3 + side]
            steep = self.slope(t + 1e-6, side)
            if abs(ahead) > 1e-7:
                self.behind[side] = float(np.sign(ahead))
            else:
                self.behind[side] = float(np.sign(steep)) if abs(steep) > self.a_max else 0.0

    def events(self) -> list[Callable[[float, Array], float]]:
        out = []
        if self.get("slip_patch", "slip", 0.0):
            px, py, radius = (self.get("slip_patch", p, 0.0) for p in ("x", "y", "radius"))
            out.append(lambda t, s: math.hypot(s[X] - px, s[Y] - py) - radius - (1e-11 if self.inside else -1e-11))
        if math.isfinite(self.a_max):
            for side in (0, 1):
                if self.behind[side] != 0.0:
                    out.append(lambda t, s, i=side: self.set_point(t, i) - s[3 + i] + 1e-12 * self.behind[i])
        for event in out:
            event.terminal = True  # type: ignore[attr-defined]
        return out

    def happened(self, t_events: list[Array]) -> None:
        if self.get("slip_patch", "slip", 0.0) and len(t_events[0]):
            self.inside = not self.inside


CASES: dict[str, EffectSet] = {
    "nominal": {},
    "command_delay": {"command_delay": {"delay": 0.137}},
    "motor_lag": {"motor_lag": {"tau": 0.21}},
    "motor_lag small": {"motor_lag": {"tau": 0.006}},
    "speed_limit": {"speed_limit": {"v_max": 0.45}},
    "accel_limit": {"accel_limit": {"a_max": 0.35}},
    "deadband": {"deadband": {"width": 0.08}},
    "drive_gain": {"drive_gain": {"gain": 0.93}},
    "battery_sag": {"battery_sag": {"rate": 0.003}},
    "wheel_radius": {"wheel_radius": {"scale": 1.04}},
    "unequal_wheels": {"unequal_wheels": {"ratio": 1.03}},
    "track_width": {"track_width": {"scale": 0.9}},
    "wheel_slip": {"wheel_slip": {"k": 0.15}},
    "side_slip": {"side_slip": {"k": 0.2}},
    "slip_patch": {"slip_patch": {"x": 4.6, "y": 3.9, "radius": 0.5, "slip": 0.4}},
    "bump": {"bump": {"time": 17.234, "distance": 0.05, "turn": -0.2}},
}


def test_no_effect_of_the_plant_is_left_out() -> None:
    plant = {e.id for e in EFFECTS.values() if e.family in ("drive", "kinematics", "ground")}
    assert plant - {"floor_tilt"} == {effect for case in CASES.values() for effect in case}  # tilt moves nothing


@pytest.mark.parametrize("case", CASES)
def test_pose_agrees_with_scipy(case: str, wild: Run) -> None:
    assert wild.truth is not None
    run = dataclasses.replace(wild, wheels=None, imu=None, beacon=None, ranges=None)
    ours = simulate(run, CASES[case], 0).truth
    assert ours is not None and ours.x is not None and ours.y is not None and ours.theta is not None
    theirs = Reference(run, CASES[case]).solve(wild.truth.t)
    assert ours.t[-1] == pytest.approx(60.0, abs=0.06)
    assert np.max(np.hypot(ours.x - theirs[:, X], ours.y - theirs[:, Y])) < 1e-6
    assert np.max(np.abs(ours.theta - theirs[:, TH])) < 1e-6
