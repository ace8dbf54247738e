"""The paper's experiments, whole: MuJoCo's robot in its worlds and the product's own simulator, then `published`."""

from __future__ import annotations

import numpy as np
import pytest

from core.estimation import estimate
from core.estimation.result import Estimate
from core.metrics import PoseErrors, evaluate
from tests.plants.mujoco_worlds import Sensors, World, world
from tests.plants.own_worlds import own_world


def through(made: World, method: str = "published") -> tuple[Estimate, PoseErrors]:
    assert made.run.truth is not None
    found = estimate(made.run, method)
    return found, evaluate(found.trajectory, made.run.truth)


def at_rest(errors: PoseErrors) -> tuple[float, float]:
    """cm and degrees at the end."""
    assert errors.final_m is not None and errors.final_rad is not None
    return 100 * errors.final_m, float(np.degrees(errors.final_rad))


@pytest.mark.parametrize("seed", range(5))
def test_obstacle_costs_the_encoders_metres_and_the_paper_centimetres(seed: int) -> None:
    made = world("obstacle", seed)
    metres, degrees = at_rest(through(made, "encoders")[1])
    assert 100 < metres < 260
    assert 80 < degrees < 140
    found, errors = through(made)
    centimetres, degrees = at_rest(errors)
    assert centimetres < 5.3
    assert degrees < 5.0
    spin = next(mark for mark in made.marks if mark.kind == "spin")
    slip = next(event for event in found.events if event.kind == "slip")
    assert abs(slip.t0 - spin.t0) < 0.3
    assert any(event.kind in ("collision", "bounce") and event.t0 < spin.t1 for event in found.events)
    assert any(event.kind == "replacement" for event in found.events)


@pytest.mark.parametrize("sensors", [Sensors(), Sensors(fixes=False, ranges=True)], ids=["fixes", "ranges"])
@pytest.mark.parametrize("seed", [0, 1], ids=["lost", "lying"])
def test_under_the_glass_the_path_is_kept(seed: int, sensors: Sensors) -> None:
    made = world("glass", seed, sensors)
    found, errors = through(made)
    assert errors.max_m is not None and errors.max_m < 0.10
    plate = made.marks[0]
    loss = max((event for event in found.events if event.kind == "beacon_loss"), key=lambda e: e.t1 - e.t0)
    assert loss.t0 == pytest.approx(plate.t0, abs=1.3)
    assert loss.t1 == pytest.approx(plate.t1, abs=1.3)
    assert at_rest(errors)[0] < 5.3


def test_spinning_against_a_wall_moves_nothing() -> None:
    made = world("wall", 0)
    found, errors = through(made)
    assert errors.max_m is not None and errors.max_m < 0.15
    assert {"slip", "collision"} <= {event.kind for event in found.events}
    assert errors.final_m is not None and errors.final_m < 0.053


def test_carried_robot_is_found_after_it_is_set_down() -> None:
    made = world("carried", 0)
    set_down = next(mark.t1 for mark in made.marks if mark.kind == "carried")
    _, errors = through(made)
    assert errors.error_xy[errors.t < set_down].max() > 0.5
    assert errors.error_xy[errors.t > set_down + 1.5].max() < 0.053


@pytest.mark.parametrize("name", ["glass", "obstacle", "thrown"])
def test_own_simulator_tells_the_same(name: str) -> None:
    made = own_world(name, 0)
    _, errors = through(made)
    centimetres, degrees = at_rest(errors)
    assert centimetres < 5.3
    assert degrees < 5.0
    end = max(mark.t1 for mark in made.marks)
    assert errors.error_xy[errors.t > end + 1.5].max() < 0.10
