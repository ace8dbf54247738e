"""Recorded logs through the room: what they give is in the guide's page `imu`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from core.formats import read_run
from core.imu.allan import allan
from core.imu.bias import METHODS, track_bias
from core.imu.noise import fit_noise

DEG = np.pi / 180

pytestmark = pytest.mark.shared


def test_adis16405_at_rest(shared_data: Path) -> None:
    run = read_run(shared_data / "real" / "adis16405-rest-a" / "run-01")
    assert run.imu is not None
    fit = fit_noise(allan(run.imu.t, run.imu.gz))
    assert fit.N.value == pytest.approx(0.0408 * DEG, rel=0.02)
    for method in ("C", "best", "smoothed"):
        assert abs(track_bias(run, method).theta[-1]) < 1 * DEG
    assert abs(track_bias(run, "A").theta[-1]) > 100 * DEG


def test_mpu6050_with_bursts_of_stamps(shared_data: Path) -> None:
    run = read_run(shared_data / "real" / "mpu6050-rest" / "rest-z-up-10min")
    for method in METHODS:
        made = track_bias(run, method)
        assert made.bias[-1] == pytest.approx(1.12 * DEG, abs=0.02 * DEG)
        gaps = [int(note.split()[0]) for note in made.notes if "gaps" in note]
        assert sum(gaps) < 20  # 133 readings are lost; that stamps come in bursts is no gap
    assert abs(track_bias(run, "best").theta[-1]) < 0.2 * DEG


@pytest.mark.parametrize("name", ["husky-steps/step-000", "borealtc-a/flooring-01", "plaza1/distance-gyro"])
def test_drives_without_a_rest_say_so(shared_data: Path, name: str) -> None:
    made = track_bias(read_run(shared_data / "real" / name), "best")
    assert any("No rest" in note for note in made.notes)
    assert made.theta_sd is not None
    assert made.theta_sd[-1] > 0.5
