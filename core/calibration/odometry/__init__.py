"""Odometry calibration: UMBmark's squares, and everything at once from any runs with a reference.

You give runs of one robot; you get radii, track width, gyro scale, mounts and clocks with standard deviations, None
with a reason for what the runs do not show, and `corrected` runs.
"""

from core.calibration.odometry.model import NAMES, OdometryCalibration, corrected
from core.calibration.odometry.simultaneous import calibrate_odometry
from core.calibration.odometry.umbmark import Umbmark, umbmark

__all__ = ["NAMES", "OdometryCalibration", "Umbmark", "calibrate_odometry", "corrected", "umbmark"]
