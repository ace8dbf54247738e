"""Dead reckoning: exact arcs, honest covariance, and the published figures of a real robot."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from core.estimation import estimate
from core.estimation.odometry import arcs, growth
from core.formats import read_run
from core.metrics import evaluate, nees
from core.robot import Pose, RobotParams
from core.run import Run, RunMeta
from core.sensors import ImuLog, WheelLog

from .world import Flaws, Sensors, simulate

DATA = Path(__file__).resolve().parents[2] / "data"


def test_a_circle_is_closed_exactly_however_coarse_the_steps() -> None:
    pose = arcs(np.linspace(0, 2 * np.pi * 0.8, 4), np.linspace(0, 2 * np.pi, 4), (1.0, 2.0, 0.3))
    np.testing.assert_allclose(pose[-1], [1.0, 2.0, 0.3 + 2 * np.pi], atol=1e-12)


def test_turning_on_the_spot_does_not_move() -> None:
    pose = arcs(np.zeros(5), np.linspace(0, 3, 5))
    np.testing.assert_array_equal(pose[:, :2], 0.0)


def test_arcs_are_of_second_order_where_the_curvature_changes() -> None:
    def end(n: int) -> np.ndarray:
        s = np.linspace(0, 4, n + 1)
        return arcs(s, np.sin(1.3 * s))[-1]

    exact = end(1 << 16)
    errors = [np.hypot(*(end(n) - exact)[:2]) for n in (64, 128, 256)]
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    np.testing.assert_allclose(orders, 2.0, atol=0.05)


def test_growth_agrees_with_sampled_steps() -> None:
    rng = np.random.default_rng(0)
    n, samples = 60, 4000
    step, turn = np.full(n, 0.1), 0.05 * np.sin(np.arange(n) / 7)
    sd_d, sd_turn = 0.004, 0.006
    path = arcs(np.concatenate(([0], np.cumsum(step))), np.concatenate(([0], np.cumsum(turn))))
    start = np.diag([1e-4, 2e-4, 3e-5])
    first = rng.multivariate_normal(np.zeros(3), start, samples)
    ends = np.array(
        [
            arcs(
                np.concatenate(([0], np.cumsum(step + sd_d * rng.standard_normal(n)))),
                np.concatenate(([0], np.cumsum(turn + sd_turn * rng.standard_normal(n)))),
                tuple(first[i]),
            )[-1]
            for i in range(samples)
        ]
    )
    claimed = growth(path, np.full(n, sd_d**2), np.full(n, sd_turn**2), start)[-1]
    found = np.cov(ends.T)
    np.testing.assert_allclose(np.diag(claimed), np.diag(found), rtol=0.1)
    correlation = claimed / np.sqrt(np.outer(np.diag(claimed), np.diag(claimed)))
    sampled = found / np.sqrt(np.outer(np.diag(found), np.diag(found)))
    np.testing.assert_allclose(correlation, sampled, atol=0.06)


def test_wheels_alone_follow_a_faultless_robot_to_the_encoder_step() -> None:
    world = simulate(1, sensors=Sensors(imu=0, fixes=0))
    errors = evaluate(estimate(world.run, "encoders").trajectory, world.run.truth)
    assert errors.max_m is not None and errors.max_m < 0.01
    assert errors.heading_max_rad is not None and errors.heading_max_rad < 0.003


def test_wheels_that_start_anywhere_and_count_back_give_the_same_path() -> None:
    run = simulate(1, seconds=20, sensors=Sensors(imu=0, fixes=0)).run
    assert run.wheels is not None
    shifted = dataclasses.replace(run.wheels, left=run.wheels.left - 1e3, right=run.wheels.right + 77.0)
    a = estimate(run, "encoders").trajectory
    b = estimate(dataclasses.replace(run, wheels=shifted), "encoders").trajectory
    np.testing.assert_allclose(a.pose, b.pose, atol=1e-9)


def test_a_start_that_is_not_given_is_the_origin_and_said_to_be() -> None:
    run = simulate(1, seconds=10, sensors=Sensors(imu=0, fixes=0), start_known=False).run
    found = estimate(run, "encoders")
    np.testing.assert_array_equal(found.trajectory.pose[0], 0.0)
    assert any("Start pose unknown" in note for note in found.notes)


@pytest.mark.parametrize("seed", range(3))
def test_the_gyro_bias_is_learnt_at_rest_and_held_while_driving(seed: int) -> None:
    world = simulate(seed, flaws=Flaws(bias=0.008, bias_walk=1e-5), sensors=Sensors(fixes=0))
    found = estimate(world.run, "encoders+gyro")
    bias = found.gyro_bias
    assert bias is not None and bias.sd is not None
    assert abs(bias.value[-1] - 0.008) < 5 * bias.sd[-1] + 5e-4
    assert bias.value[0] == 0.0
    driving = (bias.t > 10) & (bias.t < 50)
    assert np.ptp(bias.value[driving]) == 0.0
    errors = evaluate(found.trajectory, world.run.truth)
    assert errors.heading_max_rad is not None and errors.heading_max_rad < 0.06  # uncorrected: 0.48


def test_heading_is_held_at_rest() -> None:
    t = np.arange(0, 20, 0.01)
    rng = np.random.default_rng(0)
    still = np.arange(0, 20, 0.02)
    run = Run(
        RunMeta(robot=RobotParams(0.075, 0.32, 2048), start=Pose()),
        wheels=WheelLog(still, np.zeros(1000), np.zeros(1000)),
        imu=ImuLog(t, 0.01 + 0.002 * rng.standard_normal(2000)),
    )
    for method in ("encoders+gyro", "fused"):
        found = estimate(run, method).trajectory
        late = found.theta[found.t > 2.0]
        assert np.ptp(late) < 1e-4, method
        assert abs(found.theta[-1]) < 0.01, method


def test_a_dead_encoder_is_not_rest() -> None:
    """After three seconds at rest the body swings while the wheels report nothing: the heading follows the gyro."""
    t = np.arange(0, 20, 0.01)
    rate = np.where(t > 3, 0.5 * np.sin(2 * np.pi * 0.3 * (t - 3)), 0.0)
    run = Run(
        RunMeta(robot=RobotParams(0.075, 0.32, 2048), start=Pose()),
        wheels=WheelLog(t[::2], np.zeros(1000), np.zeros(1000)),
        imu=ImuLog(t, rate + 0.001 * np.random.default_rng(1).standard_normal(2000)),
    )
    for method in ("encoders+gyro", "fused"):
        found = estimate(run, method).trajectory
        assert np.ptp(found.theta) == pytest.approx(np.ptp(np.cumsum(rate) * 0.01), rel=0.05), method


def test_gyro_readings_that_are_missing_are_bridged() -> None:
    run = simulate(3, seconds=30, sensors=Sensors(fixes=0)).run
    assert run.imu is not None
    gz = np.array(run.imu.gz)
    gz[500:520] = np.nan
    holed = dataclasses.replace(run, imu=dataclasses.replace(run.imu, gz=gz))
    for method in ("encoders+gyro", "fused"):
        a, b = estimate(run, method).trajectory, estimate(holed, method).trajectory
        assert len(a) == len(b)
        np.testing.assert_allclose(a.theta, b.theta, atol=0.02)


def passes(folder: Path) -> list[Run]:
    return [read_run(path) for path in sorted(folder.glob("run-*"))]


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "distance", "degrees"), [("optiodom-circle-a", 0.162, 14.5), ("optiodom-square-a", 0.201, 7.7)]
)
def test_published_errors_before_calibration(shared_data: Path, name: str, distance: float, degrees: float) -> None:
    """Sousa et al. 2022: the largest distance and heading difference to the truth at any time of any pass of a set."""
    errors = [evaluate(estimate(run, "encoders").trajectory, run.truth) for run in passes(shared_data / "real" / name)]
    assert len(errors) == 6
    assert max(e.max_m or 0.0 for e in errors) == pytest.approx(distance, abs=5e-4)
    assert np.degrees(max(e.heading_max_rad or 0.0 for e in errors)) == pytest.approx(degrees, abs=0.05)


def test_a_recorded_circle_is_reckoned_within_its_claim() -> None:
    run = read_run(DATA / "optiodom-circle")
    assert run.truth is not None
    found = estimate(run, "encoders").trajectory
    errors, consistency = evaluate(found, run.truth), nees(found, run.truth)
    assert errors.max_m is not None and 0.01 < errors.max_m < 0.17
    assert errors.heading_max_rad is not None and np.degrees(errors.heading_max_rad) < 14.6
    assert consistency is not None and consistency.inside > 0.9
