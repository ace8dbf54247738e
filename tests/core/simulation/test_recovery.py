"""What is injected is what is found: least squares on the expected readings for effects of the plant and sensors,
the spread of the residuals for those that only add noise.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import numpy.typing as npt
import pytest
from scipy.optimize import least_squares

from core.effects import EFFECTS
from core.robot import EffectSet
from core.run import Run
from core.simulation import simulate, simulate_many

from .values import TELLING

Array = npt.NDArray[np.float64]

NOISE = sorted(name for name, effect in EFFECTS.items() if effect.noise_only)
SMOOTH = sorted(name for name, effect in EFFECTS.items() if effect.smooth and not effect.noise_only)
SCANNED = sorted(name for name, effect in EFFECTS.items() if not effect.smooth and not effect.noise_only)
START: dict[str, dict[str, float]] = {"gyro_drift": {"amplitude": 1e-3, "tau": 60.0}}
SCANS: dict[str, dict[str, Array]] = {
    "command_delay": {"delay": np.linspace(0.0, 0.3, 16)},
    "deadband": {"width": np.linspace(0.0, 0.2, 41)},
    "speed_limit": {"v_max": np.linspace(0.3, 0.9, 25)},
    "accel_limit": {"a_max": np.geomspace(0.1, 2.0, 25)},
    "gyro_clip": {"limit": np.linspace(0.3, 1.5, 25)},
    "bump": {"time": np.arange(0.0, 60.0, 0.1)},
    "slip_patch": {"radius": np.linspace(0.3, 0.8, 11)},
}
"""Where effects that aren't smooth at neutral are looked for first."""


def residual(run: Run, seen: Array, sets: list[EffectSet]) -> Array:
    """(B, rows) predicted minus seen, in about the data sheet's sigmas."""
    out = simulate_many(run, sets)
    parts = (out.left / 1e-3, out.right / 1e-3, out.gz / 1e-3, out.ax / 1e-2, out.ay / 1e-2)
    parts += (out.beacon_x / 0.03, out.beacon_y / 0.03, out.beacon_theta / 0.02, out.range / 0.05)
    return np.nan_to_num(np.hstack((*parts, out.x / 1e-3, out.y / 1e-3, out.theta / 1e-3)) - seen)


def fit(run: Run, name: str, seen: Array, start: dict[str, float], fixed: dict[str, float | str]) -> dict[str, float]:
    names, x0 = list(start), np.array(list(start.values()))
    low, high = (np.array([getattr(EFFECTS[name].parameter(p), side) for p in names]) for side in ("low", "high"))
    step = 1e-5

    def sets(points: Array) -> list[EffectSet]:
        return [{name: {**fixed, **dict(zip(names, map(float, x), strict=True))}} for x in points]

    def jacobian(x: Array) -> Array:
        points = np.clip(x + step * np.vstack((np.eye(len(x)), -np.eye(len(x)))), low, high)
        r = residual(run, seen, sets(points))
        half = len(x)
        return np.column_stack([(r[i] - r[half + i]) / (points[i, i] - points[half + i, i]) for i in range(half)])

    result = least_squares(
        lambda x: residual(run, seen, sets(x[None, :]))[0], x0, jac=jacobian, bounds=(low, high), x_scale="jac",
        xtol=1e-12, ftol=1e-12, gtol=1e-12,
    )  # fmt: skip
    return dict(zip(names, map(float, result.x), strict=True))


def numbers(name: str) -> dict[str, float]:
    return {k: float(v) for k, v in TELLING[name].items() if not isinstance(v, str)}


@pytest.mark.parametrize("name", SMOOTH)
def test_smooth_effects_are_found_from_neutral(name: str, wild: Run) -> None:
    seen = residual(wild, np.zeros(1), [{name: TELLING[name]}])[0]
    fixed = {k: v for k, v in TELLING[name].items() if isinstance(v, str)}
    neutral = {p.name: float(p.neutral) for p in EFFECTS[name].parameters if not p.text}
    found = fit(
        wild, name, seen, START.get(name, {**neutral, **({"x": 1e-4} if name == "anchor_moved" else {})}), fixed
    )
    for parameter, value in numbers(name).items():
        assert found[parameter] == pytest.approx(value, rel=1e-3, abs=1e-6), parameter


@pytest.mark.parametrize("name", SCANNED)
def test_the_rest_are_found_from_a_scan(name: str, wild: Run) -> None:
    true = TELLING[name]
    seen = residual(wild, np.zeros(1), [{name: true}])[0]
    ((parameter, grid),) = SCANS[name].items()
    candidates: list[EffectSet] = [{name: {**true, parameter: float(value)}} for value in grid]
    misfit = [float(np.sum(np.square(residual(wild, seen, [one])))) for one in candidates]
    start = {**numbers(name), parameter: float(grid[int(np.argmin(misfit))])}
    found = fit(wild, name, seen, start, {})
    for key, value in numbers(name).items():
        assert found[key] == pytest.approx(value, rel=1e-3, abs=1e-4), key


def errors(run: Run, effects: EffectSet, seed: int) -> dict[str, Array]:
    """Readings with noise minus those without, by column; rows that both have."""
    noisy, clean = simulate(run, effects, seed), simulate(run, effects, seed, noise=False)
    return {
        f"{s}.{c}": np.asarray(v) - np.asarray(clean.logs()[s].columns()[c])
        for s, log in noisy.logs().items()
        for c, v in log.columns().items()
    }


@pytest.mark.parametrize("name", NOISE)
def test_noise_is_found_in_the_spread(name: str, wild: Run) -> None:
    values, sheet = numbers(name), wild.meta.noise
    assert sheet.gyro_density and sheet.accel_density and sheet.beacon_xy and sheet.range and wild.imu is not None
    found = errors(wild, {name: TELLING[name]}, 11)
    white = sheet.gyro_density * math.sqrt(50.0)
    if name == "gyro_noise":
        assert np.std(found["imu.gz"]) / white == pytest.approx(values["factor"], rel=0.04)
    elif name == "gyro_walk":
        gyro_only = dataclasses.replace(wild, wheels=None, beacon=None, ranges=None, truth=None)
        noisy = [simulate(gyro_only, {name: TELLING[name]}, seed).imu for seed in range(200)]
        sd30, sd60 = np.std([imu.gz[[2999, 5999]] for imu in noisy if imu is not None], axis=0)
        assert sd60 == pytest.approx(values["density"] * math.sqrt(60.0), rel=0.2)
        assert sd60 / sd30 == pytest.approx(math.sqrt(2.0), rel=0.2)
    elif name == "vibration":
        speed = simulate_many(wild, [{}]).speed[0]
        extra = np.square(found["imu.ax"]) - 50.0 * sheet.accel_density**2
        assert math.sqrt(np.sum(extra) / np.sum(speed**2)) == pytest.approx(values["k"], rel=0.05)
        assert np.std(found["imu.ax"][np.abs(speed) < 1e-6]) < 1.2 * sheet.accel_density * math.sqrt(50.0)
    elif name == "beacon_noise":
        assert np.std(found["beacon.x"]) / sheet.beacon_xy == pytest.approx(values["factor"], rel=0.15)
        assert np.std(found["ranges.range"]) / sheet.range == pytest.approx(values["factor"], rel=0.15)
    elif name == "beacon_outliers":
        plain = errors(wild, {}, 11)
        extra = found["beacon.x"] - plain["beacon.x"]
        hit = extra != 0.0
        assert np.mean(hit) == pytest.approx(values["rate"], abs=0.06)
        assert np.std(extra[hit]) == pytest.approx(values["size"], rel=0.25)
        assert np.array_equal(hit, found["beacon.y"] != plain["beacon.y"])
        assert np.array_equal(found["beacon.theta"], plain["beacon.theta"])
    else:
        shadow = simulate(wild, {name: TELLING[name]}, 11, noise=False).beacon
        everywhere = simulate(wild, {}, 11, noise=False).beacon
        assert name == "beacon_shadow" and shadow is not None and everywhere is not None
        away = np.hypot(everywhere.x - values["x"], everywhere.y - values["y"])
        seen = np.isin(everywhere.t, shadow.t)
        assert away[~seen].max() < values["radius"] <= away[seen].min()
