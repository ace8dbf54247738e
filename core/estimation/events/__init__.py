"""What befell the robot: slip, collision, bounce, a push, a blocked robot, a dead encoder.

Given: a run with wheels or an IMU, and commands where there are any. Done: residuals between what the sensors say of
the same motion are tested against the noise that the run has shown so far; nothing looks ahead. An alarm comes some
tenths of a second after the onset, and the onset is dated back.
"""

from core.estimation.events.detector import Detector, detect
from core.estimation.events.disturbances import KINDS, Disturbance, Disturbances, Flags

__all__ = ["KINDS", "Detector", "Disturbance", "Disturbances", "Flags", "detect"]
