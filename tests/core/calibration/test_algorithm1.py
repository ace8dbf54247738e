"""Algorithm 1: the paper's equations by hand, the same bits in any split, and its offline counterpart."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.calibration.imu import (
    AXES,
    ImuCalibration,
    SensorModel,
    advance,
    constants,
    correct,
    correction_notes,
    initial_state,
    moving_average_bode,
    spectrum,
    step,
)
from core.errors import MissingStreamError, ParameterError
from core.run import Run
from core.sensors import ImuLog

Floats = npt.NDArray[np.float64]
RATE = 100.0


def model(rng: np.random.Generator, unit: float) -> SensorModel:
    return SensorModel(
        static_bias=rng.normal(0, unit, 3),
        drift_amplitude=rng.normal(0, unit, 3),
        drift_tau=rng.uniform(20, 200, 3),
        matrix=np.eye(3) + rng.normal(0, 0.02, (3, 3)),
        noise_sd=np.full(3, unit / 10),
    )


@pytest.fixture
def calibration() -> ImuCalibration:
    rng = np.random.default_rng(0)
    return ImuCalibration(model(rng, 0.02), model(rng, 0.1))


def log(calibration: ImuCalibration, true: Floats, t: Floats) -> ImuLog:
    """Readings without noise of `true` (n, 6) by AXES."""
    accel = true[:, :3] @ calibration.accel.matrix.T + calibration.accel.bias(t)
    gyro = true[:, 3:] @ calibration.gyro.matrix.T + calibration.gyro.bias(t)
    return ImuLog(t, **{name: np.hstack([accel, gyro])[:, j] for j, name in enumerate(AXES)})


def test_it_is_the_papers_algorithm_by_hand(calibration: ImuCalibration) -> None:
    rng = np.random.default_rng(1)
    made, readings = constants(calibration), rng.normal(size=(120, 6))
    found = advance(made, initial_state(made), readings, np.r_[0.0, np.full(119, 1 / RATE)])[1]
    g, temporary = np.ones(6), np.empty((120, 6))
    tau = np.r_[calibration.accel.drift_tau, calibration.gyro.drift_tau]
    amplitude = np.r_[calibration.accel.drift_amplitude, calibration.gyro.drift_amplitude]
    static = np.r_[calibration.accel.static_bias, calibration.gyro.static_bias]
    for i in range(120):
        if i:
            g = (1 - 1 / RATE / tau) * g
        temporary[i] = readings[i] - amplitude * (1 - g) - static
        mean = temporary[max(0, i - 39) : i + 1].mean(axis=0)
        expected = np.r_[
            np.linalg.solve(calibration.accel.matrix, mean[:3]), np.linalg.solve(calibration.gyro.matrix, mean[3:])
        ]
        np.testing.assert_allclose(found[i], expected, rtol=1e-11, atol=1e-13)


@settings(max_examples=15)
@given(st.lists(st.integers(1, 80), min_size=1, max_size=4))
def test_any_split_gives_the_same_bits(sizes: list[int]) -> None:
    rng = np.random.default_rng(2)
    made = constants(ImuCalibration(model(rng, 0.02), model(rng, 0.1)))
    readings, dt = rng.normal(size=(sum(sizes), 6)), np.full(sum(sizes), 0.01)
    whole = advance(made, initial_state(made, 3.0), readings, dt)[1]
    state, begin, parts = initial_state(made, 3.0), 0, []
    for size in sizes:
        before = state.g.copy()
        after, out = advance(made, state, readings[begin : begin + size], dt[begin : begin + size])
        np.testing.assert_array_equal(state.g, before)  # states are never changed in place
        state, begin = after, begin + size
        parts.append(out)
    np.testing.assert_array_equal(np.vstack(parts), whole)
    state = initial_state(made, 3.0)
    for i in range(3):
        if i < len(readings):
            state, value = step(made, state, readings[i], 0.01)
            np.testing.assert_array_equal(value, whole[i])


@pytest.mark.parametrize("online", [True, False])
@pytest.mark.parametrize("t0", [0.0, 250.0])
def test_a_noiseless_run_comes_back_true(online: bool, t0: float, calibration: ImuCalibration) -> None:
    t = t0 + np.arange(6000) / RATE
    true = np.tile([0.3, -0.2, 9.81, 0.5, -1.0, 2.0], (len(t), 1))
    run = correct(Run(imu=log(calibration, true, t)), calibration, online)
    assert run.imu is not None
    found = np.column_stack([getattr(run.imu, name) for name in AXES])
    # Online the drift is 20 readings older, and Euler's step is off by T / 2 Tc.
    np.testing.assert_allclose(found, true, atol=1.5e-3 if online else 1e-3)
    np.testing.assert_allclose(found[4000], true[4000], atol=1e-3 if online else 1e-6)


def test_online_is_twenty_readings_behind_offline(calibration: ImuCalibration) -> None:
    t = np.arange(3000) / RATE
    true = 2 * np.sin(2 * np.pi * 0.2 * t)[:, None] * np.ones(6)
    run = Run(imu=log(calibration, true, t))
    late, early = (correct(run, calibration, way).imu for way in (True, False))
    assert late is not None
    assert early is not None
    scores = [np.corrcoef(late.gz[100 + k :], early.gz[100 : len(t) - k])[0, 1] for k in range(10, 31)]
    assert 10 + int(np.argmax(scores)) in (19, 20)
    assert max(scores) > 0.9999  # half a reading is left between 19 and 20


def test_readings_that_are_missing_are_bridged(calibration: ImuCalibration) -> None:
    t = np.arange(400) / RATE
    imu = log(calibration, np.ones((400, 6)), t)
    gz = imu.gz.copy()
    gz[[0, 100, 101]] = np.nan
    broken = Run(imu=dataclasses.replace(imu, gz=gz))
    online, offline = (correct(broken, calibration, way).imu for way in (True, False))
    assert online is not None
    assert offline is not None
    assert np.flatnonzero(np.isnan(online.gz)).tolist() == [0]  # nothing has come yet
    assert online.gz[101] == pytest.approx(1.0, abs=1e-3)
    assert np.flatnonzero(np.isnan(offline.gz)).tolist() == [0, 100, 101]


def test_a_gyro_of_one_axis_is_corrected_alone(calibration: ImuCalibration) -> None:
    t = np.arange(200) / RATE
    scale = calibration.gyro.matrix[2, 2]
    run = Run(imu=ImuLog(t, scale * 0.7 + calibration.gyro.bias(t)[:, 2]))
    made = correct(run, calibration)
    assert made.imu is not None
    assert made.imu.ax is None
    np.testing.assert_allclose(made.imu.gz, 0.7, atol=1e-3)


def test_what_is_unknown_is_left_in_and_told() -> None:
    calibration = ImuCalibration(SensorModel(static_bias=np.array([np.nan, np.nan, 0.5])))
    run = Run(imu=ImuLog(np.arange(100) / RATE, np.full(100, 0.6), ax=np.full(100, 2.0)))
    made = correct(run, calibration)
    assert made.imu is not None
    np.testing.assert_allclose(made.imu.gz, 0.1)
    np.testing.assert_allclose(made.imu.ax, 2.0)
    assert "ax: static bias is unknown and left in" in correction_notes(run, calibration)


def test_bad_settings_are_named(calibration: ImuCalibration) -> None:
    with pytest.raises(MissingStreamError):
        correct(Run(), calibration)
    with pytest.raises(ParameterError, match="window"):
        constants(calibration, window=0)
    with pytest.raises(ParameterError, match="gyro matrix"):
        constants(ImuCalibration(SensorModel(matrix=np.zeros((3, 3)))))
    with pytest.raises(ParameterError, match="shape"):
        advance(constants(calibration), initial_state(constants(calibration)), np.zeros((3, 5)), np.zeros(3))


def test_bode_has_its_zeros_and_half_window_delay() -> None:
    made = moving_average_bode(RATE, [0.0, RATE / 40, 2 * RATE / 40, 0.5])
    np.testing.assert_allclose(made.gain, [1, 0, 0, np.sin(0.2 * np.pi) / (0.2 * np.pi)], atol=1e-12)
    assert made.phase[3] == pytest.approx(-0.2 * np.pi)
    assert made.delay == pytest.approx(19.5 / RATE)


def test_spectrum_integrates_to_its_variance() -> None:
    f = np.sinh(np.linspace(-14, 14, 400_001)) * 1e-3
    assert np.trapezoid(spectrum(0.3, 120.0, f), f) == pytest.approx(0.09, rel=1e-3)
    with pytest.raises(ParameterError, match="correlation time"):
        spectrum(1.0, 0.0, [1.0])
