"""Gyro bias by every method, on simulated records after Cechowicz 2017 and on records that break something."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.errors import MissingStreamError, NotEnoughDataError, ParameterError
from core.imu.bias import METHODS, FilterConfig, SegmentConfig, heading_errors, known_rests, track_bias
from core.imu.bias._best_numba import run as run_blocks
from core.imu.bias._learn_numba import new_state
from core.imu.bias.blocks import cut
from core.imu.bias.filtered import settings as settings_of
from core.imu.bias.result import ACCEPTED, REJECTED_BY_BAND
from core.run import Run
from core.sensors import CommandLog, ImuLog, WheelLog
from tests.plants.gyro import DEG, DEG_H, SCENARIOS, VARIATIONS, GyroPlant, gyro_plant


def plant(name: str, seed: int, *, hours: float = 12.0, rate: float = 48.0) -> GyroPlant:
    return gyro_plant(seed, dataclasses.replace((SCENARIOS | VARIATIONS)[name], hours=hours, rate=rate))


def still(seconds: float, rate: float = 100.0, *, bias: float = 0.01, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * rate)) / rate
    return t, bias + 2e-4 * np.sqrt(rate) * rng.standard_normal(len(t))


def test_published_methods_come_in_the_papers_order_and_sizes() -> None:
    run = plant("paper", 1, hours=2.0, rate=384.0).run()
    errors = {m: heading_errors(track_bias(run, m), run.truth) for m in "ABC"}
    largest = {m: e.max_rad / DEG for m, e in errors.items() if e is not None}
    assert largest["A"] > 20
    assert largest["A"] > largest["B"] > largest["C"]
    net = {m: abs(e.net_rate) / DEG_H for m, e in errors.items() if e is not None}
    assert 1.5 < net["B"] < 15
    assert net["C"] < 1


def test_twelve_hours_with_one_setting() -> None:
    largest: dict[str, list[float]] = {}
    for seed in (11, 12, 13):
        for name in ("paper", "lively"):
            made = plant(name, seed, rate=24.0)
            run = made.run()
            assert run.imu is not None
            found = {m: track_bias(run, m) for m in ("best", "smoothed")}
            if name == "lively":
                found["known"] = known_rests(run, run.imu, made.resting, FilterConfig(), hindsight=False)
            for method, estimate in found.items():
                errors = heading_errors(estimate, run.truth)
                assert errors is not None
                largest.setdefault(f"{name} {method}", []).append(errors.max_rad / DEG)
                if name == "paper" and method == "best":
                    assert abs(errors.net_rate) < 0.2 * DEG_H
    middle = {key: float(np.median(values)) for key, values in largest.items()}
    assert middle["paper best"] < 1.5
    assert middle["paper smoothed"] < 1.0
    assert middle["lively best"] < 7.0
    # The gyro's own noise in movement is what remains: knowing every rest is hardly better.
    together = {key: float(np.sqrt(np.mean(np.square(values)))) for key, values in largest.items()}
    assert together["lively smoothed"] < 4.0 / 3.6 * together["lively known"]


@pytest.mark.parametrize("name", ["paper", "lively, mixed, wide", "lively, MPU6050"])
def test_claimed_deviations_are_honest(name: str) -> None:
    heading, bias = [], []
    for seed in range(30, 38):
        made = plant(name, seed, hours=2.0, rate=24.0)
        estimate = track_bias(made.run(), "best")
        late = estimate.t > 600
        errors = heading_errors(estimate, made.run().truth)
        assert errors is not None
        assert estimate.theta_sd is not None
        heading.append(errors.error[-1] / np.interp(errors.t[-1], estimate.t, estimate.theta_sd))
        true = np.interp(estimate.t[late], made.t, made.bias)
        bias.append(np.mean(((true - estimate.bias[late]) / estimate.sd[late]) ** 2))
    assert 0.5 < np.sqrt(np.mean(np.square(heading))) < 1.5
    assert 0.7 < np.sqrt(np.mean(bias)) < 1.4


@pytest.fixture(scope="module")
def lively() -> Run:
    """Half an hour of the lively platform with everything that a run may hold beside the gyro."""
    made = plant("lively, temperature", 3, hours=0.5)
    truth = np.interp(made.t, made.truth_t, made.truth_theta)
    rng = np.random.default_rng(0)
    shake = np.where(made.resting, 0.01, 0.1) * rng.standard_normal(len(made.t))
    imu = ImuLog(made.t, made.gz, ax=shake, temperature=made.temperature)
    wheels = WheelLog(made.t[::5], np.round(truth[::5] * 50) / 50, -np.round(truth[::5] * 50) / 50)
    return Run(imu=imu, wheels=wheels)


@settings(max_examples=12, deadline=None)
@given(st.floats(20.0, 1790.0))
def test_best_depends_on_the_past_only(lively: Run, end: float) -> None:
    assert lively.imu is not None
    assert lively.wheels is not None
    imu = ImuLog(**{k: v[lively.imu.t <= end] for k, v in lively.imu.columns().items()})
    kept = lively.wheels.t <= end
    wheels = WheelLog(lively.wheels.t[kept], lively.wheels.left[kept], lively.wheels.right[kept])
    whole, part = track_bias(lively, "best"), track_bias(Run(imu=imu, wheels=wheels), "best")
    closed = len(part.t) - 3  # the last block is open
    for name in ("t", "theta", "bias", "sd", "theta_sd", "accepted"):
        np.testing.assert_array_equal(getattr(part, name)[:closed], getattr(whole, name)[:closed])


def test_blocks_fed_one_by_one_give_the_same() -> None:
    run = plant("paper", 4, hours=0.3).run()
    assert run.imu is not None
    blocks = cut(run, run.imu, 0.2)
    c = settings_of(FilterConfig(), blocks.length, warm=False)
    whole, _, _ = run_blocks(new_state(c), c, run.imu.gz, blocks.start, blocks.given.copy())
    state, x = new_state(c), run.imu.gz
    for k in range(len(blocks.t)):
        readings = x[blocks.start[k] : blocks.start[k + 1]]
        now, _, _ = run_blocks(state, c, readings, np.array([0, len(readings)]), blocks.given[k : k + 1].copy())
        np.testing.assert_array_equal(now[0], whole[k])


def test_hindsight_repairs_the_heading_of_a_start_in_movement() -> None:
    t, gz = still(300)
    turning = (t > 0) & (t < 100)
    gz = gz + np.where(turning, 0.2 * np.sin(t), 0.0)
    run = Run(imu=ImuLog(t, gz))
    live, hindsight = track_bias(run, "best"), track_bias(run, "smoothed")
    true = 0.2 * (1 - np.cos(50.0))
    assert abs(np.interp(50, hindsight.t, hindsight.theta) - true) < 0.01
    assert abs(np.interp(50, live.t, live.theta) - true) > 0.3
    assert abs(live.theta[-1] - 0.2 * (1 - np.cos(100.0))) < 0.01


def test_wheels_tell_a_slow_steady_turn_from_a_rest() -> None:
    t, gz = still(200)
    turning = t > 60
    gz = gz + np.where(turning, 0.002, 0.0)
    stamps = t[::5]
    angle = np.where(stamps > 60, 0.3 * (stamps - 60), 0.0)
    imu = ImuLog(t, gz)
    told = track_bias(Run(imu=imu, wheels=WheelLog(stamps, angle, angle)), "best")
    commanded = CommandLog(stamps, np.where(stamps > 60, 0.1, 0.0), np.zeros(len(stamps)))
    asked = track_bias(Run(imu=imu, commands=commanded), "best")
    for made in (told, asked):
        assert made.theta[-1] == pytest.approx(0.002 * 140, abs=0.02)
        assert not made.accepted[made.t > 61].any()


def test_temperature_explains_the_bias_through_a_long_movement() -> None:
    rng = np.random.default_rng(5)
    t = np.arange(0.0, 3600.0, 0.02)
    temperature = 25 + 8 * np.sin(2 * np.pi * t / 1200)
    slope = 1e-4
    moving = (t > 2450) & (t < 3050)
    gz = slope * (temperature - 25) + 1e-3 * rng.standard_normal(len(t)) + np.where(moving, 0.3 * np.cos(t), 0.0)
    without = track_bias(Run(imu=ImuLog(t, gz)), "best")
    known = track_bias(Run(imu=ImuLog(t, gz, temperature=temperature)), "best")
    true = float(np.sum(np.where(moving, 0.3 * np.cos(t), 0.0)) * 0.02)
    assert abs(known.theta[-1] - true) < 0.25 * abs(without.theta[-1] - true)
    assert abs(known.theta[-1] - true) < 0.03


def test_a_bias_that_jumps_is_believed_after_a_while() -> None:
    t, gz = still(300)
    made = track_bias(Run(imu=ImuLog(t, gz + np.where(t > 100, 0.05, 0.0))), "best")
    assert made.bias[-1] == pytest.approx(0.06, abs=1e-3)
    assert made.accepted[-100:-5].all()


def test_gap_widens_the_claim() -> None:
    t, gz = still(300)
    moving = (t > 90) & (t < 160)
    gz = gz + np.where(moving, 0.3 * np.sin(t / 5), 0.0)
    keep = (t < 120) | (t > 130)
    whole = track_bias(Run(imu=ImuLog(t, gz)), "best")
    holed = track_bias(Run(imu=ImuLog(t[keep], gz[keep])), "best")
    assert whole.theta_sd is not None
    assert holed.theta_sd is not None
    assert holed.theta_sd[-1] > 3 * whole.theta_sd[-1]
    assert any("1 gaps" in note for note in holed.notes)


def test_segment_verdicts_add_up() -> None:
    run = plant("paper", 7, hours=0.5, rate=96.0).run()
    b, c = track_bias(run, "B"), track_bias(run, "C", SegmentConfig(n=40))
    assert set(np.flatnonzero(c.segments.verdict == ACCEPTED)) <= set(np.flatnonzero(b.segments.verdict == ACCEPTED))
    assert (c.segments.verdict == REJECTED_BY_BAND).sum() == (b.segments.verdict == 1).sum() - (
        c.segments.verdict == ACCEPTED
    ).sum()


@pytest.mark.parametrize("method", METHODS)
def test_every_method_gives_ten_hertz_from_zero(method: str) -> None:
    t, gz = still(60)
    made = track_bias(Run(imu=ImuLog(t + 5, gz)), method)
    np.testing.assert_allclose(np.diff(made.t), 0.1, atol=1e-9)
    assert made.t[0] == 5.0
    assert made.theta[0] == 0.0
    assert made.bias[-1] == pytest.approx(0.01, abs=2e-3)
    assert len(made.theta) == len(made.bias) == len(made.sd) == len(made.accepted) == len(made.t)


@pytest.mark.parametrize("method", METHODS)
def test_odd_records_are_answered_with_a_note(method: str) -> None:
    t, gz = still(60)
    dead = track_bias(Run(imu=ImuLog(t, np.full(len(t), 0.02))), method)
    assert dead.bias[-1] == 0.02
    assert any("dead" in note for note in dead.notes)
    holes = gz.copy()
    holes[1000:1010] = np.nan
    assert any("10 gyro readings" in n for n in track_bias(Run(imu=ImuLog(t, holes)), method).notes)
    turning = gz + np.clip(9 * np.sin(t), -4.36, 4.36) * (t > 20)
    assert any("saturated" in n for n in track_bias(Run(imu=ImuLog(t, np.clip(turning, -4.3, 4.3))), method).notes)
    assert any("deg/s" in n for n in track_bias(Run(imu=ImuLog(t, turning * 57.3)), method).notes)
    assert not any("deg/s" in n for n in track_bias(Run(imu=ImuLog(t, turning)), method).notes)


def test_no_rest_at_all_leaves_the_raw_integral() -> None:
    t, gz = still(100, bias=0.0)
    made = track_bias(Run(imu=ImuLog(t, gz + np.sin(t))), "best")
    assert any("No rest" in note for note in made.notes)
    assert any("Hardly a segment" in note for note in track_bias(Run(imu=ImuLog(t, gz + np.sin(t))), "C").notes)
    assert not any("Hardly a segment" in note for note in track_bias(Run(imu=ImuLog(t, gz)), "C").notes)
    assert made.theta[-1] == pytest.approx(1 - np.cos(made.t[-1]), abs=0.02)
    assert made.theta_sd is not None
    assert made.theta_sd[-1] > 1


def test_refusals_name_what_is_wrong() -> None:
    t, gz = still(60)
    run = Run(imu=ImuLog(t, gz))
    with pytest.raises(ParameterError, match="no bias method 'D'"):
        track_bias(run, "D")
    with pytest.raises(ParameterError, match="SegmentConfig"):
        track_bias(run, "C", FilterConfig())
    with pytest.raises(ParameterError, match="gate"):
        FilterConfig(gate=-1)
    with pytest.raises(MissingStreamError, match="no gyro"):
        track_bias(Run(), "best")
    with pytest.raises(NotEnoughDataError, match="too short"):
        track_bias(Run(imu=ImuLog(t[:50], gz[:50])), "best")
    with pytest.raises(NotEnoughDataError, match="finite"):
        track_bias(Run(imu=ImuLog(t, np.full(len(t), np.nan))), "C")
