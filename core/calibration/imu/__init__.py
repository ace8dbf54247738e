"""IMU calibration and correction after Kolhoff & Kemper 2021, whole.

You give rest, six-position and rate-table runs (`calibrate`); you get an error model with deviations, what it stands
on, and why the rest is null. With a model: corrected runs (`correct`), how good they are (`judge_correction`), and
Algorithm 1 sample by sample (`constants`, `initial_state`, `step`).
"""

from core.calibration.imu.algorithm1 import AXES, WINDOW, Constants, State, advance, constants, initial_state, step
from core.calibration.imu.calibrate import AxisReport, CalibrationReport, calibrate
from core.calibration.imu.correct import CorrectionReport, Judged, correct, correction_notes, judge_correction
from core.calibration.imu.curves import Bode, CharacteristicLine, moving_average_bode, spectrum
from core.calibration.imu.model import ImuCalibration, SensorModel, SensorPair
from core.calibration.imu.paper import PaperDrift

__all__ = [
    "AXES",
    "WINDOW",
    "AxisReport",
    "Bode",
    "CalibrationReport",
    "CharacteristicLine",
    "Constants",
    "CorrectionReport",
    "ImuCalibration",
    "Judged",
    "PaperDrift",
    "SensorModel",
    "SensorPair",
    "State",
    "advance",
    "calibrate",
    "constants",
    "correct",
    "correction_notes",
    "initial_state",
    "judge_correction",
    "moving_average_bode",
    "spectrum",
    "step",
]
