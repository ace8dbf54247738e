"""One calibrated sensor for all tests of the room: fitting takes longest."""

from __future__ import annotations

import pytest

from core.calibration.imu import CalibrationReport, calibrate
from tests.plants.imu_rig import Rig, draw_rig, rate_table_run, rest_run, six_position_run

SEED = 5


@pytest.fixture(scope="session")
def rig() -> Rig:
    """A sensor out of Table 1, sampled slowly to keep the runs small."""
    return draw_rig(SEED, rate=25.0)


@pytest.fixture(scope="session")
def report(rig: Rig) -> CalibrationReport:
    return calibrate([rest_run(rig, 1, 3000.0), six_position_run(rig, 2, 30.0), rate_table_run(rig, 3, seconds=20.0)])
