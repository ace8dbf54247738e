"""The paper's experiments on the product's own simulator, as far as its effects allow: glass, obstacle, a throw.

No wall and no lying beacon: no effect of the simulator holds a body back or moves fixes in one place only.
"""

from __future__ import annotations

import functools
from dataclasses import replace

from core.robot import EffectSet
from core.simulation import simulate
from core.simulation.scenarios import Rates, Scenario, drive, stop, turn
from tests.plants.mujoco_robot import Flaws, Mark, World

HALF_PI = 1.5707963267948966

FLAWS: EffectSet = {
    "unequal_wheels": {"ratio": 1.003},
    "track_width": {"scale": 1.008},
    "gyro_bias": {"bias": 4e-3},
    "gyro_scale": {"scale": 1.005},
    "accel_bias": {"x": 0.04, "y": -0.04},
    "imu_yaw": {"angle": 0.010},
    "vibration": {"k": 0.15},
    "beacon_outliers": {"rate": 0.01, "size": 0.4},
}


def _square_under_glass() -> list:
    return [
        stop(3.0), drive(1.0, 0.4), turn(HALF_PI), drive(0.7, 0.4), drive(1.4, -0.4), drive(0.7, 0.4),
        turn(-HALF_PI), drive(1.0, 0.4), drive(1.0, 0.4), stop(3.0),
    ]  # fmt: skip


def _straight() -> list:
    return [stop(3.0), drive(2.1, 0.3), stop(4.0)]


def _round() -> list:
    return [stop(3.0), drive(2.0, 0.4), stop(4.0), turn(HALF_PI), drive(2.0, 0.4), stop(4.0)]


CASES = {
    "glass": (_square_under_glass, {"beacon_shadow": {"x": 2.7, "y": 1.5, "radius": 0.9}}, None),
    "obstacle": (
        _straight,
        {
            "slip_patch": {"x": 2.65, "y": 1.5, "radius": 0.15, "slip": 0.6},
            "bump": {"time": 7.2, "distance": 0.03, "turn": -0.35},
        },
        Mark("spin", 6.5, 8.5),
    ),
    "thrown": (_round, {"bump": {"time": 10.0, "distance": 1.2, "turn": 1.0}}, Mark("carried", 10.0, 10.3)),
}


@functools.cache
def own_world(name: str, seed: int = 0) -> World:
    """The experiment of that name, made once per process."""
    legs, effects, mark = CASES[name]
    blank = Scenario(name, name, legs).run(Rates(commands=20.0, ranges=0.0, truth=100.0))
    run = simulate(blank, {**FLAWS, **effects}, seed)
    marks = [mark] if mark else []
    if name == "glass" and run.beacon is not None:
        step = run.beacon.t[1:] - run.beacon.t[:-1]
        marks = [Mark("lost", float(run.beacon.t[i]), float(run.beacon.t[i + 1])) for i in (step > 0.5).nonzero()[0]]
    return World(replace(run, meta=replace(run.meta, name=f"own {name} {seed}")), tuple(marks), Flaws())
