"""`Run`: one recording of one robot, real or simulated; the type that every later step works on."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from core.robot import BeaconMap, EffectSet, Noise, Pose, Procedure, RobotParams
from core.sensors import STREAMS, BeaconLog, CommandLog, ImuLog, Log, RangeLog, TruthLog, WheelLog


@dataclass(frozen=True)
class RunMeta:
    """What `run.json` holds. `extra` keeps keys that we do not know, so that writing back loses nothing."""

    name: str = ""
    robot: RobotParams = field(default_factory=RobotParams)
    beacons: BeaconMap = field(default_factory=dict)
    start: Pose | None = None
    noise: Noise = field(default_factory=Noise)
    effects: EffectSet = field(default_factory=dict)
    procedure: Procedure | None = None
    extra: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class Run:
    """A recording: its description and the streams that it has (None where absent)."""

    meta: RunMeta = field(default_factory=RunMeta)
    commands: CommandLog | None = None
    wheels: WheelLog | None = None
    imu: ImuLog | None = None
    beacon: BeaconLog | None = None
    ranges: RangeLog | None = None
    truth: TruthLog | None = None

    def logs(self) -> dict[str, Log]:
        """Present streams by name, in the format's order."""
        pairs = ((name, getattr(self, name)) for name in STREAMS)
        return {name: log for name, log in pairs if log is not None}

    @property
    def span(self) -> tuple[float, float]:
        """First and last stamp over all streams [s]; (0, 0) for a run without readings."""
        logs = [log for log in self.logs().values() if len(log)]
        if not logs:
            return 0.0, 0.0
        return min(float(log.t[0]) for log in logs), max(float(log.t[-1]) for log in logs)

    @property
    def duration(self) -> float:
        """Seconds between the first and the last stamp."""
        t0, t1 = self.span
        return t1 - t0

    def crop(self, t0: float, t1: float) -> Run:
        """The run between two stamps, views of the same arrays. `start` no longer holds and is dropped if t0 cuts."""
        logs: dict[str, Any] = {name: log.crop(t0, t1) for name, log in self.logs().items()}
        meta = self.meta if t0 <= self.span[0] else dataclasses.replace(self.meta, start=None)
        return dataclasses.replace(self, meta=meta, **logs)
