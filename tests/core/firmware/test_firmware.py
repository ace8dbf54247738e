"""The generated C against Python on the same logs, to float32; and the paper's own validation on a Cortex-M7."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from board import build, records, run, size, write
from logs import (
    EPS,
    bias_by,
    corrected,
    driving_log,
    live_heading,
    offline,
    path_of,
    random_calibration,
    scale_of,
    wrapped,
)

from core.calibration.imu import AXES
from core.firmware import TRACKERS, Noise, generate


@pytest.mark.parametrize("seed", range(3))
def test_algorithm_1_and_method_c_agree_with_python(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    calibration = random_calibration(rng, silent=(0.0, 0.3, 0.0)[seed])
    rate = (100.0, 384.0, 53.0)[seed]
    t, readings = driving_log(rng, calibration, (4500.0, 900.0, 1800.0)[seed], rate)
    z = corrected(calibration, t, readings, window=1)[:, 5]
    found = bias_by("C", t, z)
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


@pytest.mark.parametrize("bias", TRACKERS)
def test_cortex_m7_gives_what_the_paper_asks_and_what_this_machine_gives(bias: str, tmp_path: Path) -> None:
    """Kolhoff & Kemper 2021, section 5: online on the controller against processing afterwards, at least 98 %."""
    rng = np.random.default_rng(10)
    calibration = random_calibration(rng)
    t, readings = driving_log(rng, calibration, 600.0, 100.0)
    folder = write(generate(calibration, rate_hz=100.0, bias=bias), tmp_path)
    log = records(t, readings)
    board, here = run(build(folder, "m7"), log), run(build(folder, "host"), log)
    for name, values in board.values.items():
        ulps = np.abs(values.view(np.int32).astype(np.int64) - here.values[name].view(np.int32))
        assert ulps.max() == 0, name  # float32 by the letter on both, expf(0) at the start included
    after = offline(calibration, t, readings)
    delay = 19  # of the window behind a sample to that about it
    for j, axis in enumerate(AXES):
        alike = np.corrcoef(board.values[axis][delay + 40 :], after[40:-delay, j])[0, 1]
        assert alike >= 0.98, axis
    heading = np.unwrap(board.values["heading"].astype(float))
    z = corrected(calibration, t, readings, window=1)[:, 5]
    theirs = bias_by(bias, t, z)
    assert np.corrcoef(np.interp(theirs.t, t, heading), theirs.theta)[0, 1] >= 0.98
    # 1.9 ms at 480 MHz are 912 000 cycles.
    assert 100 < np.median(board.instructions) < board.instructions.max() < 912_000
    flash, ram = size(folder)
    assert 1000 < flash < 64 * 1024
    assert 1000 < ram < 64 * 1024


@pytest.mark.parametrize("bias", TRACKERS)
def test_missing_readings_and_a_clock_gone_wrong_leave_the_rest_alone(bias: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(11)
    calibration = random_calibration(rng)
    t, readings = driving_log(rng, calibration, 120.0, 100.0)
    harness = build(write(generate(calibration, bias=bias), tmp_path), "host")
    whole = run(harness, records(t, readings))

    holed = readings.copy()
    holed[3000:3003, 1] = np.nan
    holed[5000:5002, 5] = np.nan
    made = run(harness, records(t, holed))
    assert list(np.flatnonzero(made.status)) == [5000, 5001]
    assert (made.status[5000:5002] == 1).all()
    assert all(np.isfinite(values).all() for values in made.values.values())
    np.testing.assert_array_equal(made.values["heading"][5000:5002], made.values["heading"][4999])
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
