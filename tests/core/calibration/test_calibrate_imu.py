"""Calibration: parameters drawn over Table 1 come back within their claims, and what runs do not show is null."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from core.calibration.imu import CalibrationReport, calibrate, judge_correction
from core.errors import MissingStreamError, NotEnoughDataError
from core.formats import read_run
from core.robot import Procedure, Segment
from core.run import Run
from tests.plants.imu_rig import DEG, G, Rig, draw_rig, rate_table_run, rest_run, six_position_run

NUMBERS = ("static_bias", "drift_amplitude", "drift_tau", "matrix", "noise_sd")
RIG = draw_rig(11, rate=50.0)


def errors(report: CalibrationReport, rig: Rig) -> Iterator[tuple[str, np.ndarray]]:
    """Errors over claimed deviations, NaN where null."""
    for sensor in ("gyro", "accel"):
        for number in NUMBERS:
            found, sd, true = (
                getattr(getattr(of, sensor), number) for of in (report.calibration, report.calibration.sd, rig)
            )
            yield f"{sensor}.{number}", (found - true) / sd


def without(run: Run, *names: str) -> Run:
    assert run.imu is not None
    return dataclasses.replace(run, imu=dataclasses.replace(run.imu, **dict.fromkeys(names)))


def declaring(run: Run, *segments: Segment, kind: str | None = None) -> Run:
    assert run.meta.procedure is not None
    procedure = Procedure(kind or run.meta.procedure.kind, segments)
    return dataclasses.replace(run, meta=dataclasses.replace(run.meta, procedure=procedure))


def segments(run: Run) -> list[Segment]:
    assert run.meta.procedure is not None
    return list(run.meta.procedure.segments)


@pytest.fixture(scope="module")
def table() -> Run:
    """A short rate-table run of the gyro alone."""
    made = rate_table_run(RIG, 3, (-2.0, 2.0), seconds=12.0)
    return without(made, "ax", "ay", "az")


@pytest.fixture(scope="module")
def six() -> Run:
    return six_position_run(RIG, 2, 15.0)


def test_parameters_come_back_within_their_claims(report: CalibrationReport, rig: Rig) -> None:
    shown = dict(errors(report, rig))
    for name in ("gyro.static_bias", "gyro.drift_amplitude", "gyro.matrix", "gyro.noise_sd", "accel.static_bias"):
        assert np.isfinite(shown[name]).all(), name
    assert np.isfinite(shown["accel.matrix"]).all()
    every = np.concatenate([z.ravel() for z in shown.values()])
    every = every[np.isfinite(every)]
    assert len(every) > 40
    assert np.abs(every).max() < 4.5
    assert 0.6 < np.sqrt(np.mean(every**2)) < 1.5


def test_claims_are_as_fine_as_the_noise_allows(report: CalibrationReport, rig: Rig) -> None:
    sd = report.calibration.sd
    assert sd.gyro.matrix.max() < 5e-6
    assert sd.accel.matrix.max() < 2e-4
    assert sd.gyro.static_bias.max() < 0.003 * DEG
    strong = np.abs(rig.gyro.drift_amplitude) > 0.1 * DEG
    assert strong.any()
    assert (sd.gyro.drift_tau[strong] < 0.15 * rig.gyro.drift_tau[strong]).all()


def test_the_papers_rule_reads_short_and_the_report_says_how_short(report: CalibrationReport, rig: Rig) -> None:
    k = int(np.argmax(np.abs(rig.gyro.drift_amplitude)))
    axis = report.axes["g" + "xyz"[k]]
    (paper,) = axis.paper
    assert paper.tau < 0.85 * rig.gyro.drift_tau[k]
    assert abs(paper.tau - paper.expected) < 5 * paper.tau_sd
    assert abs(axis.fit.tau / rig.gyro.drift_tau[k] - 1) < 0.2
    assert paper.correlation[0] == 1


def test_report_holds_curves_and_lines(report: CalibrationReport) -> None:
    gx = report.axes["gx"]
    assert gx.t.shape == gx.bias.shape == gx.curve.shape == gx.run.shape
    assert np.sqrt(np.mean((gx.bias - gx.curve) ** 2)) < 1e-3
    assert [line.axis for line in report.lines] == ["ax", "ay", "az", "gx", "gy", "gz"]
    for line in report.lines:
        np.testing.assert_allclose(line.corrected, line.real, atol=2e-4 if line.axis[0] == "g" else 5e-3)
    assert not report.left_out


def test_correction_reaches_the_papers_figures(report: CalibrationReport, rig: Rig) -> None:
    judged = judge_correction(rest_run(rig, 9, 1500.0), report.calibration)
    assert (judged.noise_factor > 5.8).all()
    assert (judged.mean_left_sensor < 0.069).all()
    assert (judged.correlation > 0.98).all()
    assert np.abs(judged.online.start[3:]).max() < 0.02 * DEG
    assert np.abs(judged.raw.start[3:]).max() > 0.1 * DEG


def test_rest_alone_shows_gyro_bias_and_noise_and_says_what_it_does_not() -> None:
    made = calibrate([rest_run(RIG, 4, 400.0)])
    gyro, accel = made.calibration.gyro, made.calibration.accel
    assert np.isfinite(gyro.static_bias).all()
    assert np.isfinite(accel.noise_sd).all()
    assert np.isnan(gyro.matrix).all()
    assert np.isnan(accel.matrix).all()
    assert np.isnan(accel.static_bias).all()
    told = "\n".join(made.notes)
    for what in ("gyro.matrix: null", "accel.matrix: null", "static bias is null", "from one switching on to the next"):
        assert what in told


def test_four_positions_show_two_columns(six: Run) -> None:
    made = calibrate([without(six_position_run(RIG, 2, 15.0, order=(0, 3, 1, 4)), "gx", "gy")]).calibration.accel
    assert np.isnan(made.matrix[:, 2]).all()
    np.testing.assert_allclose(made.matrix[:, :2], RIG.accel.matrix[:, :2], atol=1e-3)
    np.testing.assert_allclose(made.static_bias, RIG.accel.static_bias, atol=0.02)


@pytest.mark.parametrize(
    ("index", "change", "told"),
    [
        (1, {"rate": (-2.0, 0.0, 0.0)}, "wrong sign"),
        (1, {"rate": (0.0, 0.0, 2.0)}, "wrong axis, the data say x"),
        (1, {"rate": (4.0, 0.0, 0.0)}, "wrong rate"),
        (2, {"rate": (0.0, -2.2, 0.0)}, "wrong rate"),
        (0, {"rate": (0.0, 0.0, 0.0)}, "declared at rest but turns"),
        (3, {"rate": None}, "rate of the table is not given"),
        (4, {"rate": (0.0, 0.0, -114.6)}, "looks like deg/s"),
        (4, {"t1": 0.0, "t0": 0.0}, "too few"),
    ],
)
def test_a_segment_that_contradicts_is_named_and_left_out(
    index: int, change: dict[str, object], told: str, table: Run
) -> None:
    changed = segments(table)
    changed[index] = dataclasses.replace(changed[index], **change)  # type: ignore[arg-type]
    made = calibrate([declaring(table, *changed)])
    (left,) = made.left_out
    assert (left.run, left.index) == (0, index)
    assert told in str(left)
    np.testing.assert_allclose(made.calibration.gyro.matrix, RIG.gyro.matrix, atol=2e-4)


def test_a_table_that_stands_still_is_named(table: Run) -> None:
    still = without(rest_run(RIG, 5, 60.0), "ax", "ay", "az")
    made = calibrate([table, declaring(still, Segment(5.0, 55.0, rate=(1.0, 0.0, 0.0)), kind="rate_table")])
    (left,) = made.left_out
    assert "the table does not move" in str(left)


def test_saturation_is_named(table: Run) -> None:
    assert table.imu is not None
    clipped = {name: np.clip(getattr(table.imu, name), -9.0, 1.95) for name in ("gx", "gy", "gz")}
    made = calibrate([dataclasses.replace(table, imu=dataclasses.replace(table.imu, **clipped))])
    assert [left.index for left in made.left_out] == [
        k
        for k, s in enumerate(segments(table))
        if max(RIG.gyro.matrix @ np.array(s.rate) + RIG.gyro.static_bias) > 1.95
    ]
    assert all("saturated" in left.reason for left in made.left_out)


def test_a_position_held_wrong_way_up_is_named(six: Run) -> None:
    changed = segments(six)
    changed[0] = dataclasses.replace(changed[0], gravity=(0.0, 0.0, -G))
    made = calibrate([declaring(without(six, "gx", "gy"), *changed)])
    (left,) = made.left_out
    assert left.sensor == "accel"
    assert "the other side is up" in left.reason


def test_units_are_seen_from_the_size() -> None:
    rest = without(rest_run(RIG, 6, 60.0), "ax", "ay", "az")
    assert rest.imu is not None
    degrees = {name: np.degrees(getattr(rest.imu, name)) for name in ("gx", "gy", "gz")}
    made = calibrate([dataclasses.replace(rest, imu=dataclasses.replace(rest.imu, **degrees))])
    assert any("deg/s" in note for note in made.notes)


def test_odd_readings_are_told_and_the_rest_is_given() -> None:
    rest = without(rest_run(RIG, 7, 60.0), "ay", "az")
    assert rest.imu is not None
    gx = np.where(np.arange(len(rest.imu)) % 9 == 0, np.nan, rest.imu.gx)
    odd = dataclasses.replace(rest, imu=dataclasses.replace(rest.imu, gx=gx, ax=np.full(len(gx), 0.02)))
    made = calibrate([odd])
    assert any("not finite" in note and "gx" in note for note in made.notes)
    assert any(note.startswith("ax: all readings are equal") for note in made.notes)
    assert np.isfinite(made.calibration.gyro.static_bias).all()
    np.testing.assert_allclose(made.calibration.gyro.noise_sd, RIG.gyro.noise_sd, rtol=0.06)


def test_a_run_that_sways_is_no_rest() -> None:
    rest = without(rest_run(RIG, 9, 60.0), "ax", "ay", "az")
    assert rest.imu is not None
    swaying = dataclasses.replace(rest.imu, gz=rest.imu.gz + np.sin(rest.imu.t))
    with pytest.raises(NotEnoughDataError, match="gz's readings wander"):
        calibrate([dataclasses.replace(rest, imu=swaying)])


def test_spin_up_inside_a_segment_is_trimmed(table: Run) -> None:
    made = calibrate([table])
    for used, declared in zip(made.used, segments(table), strict=True):
        assert used.lo[0] >= declared.t0 + 3.0
        assert used.hi[-1] >= declared.t1 - 1.0


def test_what_cannot_be_calibrated_is_refused(six: Run) -> None:
    rest = rest_run(RIG, 8, 30.0)
    with pytest.raises(MissingStreamError):
        calibrate([Run()])
    with pytest.raises(NotEnoughDataError, match="too short"):
        calibrate([rest.crop(0.0, 2.0)])
    with pytest.raises(NotEnoughDataError, match="not at rest"):
        calibrate([declaring(six, Segment(0.0, 130.0), kind="rest")])
    with pytest.raises(NotEnoughDataError, match="'drive'"):
        calibrate([declaring(rest, kind="drive")])
    with pytest.raises(NotEnoughDataError, match="no stretch of the run rests"):
        judge_correction(declaring(rest, kind="drive"), calibrate([rest]).calibration)


@pytest.mark.shared
def test_a_real_log_goes_through(shared_data: Path) -> None:
    made = calibrate([read_run(shared_data / "real" / "mpu6050-rest" / "rest-x-up")])
    gyro = made.calibration.gyro
    assert np.abs(gyro.static_bias[0] + 0.079) < 0.002
    assert (gyro.noise_sd > 1e-3).all()
    assert (gyro.noise_sd < 4e-3).all()
    assert np.isnan(gyro.matrix).all()
