"""One live run: batches in their order, rows in theirs, each where it belongs: log, columns, estimator, feed."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from app.live import log as logs
from app.live.columns import Columns
from app.live.feed import Feed
from app.live.messages import LIMITS, CheckedBatch, CheckedHello, batch, decode, hello
from app.live.messages import NAMES as MOST_NAMES
from app.live.protocol import Quality, Throttle
from app.live.quality import Gauge
from core.errors import DriftscopeError, TooLargeError

JUMP_AHEAD = 600.0  # s that a stamp may be ahead of the one before it
STEP_BACK = 2.0  # s that a whole batch may lie before what is there
BURST = 4.0  # s of the highest rate that may come at once
FLOOD = 2000  # batches in a row that could not be taken: the robot does not listen


class ClockError(DriftscopeError):
    """Stamps that no run can have: a clock that jumped. `where`: stream, expected, found."""

    code = "clock"


class FloodError(DriftscopeError):
    """A robot that goes on sending though it was told to wait."""

    code = "flood"


Sink = Callable[[int, dict[str, dict[str, Any]], list[str]], None]
"""Where the rows of a run go for estimation: number of the batch, streams, names of beacons."""


@dataclass(frozen=True)
class Taken:
    """What came of a batch: whether it was new, or why it has to wait."""

    new: bool = False
    throttle: Throttle | None = None


class LiveRun:
    """State of one run. Nothing here waits: what takes time is handed on."""

    def __init__(self, data: Path, run_id: str, robot: str, said: CheckedHello) -> None:
        self.id, self.robot, self.said = run_id, robot, said
        self.columns, self.feed, self.gauge = Columns(data, run_id), Feed(), Gauge()
        self.next = 0  # batch that is wanted
        self.durable = -1  # batches up to this one are on disk
        self.path = data / "live" / run_id / "log"
        self.log: logs.Log | None = None
        self.ended = False
        self.started = time.time()
        self._last: dict[str, float] = {}  # newest stamp per stream
        self._tokens, self._filled = BURST * LIMITS["rows_per_s"], time.monotonic()
        self._batch_tokens = BURST * LIMITS["batches_per_s"]
        self._refused = 0
        self._told_gap = -1
        self._robot_commands = False

    def quality(self) -> Quality:
        """How good the connection is by now."""
        return self.gauge.read(time.time())

    @property
    def t(self) -> float:
        """Newest stamp of all streams."""
        return max(self._last.values(), default=0.0)

    def take(
        self, checked: CheckedBatch, frame: str | bytes, feed: Sink, durable: Callable[[int, OSError | None], None]
    ) -> Taken:
        """A batch: new, known already, or too early. `durable` is called from the log's thread."""
        now = time.time()
        if checked.n < self.next:
            self.gauge.again(now)
            return Taken()
        waits = self._must_wait(checked)
        if waits is not None:
            self.gauge.again(now)
            self._refused += 1
            if self._refused > FLOOD:
                raise FloodError(
                    f"{FLOOD} batches came though the robot was told to wait: {waits['reason']}", found=self._refused
                )
            return Taken(throttle=waits)
        streams = self._fresh(checked, now)
        self._refused, self._told_gap = 0, -1
        self.next += 1
        self.gauge.arrived(now, checked.n, checked.sent, checked.heard, {s: len(c["t"]) for s, c in streams.items()})
        assert self.log is not None
        kind = logs.TEXT if isinstance(frame, str) else logs.BINARY
        payload = frame.encode() if isinstance(frame, str) else frame
        n = checked.n
        self.log.append(kind, payload, lambda error: durable(n, error))
        self._hand_on(streams, n, feed)
        return Taken(new=True)

    def _must_wait(self, checked: CheckedBatch) -> Throttle | None:
        if checked.n > self.next:
            return self._throttle("gap", f"batch {self.next} is missing before {checked.n}", 0.0)
        if self.next - self.durable > LIMITS["unacknowledged"]:
            return self._throttle("backlog", f"{LIMITS['unacknowledged']} batches are not on disk yet", 0.2)
        now = time.monotonic()
        passed, self._filled = now - self._filled, now
        rows, batches = LIMITS["rows_per_s"], LIMITS["batches_per_s"]
        self._tokens = min(BURST * rows, self._tokens + passed * rows)
        self._batch_tokens = min(BURST * batches, self._batch_tokens + passed * batches)
        if self._tokens < checked.rows:
            wait = (checked.rows - self._tokens) / rows
            return self._throttle("rate", f"more than {rows:g} rows a second", max(wait, 0.1))
        if self._batch_tokens < 1:
            return self._throttle("rate", f"more than {batches:g} batches a second", 0.1)
        self._tokens -= checked.rows
        self._batch_tokens -= 1
        return None

    def _throttle(self, code: str, reason: str, wait: float) -> Throttle:
        return Throttle(type="throttle", code=code, reason=reason, wait_s=round(wait, 3), next=self.next)

    def tell_throttle(self, throttle: Throttle) -> bool:
        """Whether the robot is to be told: once for each gap, not for every batch behind it."""
        if throttle["code"] == "gap" and self._told_gap == throttle["next"]:
            return False
        self._told_gap = throttle["next"]
        return True

    def _fresh(self, checked: CheckedBatch, now: float) -> dict[str, dict[str, Any]]:
        """Rows newer than those of their stream; names of beacons as codes."""
        streams: dict[str, dict[str, Any]] = {}
        for name, columns in checked.streams.items():
            t = columns["t"]
            if not len(t):
                continue
            newest = self._last.get(name)
            if newest is None or (newest < t[0] and t[-1] - newest <= JUMP_AHEAD):
                streams[name] = dict(columns)
                continue
            self._check_clock(name, t, newest)
            first = int(np.searchsorted(t, newest, "right"))
            if first:
                self.gauge.late(now, first)
            if first < len(t):
                streams[name] = {column: values[first:] for column, values in columns.items()}
        if "ranges" in streams:
            streams["ranges"]["beacon"] = self._codes(streams["ranges"]["beacon"])
        for name, columns in streams.items():
            self._last[name] = float(columns["t"][-1])
        self._robot_commands = self._robot_commands or "commands" in checked.streams
        return streams

    def _check_clock(self, name: str, t: Any, newest: float) -> None:
        if t[-1] < newest - STEP_BACK:
            raise ClockError(
                f"{name}: the robot's clock went back by {newest - t[-1]:.3g} s; begin a new session",
                stream=name, expected=f"stamps after {newest!r}", found=float(t[-1]),
            )  # fmt: skip
        ahead = max(float(t[0] - newest), float((t[1:] - t[:-1]).max()) if len(t) > 1 else 0.0)
        if ahead > JUMP_AHEAD:
            raise ClockError(
                f"{name}: the robot's clock jumped ahead by {ahead:.3g} s; begin a new session",
                stream=name, expected=f"steps of at most {JUMP_AHEAD} s", found=ahead,
            )  # fmt: skip

    def _codes(self, names: list[str]) -> Any:
        known = self.columns.names
        for name in dict.fromkeys(names):
            if name not in known:
                if len(known) >= MOST_NAMES:
                    raise TooLargeError(f"more than {MOST_NAMES} different beacons", stream="ranges", column="beacon")
                known.append(name)
        return np.array([known.index(name) for name in names], np.int16)

    def _hand_on(self, streams: dict[str, dict[str, Any]], n: int, feed: Sink) -> None:
        if streams:
            self.columns.add(streams)
            self.feed.take_rows(streams, self.columns.names)
        feed(n, streams, self.columns.names)

    def commanded(self, v: float, w: float, feed: Sink) -> None:
        """A command went to a robot that does not send its `commands` itself: recorded at its newest stamp."""
        if self._robot_commands or self.log is None or self.ended:
            return
        at = self._command_stamp()
        self.log.append(logs.COMMAND, json.dumps([at, v, w]).encode(), lambda error: None)
        self._command_row(at, v, w, feed)

    def _command_stamp(self) -> float:
        since = min(max(time.time() - self.gauge.last_heard, 0.0), 1.0) if self.gauge.last_heard else 0.0
        return max(self.t + since, math.nextafter(self._last.get("commands", -math.inf), math.inf))

    def _command_row(self, at: float, v: float, w: float, feed: Sink) -> None:
        self._last["commands"] = at
        row = {"t": np.array([at]), "v": np.array([v]), "w": np.array([w])}
        self._hand_on({"commands": row}, self.next - 1, feed)

    def replay(self, feed: Sink) -> None:
        """Take in again what the log holds: after a crash of the server. Columns are made anew."""
        for kind, payload in logs.read(self.path):
            if kind in (logs.TEXT, logs.BINARY):
                checked = batch(decode(payload.decode() if kind == logs.TEXT else payload))
                self._hand_on(self._fresh(checked, 0.0), checked.n, feed)
                self.next = checked.n + 1
            elif kind == logs.COMMAND:
                at, v, w = json.loads(payload)
                self._command_row(at, v, w, feed)
            elif kind == logs.END:
                self.ended = True
        self.durable = self.next - 1

    def rows_so_far(self) -> Mapping[str, dict[str, Any]]:
        """All rows that are on file, by stream: for an estimator that begins anew."""
        self.columns.flush()
        return self.columns.all()


def said_in(path: Path) -> tuple[str, CheckedHello] | None:
    """The robot and its Hello out of a log; None where not even that is whole."""
    for kind, payload in logs.read(path):
        if kind == logs.HELLO:
            held = json.loads(payload)
            return held["robot"], hello(held["hello"])
        break
    return None
