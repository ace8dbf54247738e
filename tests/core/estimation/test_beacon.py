"""The beacon system alone: fixes as poses of the body, and positions from rounds of ranges."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from core.errors import NotEnoughDataError
from core.estimation import estimate
from core.metrics import evaluate, nees
from core.sensors import BeaconLog

from .world import Sensors, simulate


def test_fixes_with_heading_give_the_body_not_the_tag() -> None:
    world = simulate(0, sensors=Sensors(fix_xy=1e-4, fix_theta=1e-4))
    errors = evaluate(estimate(world.run, "beacon").trajectory, world.run.truth)
    assert errors.max_m is not None and errors.max_m < 0.02  # the truth is matched between fixes a tenth apart
    assert errors.heading_max_rad is not None and errors.heading_max_rad < 0.01


def test_claimed_noise_of_fixes_is_right() -> None:
    world = simulate(1)
    assert world.run.beacon is not None
    found = estimate(world.run, "beacon").trajectory
    truth = dataclasses.replace(world.run.truth) if world.run.truth else None
    assert truth is not None
    consistency = nees(found, truth.crop(2.0, 58.0))
    assert consistency is not None and consistency.inside > 0.9


def test_fixes_without_heading_leave_it_open_and_say_so() -> None:
    world = simulate(0, sensors=Sensors(fix_theta=None))
    found = estimate(world.run, "beacon")
    assert np.isnan(found.trajectory.theta).all()
    assert any("no heading" in note for note in found.notes)
    assert any("of the tag" in note for note in found.notes)
    errors = evaluate(found.trajectory, world.run.truth)
    assert errors.ate_rmse_m is not None and errors.ate_rmse_m < 0.2  # the tag's arm is 0.11 m
    assert errors.heading_rmse_rad is None


def test_one_row_per_usable_fix() -> None:
    x = np.array([0.0, np.nan, 2.0])
    run = dataclasses.replace(simulate(0, 5.0).run, beacon=BeaconLog(np.array([0.0, 1.0, 2.0]), x, x, x))
    np.testing.assert_array_equal(estimate(run, "beacon").trajectory.t, [0.0, 2.0])
    nothing = dataclasses.replace(run, beacon=BeaconLog(np.array([0.0]), np.array([np.nan]), np.array([1.0])))
    with pytest.raises(NotEnoughDataError, match="no beacon fix"):
        estimate(nothing, "beacon")


def test_ranges_give_positions_within_their_claim() -> None:
    world = simulate(2, sensors=Sensors(fixes=0, ranges=40, range=0.02))
    run = dataclasses.replace(
        world.run, meta=dataclasses.replace(world.run.meta, robot=dataclasses.replace(world.run.meta.robot))
    )
    found = estimate(run, "beacon")
    errors = evaluate(found.trajectory, world.run.truth)
    assert len(found.trajectory) > 50
    assert (
        errors.ate_rmse_m is not None and errors.ate_rmse_m < 0.5
    )  # a round is a second: 0.3 m of driving, and the arm


def test_ranges_at_rest_give_the_tag_exactly() -> None:
    world = simulate(3, 20.0, sensors=Sensors(fixes=0, ranges=40, range=0.01), rest=10.0)
    found = estimate(world.run, "beacon").trajectory
    start = world.truth[0]
    cos, sin = np.cos(start[2]), np.sin(start[2])
    tag = start[:2] + np.array((cos * 0.1 - sin * 0.05, sin * 0.1 + cos * 0.05))
    assert np.abs(np.column_stack((found.x, found.y)) - tag).max() < 0.05
    assert found.sd is not None
    error = (np.column_stack((found.x, found.y)) - tag) / found.sd[:, :2]
    assert 0.5 < np.sqrt(np.mean(error**2)) < 1.5


def test_ranges_that_contradict_each_other_give_no_position() -> None:
    world = simulate(4, 10.0, sensors=Sensors(fixes=0, ranges=40, range=0.01), rest=5.0)
    assert world.run.ranges is not None
    broken = dataclasses.replace(
        world.run.ranges, range=world.run.ranges.range * np.array([1.0, 3.0, 0.2, 2.0])[world.run.ranges.beacon]
    )
    with pytest.raises(NotEnoughDataError, match="disagree"):
        estimate(dataclasses.replace(world.run, ranges=broken), "beacon")
