"""The table of streams: what a run can hold, column by column, with units. One file per sensor beside this one.

To add a sensor: a file here with its log, a row in STREAMS, a field in `core.run.Run`.
"""

from __future__ import annotations

from core.sensors.base import Column, Log, StreamSpec
from core.sensors.beacon import BEACON, BeaconLog
from core.sensors.commands import COMMANDS, CommandLog
from core.sensors.imu import IMU, ImuLog
from core.sensors.ranges import RANGES, RangeLog
from core.sensors.truth import TRUTH, TruthLog
from core.sensors.wheels import WHEELS, WheelLog

STREAMS: dict[str, StreamSpec] = {s.name: s for s in (COMMANDS, WHEELS, IMU, BEACON, RANGES, TRUTH)}

__all__ = [
    "STREAMS",
    "BeaconLog",
    "Column",
    "CommandLog",
    "ImuLog",
    "Log",
    "RangeLog",
    "StreamSpec",
    "TruthLog",
    "WheelLog",
]
