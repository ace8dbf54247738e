"""All causal methods of a run that is still being driven. The story, one screen.

A piece of new rows comes: it is put behind the last seconds (`Recent`); every method steps. What is slow and may lag
behind (events, bias, links) is stepped every SLOW seconds of the robot's time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from core.estimation import needs
from core.estimation.assumptions import Config, assume
from core.estimation.odometry import WheelPath
from core.estimation.rest import at_rest
from core.estimation.result import Curve, Event
from core.live.beacon import Beacon
from core.live.disturbed import Disturbed
from core.live.fused import Fused
from core.live.links import Links, LinkState
from core.live.odometry import Encoders, EncodersGyro, WheelSum
from core.live.recent import Recent
from core.live.rhythm import Rhythm, rhythm
from core.live.steady import SteadyBias
from core.run import Run, RunMeta
from core.trajectory import Trajectory

Array = npt.NDArray[np.float64]

KEEP = 4.0  # s that methods look back
SLOW = 0.5  # s between two steps of what may lag behind
PATIENCE = 1.0  # s after which a silent wheel stream is not waited for
METHODS = ("encoders", "beacon", "encoders+gyro", "fused")


@dataclass(frozen=True)
class Step:
    """What is new after a piece: poses by method (rows in order of time), the bias by `best`, events that have come to
    their end, links (None: as they were), and per method the reason why it does not run (yet), or None."""

    paths: Mapping[str, Trajectory] = field(default_factory=dict)
    bias: Curve | None = None
    events: tuple[Event, ...] = ()
    links: tuple[LinkState, ...] | None = None
    reasons: Mapping[str, str | None] = field(default_factory=dict)


class LiveEstimator:
    """Estimators of one run. `feed` pieces whose rows are newer than those before, stream by stream."""

    def __init__(self, meta: RunMeta, config: Config | None = None) -> None:
        self._meta = meta
        self.numbers = assume(Run(meta), config)[0]
        self._recent = Recent(meta, KEEP)
        self._wheels = WheelSum(meta)
        self._rolled = WheelPath(*(np.zeros(0),) * 3)
        self._by_wheels: list[Trajectory] = []  # until the gyro's path has begun
        self.encoders = Encoders(meta, self.numbers)
        self.beacon = Beacon(self.numbers)
        self.fused = Fused(meta, self.numbers)
        self.gyro: EncodersGyro | None = None
        self.rhythm: Rhythm | None = None
        self.disturbed, self.bias, self.links = Disturbed(meta, self.numbers), SteadyBias(), Links(meta, self.numbers)
        self._beginning: Recent | None = Recent(meta, 60.0)
        self._slow = -np.inf
        self._seen: set[str] = set()

    def feed(self, piece: Run) -> Step:
        """Go on by a piece, of any length."""
        if not any(len(log) for log in piece.logs().values()):
            return Step(reasons=self.reasons())
        self._seen.update(piece.logs())
        self._recent.append(piece)
        self._learn_rhythm(piece)
        paths: dict[str, Trajectory | None] = {"beacon": self.beacon.step(self._recent.run, piece)}
        if piece.wheels is not None and self._meta.robot.wheel_radius:
            paths["encoders"] = self._roll(piece)
        if needs.for_fused(self._recent.run) is None:
            paths["fused"] = self.fused.step(self._recent.run, piece, self.rhythm)
        newest = self._recent.run.span[1]
        if newest - self._slow < SLOW:
            return Step(_present(paths), reasons=self.reasons())
        self._slow = newest
        return self._settle(paths, piece)

    def _settle(self, paths: dict[str, Trajectory | None], piece: Run) -> Step:
        """What may lag behind."""
        recent = self._recent.run
        paths["encoders+gyro"] = self._turn()
        found = self.disturbed.step(recent)
        self.fused.tell(found)
        bias = self.bias.step(recent)
        self.links.know(bias, paths.get("fused"))
        links = self.links.step(recent, self._rolled)
        return Step(_present(paths), bias, found.events, links, self.reasons())

    def reasons(self) -> dict[str, str | None]:
        """Per method None, or why it does not run (yet)."""
        run = self._recent.run
        missing = {
            "encoders": needs.for_encoders(run),
            "beacon": needs.for_beacon(run),
            "encoders+gyro": needs.for_encoders_gyro(run),
            "fused": needs.for_fused(run) or self.fused.reason,
        }
        if missing["encoders+gyro"] is None and self.gyro is None:
            missing["encoders+gyro"] = "waiting for a second of wheels and IMU"
        return missing

    def _learn_rhythm(self, piece: Run) -> None:
        if self.rhythm is not None and not self.rhythm.imu and self._beginning is None and piece.imu is not None:
            self._beginning = Recent(self._meta, 60.0)  # an IMU that begins later than the wheels
        if self._beginning is None:
            return
        self._beginning.append(piece)
        found = rhythm(self._beginning.run, self.numbers)
        if found is None:
            return
        if self.rhythm is not None and found.imu:
            self.fused = self.fused.again()
        self.rhythm, self._beginning = found, None

    def _roll(self, piece: Run) -> Trajectory | None:
        assert piece.wheels is not None
        new = self._wheels.path(piece.wheels)
        old, kept = self._rolled, self._rolled.t >= piece.wheels.t[0] - KEEP
        columns = ((old.t, new.t), (old.d, new.d), (old.turn, new.turn))
        self._rolled = WheelPath(*(np.concatenate((a[kept], b)) for a, b in columns))
        if not self._meta.robot.track_width:
            return None
        path = self.encoders.step(new)
        if self.gyro is None:
            self._by_wheels.append(path)
        return path

    def _turn(self) -> Trajectory | None:
        """`encoders+gyro` up to the newest wheel reading, or past it where the wheels are silent."""
        imu, seen = self._recent.run.imu, self.rhythm
        if imu is None or seen is None or not seen.imu or not len(self._rolled.t):
            return None
        if self.gyro is None:
            self.gyro = EncodersGyro(self._meta, self.numbers, seen)
            self.gyro.begin(float(imu.t[0]), _whole(self._by_wheels))
            self._by_wheels = []
        resting = at_rest(self._recent.run, self.numbers, seen.gyro_sd).flags
        until = max(float(self._rolled.t[-1]), float(imu.t[-1]) - PATIENCE)
        return self.gyro.step(imu, resting, self._rolled, until)


def _present(paths: Mapping[str, Trajectory | None]) -> dict[str, Trajectory]:
    return {name: path for name, path in paths.items() if path is not None and len(path)}


def _whole(parts: list[Trajectory]) -> Trajectory:
    t, x, y, theta = (np.concatenate([getattr(p, k) for p in parts]) for k in ("t", "x", "y", "theta"))
    return Trajectory(t, x, y, theta)
