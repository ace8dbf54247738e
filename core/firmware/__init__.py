"""Algorithm 1 (Kolhoff & Kemper 2021) and a gyro bias tracker as self-contained C99 for a microcontroller.

The user gives a calibration, the IMU's rate, a tracker and how noisy the gyro is; `generate` gives C files. The
algorithms are plain C beside this file (`c/`); only the header of constants is made for the calibration.
"""

from __future__ import annotations

from core.firmware.constants import Noise, noise_of_allan
from core.firmware.source import TRACKERS, Firmware, firmware, generate

__all__ = ["TRACKERS", "Firmware", "Noise", "firmware", "generate", "noise_of_allan"]
