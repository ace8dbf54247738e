"""How good a robot's connection is, over the last seconds."""

from __future__ import annotations

import statistics
from collections import deque

from app.live.protocol import Quality

WINDOW = 10.0  # s
DELAYS = 2000  # batches
TRIPS = 50  # round trips that the clocks' offset is told from


class Gauge:
    """What comes in, and how late. Times: `now` on the server's clock, Unix time [s]."""

    def __init__(self) -> None:
        self.late_rows = 0
        self.last_heard = 0.0
        self._batches: deque[tuple[float, int, int, dict[str, int]]] = deque()  # when, again, dropped, rows
        self._sent: dict[int, float] = {}  # batches under way to an estimate
        self._delays: deque[tuple[float, float]] = deque(maxlen=DELAYS)  # when, how long
        self._offsets: deque[tuple[float, float]] = deque(maxlen=TRIPS)  # half of the round trip, offset
        self._least = float("inf")  # delay: without round trips all that is known of the offset

    def arrived(self, now: float, n: int, sent: float, heard: tuple[float, float] | None, rows: dict[str, int]) -> None:
        """A new batch."""
        self.last_heard = now
        self._batches.append((now, 0, 0, rows))
        self._sent[n] = sent
        self._least = min(self._least, now - sent)
        if heard is not None:
            at, there = heard
            trip = (now - at) - (sent - there)
            if trip >= 0:
                self._offsets.append((trip / 2, ((there - at) + (sent - now)) / 2))

    def again(self, now: float) -> None:
        """A batch that was there already, or could not be taken."""
        self.last_heard = now
        self._batches.append((now, 1, 0, {}))

    def late(self, now: float, rows: int) -> None:
        """Rows that were dropped."""
        self.late_rows += rows
        self._batches.append((now, 0, rows, {}))

    def estimated(self, now: float, n: int) -> None:
        """The estimate up to batch n is there."""
        for done in [k for k in self._sent if k <= n]:
            self._delays.append((now, now - self._sent.pop(done)))

    @property
    def backlog(self) -> int:
        """Batches without an estimate."""
        return len(self._sent)

    def forget_backlog(self) -> None:
        """Estimates begin anew."""
        self._sent.clear()

    def read(self, now: float) -> Quality:
        """As it is now."""
        while self._batches and self._batches[0][0] < now - WINDOW:
            self._batches.popleft()
        span = max(now - self._batches[0][0], 1.0) if self._batches else 1.0
        rows: dict[str, int] = {}
        again = dropped = taken = 0
        for _, repeated, lost, counts in self._batches:
            again, dropped, taken = again + repeated, dropped + lost, taken + bool(counts)
            for name, count in counts.items():
                rows[name] = rows.get(name, 0) + count
        trip = min(self._offsets, default=None)
        offset = trip[1] if trip is not None else None
        while self._delays and self._delays[0][0] < now - WINDOW:
            self._delays.popleft()
        delays = sorted(delay for _, delay in self._delays)
        # by a one-way stamp alone, the quickest batch is taken to have come in no time
        shift = offset if offset is not None else -self._least
        total = sum(rows.values()) + dropped
        return Quality(
            rate_hz={name: round(count / span, 2) for name, count in rows.items()},
            batches_hz=round(taken / span, 2),
            latency_ms=round(1e3 * (statistics.median(delays) + shift), 2) if delays else None,
            latency_p99_ms=round(1e3 * (delays[int(0.99 * (len(delays) - 1))] + shift), 2) if delays else None,
            delay_ms=round(1e3 * statistics.median(delays), 2) if delays else None,
            loss=round(max(again / max(again + taken, 1), dropped / max(total, 1)), 4),
            late_rows=self.late_rows,
            clock_offset_s=round(offset, 6) if offset is not None else None,
            offset_sd_s=round(trip[0], 6) if trip is not None else None,
            silent_s=round(max(now - self.last_heard, 0.0), 2),
            backlog=self.backlog,
        )
