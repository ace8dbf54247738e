"""Errors of a path: known answers, agreement with evo, and honest counting."""

from __future__ import annotations

import numpy as np
import pytest
from evo.core import metrics as evo_metrics
from evo.core.trajectory import PoseTrajectory3D

from core.errors import NotEnoughDataError, ParameterError
from core.geometry import compose
from core.metrics import chi2_band, evaluate, match, nees
from core.metrics.pose_error import pairs_apart
from core.sensors import TruthLog
from core.trajectory import Trajectory


def wobble(seed: int = 0, n: int = 400, dt: float = 0.05) -> tuple[Trajectory, TruthLog]:
    """A curved truth and a path that wanders off it, on the same stamps."""
    rng = np.random.default_rng(seed)
    t = np.arange(n) * dt
    theta = 0.4 * t + 0.3 * np.sin(t)
    x, y = np.cumsum(0.4 * dt * np.cos(theta)), np.cumsum(0.4 * dt * np.sin(theta))
    off = np.cumsum(0.003 * rng.standard_normal((n, 3)), axis=0)
    return Trajectory(t, x + off[:, 0], y + off[:, 1], theta + off[:, 2]), TruthLog(t, x, y, theta)


def evo_path(t: np.ndarray, x: np.ndarray, y: np.ndarray, theta: np.ndarray) -> PoseTrajectory3D:
    zero = np.zeros_like(t)
    return PoseTrajectory3D(
        positions_xyz=np.column_stack((x, y, zero)),
        orientations_quat_wxyz=np.column_stack((np.cos(theta / 2), zero, zero, np.sin(theta / 2))),
        timestamps=t,
    )


def evo_pair(path: Trajectory, truth: TruthLog) -> tuple[PoseTrajectory3D, PoseTrajectory3D]:
    assert truth.x is not None and truth.y is not None and truth.theta is not None
    return evo_path(truth.t, truth.x, truth.y, truth.theta), evo_path(path.t, path.x, path.y, path.theta)


def evo_rmse(metric: evo_metrics.PE, pair: tuple[PoseTrajectory3D, PoseTrajectory3D]) -> float:
    metric.process_data(pair)
    return float(metric.get_statistic(evo_metrics.StatisticsType.rmse))


@pytest.mark.parametrize("seed", range(3))
def test_absolute_errors_agree_with_evo(seed: int) -> None:
    path, truth = wobble(seed)
    ours, theirs = evaluate(path, truth), evo_pair(path, truth)
    relation = evo_metrics.PoseRelation
    assert ours.ate_rmse_m == pytest.approx(evo_rmse(evo_metrics.APE(relation.translation_part), theirs), rel=1e-9)
    assert ours.heading_rmse_rad == pytest.approx(
        evo_rmse(evo_metrics.APE(relation.rotation_angle_rad), theirs), rel=1e-6
    )


@pytest.mark.parametrize("seed", range(3))
def test_errors_after_alignment_agree_with_evo(seed: int) -> None:
    path, truth = wobble(seed)
    turned = compose(np.array((4.0, -2.0, 1.1)), path.pose)
    moved = Trajectory(path.t, *turned.T.copy())
    reference, theirs = evo_pair(moved, truth)
    theirs.align(reference)
    ours = evaluate(moved, truth, alignment="se2")
    ape = evo_metrics.APE(evo_metrics.PoseRelation.translation_part)
    assert ours.alignment.name == "se2"
    assert ours.ate_rmse_m == pytest.approx(evo_rmse(ape, (reference, theirs)), rel=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_relative_errors_per_second_agree_with_evo(seed: int) -> None:
    path, truth = wobble(seed)
    ours, theirs = evaluate(path, truth).rpe["s"], evo_pair(path, truth)
    relation, frames = evo_metrics.PoseRelation, evo_metrics.Unit.frames
    parts = (
        (relation.translation_part, ours.translation_rmse_m),
        (relation.rotation_angle_rad, ours.rotation_rmse_rad),
    )
    for part, found in parts:
        reference = evo_metrics.RPE(part, delta=20, delta_unit=frames, all_pairs=True)
        assert found == pytest.approx(evo_rmse(reference, theirs), rel=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_relative_errors_per_metre_agree_with_evo(seed: int) -> None:
    """With a last pose far off, so that evo too ends where a whole metre no longer follows."""
    path, truth = wobble(seed)
    assert truth.x is not None and truth.y is not None and truth.theta is not None
    far = [np.append(c, c[-1] + 50.0) for c in (truth.t, truth.x, truth.y)]
    path = Trajectory(far[0], *(np.append(c, c[-1] + 50.0) for c in (path.x, path.y)), np.append(path.theta, 0.0))
    truth = TruthLog(*far, np.append(truth.theta, 0.0))
    ours, theirs = evaluate(path, truth).rpe["m"], evo_pair(path, truth)
    relation, metres = evo_metrics.PoseRelation, evo_metrics.Unit.meters
    parts = (
        (relation.translation_part, ours.translation_rmse_m),
        (relation.rotation_angle_rad, ours.rotation_rmse_rad),
    )
    for part, found in parts:
        reference = evo_metrics.RPE(
            part, delta=1.0, delta_unit=metres, rel_delta_tol=0.1, all_pairs=True, pairs_from_reference=True
        )
        assert found == pytest.approx(evo_rmse(reference, theirs), rel=1e-6)


def test_a_known_offset_gives_known_errors() -> None:
    t = np.linspace(0, 10, 101)
    truth = TruthLog(t, 0.5 * t, np.zeros(101), np.zeros(101))
    path = Trajectory(t, 0.5 * t + 0.3, np.full(101, 0.4), np.full(101, 2 * np.pi + 0.1))
    errors = evaluate(path, truth)
    assert errors.ate_rmse_m == pytest.approx(0.5)
    assert errors.final_m == pytest.approx(0.5)
    assert errors.max_m == pytest.approx(0.5)
    assert errors.heading_rmse_rad == pytest.approx(0.1)
    assert errors.heading_max_rad == pytest.approx(0.1)
    np.testing.assert_allclose(errors.error_along, 0.3)
    np.testing.assert_allclose(errors.error_across, 0.4)
    assert errors.rpe["m"].translation_rmse_m == pytest.approx(2 * np.sin(0.05), rel=1e-6)  # a metre in a turned frame
    assert errors.alignment.name == "none"


def test_drift_per_metre_of_a_scaled_path_is_its_scale() -> None:
    t = np.linspace(0, 20, 401)
    truth = TruthLog(t, 0.5 * t, np.zeros(401), np.zeros(401))
    errors = evaluate(Trajectory(t, 0.51 * t, np.zeros(401), np.zeros(401)), truth)
    assert errors.rpe["m"].translation_rmse_m == pytest.approx(0.02, rel=1e-6)
    assert errors.rpe["s"].translation_rmse_m == pytest.approx(0.01, rel=1e-6)


def test_truth_without_heading_gives_position_only() -> None:
    path, truth = wobble()
    errors = evaluate(path, TruthLog(truth.t, truth.x, truth.y))
    assert errors.ate_rmse_m is not None and errors.final_m is not None
    assert errors.heading_rmse_rad is None and errors.final_rad is None and not errors.rpe
    assert np.isnan(errors.error_theta).all() and np.isnan(errors.error_along).all()


def test_truth_of_heading_only_gives_heading_only() -> None:
    path, truth = wobble()
    errors = evaluate(path, TruthLog(truth.t, theta=truth.theta))
    assert errors.ate_rmse_m is None and errors.max_m is None
    assert errors.heading_rmse_rad is not None and errors.matched == len(truth)


def test_a_path_without_heading_is_still_judged_by_position() -> None:
    path, truth = wobble()
    errors = evaluate(Trajectory(path.t, path.x, path.y, np.full(len(path), np.nan)), truth)
    assert errors.ate_rmse_m is not None and errors.heading_rmse_rad is None


def test_stamps_before_and_after_the_path_are_counted() -> None:
    path, truth = wobble()
    short = Trajectory(path.t[50:350], path.x[50:350], path.y[50:350], path.theta[50:350])
    errors = evaluate(short, truth)
    assert (errors.matched, errors.unmatched_outside, errors.unmatched_in_pauses) == (300, 100, 0)
    assert errors.unmatched == 100


def test_stamps_inside_a_pause_of_the_path_are_counted_not_invented() -> None:
    path, truth = wobble()
    kept = np.r_[0:100, 160:400]  # a pause of 3 s
    errors = evaluate(Trajectory(path.t[kept], path.x[kept], path.y[kept], path.theta[kept]), truth)
    assert errors.unmatched_in_pauses == 60
    assert errors.matched + errors.unmatched == len(truth)


def test_the_path_is_interpolated_at_the_stamps_of_the_truth() -> None:
    t = np.arange(0, 10, 0.5)
    found = match(Trajectory(t, t, 2 * t, 0.1 * t), TruthLog(np.array([1.25]), np.zeros(1), np.zeros(1), np.zeros(1)))
    np.testing.assert_allclose(found.path, [[1.25, 2.5, 0.125]])


def test_an_empty_path_matches_nothing() -> None:
    none = np.zeros(0)
    errors = evaluate(Trajectory(none, none, none, none), wobble()[1])
    assert (errors.matched, errors.unmatched) == (0, 400)
    assert errors.ate_rmse_m is None


def test_alignment_by_the_start_moves_the_first_pose_onto_the_truth() -> None:
    path, truth = wobble()
    moved = compose(np.array((1.0, 2.0, -0.4)), path.pose)
    errors = evaluate(Trajectory(path.t, *moved.T.copy()), truth, alignment="start")
    assert errors.error_xy[0] == pytest.approx(0, abs=1e-12)
    assert errors.error_theta[0] == pytest.approx(0, abs=1e-12)


def test_bad_alignments_are_refused() -> None:
    path, truth = wobble()
    with pytest.raises(ParameterError, match="sim3"):
        evaluate(path, truth, alignment="sim3")
    with pytest.raises(NotEnoughDataError):
        evaluate(path, TruthLog(truth.t, theta=truth.theta), alignment="se2")


def test_pairs_of_a_standing_robot_end_at_its_first_pose_there() -> None:
    i, j = pairs_apart(np.array([0.0, 0.5, 1.0, 1.0, 1.0, 1.5, 2.0]), 1.0)
    assert list(zip(i.tolist(), j.tolist(), strict=True)) == [(0, 2), (1, 5), (2, 6), (3, 6), (4, 6)]


def test_every_scalar_is_in_the_summary_with_its_unit() -> None:
    path, truth = wobble()
    summary = evaluate(path, truth).summary()
    assert summary["ate_rmse_m"][1] == "m" and summary["final_rad"][1] == "rad"
    assert all(value is not None for value, _ in summary.values())


def test_nees_of_a_right_claim_is_chi_square() -> None:
    rng = np.random.default_rng(1)
    n = 4000
    P = np.array([[0.02, 0.005, 0.001], [0.005, 0.01, 0.002], [0.001, 0.002, 0.004]])
    error, t = rng.multivariate_normal(np.zeros(3), P, n), np.arange(n) * 0.1
    truth = TruthLog(t, np.sin(t), np.cos(t), 0.1 * t)
    path = Trajectory(t, np.sin(t) + error[:, 0], np.cos(t) + error[:, 1], 0.1 * t + error[:, 2], np.tile(P, (n, 1, 1)))
    found = nees(path, truth)
    assert found is not None and found.dof == 3
    low, high = chi2_band(3, n)
    assert low < found.mean < high
    assert found.inside == pytest.approx(0.95, abs=0.015)


def test_nees_uses_what_the_truth_has() -> None:
    path, truth = wobble()
    claimed = Trajectory(path.t, path.x, path.y, path.theta, np.tile(np.eye(3), (len(path), 1, 1)))
    position = nees(claimed, TruthLog(truth.t, truth.x, truth.y))
    assert position is not None and position.dof == 2
    assert nees(path, truth) is None  # no covariance, no claim


def test_chi_square_band_narrows_with_samples() -> None:
    assert chi2_band(3) == pytest.approx((0.2158, 9.3484), abs=1e-3)
    low, high = chi2_band(3, 50)
    assert 2.3 < low < 3 < high < 3.8
