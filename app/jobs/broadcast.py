"""News about jobs, from the engine's thread to any number of readers in event loops.

Each reader gets the latest state of every job that changed, in the order of the changes; a slow reader skips what
is overtaken, so that memory is bounded by the number of jobs. Ids are `epoch.number`: a reader that comes back with
the last id it saw gets what changed since, if this process remembers.
"""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import threading
from collections import OrderedDict
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass, field
from typing import Any

REMEMBERED = 2000


@dataclass(frozen=True)
class News:
    """One job as it is now."""

    id: str
    job: dict[str, Any]


@dataclass(eq=False)
class Reader:
    """A subscription; iterate over `news()`."""

    loop: asyncio.AbstractEventLoop
    pending: OrderedDict[str, News] = field(default_factory=OrderedDict)
    wake: asyncio.Event = field(default_factory=asyncio.Event)
    closed: bool = False

    async def news(self) -> AsyncIterator[News]:
        """News as they come; ends when the server stops."""
        while True:
            while self.pending:
                yield self.pending.popitem(last=False)[1]
            if self.closed:
                return
            self.wake.clear()
            await self.wake.wait()

    def put(self, news: News) -> None:
        """Called in the reader's loop."""
        self.pending.pop(news.job["id"], None)
        self.pending[news.job["id"]] = news
        self.wake.set()

    def close(self) -> None:
        """Called in the reader's loop: what is pending is still delivered."""
        self.closed = True
        self.wake.set()


class Broadcast:
    """One per engine. `publish` from any thread, `reader` in an event loop."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._epoch = secrets.token_hex(4)
        self._number = 0
        self._latest: OrderedDict[str, tuple[int, News]] = OrderedDict()
        self._readers: set[Reader] = set()
        self._closed = False

    def publish(self, job: dict[str, Any]) -> None:
        """Tell every reader."""
        with self._lock:
            self._number += 1
            news = News(f"{self._epoch}.{self._number}", job)
            self._latest.pop(job["id"], None)
            self._latest[job["id"]] = (self._number, news)
            while len(self._latest) > REMEMBERED:
                self._latest.popitem(last=False)
            for reader in self._readers:
                _call(reader, reader.put, news)

    def since(self, last_id: str | None) -> list[News] | None:
        """What changed after that id; None if this process can't know."""
        epoch, _, number = (last_id or "").partition(".")
        if epoch != self._epoch or not number.isdigit():
            return None
        with self._lock:
            return [news for n, news in self._latest.values() if n > int(number)]

    @contextlib.contextmanager
    def reader(self) -> Iterator[Reader]:
        """Subscribe for as long as the block lasts."""
        reader = Reader(asyncio.get_running_loop())
        with self._lock:
            self._readers.add(reader)
            if self._closed:
                reader.close()
        try:
            yield reader
        finally:
            with self._lock:
                self._readers.discard(reader)

    def close(self) -> None:
        """End every stream: the server stops."""
        with self._lock:
            self._closed = True
            for reader in self._readers:
                _call(reader, reader.close)


def _call(reader: Reader, function: Any, *args: Any) -> None:
    with contextlib.suppress(RuntimeError):  # the reader's loop is closed: nobody reads any more
        reader.loop.call_soon_threadsafe(function, *args)
