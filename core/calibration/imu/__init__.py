"""IMU calibration and correction after Kolhoff & Kemper 2021, whole.

You give rest, six-position and rate-table runs; you get an error model with deviations, and corrected runs.
"""

from core.calibration.imu.algorithm1 import AXES, WINDOW, Constants, State, advance, constants, initial_state, step
from core.calibration.imu.model import ImuCalibration, SensorModel, SensorPair

__all__ = [
    "AXES",
    "WINDOW",
    "Constants",
    "ImuCalibration",
    "SensorModel",
    "SensorPair",
    "State",
    "advance",
    "constants",
    "initial_state",
    "step",
]
