"""All plant effects at once, in the order that they are defined in: against small steps of another program; and any
plausible values of any effects: no endless cutting of time, no NaN.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

import core.simulation
from core.effects import EFFECTS, Parameter
from core.robot import EffectSet, Pose
from core.run import Run
from core.simulation import _batch_numba, simulate
from core.simulation import params as P
from core.simulation.inputs import prepare
from core.simulation.scenarios import SCENARIOS, Rates
from core.simulation.simulate import simulate_sets

Array = npt.NDArray[np.float64]
STEP = 2e-5

EVERYTHING: EffectSet = {
    "command_delay": {"delay": 0.07},
    "deadband": {"width": 0.06},
    "drive_gain": {"gain": 0.95},
    "battery_sag": {"rate": 0.002},
    "motor_lag": {"tau": 0.12},
    "accel_limit": {"a_max": 0.4},
    "speed_limit": {"v_max": 0.5},
    "wheel_radius": {"scale": 1.02},
    "unequal_wheels": {"ratio": 0.97},
    "track_width": {"scale": 1.05},
    "wheel_slip": {"k": 0.2},
    "side_slip": {"k": 0.15},
    "slip_patch": {"x": 4.6, "y": 3.9, "radius": 0.5, "slip": 0.4},
    "bump": {"time": 17.234, "distance": 0.05, "turn": -0.2},
}


@njit
def small_steps(u: Array, b: float, stamps: Array) -> Array:  # pragma: no cover
    """The effects above as plain code at STEP; u (n, 2): delayed rim set-points. Rows x, y, theta, left, right."""
    out = np.zeros((len(stamps), 5))
    lag, limited, rim, way = np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2)
    x, y, th, k = 4.5, 3.5, 0.3, 0
    blend = 1.0 - math.exp(-STEP / 0.12)
    scale = (1.02 * 2.0 / 1.97, 1.02 * 2.0 * 0.97 / 1.97)
    ground = np.zeros(2)
    for n in range(u.shape[0]):
        t = n * STEP
        while k < len(stamps) and stamps[k] <= t + 0.5 * STEP:
            out[k] = (x, y, th, way[0], way[1])
            k += 1
        slippery = (x - 4.6) ** 2 + (y - 3.9) ** 2 < 0.25
        for i in range(2):
            target = 0.0 if abs(u[n, i]) < 0.06 else 0.95 * math.exp(-0.002 * t) * u[n, i]
            lag[i] += blend * (target - lag[i])
            limited[i] += min(max(lag[i] - limited[i], -0.4 * STEP), 0.4 * STEP)
            new = min(max(limited[i], -0.5), 0.5)
            a, v = (new - rim[i]) / STEP, 0.5 * (new + rim[i])
            rim[i] = new
            way[i] += v * STEP
            ground[i] = (v - min(max(0.2 * a, -1.0), 1.0) * abs(v)) * scale[i] * (0.6 if slippery else 1.0)
        v, w = 0.5 * (ground[0] + ground[1]), (ground[1] - ground[0]) / (1.05 * b)
        vy, s = -0.15 * v * w, t + 0.5 * STEP - 17.234
        if 0.0 < s < 0.3:
            profile = (1.0 - math.cos(2.0 * math.pi * s / 0.3)) / 0.3
            v, w = v + 0.05 * profile, w - 0.2 * profile
        middle = th + 0.5 * w * STEP
        x += STEP * (v * math.cos(middle) - vy * math.sin(middle))
        y += STEP * (v * math.sin(middle) + vy * math.cos(middle))
        th += STEP * w
    return out


def test_all_plant_effects_at_once_in_their_order(wild: Run) -> None:
    assert wild.commands is not None and wild.truth is not None
    truth = dataclasses.replace(wild.truth, **{c: getattr(wild.truth, c)[:1001] for c in ("t", "x", "y", "theta")})
    wheels = dataclasses.replace(wild.wheels, t=truth.t, left=truth.t, right=truth.t)  # type: ignore[type-var]
    run = dataclasses.replace(wild, imu=None, beacon=None, ranges=None, truth=truth, wheels=wheels)
    ours = simulate(run, EVERYTHING, 0, noise=False)
    t = np.arange(0.0, 50.1, STEP) - 0.07
    v, w = (np.interp(t, wild.commands.t, c) for c in (wild.commands.v, wild.commands.w))
    theirs = small_steps(np.column_stack((v - 0.16 * w, v + 0.16 * w)), 0.32, truth.t)
    assert ours.truth is not None and ours.wheels is not None
    assert ours.truth.x is not None and ours.truth.y is not None and ours.truth.theta is not None
    np.testing.assert_allclose(0.075 * ours.wheels.left, theirs[:, 3], atol=2e-4)
    np.testing.assert_allclose(0.075 * ours.wheels.right, theirs[:, 4], atol=2e-4)
    np.testing.assert_allclose(ours.truth.theta, theirs[:, 2], atol=1e-3)
    np.testing.assert_allclose(ours.truth.x, theirs[:, 0], atol=2e-3)
    np.testing.assert_allclose(ours.truth.y, theirs[:, 1], atol=2e-3)


def plausible(p: Parameter) -> st.SearchStrategy[float | str]:
    """Values over a parameter's range, near neutral as often as far from it."""
    if p.text:
        return st.just("B2")
    if p.name in ("x", "y") and p.high > 100.0:
        return st.floats(2.0, 7.0)
    low, high, neutral = max(p.low, -10.0), min(p.high, 60.0), float(p.neutral)
    anywhere = st.floats(low, high)
    if not math.isfinite(neutral) or not low <= neutral <= high:
        return anywhere
    return st.one_of(anywhere, st.floats(-6.0, 0.0).map(lambda e: neutral + (high - neutral) * 10.0**e))


SETS = st.fixed_dictionaries(
    {},
    optional={e.id: st.fixed_dictionaries({p.name: plausible(p) for p in e.parameters}) for e in EFFECTS.values()},
)


@given(effects=SETS)
@settings(max_examples=60, deadline=None)
def test_any_plausible_values_settle(effects: EffectSet, wild: Run) -> None:
    par = P.pack(wild.meta, effects)
    out, nodes = simulate_sets(prepare(wild), par[None, :])
    assert 0 < nodes[0] < 80_000  # six thousand IMU samples; a lag of milliseconds wants a piece per millisecond
    for name in ("left", "right", "gz", "ax", "ay", "x", "y", "theta"):
        assert np.isfinite(getattr(out, name)).all(), name


def test_a_mirrored_drive_swaps_the_wheels() -> None:
    """Events of one wheel cut the other's pieces, often at the same instant: neither side may come first."""
    drive: EffectSet = {
        "command_delay": {"delay": 0.05}, "motor_lag": {"tau": 0.08}, "speed_limit": {"v_max": 0.65},
        "accel_limit": {"a_max": 0.4}, "deadband": {"width": 0.02}, "battery_sag": {"rate": 1e-4},
        "wheel_slip": {"k": 0.05}, "side_slip": {"k": 0.05},
    }  # fmt: skip
    run = SCENARIOS["mission"].run(Rates(imu=0, beacon=0, ranges=0))
    assert run.commands is not None
    run = dataclasses.replace(run, meta=dataclasses.replace(run.meta, start=Pose()))
    other = dataclasses.replace(run, commands=dataclasses.replace(run.commands, w=-run.commands.w))
    a, b = (simulate(r, drive, 0, noise=False) for r in (run, other))
    assert a.wheels is not None and b.wheels is not None and a.truth is not None and b.truth is not None
    np.testing.assert_allclose(a.wheels.left, b.wheels.right, rtol=0, atol=1e-12)
    np.testing.assert_allclose(a.wheels.right, b.wheels.left, rtol=0, atol=1e-12)
    for column, sign in (("x", 1.0), ("y", -1.0), ("theta", -1.0)):
        np.testing.assert_allclose(getattr(a.truth, column), sign * getattr(b.truth, column), rtol=0, atol=1e-12)


def test_cache_key_covers_every_kernel() -> None:
    """numba keeps compiled entry points on disk; their key must see each file whose code is compiled into them."""
    room = Path(core.simulation.__file__).parent
    assert set(_batch_numba.KERNELS) == {p.name for p in room.glob("*_numba.py")} - {"_batch_numba.py"} | {"params.py"}


def test_a_cropped_run_begins_with_its_first_command(wild: Run) -> None:
    """Cropping drops the start; nothing may drive between t = 0 and the crop."""
    cropped = wild.crop(25.0, 50.0)
    assert cropped.meta.start is None
    out = simulate(cropped, {}, 0, noise=False)
    whole = simulate(wild, {}, 0, noise=False)
    assert out.truth is not None and whole.truth is not None and out.imu is not None and whole.imu is not None
    assert out.truth.theta is not None and whole.truth.theta is not None and out.truth.x is not None
    kept = (whole.truth.t >= 25.0) & (whole.truth.t <= 50.0)
    moved = whole.truth.theta[kept]
    assert cropped.commands is not None and wild.commands is not None
    late = out.truth.t >= cropped.commands.t[0]
    assert (out.truth.x[~late] == 0.0).all() and (out.truth.theta[~late] == 0.0).all()
    late &= out.truth.t <= cropped.commands.t[-1]
    np.testing.assert_allclose(np.diff(out.truth.theta[late]), np.diff(moved[late]), atol=1e-9)
    steady = (out.imu.t > cropped.commands.t[0] + 0.02) & (out.imu.t < cropped.commands.t[-1])
    inside = (whole.imu.t >= 25.0) & (whole.imu.t <= 50.0)
    np.testing.assert_allclose(out.imu.gz[steady], whole.imu.gz[inside][steady], atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_seed_of_any_size_is_fine(seed: int, wild: Run) -> None:
    assert simulate(wild, {}, seed * 10**12).imu is not None
