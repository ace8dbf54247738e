"""Odometry calibration: known robots are found within their deviations, what runs cannot show is None, real squares."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from core.calibration.odometry import NAMES, OdometryCalibration, calibrate_odometry, corrected, umbmark
from core.calibration.odometry.umbmark import angles, ratios
from core.errors import FormatError, MissingStreamError, NotEnoughDataError, ParameterError
from core.estimation import estimate
from core.formats import read_run
from core.metrics import evaluate
from core.run import Run
from core.simulation import simulate
from core.simulation.scenarios import ROBOT, Leg, Rates, Scenario, drive, stop, turn

EFFECTS = {
    "unequal_wheels": {"ratio": 1.006}, "wheel_radius": {"scale": 0.995}, "track_width": {"scale": 1.012},
    "gyro_bias": {"bias": 0.004}, "gyro_scale": {"scale": 1.006}, "tag_offset": {"x": 0.06, "y": -0.03},
    "imu_clock": {"offset": 0.02}, "beacon_delay": {"delay": 0.08}, "imu_yaw": {"angle": 0.05},
    "imu_offset": {"x": 0.04, "y": 0.03}, "accel_bias": {"x": 0.05, "y": -0.03},
}  # fmt: skip
TRUE = {
    "left_radius": 0.995 * 0.075 * 2 / 2.006, "right_radius": 0.995 * 0.075 * 2 * 1.006 / 2.006,
    "track_width": 0.32 * 1.012, "gyro_scale": 1.006, "tag_x": 0.06, "tag_y": -0.03, "tag_yaw": 0.0, "imu_clock": 0.02,
    "reference_delay": 0.08, "imu_yaw": 0.05, "imu_x": 0.09, "imu_y": 0.01,
}  # fmt: skip


def legs() -> list[Leg]:
    """Straights and turns both ways, arcs: 50 s."""
    bends = [drive(2.0, 0.7), turn(3.3, 1.5), drive(2.0, 0.6, curvature=0.8), turn(-4.0, 1.2), drive(1.5, -0.6)]
    return [
        stop(1.0),
        *bends,
        turn(5.0, 1.6),
        drive(2.0, 0.7, curvature=-0.9),
        turn(-3.0, 1.4),
        drive(2.0, 0.8),
        stop(1.0),
    ]


def a_run(seed: int = 0, what: list[Leg] | None = None, **rates: float) -> Run:
    blank = Scenario("calibration", "", lambda: what or legs()).run(Rates(**{"ranges": 0.0, "truth": 20.0, **rates}))
    return simulate(blank, EFFECTS, seed)


def squares(ratio: float, scale: float) -> list[Run]:
    def square(sign: float) -> list[Leg]:
        return [stop(1.0), *([drive(4.0, 0.5), turn(sign * np.pi / 2)] * 4), stop(1.0)]

    effects = {"unequal_wheels": {"ratio": ratio}, "track_width": {"scale": scale}}
    rates = Rates(beacon=0.0, ranges=0.0, truth=10.0)
    return [simulate(Scenario("square", "", lambda s=s: square(s)).run(rates), effects, 0) for s in (1.0, -1.0)]  # type: ignore[misc]


@pytest.mark.parametrize("kind", ["beacon", "ranges"])
def test_everything_is_found_at_once_within_its_deviation(kind: str) -> None:
    run = a_run(1, ranges=10.0 if kind == "ranges" else 0.0)
    found = calibrate_odometry([run], reference=kind)
    assert found.reference == kind
    assert set(found.reasons) == ({"tag_yaw"} if kind == "ranges" else set())
    for name in set(TRUE) - set(found.reasons):
        true = TRUE[name]
        value = found.parameters[name]
        assert value is not None and value.sd is not None, name
        assert abs(value.value - true) < 4 * value.sd, (name, value, true)
    radius = found.parameters["left_radius"]
    assert radius is not None and radius.sd is not None and radius.sd < 0.003 * 0.075


def test_truth_shows_wheels_and_gyro_but_no_tag() -> None:
    found = calibrate_odometry([a_run(2, beacon=0.0)])
    assert found.reference == "truth"
    for name in ("left_radius", "right_radius", "track_width", "gyro_scale"):
        assert found.value(name) == pytest.approx(TRUE[name], rel=1e-3)
    assert found.value("imu_clock") == pytest.approx(0.02, abs=0.002)
    assert found.parameters["tag_x"] is None
    assert "body's origin" in found.reasons["tag_x"]


def test_a_straight_line_cannot_show_what_only_turning_shows() -> None:
    found = calibrate_odometry([a_run(3, [stop(1.0), drive(6.0, 0.6), stop(1.0)])], reference="beacon")
    assert {"track_width", "gyro_scale", "imu_clock"} <= set(found.reasons)
    assert "turn on the spot" in found.reasons["track_width"]
    left, right = found.parameters["left_radius"], found.parameters["right_radius"]
    assert left is not None and right is not None and left.sd is not None
    assert left.value == pytest.approx(TRUE["left_radius"], abs=4 * left.sd)
    assert found.parameters["tag_x"] is None or found.parameters["reference_delay"] is None, "one along the line"


def test_at_rest_nothing_is_shown() -> None:
    found = calibrate_odometry([a_run(4, [stop(20.0)])], reference="beacon")
    assert all(value is None for value in found.parameters.values())
    assert set(found.reasons) == set(NAMES)


def test_slips_and_wild_fixes_count_less() -> None:
    run = a_run(5)
    wheels, fixes = run.wheels, run.beacon
    assert wheels is not None and fixes is not None and fixes.theta is not None
    spun = wheels.right + 3.0 * np.clip(wheels.t - 12.0, 0.0, 0.5)
    wild = np.where(np.arange(len(fixes)) % 50 == 7, 0.6, 0.0)
    faulty = dataclasses.replace(
        run, wheels=dataclasses.replace(wheels, right=spun), beacon=dataclasses.replace(fixes, x=fixes.x + wild)
    )
    found = calibrate_odometry([faulty], reference="beacon")
    for name in ("left_radius", "right_radius", "track_width", "gyro_scale"):
        assert found.value(name) == pytest.approx(TRUE[name], rel=4e-3), name


def test_a_corrected_run_needs_no_calibration() -> None:
    run = a_run(6, beacon=0.0)
    found = calibrate_odometry([run])
    better = corrected(run, found)
    assert better.truth is not None
    before, after = (evaluate(estimate(r, "encoders").trajectory, better.truth).ate_rmse_m for r in (run, better))
    assert before is not None and after is not None
    assert after < before / 10


def test_json_round_trip() -> None:
    found = calibrate_odometry([a_run(4, [stop(1.0), drive(3.0, 0.6), stop(1.0)])], reference="beacon")
    again = OdometryCalibration.from_json(json.loads(json.dumps(found.to_json())))
    assert again.parameters == found.parameters
    assert again.reasons == found.reasons
    with pytest.raises(FormatError, match="odometry-calibration/1"):
        OdometryCalibration.from_json({"schema": "calibration/1"})


def test_refusals_say_what_is_missing() -> None:
    run = a_run(4, [stop(2.0)])
    with pytest.raises(NotEnoughDataError, match="no runs"):
        calibrate_odometry([])
    with pytest.raises(ParameterError, match="unknown reference"):
        calibrate_odometry([run], reference="gps")
    with pytest.raises(MissingStreamError, match="no wheels"):
        calibrate_odometry([dataclasses.replace(run, wheels=None)])
    with pytest.raises(MissingStreamError, match="no fixes and no ranges"):
        calibrate_odometry([dataclasses.replace(run, beacon=None, truth=None)])
    with pytest.raises(NotEnoughDataError, match="3/4 or 4/4"):
        umbmark([run])
    with pytest.raises(NotEnoughDataError, match="both ways"):
        umbmark(squares(1.0, 1.0)[:1])
    bare = dataclasses.replace(
        run, meta=dataclasses.replace(run.meta, robot=dataclasses.replace(ROBOT, track_width=None))
    )
    with pytest.raises(MissingStreamError, match="track_width"):
        umbmark([bare])


def test_umbmark_by_the_equations_of_borenstein_and_feng() -> None:
    """First order, by hand: alpha = 0.03, beta = 0.01 on a square of 4 m."""
    L, a, b = 4.0, 0.03, 0.01
    cw, ccw = np.array((-2 * L * (a + b), -2 * L * (a + b))), np.array((-2 * L * (a - b), 2 * L * (a - b)))
    assert angles(cw, ccw, L) == (pytest.approx((a, a)), pytest.approx((b, b)))
    E_d, E_b = ratios(a, b, L, 0.34)
    R = (L / 2) / np.sin(b / 2)
    assert pytest.approx((R + 0.17) / (R - 0.17)) == E_d
    assert pytest.approx(90 / (90 - np.degrees(a))) == E_b


@pytest.mark.parametrize(("ratio", "scale"), [(1.006, 1.0), (0.996, 0.992)])
def test_umbmark_and_all_at_once_agree_on_squares(ratio: float, scale: float) -> None:
    runs = squares(ratio, scale)
    mark = umbmark(runs)
    assert mark.side == pytest.approx(4.0, abs=0.02)
    assert pytest.approx(ratio, abs=1e-3) == mark.E_d
    assert pytest.approx(scale, abs=5e-3) == mark.E_b, "first order: alpha and beta are not small together"
    assert mark.c_left + mark.c_right == pytest.approx(2.0)
    whole = calibrate_odometry(runs)
    left, right, track = (whole.value(name) for name in NAMES[:3])
    assert left is not None and right is not None and track is not None
    assert right / left == pytest.approx(ratio, abs=3e-4)
    assert track / 0.32 == pytest.approx(scale, abs=1e-3)


def test_streams_of_different_runs_are_refused() -> None:
    run, other = a_run(1), a_run(1, [stop(1.0), turn(12.0, 1.0), stop(1.0), turn(-20.0, 1.0), stop(20.0)])
    with pytest.raises(NotEnoughDataError, match="one motion"):
        calibrate_odometry([dataclasses.replace(run, wheels=other.wheels)], reference="beacon")


@pytest.mark.shared
def test_recorded_circles_are_reckoned_far_better_after_calibration(shared_data: Path) -> None:
    """Two passes one way and two the other calibrate, the two others judge."""
    runs = [read_run(path) for path in sorted((shared_data / "real" / "optiodom-circle-a").glob("run-*"))]
    found = calibrate_odometry([runs[0], runs[3]], own_clocks=True)
    for run in (runs[1], runs[4]):
        assert run.truth is not None
        before = evaluate(estimate(run, "encoders").trajectory, run.truth)
        after = evaluate(estimate(corrected(run, found), "encoders").trajectory, run.truth)
        assert before.max_m is not None and after.max_m is not None
        assert after.max_m < 0.06 < before.max_m
