"""All causal methods of a run that is still being driven. The story, one screen.

A piece of new rows comes: it is made ready (`Intake`), and every method steps by what is new. What is slow and may lag
behind (events, bias, links) looks at the last seconds (`Recent`), every SLOW seconds of the robot's time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from core.estimation import needs
from core.estimation.assumptions import Config, assume
from core.estimation.odometry import WheelPath, start_pose
from core.estimation.published import missing as missing_for_published
from core.estimation.rest import at_rest
from core.estimation.result import Curve, Event
from core.live.beacon import Beacon
from core.live.disturbed import Disturbed
from core.live.early import Early, Rolled, joined_paths
from core.live.fused import Fused
from core.live.intake import Intake, Taken
from core.live.links import Links, LinkState
from core.live.odometry import Encoders, EncodersGyro
from core.live.pieces import pieces
from core.live.published import Published
from core.live.recent import Recent
from core.live.rhythm import Rhythm, rhythm
from core.live.steady import SteadyBias
from core.run import Run, RunMeta
from core.trajectory import Trajectory

Array = npt.NDArray[np.float64]

KEEP = 4.0  # s that methods look back
LONGEST = 2.0  # s of a piece that is taken at once
SLOW = 0.5  # s between two steps of what may lag behind
PATIENCE = 1.0  # s after which a silent wheel stream is not waited for
METHODS = ("encoders", "beacon", "encoders+gyro", "published", "fused")


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
        self._intake = Intake(meta, self.numbers)
        self._rolled = Rolled(KEEP)
        self._early = Early()
        self.encoders = Encoders(meta, self.numbers)
        self.beacon = Beacon(meta, self.numbers)
        self.fused = Fused(meta, self.numbers, frozenset(config or {}))
        self.gyro: EncodersGyro | None = None
        self.published: Published | None = None
        self.rhythm: Rhythm | None = None
        self.disturbed, self.bias, self.links = Disturbed(meta, self.numbers), SteadyBias(), Links(meta, self.numbers)
        self._beginning: Recent | None = Recent(meta, 60.0)
        self._newest = self._slow = -np.inf
        self._runs = False  # whether the filter has what it needs
        self._reasons: dict[str, str | None] = {}

    def feed(self, piece: Run) -> Step:
        """Go on by a piece, of any length."""
        ends = [float(log.t[-1]) for log in piece.logs().values() if len(log)]
        if not ends:
            return Step(reasons=self.reasons())
        begin, end = piece.span
        if end - begin > LONGEST:
            return _together([self._step(part) for part in pieces(piece, LONGEST) if part.logs()])
        return self._step(piece)

    def _step(self, piece: Run) -> Step:
        self._newest = max(self._newest, piece.span[1])
        self._recent.append(piece)
        self._learn_rhythm(piece)
        taken = self._intake.take(piece)
        paths: dict[str, Trajectory | None] = {}
        if len(taken.fixes):
            paths["beacon"] = self.beacon.by_fixes(taken.fixes)
        if piece.wheels is not None and self._meta.robot.wheel_radius:
            paths["encoders"] = self._roll(taken.rolled)
        self._feel(taken)
        if not self._runs and piece.wheels is not None:
            self._runs = needs.for_fused(self._recent.run) is None
        paths["fused"] = self.fused.step(self._recent, piece, taken.events, self.rhythm if self._runs else None)
        if self._newest - self._slow < SLOW:
            return Step(_present(paths), reasons=self._reasons)
        self._slow = self._newest
        return self._settle(paths)

    def _settle(self, paths: dict[str, Trajectory | None]) -> Step:
        """What may lag behind."""
        recent, rolled = self._recent.run, self._rolled.path
        if recent.beacon is None and recent.ranges is not None:
            paths["beacon"] = self.beacon.by_ranges(recent)
        paths.update(self._turn())
        found = self.disturbed.step(recent)
        self.fused.tell(found)
        bias = self.bias.step(recent)
        self.links.know(bias, paths.get("fused"))
        links = self.links.step(recent, rolled)
        return Step(_present(paths), bias, found.events, links, self.reasons())

    def reasons(self) -> dict[str, str | None]:
        """Per method None, or why it does not run (yet)."""
        run = self._recent.run
        missing = {
            "encoders": needs.for_encoders(run),
            "beacon": needs.for_beacon(run),
            "encoders+gyro": needs.for_encoders_gyro(run),
            "published": missing_for_published(run),
            "fused": needs.for_fused(run) or self.fused.reason,
        }
        if missing["encoders+gyro"] is None and self.gyro is None:
            missing["encoders+gyro"] = "waiting for a second of wheels and IMU"
        if missing["published"] is None:
            missing["published"] = self.published.reason if self.published is not None else missing["encoders+gyro"]
        self._reasons = missing
        return missing

    def _learn_rhythm(self, piece: Run) -> None:
        if self.rhythm is not None and not self.rhythm.imu and self._beginning is None and piece.imu is not None:
            self._beginning = Recent(self._meta, 60.0)  # an IMU that begins later than the wheels
        if self._beginning is None:
            return
        self._beginning.append(piece)
        if piece.wheels is None and piece.imu is None:
            return
        found = rhythm(self._beginning.run, self.numbers)
        if found is None:
            return
        if self.rhythm is not None and found.imu:
            self.fused = self.fused.again()
        self.rhythm = found
        self._intake.know(found)
        if found.imu:
            self._early.rested(at_rest(self._beginning.run, self.numbers, found.gyro_sd), self._beginning.run)
        self._beginning = None

    def _roll(self, new: WheelPath) -> Trajectory | None:
        self._rolled.append(new)
        if not self._meta.robot.track_width:  # straight on, until the gyro tells the turns
            x, y, theta = start_pose(Run(self._meta))[0]
            at = x + new.d * np.cos(theta), y + new.d * np.sin(theta), np.full(len(new.t), theta)
            self._early.by_wheels(Trajectory(new.t, *at))
            return None
        path = self.encoders.step(new)
        self._early.by_wheels(path)
        return path

    def _feel(self, taken: Taken) -> None:
        if self.gyro is None:
            self._early.keep(taken)
            return
        self.gyro.take(taken)
        if self.published is not None:
            self.published.take(taken)

    def _turn(self) -> dict[str, Trajectory | None]:
        """`encoders+gyro` and `published` up to the newest wheel reading, or past it where the wheels are silent."""
        imu, seen, rolled = self._recent.run.imu, self.rhythm, self._rolled.path
        if imu is None or seen is None or not seen.imu or not len(rolled.t):
            return {}
        if self.gyro is None:
            self.gyro = EncodersGyro(self._meta, self.numbers, seen)
            if imu.ax is not None and imu.ay is not None and self._meta.robot.track_width:
                self.published = Published(self._meta, self.numbers, seen)
            self._early.hand_over(self.gyro, self.published)
        until = max(float(rolled.t[-1]), float(imu.t[-1]) - PATIENCE)
        by_published = self.published.step(rolled, until) if self.published is not None else None
        return {"encoders+gyro": self.gyro.step(rolled, until), "published": by_published}


def _present(paths: Mapping[str, Trajectory | None]) -> dict[str, Trajectory]:
    return {name: path for name, path in paths.items() if path is not None and len(path)}


def _together(steps: list[Step]) -> Step:
    """Steps that follow each other as one."""
    methods = dict.fromkeys(m for step in steps for m in step.paths)
    paths = {m: joined_paths([step.paths[m] for step in steps if m in step.paths]) for m in methods}
    curves = [step.bias for step in steps if step.bias is not None]
    bias = Curve(*(np.concatenate([getattr(c, k) for c in curves]) for k in ("t", "value", "sd"))) if curves else None
    links = [step.links for step in steps if step.links is not None]
    events = tuple(event for step in steps for event in step.events)
    return Step(paths, bias, events, links[-1] if links else None, steps[-1].reasons)
