"""`fused`, stepped: the filter of `core.estimation.fusion` by `Replay`, which takes readings late or out of order.

Offline some numbers are learnt from the whole run: here they are those of `rhythm`, and noise is what run.json states,
else what is assumed; of fixes and ranges it is then learnt as it goes (`surprise`). The start is found by the same
three ways as offline, from what has come so far: until then there is no pose, and `reason` says what is waited for. On
the same numbers and start the path is the same.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from core.estimation.assumptions import Assumptions
from core.estimation.cleaning import wheel_readings
from core.estimation.events import Disturbances
from core.estimation.fusion.events import Events, merge
from core.estimation.fusion.fused import reckoned_alone
from core.estimation.fusion.layout import FIX, RANGE, WHEEL
from core.estimation.fusion.replay import Replay
from core.estimation.fusion.start import Start, find_start
from core.estimation.fusion.walk import problem
from core.estimation.rest import Rest, at_rest
from core.live.recent import Recent
from core.live.rhythm import Rhythm
from core.live.surprise import Surprise
from core.run import Run, RunMeta
from core.trajectory import Trajectory

Array = npt.NDArray[np.float64]

HORIZON = 2.0  # s: how late a reading may be, and how far back a disturbance can be told
HEADING = 0.1  # rad: sd of the heading with which the filter sets out
LISTEN = 2.0  # s without fix or range, after which the path is relative
TRIES = 0.5  # s between two tries to find the start
LONGEST_WAIT = 60.0  # s of readings from which a start is sought


class Fused:
    """The filter, and until it has set out the readings that its start is sought from."""

    def __init__(self, meta: RunMeta, numbers: Assumptions, given: frozenset[str] = frozenset()) -> None:
        self.meta, self.numbers, self._given = meta, numbers, given
        self._surprise = Surprise(meta, given)
        self.reason: str | None = "waiting for a second of wheels and IMU"
        self.replay: Replay | None = None
        self.start: Start | None = None
        self._waiting = Recent(meta, LONGEST_WAIT)
        self._first: Array | None = None  # wheel angles that distance counts from
        self._tried = self._told = -np.inf
        self._kinds: frozenset[int] = frozenset()
        self._relative = False
        self.bias: tuple[Array, Array, Array] = (np.zeros(0),) * 3  # t, bias, variance of the last step's rows

    def step(self, recent: Recent, piece: Run, events: Events, rhythm: Rhythm | None) -> Trajectory | None:
        """New poses, up to the newest reading; None where there are none. `events` are those of the piece."""
        if self.replay is None:
            self._waiting.append(piece)
            if rhythm is None or piece.span[1] - self._tried < TRIES or not self._set_out(self._waiting.run, rhythm):
                return None
            self._waiting = Recent(self.meta, LONGEST_WAIT)
        else:
            assert rhythm is not None
            self._go_on(recent, events, rhythm)
        return self._new_rows()

    def again(self) -> Fused:
        """A filter that sets out anew from where this one is: for a sensor that it was not made for."""
        fresh = Fused(self.meta, self.numbers, self._given)
        fresh._first, fresh._told = self._first, self._told
        if self.replay is not None and not self._relative:
            state = self.replay.state
            fresh.start = Start(state.x[:3].copy(), state.P[:3, :3].copy())
        return fresh

    def tell(self, known: Disturbances) -> None:
        """What befell the robot, found a moment ago."""
        if self.replay is not None and known.found:
            self.replay.tell(known)

    def _events(self, run: Run, rhythm: Rhythm) -> tuple[Events, Rest | None]:
        """Events of the readings, distances counted from the run's first."""
        rest = at_rest(run, self.numbers, rhythm.gyro_sd) if rhythm.imu and run.imu is not None else None
        events = merge(run, self.numbers, rest)
        robot, wheels = run.meta.robot, run.wheels
        assert wheels is not None and robot.wheel_radius
        now = np.array([side[0] for side in wheel_readings(wheels)])
        self._first = now if self._first is None else self._first
        left, right = robot.wheel_radius * (now - self._first)
        rows = events.kind == WHEEL
        events.data[rows, 0] += (left + right) / 2
        if robot.track_width:
            events.data[rows, 1] += (right - left) / robot.track_width
        return events, rest

    def _set_out(self, run: Run, rhythm: Rhythm) -> bool:
        """Find the start and walk over what has come; False while it is not known."""
        newest = run.span[1]
        self._tried = newest
        events, rest = self._events(run, rhythm)
        absolute = bool(events.of(FIX, RANGE).any())
        if self.meta.start is None and self.start is None and not absolute and newest - run.span[0] < LISTEN:
            self.reason = "listening for fixes or ranges"
            return False
        start = self.start or self._found(run, events, rest)
        if start is None:
            return False
        self._relative = self.meta.start is None and not absolute
        self._begin(run, events, start, rest)
        return True

    def _found(self, run: Run, events: Events, rest: Rest | None) -> Start | None:
        start = find_start(run, events, self.numbers, lambda: reckoned_alone(run, events, self.numbers, rest))
        sd = float(np.sqrt(start.covariance[2, 2]))
        if sd > HEADING or "ambiguous" in "".join(start.notes):
            self.reason = f"drive a metre or two: the heading is known to {sd:.2g} rad only"
            return None
        return start

    def _begin(self, run: Run, events: Events, start: Start, rest: Rest | None) -> None:
        self.start, self.reason = start, None
        self.replay = Replay(problem(run, events, start, self.numbers, rest), HORIZON)
        self._kinds = frozenset(events.kind.tolist())
        self._take(start.without_used(events))

    def _go_on(self, recent: Recent, events: Events, rhythm: Rhythm) -> None:
        fresh = frozenset(events.kind.tolist()) & {FIX, RANGE} - self._kinds
        if not fresh:
            self._take(events)
        elif self._relative:  # the map is known only now
            self.replay = self.start = None
            self.reason = "finding the place on the map"
        else:  # a sensor that the filter was not made for
            assert self.replay is not None
            state = self.replay.state
            x = Start(state.x[:3].copy(), state.P[:3, :3].copy())
            rest = at_rest(recent.run, self.numbers, rhythm.gyro_sd) if rhythm.imu else None
            self._begin(recent.run, events, x, rest)

    def _take(self, events: Events) -> None:
        assert self.replay is not None
        if len(events.t):
            self.replay.take(events.t, events.kind, events.data, events.flags)
            kind, third, nis = self.replay.judged()
            if len(kind):
                self._surprise.take(kind, (kind == FIX) & np.isfinite(third), nis, self.replay.constants)

    def _new_rows(self) -> Trajectory | None:
        if self.replay is None:
            return None
        parts = (self.replay.drain(), self.replay.since(self._told))
        t, rows, covariance = (np.concatenate([part[i] for part in parts]) for i in range(3))
        new = t > self._told
        if not new.any():
            return None
        t, rows, covariance = t[new], rows[new], covariance[new]
        self._told = float(t[-1])
        self.bias = t, rows[:, 3], rows[:, 4]
        return Trajectory(t, rows[:, 0], rows[:, 1], rows[:, 2], covariance)
