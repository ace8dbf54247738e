"""What viewers of one run are told: the whole run so far to who joins, then what is new, at most UPDATE_HZ times a
second. Each viewer has a short queue; one that reads too slowly misses updates and is never waited for."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping, Sequence
from typing import Any

import msgpack
import numpy as np
import numpy.typing as npt

from app.live.history import SHORT, Extremes, Thinned
from app.live.protocol import Bias, Link, LiveEvent, MethodState, Path, Pose, Quality, Ranges, Signal
from core.estimation.pipeline import METHODS
from core.live.estimator import METHODS as LIVE_METHODS
from core.sensors import STREAMS

Array = npt.NDArray[np.float64]

QUEUE = 8  # messages that may wait for a viewer
WIDTH = 8  # columns of a `Path`
EVENTS = 500
UNSEEN, COARSE = 40, 0.5  # without viewers: batches that wait, s that become two points


class Viewer:
    """One who watches. `post` never waits."""

    def __init__(self, name: str, binary: bool) -> None:
        self.name, self.binary = name, binary
        self.queue: asyncio.Queue[str | bytes] = asyncio.Queue(QUEUE)
        self.missed = 0

    def post(self, frame: str | bytes) -> bool:
        """Queue a frame; False where there is no room: it is left out."""
        try:
            self.queue.put_nowait(frame)
        except asyncio.QueueFull:
            self.missed += 1
            return False
        return True

    def tell(self, message: Mapping[str, Any]) -> None:
        """Queue a message that must not be missed: the oldest gives way."""
        frame = encoded(message, self.binary)
        while not self.post(frame):
            self.queue.get_nowait()


def encoded(message: Mapping[str, Any], binary: bool) -> str | bytes:
    """A message as a frame."""
    if binary:
        packed: bytes = msgpack.packb(message)
        return packed
    return json.dumps(message, separators=(",", ":"), allow_nan=False)


class Feed:
    """The state of one run as viewers see it: all so far (thinned), and what is new since the last update."""

    def __init__(self) -> None:
        self.seq = 0
        self.t = 0.0
        self.rows: dict[str, int] = {}
        self._paths: dict[str, Thinned] = {}
        self._poses: dict[str, Pose] = {}
        self._signals: dict[str, Extremes] = {}
        self._bias = Thinned(3, 2000)
        self._events: dict[tuple[str, float], LiveEvent] = {}
        self._links: list[Link] = []
        self._ranges: dict[str, Ranges] = {}
        self._reasons: dict[str, str | None] = {}
        self._new_trail: dict[str, list[list[Any]]] = {}
        self._new_bias: list[list[Any]] = [[], [], []]
        self._new_events: list[LiveEvent] = []
        self._methods_changed = True
        self.changed = self.watched = False
        self._unseen: dict[str, list[tuple[Array, Array]]] = {}  # readings by signal
        self._batches = 0

    def take_rows(self, streams: Mapping[str, Mapping[str, Any]], names: list[str]) -> None:
        """Readings as they were accepted."""
        for name, columns in streams.items():
            t = columns["t"]
            self.rows[name] = self.rows.get(name, 0) + len(t)
            self.t = max(self.t, float(t[-1]))
            if name == "ranges":
                self._take_ranges(columns, names)
                continue
            for column, values in columns.items():
                if column != "t":
                    self._unseen.setdefault(f"{name}.{column}", []).append((t, values))
        self._batches += 1
        if self.watched or self._batches >= UNSEEN:
            self._catch_up(SHORT if self.watched else COARSE)
        self.changed = True

    def _catch_up(self, width: float) -> None:
        """Thin the readings that nobody has looked at yet."""
        for name, parts in self._unseen.items():
            t, values = (np.concatenate([part[i] for part in parts]) for i in range(2))
            self._signals.setdefault(name, Extremes()).add(t, values, width)
        self._unseen, self._batches = {}, 0

    def _take_ranges(self, columns: Mapping[str, Any], names: list[str]) -> None:
        for stamp, code, value in zip(columns["t"].tolist(), columns["beacon"].tolist(), columns["range"].tolist(),
                                      strict=True):  # fmt: skip
            if value == value:
                self._ranges[names[code]] = Ranges(t=stamp, range=value)
        for code in np.unique(columns["beacon"]):
            mine = columns["beacon"] == code
            signal = self._signals.setdefault(f"ranges.{names[code]}", Extremes())
            signal.add(columns["t"][mine], columns["range"][mine])

    def take_estimate(self, made: Mapping[str, Any]) -> None:
        """A worker's answer."""
        for method, row in made["poses"].items():
            self._poses[method] = _pose(row)
        for method, columns in made["trails"].items():
            self._paths.setdefault(method, Thinned(WIDTH)).add(columns)
            new = self._new_trail.setdefault(method, [[] for _ in range(WIDTH)])
            for held, column in zip(new, columns, strict=True):
                held.extend(column)
                del held[:-200]
        if made["bias"] is not None:
            self._bias.add(made["bias"])
            for held, column in zip(self._new_bias, made["bias"], strict=True):
                held.extend(column)
                del held[:-200]
        for kind, t0, t1, evidence in made["events"]:
            event = LiveEvent(kind=kind, t0=t0, t1=t1, evidence=evidence)
            self._events[kind, t0] = event
            self._new_events.append(event)
            if len(self._events) > EVENTS:
                self._events.pop(next(iter(self._events)))
        if made["links"] is not None:
            self._links = [
                Link(link=link, streams=streams, excess=excess, level=level, warn=warn, rows=rows)
                for link, streams, excess, level, warn, rows in made["links"]
            ]
        if made["reasons"] != self._reasons:
            self._reasons, self._methods_changed = dict(made["reasons"]), True
        self.changed = True

    def methods(self) -> list[MethodState]:
        """Which methods run, and why the others do not."""
        waiting = "waiting for readings"
        return [
            MethodState(method=m, label=METHODS[m].label, reason=self._reasons.get(m, waiting)) for m in LIVE_METHODS
        ]

    def snapshot(self, quality: Quality) -> dict[str, Any]:
        """All so far: what a Snapshot holds beside the run's description."""
        self._catch_up(SHORT)
        signals = {name: _signal(signal.shown()) for name, signal in self._signals.items()}
        return {
            "seq": self.seq,
            "t": self.t,
            "methods": self.methods(),
            "paths": {m: _path(path.columns) for m, path in self._paths.items()},
            "signals": signals,
            "units": {name: _unit(name) for name in signals},
            "bias": _bias(self._bias.columns),
            "events": list(self._events.values()),
            "links": self._links,
            "ranges": self._ranges,
            "quality": quality,
            "rows": self.rows,
        }

    def update(self, state: str, quality: Quality) -> dict[str, Any]:
        """What is new, which then is old."""
        self.seq += 1
        message: dict[str, Any] = {
            "type": "update",
            "seq": self.seq,
            "state": state,
            "t": self.t,
            "poses": self._poses,
            "trail": {m: _path(columns) for m, columns in self._new_trail.items()},
            "signals": {name: _signal(new) for name, s in self._signals.items() if (new := s.fresh())},
            "bias": _bias(self._new_bias),
            "events": self._new_events,
            "links": self._links,
            "ranges": self._ranges,
            "quality": quality,
            "rows": self.rows,
        }
        if self._methods_changed:
            message["methods"] = self.methods()
        self._new_trail, self._new_bias, self._new_events = {}, [[], [], []], []
        self._methods_changed = self.changed = False
        return message


def _pose(row: Sequence[Any]) -> Pose:
    t, x, y, theta, sd_x, sd_y, sd_theta, cov_xy = row
    return Pose(t=t, x=x, y=y, theta=theta, sd_x=sd_x, sd_y=sd_y, sd_theta=sd_theta, cov_xy=cov_xy)


def _path(columns: Sequence[list[Any]]) -> Path:
    t, x, y, theta, sd_x, sd_y, sd_theta, cov_xy = columns
    return Path(t=t, x=x, y=y, theta=theta, sd_x=sd_x, sd_y=sd_y, sd_theta=sd_theta, cov_xy=cov_xy)


def _bias(columns: list[list[Any]]) -> Bias:
    return Bias(t=columns[0], value=columns[1], sd=columns[2])


def _signal(points: list[tuple[float, float]]) -> Signal:
    return Signal(t=[t for t, _ in points], y=[y if y == y else None for _, y in points])


def _unit(name: str) -> str:
    stream, _, column = name.partition(".")
    return "m" if stream == "ranges" else STREAMS[stream].column(column).unit
