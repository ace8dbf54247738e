"""A process that estimates live runs: `python -m app.live.worker`, frames of MessagePack on standard input and output.

Beside the web server and not in it: filters take the processor for milliseconds at a time, and an answer on the
network must not wait for them. What has come in for a run while another was estimated is taken as one piece, so a
worker that falls behind does less work per row and catches up.

In    {"op": "open", "id", "run": run.json} · {"op": "feed", "id", "n", "streams", "names"} · {"op": "close", "id"}
Out   {"id", "n", ...} as `answer` makes it; {"id", "error"} where estimating failed
"""

from __future__ import annotations

import os
import queue
import struct
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import IO, TYPE_CHECKING, Any

import msgpack
import numpy as np

if TYPE_CHECKING:
    from core.live import LiveEstimator, Step
    from core.run import Run
    from core.trajectory import Trajectory

LENGTH = struct.Struct("<I")
THIN = 0.05  # s between two poses of a trail
Message = dict[str, Any]


def packed(message: Message) -> bytes:
    """A message as it goes through the pipe."""
    body: bytes = msgpack.packb(message)
    return LENGTH.pack(len(body)) + body


@dataclass
class Held:
    """A run's estimator, and until when its trails have been told."""

    estimator: LiveEstimator
    told: dict[str, float] = field(default_factory=dict)


def main() -> int:
    """Serve until standard input ends."""
    os.environ.setdefault("NUMBA_NUM_THREADS", "1")  # pieces are small: threads only cost
    from core.formats.run_json import meta_from_json
    from core.live import LiveEstimator

    inbox: queue.Queue[Message | None] = queue.Queue()
    threading.Thread(target=_listen, args=(sys.stdin.buffer, inbox), daemon=True).start()
    runs: dict[str, Held] = {}
    for messages in _batches(inbox):
        feeds: dict[str, list[Message]] = {}
        for message in messages:
            if message["op"] == "open":
                runs[message["id"]] = Held(LiveEstimator(meta_from_json(message["run"], file="run.json")))
            elif message["op"] == "close":
                runs.pop(message["id"], None)
                feeds.pop(message["id"], None)
            else:
                feeds.setdefault(message["id"], []).append(message)
        for run_id, parts in feeds.items():
            if run_id in runs:
                _say(_fed(runs, run_id, parts))
    return 0


def _fed(runs: dict[str, Held], run_id: str, parts: list[Message]) -> Message:
    held = runs[run_id]
    try:
        step = held.estimator.feed(as_run(parts))
    except Exception as error:  # a fault in one run must not end the others'
        del runs[run_id]
        return {"id": run_id, "n": parts[-1]["n"], "error": f"{type(error).__name__}: {error}"}
    return {"id": run_id, "n": parts[-1]["n"], **answer(step, held.told)}


def as_run(parts: list[Message]) -> Run:
    """The parts of one run, in order, as one piece."""
    from core.run import Run
    from core.sensors import STREAMS

    logs: dict[str, Any] = {}
    for name in dict.fromkeys(name for part in parts for name in part["streams"]):
        having = [part["streams"][name] for part in parts if name in part["streams"]]
        columns: dict[str, Any] = {}
        for column in dict.fromkeys(c for part in having for c in part):
            dtype = "<i2" if column == "beacon" else "<f8"
            values = [
                np.frombuffer(p[column], dtype) if column in p else np.full(len(p["t"]) // 8, np.nan) for p in having
            ]
            columns[column] = np.concatenate(values)  # copied: of read-only arrays kernels would be compiled anew
        if name == "ranges":
            columns["names"] = tuple(parts[-1]["names"])
        logs[name] = STREAMS[name].log(**columns)
    return Run(**logs)


def answer(step: Step, told: dict[str, float]) -> Message:
    """A step as plain data: the newest pose of each method, trails of at most one pose per THIN s, and the rest."""
    poses, trails = {}, {}
    for method, path in step.paths.items():
        keep = thinned(path.t, told.get(method, -np.inf))
        rows = _rows(path, np.append(keep, len(path) - 1))
        poses[method] = plain(rows[:, -1])
        if len(keep):
            told[method] = float(path.t[keep[-1]])
            trails[method] = [plain(column) for column in rows[:, :-1]]
    bias = step.bias
    return {
        "poses": poses,
        "trails": trails,
        "bias": None if bias is None else [plain(bias.t), plain(bias.value), plain(bias.sd)],
        "events": [[e.kind, e.t0, e.t1, e.evidence] for e in step.events],
        "links": None
        if step.links is None
        else [[s.link, list(s.streams), s.excess, s.level, s.warn, s.rows] for s in step.links],
        "reasons": dict(step.reasons),
    }


def _rows(path: Trajectory, at: Any) -> Any:
    """(8, N) columns of the poses `at`: t, x, y, theta, their standard deviations, covariance of x and y."""
    rows, P = np.full((8, len(at)), np.nan), path.covariance
    rows[0], rows[1], rows[2], rows[3] = path.t[at], path.x[at], path.y[at], path.theta[at]
    if P is not None:
        P = P[at]
        rows[4:7] = np.sqrt(np.maximum(P.diagonal(axis1=1, axis2=2), 0.0)).T
        rows[7] = P[:, 0, 1]
    return rows


def thinned(t: Any, last: float) -> Any:
    """Rows that are THIN s after the one before, the first after `last`."""
    slot = np.floor(t / THIN)
    new = np.empty(len(slot), bool)
    new[0], new[1:] = slot[0] > np.floor(last / THIN), slot[1:] > slot[:-1]
    return np.flatnonzero(new)


def plain(values: Any) -> list[float | None]:
    """Numbers for the wire; None where there is none."""
    return [v if v == v else None for v in values.tolist()]


def _listen(stream: IO[bytes], inbox: queue.Queue[Message | None]) -> None:
    while head := stream.read(LENGTH.size):
        inbox.put(msgpack.unpackb(stream.read(LENGTH.unpack(head)[0])))
    inbox.put(None)


def _batches(inbox: queue.Queue[Message | None]) -> Iterator[list[Message]]:
    """Everything that has come by now, again and again until the end."""
    while True:
        batch = [inbox.get()]
        while not inbox.empty():
            batch.append(inbox.get())
        yield [message for message in batch if message is not None]
        if None in batch:
            return


def _say(message: Message) -> None:
    sys.stdout.buffer.write(packed(message))
    sys.stdout.buffer.flush()


if __name__ == "__main__":
    sys.exit(main())
