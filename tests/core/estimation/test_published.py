"""`published`: the paper's equations against known answers, and each decision of its flow chart, seen from outside."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.errors import MissingStreamError
from core.estimation import available, estimate
from core.estimation.published import Decisions, navigate
from core.estimation.published.kalman import PoseFilter
from core.estimation.published.reckoning import Reckoning, motion
from core.estimation.published.signals import lowpass, offsets
from core.estimation.published.substitution import Steps
from core.geometry import compose
from core.metrics import evaluate
from core.robot import Pose
from core.run import Run
from core.sensors import BeaconLog, WheelLog
from core.simulation import simulate
from core.simulation.scenarios import Rates, Scenario, drive, stop, turn


def a_run(seed: int = 1, *, ranges: float = 0.0, beacon: float = 10.0) -> Run:
    """Straight, a turn, straight; rests at both ends: 17 s."""
    legs = [stop(3.0), drive(1.2, 0.4), turn(1.2), drive(1.2, 0.4), stop(2.0)]
    blank = Scenario("test", "test", lambda: legs).run(Rates(commands=20.0, beacon=beacon, ranges=ranges))
    return simulate(blank, {"gyro_bias": {"bias": 4e-3}, "accel_bias": {"x": 0.04, "y": -0.04}}, seed)


@pytest.fixture(scope="module")
def run() -> Run:
    return a_run()


def spinning(run: Run, t0: float, t1: float, extra: float) -> Run:
    """The same run whose wheels turn `extra` rad/s faster from t0 to t1: the body does not."""
    wheels = run.wheels
    assert wheels is not None
    more = extra * np.clip(wheels.t - t0, 0.0, t1 - t0)
    return dataclasses.replace(run, wheels=WheelLog(wheels.t, wheels.left + more, wheels.right + more))


def without_fixes(run: Run, t0: float, t1: float) -> Run:
    log = run.beacon
    assert log is not None and log.theta is not None
    kept = (log.t < t0) | (log.t > t1)
    return dataclasses.replace(run, beacon=BeaconLog(log.t[kept], log.x[kept], log.y[kept], log.theta[kept]))


def shifted(run: Run, t0: float, t1: float, by: float) -> Run:
    log = run.beacon
    assert log is not None
    x = np.where((log.t > t0) & (log.t < t1), log.x + by, log.x)
    return dataclasses.replace(run, beacon=BeaconLog(log.t, x, log.y, log.theta))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda run: dataclasses.replace(run, wheels=None), "no wheels stream"),
        (lambda run: dataclasses.replace(run, imu=dataclasses.replace(run.imu, ay=None)), r"no imu\.ay"),
        (lambda run: dataclasses.replace(run, beacon=None), "neither beacon fixes nor ranges"),
    ],
)
def test_says_what_it_needs(run: Run, change, reason: str) -> None:  # type: ignore[no-untyped-def]
    lacking = change(run)
    with pytest.raises(MissingStreamError, match=reason):
        estimate(lacking, "published")
    assert available(lacking)["published"] is not None
    assert available(run)["published"] is None


def test_many_steps_have_the_jacobians_product_of_equation_4() -> None:
    rng = np.random.default_rng(0)
    n = 40
    d, w = rng.uniform(0, 0.02, n), rng.normal(0, 0.05, n)
    vd, vw = rng.uniform(0, 1e-5, n), rng.uniform(0, 1e-4, n)
    path = Reckoning.of(np.arange(n) * 0.1, Steps(d, w, vd, vw, np.zeros(n, bool)))
    rows = path.at(path.t)
    _, whole = motion(rows[:1], rows[-1:])
    P, theta = np.zeros((3, 3)), rows[0, 2]
    for k in range(1, n):  # eq. (4) and (5), one step after the other, heading at the step's middle
        middle = theta + w[k] / 2
        A = np.array(((1, 0, -d[k] * np.sin(middle)), (0, 1, d[k] * np.cos(middle)), (0, 0, 1)))
        B = np.array(
            ((np.cos(middle), -d[k] / 2 * np.sin(middle)), (np.sin(middle), d[k] / 2 * np.cos(middle)), (0, 1))
        )
        P = A @ P @ A.T + B @ np.diag((vd[k], vw[k])) @ B.T
        theta += w[k]
    turned = np.array(
        ((np.cos(rows[0, 2]), np.sin(rows[0, 2]), 0), (-np.sin(rows[0, 2]), np.cos(rows[0, 2]), 0), (0, 0, 1))
    )
    assert whole[0] == pytest.approx(turned @ P @ turned.T, rel=1e-3, abs=1e-12)


def test_filter_weighs_pose_and_fix_by_their_covariances() -> None:
    kf = PoseFilter(np.array((1.0, 2.0, 0.0)), np.diag((0.04, 0.01, 0.01)), np.zeros(2))
    kf.update(np.array((2.0, 2.0, 0.2)), np.diag((0.01, 0.01, 0.01)))
    assert kf.pose == pytest.approx((1.8, 2.0, 0.1))
    assert np.diag(kf.covariance) == pytest.approx((0.008, 0.005, 0.005))
    assert PoseFilter(np.array((0, 0, 3.1)), np.eye(3), np.zeros(2)).distance(
        np.array((0, 0, -3.1)), np.eye(3)
    ) == pytest.approx((2 * np.pi - 6.2) ** 2 / 2), "headings differ by the shorter way round"


def test_fix_is_of_the_tag() -> None:
    kf = PoseFilter(np.array((1.0, 0.0, np.pi / 2)), np.eye(3), np.array((0.1, 0.0)))
    assert kf.expected() == pytest.approx((1.0, 0.1, np.pi / 2))


def test_lowpass_keeps_what_is_slow_and_takes_what_is_fast() -> None:
    t = np.arange(0, 4, 0.01)
    assert lowpass(np.full(t.size, 3.0), 100.0, 5.0) == pytest.approx(np.full(t.size, 3.0))
    assert np.abs(lowpass(np.sin(2 * np.pi * 0.5 * t), 100.0, 5.0)[200:]).max() == pytest.approx(1.0, abs=0.01)
    assert np.abs(lowpass(np.sin(2 * np.pi * 25 * t), 100.0, 5.0)[200:]).max() < 0.05


def test_offsets_are_means_at_rest_so_far() -> None:
    values = np.array((9.0, 1.0, 3.0, 9.0, 2.0, 9.0))
    rest = np.array((False, True, True, False, True, False))
    assert offsets(values, rest, 1000.0) == pytest.approx((0, 1, 2, 2, 2, 2), abs=1e-3)


def test_plain_drive_is_followed_without_a_decision(run: Run) -> None:
    found = estimate(run, "published")
    assert found.events == ()
    assert run.truth is not None
    errors = evaluate(found.trajectory, run.truth)
    assert errors.max_m is not None and errors.max_m < 0.03
    assert errors.heading_rmse_rad is not None and errors.heading_rmse_rad < 0.012
    assert 0.9 < found.innovations["beacon"].accepted.mean() <= 1.0


def test_imu_stands_in_for_spinning_wheels(run: Run) -> None:
    faulty = without_fixes(spinning(run, 5.0, 6.0, 6.0), 4.5, 6.6)
    found = estimate(faulty, "published")
    slip = next(event for event in found.events if event.kind == "slip")
    assert slip.t0 == pytest.approx(5.0, abs=0.25)
    assert slip.t1 == pytest.approx(6.8, abs=0.2), "two windows of 0.4 s after the wheels grip again"
    assert "accelerometers" in slip.replaced
    assert faulty.truth is not None

    def error(choice: Decisions) -> float:
        errors = evaluate(navigate(faulty, None, choice).trajectory, faulty.truth)  # type: ignore[arg-type]
        return float(np.interp(6.5, errors.t, errors.error_xy))

    assert error(Decisions(mean_factor=1e9)) > 0.4, "0.45 m were spun"
    assert error(Decisions()) < 0.08


def test_lost_beacon_is_an_event_and_costs_little(run: Run) -> None:
    found = estimate(without_fixes(run, 5.0, 9.0), "published")
    (loss,) = found.events
    assert (loss.kind, loss.t0, loss.t1) == ("beacon_loss", pytest.approx(5.0, abs=0.11), pytest.approx(9.0, abs=0.2))
    assert "no fix came" in loss.evidence
    assert run.truth is not None
    errors = evaluate(found.trajectory, run.truth)
    assert errors.max_m is not None and errors.max_m < 0.06


def test_lying_beacon_is_refused_until_it_is_right_again(run: Run) -> None:
    found = estimate(shifted(run, 5.0, 9.0, 0.5), "published")
    (loss,) = found.events
    assert (loss.t0, loss.t1) == (pytest.approx(5.0, abs=0.11), pytest.approx(9.0, abs=0.2))
    assert "abnormal" in loss.evidence
    assert run.truth is not None
    errors = evaluate(found.trajectory, run.truth)
    assert errors.max_m is not None and errors.max_m < 0.06


def test_after_a_shock_the_position_is_the_beacons() -> None:
    blank = Scenario("thrown", "thrown", lambda: [stop(3.0), drive(1.2, 0.4), stop(5.0)]).run(
        Rates(commands=20.0, ranges=0)
    )
    run = simulate(blank, {"bump": {"time": 8.0, "distance": 0.8, "turn": 0.5}}, 3)
    found = estimate(run, "published")
    replacement = next(event for event in found.events if event.kind == "replacement")
    assert 8.3 < replacement.t1 < 9.8
    assert run.truth is not None
    errors = evaluate(found.trajectory, run.truth)
    assert errors.error_xy[errors.t > replacement.t1 + 0.1].max() < 0.04
    deaf = navigate(run, None, Decisions(shock=1e9, mean_factor=1e9))
    assert not any(event.kind == "replacement" for event in deaf.events)
    unmoved = evaluate(deaf.trajectory, run.truth)
    assert unmoved.error_xy[unmoved.t > 8.4].min() > 0.5


def test_fixes_without_heading_and_no_start_pose(run: Run) -> None:
    log = run.beacon
    assert log is not None and run.truth is not None
    bare = dataclasses.replace(
        run, beacon=BeaconLog(log.t, log.x, log.y), meta=dataclasses.replace(run.meta, start=None)
    )
    found = estimate(bare, "published")
    assert any("hindsight" in note for note in found.notes)
    errors = evaluate(found.trajectory, run.truth)
    assert errors.final_m is not None and errors.final_m < 0.03
    assert errors.final_rad is not None and errors.final_rad < 0.03


def test_ranges_become_fixes_as_of_one_moment() -> None:
    run = a_run(2, ranges=10.0, beacon=0.0)
    found = estimate(run, "published")
    assert run.truth is not None
    errors = evaluate(found.trajectory, run.truth)
    assert errors.ate_rmse_m is not None and errors.ate_rmse_m < 0.03
    assert any("Ranges were turned into fixes" in note for note in found.notes)


def test_increments_to_the_letter_never_pull_the_position_back(run: Run) -> None:
    elsewhere = dataclasses.replace(run, meta=dataclasses.replace(run.meta, start=Pose(1.54, 1.5, 0.0)))
    end = {
        letter: navigate(elsewhere, {"start_xy": 0.05}, Decisions(increments=letter)).trajectory.x[-1]
        for letter in (True, False)
    }
    assert run.truth is not None and run.truth.x is not None
    assert end[False] == pytest.approx(float(run.truth.x[-1]), abs=0.02)
    assert end[True] == pytest.approx(float(run.truth.x[-1]) + 0.04, abs=0.02)


def test_a_pose_uses_only_readings_up_to_its_stamp(run: Run) -> None:
    whole = estimate(run, "published").trajectory
    part = estimate(run.crop(0.0, 9.0), "published").trajectory
    n = int(np.searchsorted(part.t, 8.9))
    assert part.pose[:n] == pytest.approx(whole.pose[:n], abs=1e-9)


@settings(max_examples=5, deadline=None)
@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(-3, 3))
def test_path_moves_with_the_map(x: float, y: float, theta: float) -> None:
    run = a_run().crop(0.0, 7.0)
    log, start = run.beacon, run.meta.start
    assert log is not None and log.theta is not None and start is not None
    frame = np.array((x, y, theta))

    def carried(rows: np.ndarray) -> np.ndarray:
        return compose(np.broadcast_to(frame, rows.shape), rows)

    fixes = carried(np.column_stack((log.x, log.y, log.theta)))
    begin = carried(np.array(((start.x, start.y, start.theta),)))[0]
    moved = dataclasses.replace(
        run,
        beacon=BeaconLog(log.t, *fixes.T.copy()),
        meta=dataclasses.replace(run.meta, start=Pose(*(float(v) for v in begin))),
    )
    assert estimate(moved, "published").trajectory.pose == pytest.approx(
        carried(estimate(run, "published").trajectory.pose), abs=1e-6
    )
