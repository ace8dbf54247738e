"""The generated C against Python on the same logs, to float32; and the paper's own validation on a Cortex-M7."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from core.calibration.imu import AXES, ImuCalibration
from core.firmware import TRACKERS, Noise, generate
from core.formats import read_run
from core.imu.bias import BiasEstimate, BiasNoise, FilterConfig
from core.sensors import CommandLog
from tests.core.firmware.board import Replay, build, microseconds, records, run, size, write
from tests.core.firmware.logs import (
    EPS,
    alike,
    bias_by,
    corrected,
    driving_log,
    live_heading,
    path_of,
    random_calibration,
    scale_of,
    wrapped,
)

Floats = npt.NDArray[np.float64]

EXAMPLES = Path(__file__).resolve().parents[3] / "app" / "examples"
NOTHING = {"schema": "calibration/1", "gyro": {"static_bias": [0, 0, 0]}, "accel": {}}


@pytest.mark.parametrize("seed", range(3))
def test_algorithm_1_and_method_c_agree_with_python(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    calibration = random_calibration(rng, silent=(0.0, 0.3, 0.0)[seed])
    rate = (100.0, 384.0, 53.0)[seed]
    t, readings = driving_log(rng, calibration, (1500.0, 600.0, 900.0)[seed], rate)
    axes = corrected(calibration, t, readings, window=1)
    z = axes[:, 5]
    found = bias_by("C", t, axes)
    noise = Noise(sd=found.figures["sigma_sr"])
    files = generate(calibration, rate_hz=rate, bias="C", noise=noise)
    made = run(build(write(files, tmp_path), "host"), records(t, readings))

    # A sum of 40 is made anew every 40 samples: at most 80 roundings, and a few on the way to and from it.
    offline = corrected(calibration, t, readings)
    for j, axis in enumerate(AXES):
        worst = np.abs(made.values[axis] - offline[:, j]).max()
        assert worst <= 90 * EPS * scale_of(calibration, readings)[j], axis
    heading, bias = live_heading(found, t, z)
    np.testing.assert_allclose(made.values["bias"], bias, atol=8 * EPS * np.abs(readings[:, 5]).max())
    # Per step: the corrected rate (5 roundings), the time, their product; the sum loses nothing; pi at the end.
    bound = EPS * (8 * path_of(calibration, t, readings) + 4 * np.pi)
    assert np.abs(wrapped(made.values["heading"] - heading)).max() <= bound
    assert not made.status.any()
    assert made.at_rest.any()
    assert not made.at_rest.all()


def assert_best_agrees(made: Replay, found: BiasEstimate, t: Floats, path: float, largest: float) -> None:
    """At the curve's stamps: the same labels; heading and bias to the rounding of the sums and a thousandth of their
    claimed deviation, for the rounding of the filter's gains.

    path [rad] and largest [rad/s]: sizes of the rates, summed over time and at most. Stamps that fall on no reading
    are known to the firmware with the next.
    """
    cells = round(found.figures["length"] * 10)
    blocks = slice(cells, None, cells)
    stamps = found.t[blocks]
    place = np.searchsorted(t, stamps - 1e-9)
    inside = place < len(t)
    inside[inside] = t[place[inside]] - stamps[inside] < 0.9 * found.figures["length"]  # not over a pause
    stamps, place = stamps[inside], place[inside]
    theirs = {name: getattr(found, name)[blocks][inside] for name in ("theta", "bias", "sd", "theta_sd", "accepted")}
    np.testing.assert_array_equal(made.at_rest[place], theirs["accepted"])
    known = theirs["accepted"].cumsum() > 0
    off = np.abs(made.values["bias"][place] - theirs["bias"])[known]
    assert np.all(off <= 1e-3 * theirs["sd"][known] + 4 * EPS * largest)
    exact = np.abs(t[place] - stamps) < 1e-9
    compared = exact | theirs["accepted"]
    turned = np.abs(wrapped(made.values["heading"][place] - theirs["theta"]))[compared]
    assert np.all(turned <= EPS * (8 * path + 4 * np.pi) + 1e-3 * theirs["theta_sd"][compared])
    for mine, sd in (("bias_sd", "sd"), ("heading_sd", "theta_sd")):
        np.testing.assert_allclose(made.values[mine][place][known], theirs[sd][known], rtol=2e-3)


@pytest.mark.parametrize("seed", range(3))
def test_best_agrees_with_python(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    calibration = random_calibration(rng, silent=(0.0, 0.0, 0.4)[seed])
    rate = (100.0, 384.0, 50.0)[seed]
    t, readings = driving_log(rng, calibration, (1500.0, 400.0, 900.0)[seed], rate)
    files = generate(calibration, rate_hz=rate, bias="best")
    made = run(build(write(files, tmp_path), "host"), records(t, readings))
    found = bias_by("best", t, corrected(calibration, t, readings, window=1))
    assert_best_agrees(made, found, t, path_of(calibration, t, readings), np.abs(readings[:, 5]).max())
    assert 0.2 < made.at_rest.mean() < 0.8


def test_best_agrees_where_it_is_warm_where_stamps_pause_and_where_wheels_are_told_to_turn(tmp_path: Path) -> None:
    rng = np.random.default_rng(20)
    calibration = random_calibration(rng)
    t, readings = driving_log(rng, calibration, 900.0, 100.0)
    temperature = np.float32(30 + 6 * np.sin(t / 200)).astype(float)
    readings[:, 5] = np.float32(readings[:, 5] + 1e-4 * (temperature - 30))
    kept = ~(((t > 70) & (t < 71.3)) | ((t > 150.1) & (t < 154)) | ((t > 355) & (t < 362.05)))
    t, readings, temperature = t[kept], readings[kept], temperature[kept]
    told = (t >= 500.0) & (t < 505.0)
    stamps = np.arange(0.0, 900.0, 0.1)
    commands = CommandLog(stamps, np.where((stamps >= 500.0 - 1e-6) & (stamps < 505.0 - 1e-6), 0.2, 0.0), 0 * stamps)
    files = generate(calibration, bias="best")
    made = run(build(write(files, tmp_path), "host"), records(t, readings, temperature, told))
    found = bias_by("best", t, corrected(calibration, t, readings, window=1), temperature, commands)
    assert_best_agrees(made, found, t, path_of(calibration, t, readings), np.abs(readings[:, 5]).max())
    inside = (t > 500.0) & (t < 505.0)
    assert not made.at_rest[inside].any()


@pytest.mark.parametrize("given", [False, True])
def test_best_agrees_on_an_example_run(given: bool, tmp_path: Path) -> None:
    example = read_run(EXAMPLES / "simulated-mission")
    assert example.imu is not None
    names = ("ax", "ay", "az", "gx", "gy", "gz")
    columns = [getattr(example.imu, name) for name in names]
    t = microseconds(example.imu.t) / 1e6
    readings = np.column_stack([np.zeros(len(t)) if c is None else np.float32(c) for c in columns]).astype(float)
    drift = BiasNoise(3e-4, 1e-6, 2e-5, 80.0) if given else None
    nothing = ImuCalibration.from_json(NOTHING)
    rate = round(1 / float(np.median(np.diff(t))))
    files = generate(nothing, rate_hz=rate, bias="best", noise=Noise(drift=drift))
    made = run(build(write(files, tmp_path), "host"), records(t, readings))
    found = bias_by("best", t, readings, config=FilterConfig(noise=drift))
    assert_best_agrees(made, found, t, path_of(nothing, t, readings), np.abs(readings[:, 5]).max())
    assert made.at_rest.any()


@pytest.mark.parametrize("bias", TRACKERS)
def test_cortex_m7_gives_what_the_paper_asks_and_what_this_machine_gives(bias: str, tmp_path: Path) -> None:
    """Kolhoff & Kemper 2021, section 5: online on the controller against processing afterwards, at least 98 %."""
    rng = np.random.default_rng(10)
    calibration = random_calibration(rng)
    t, readings = driving_log(rng, calibration, 180.0, 100.0)
    folder = write(generate(calibration, rate_hz=100.0, bias=bias), tmp_path)
    log = records(t, readings)
    board, here = run(build(folder, "m7"), log), run(build(folder, "host"), log)
    for name, values in board.values.items():
        if bias == "C" or name in AXES:
            np.testing.assert_array_equal(values, here.values[name])  # float32 by the letter on both
        else:  # but for the expf of two C libraries
            np.testing.assert_allclose(values, here.values[name], rtol=1e-4, atol=1e-6)
    assert (alike(calibration, t, readings, board.values) >= 0.98).all()
    heading = np.unwrap(board.values["heading"].astype(float))
    theirs = bias_by(bias, t, corrected(calibration, t, readings, window=1))
    assert np.corrcoef(np.interp(theirs.t, t, heading), theirs.theta)[0, 1] >= 0.98
    # 1.9 ms at 480 MHz are 912 000 cycles.
    assert 100 < np.median(board.instructions) < board.instructions.max() < 912_000
    flash, ram, stack = size(folder)
    assert 1000 < flash < 64 * 1024
    assert 1000 < ram < 64 * 1024
    assert 100 < stack < 4096


@pytest.mark.parametrize("bias", TRACKERS)
def test_missing_readings_and_a_clock_gone_wrong_leave_the_rest_alone(bias: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(11)
    calibration = random_calibration(rng)
    t, readings = driving_log(rng, calibration, 120.0, 100.0)
    harness = build(write(generate(calibration, bias=bias), tmp_path), "host")
    whole = run(harness, records(t, readings))

    holed = readings.copy()
    holed[3000:3003, 1] = np.nan
    holed[5000:5002, 5] = np.nan, 1e30
    made = run(harness, records(t, holed))
    assert list(np.flatnonzero(made.status)) == [5000, 5001]
    assert (made.status[5000:5002] == 1).all()
    assert all(np.isfinite(values).all() for values in made.values.values())
    np.testing.assert_array_equal(made.values["heading"][5000:5002], made.values["heading"][4999])
    holed[5001, 5] = np.nan
    np.testing.assert_allclose(made.values["ay"], corrected(calibration, t, holed)[:, 1], atol=1e-4)
    assert abs(made.values["heading"][-1] - whole.values["heading"][-1]) < 1e-3

    late = t.copy()
    late[7000] = late[6999]
    late[7001] = late[6990]
    made = run(harness, records(late, readings))
    assert list(np.flatnonzero(made.status)) == [7000, 7001]
    assert (made.status[7000:7002] == 2).all()
    for values in made.values.values():
        np.testing.assert_array_equal(values[7000:7002], values[6999])

    jumped = np.where(np.arange(len(t)) >= 9000, t - 50.0, t)  # the clock's counter began anew
    made = run(harness, records(jumped, readings))
    assert list(np.flatnonzero(made.status)) == [9000]
    assert abs(made.values["heading"][-1] - whole.values["heading"][-1]) < 0.02  # a sample at 0.6 rad/s is lost

    early = t + 2.0**32 / 1e6 - 50.0  # the clock wraps after 50 s
    made = run(harness, records(early, readings))
    for name, values in made.values.items():
        np.testing.assert_array_equal(values, whole.values[name])


def test_an_imu_with_power_already_starts_further_on(tmp_path: Path) -> None:
    """`ds_init(&state, 300.0f)` is as if the log had begun 300 s after switching on."""
    rng = np.random.default_rng(12)
    calibration = random_calibration(rng)
    t, readings = driving_log(rng, calibration, 20.0, 100.0)
    folder = write(generate(calibration, bias="C"), tmp_path)
    made = run(build(folder, "host", uptime=300.0), records(t, readings))
    expected = corrected(calibration, t + 300.0, readings)
    for j, axis in enumerate(AXES):
        worst = np.abs(made.values[axis] - expected[:, j]).max()
        assert worst <= 90 * EPS * scale_of(calibration, readings)[j], axis
