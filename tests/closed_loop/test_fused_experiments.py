"""The paper's experiments through `fused` and `smoothed`: MuJoCo's robot in its worlds, fixes without heading."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from core.estimation import estimate
from core.estimation.result import Estimate
from core.metrics import PoseErrors, evaluate
from tests.plants.mujoco_worlds import Sensors, World, world


def through(name: str, seed: int, method: str = "fused") -> tuple[World, Estimate, PoseErrors]:
    made = world(name, seed)
    assert made.run.truth is not None and made.run.beacon is not None
    found = estimate(dataclasses.replace(made.run, beacon=dataclasses.replace(made.run.beacon, theta=None)), method)
    return made, found, evaluate(found.trajectory, made.run.truth)


def degrees(angle: float | None) -> float:
    assert angle is not None
    return float(np.degrees(angle))


@pytest.mark.parametrize("seed", [0, 1], ids=["lost", "lying"])
def test_under_the_glass(seed: int) -> None:
    _, found, errors = through("glass", seed)
    assert errors.ate_rmse_m is not None and errors.ate_rmse_m < 0.05
    assert errors.max_m is not None and errors.max_m < 0.15
    assert degrees(errors.heading_rmse_rad) < 2.0
    assert "beacon_loss" in {event.kind for event in found.events}
    assert ("beacon_lying" in {event.kind for event in found.events}) == (seed == 1)
    assert "kidnap" not in {event.kind for event in found.events}


def test_ranges_that_lie_together_are_not_believed() -> None:
    """Under the glass all four beacons' ranges are those of a tag some decimetres away."""
    made = world("glass", 1, Sensors(fixes=False, ranges=True))
    assert made.run.truth is not None
    found = estimate(made.run, "fused")
    errors = evaluate(found.trajectory, made.run.truth)
    assert errors.ate_rmse_m is not None and errors.ate_rmse_m < 0.05
    assert errors.max_m is not None and errors.max_m < 0.15
    assert "beacon_lying" in {event.kind for event in found.events}


@pytest.mark.parametrize("seed", range(5))
def test_obstacle_is_crossed_within_two_centimetres(seed: int) -> None:
    _, found, errors = through("obstacle", seed)
    assert errors.ate_rmse_m is not None and errors.ate_rmse_m < 0.05
    assert errors.final_m is not None and errors.final_m < 0.02
    assert degrees(errors.final_rad) < 1.0
    assert {"collision", "slip"} & {event.kind for event in found.events}


def test_spinning_against_a_wall_is_not_driving() -> None:
    _, _, errors = through("wall", 0)
    assert errors.ate_rmse_m is not None and errors.ate_rmse_m < 0.03
    assert errors.final_m is not None and errors.final_m < 0.02


def test_a_carried_robot_is_found() -> None:
    made, found, errors = through("carried", 0)
    set_down = next(mark.t1 for mark in made.marks if mark.kind == "carried")
    late = errors.t > set_down + 3.0
    assert errors.error_xy[late].max() < 0.05
    assert degrees(float(np.abs(errors.error_theta[late]).max())) < 5.0
    assert degrees(float(np.abs(errors.error_theta[errors.t > set_down + 6.0]).max())) < 2.0
    kidnap = next(event for event in found.events if event.kind == "kidnap")
    assert abs(kidnap.t1 - set_down) < 1.0


@pytest.mark.parametrize(("name", "bound"), [("glass", 0.02), ("obstacle", 0.02)])
def test_hindsight_helps(name: str, bound: float) -> None:
    errors = through(name, 0, "smoothed")[2]
    assert errors.ate_rmse_m is not None and errors.ate_rmse_m < bound
