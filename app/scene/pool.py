"""The open scenes: made when first looked at, stopped when nobody has looked for a while, never too many."""

from __future__ import annotations

import itertools
import logging
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from typing import TYPE_CHECKING

from app.scene.data import SceneData
from core.errors import DriftscopeError

if TYPE_CHECKING:
    from app.scene.live import Feed
    from app.scene.servers import Scene

log = logging.getLogger("driftscope")


class BusyError(DriftscopeError):
    """As many scenes are open as may be, and all of them are looked at."""

    code = "busy"


class Scenes:
    """The open scenes, at most `limit`, least recently used first to go; made and stopped thread-safely.

    `load` gives a run's data (or raises NotFoundError); `revision` tells cheaply whether it would differ by now;
    `live` gives the feed of a run that is still going on, whose scene grows with it.
    """

    def __init__(
        self,
        load: Callable[[str], SceneData],
        revision: Callable[[str], str],
        live: Callable[[str], Feed | None] = lambda run_id: None,
        *,
        limit: int = 24,
        idle_seconds: float = 180.0,
        grace_seconds: float = 10.0,
    ) -> None:
        self._load, self._revision, self._live, self._limit = load, revision, live, limit
        self._idle, self._grace = idle_seconds, grace_seconds  # grace: a browser on its way to a new scene
        self._lock = threading.Lock()
        self._making: dict[str, threading.Lock] = {}
        self._open: OrderedDict[str, Scene] = OrderedDict()
        self._retired: list[Scene] = []  # older revisions that somebody still looks at
        self._reaper: threading.Thread | None = None
        self._stopping = threading.Event()

    def __len__(self) -> int:
        return len(self._open) + len(self._retired)

    def data(self, run_id: str) -> SceneData:
        """The run's data, without a scene. NotFoundError."""
        return self._load(run_id)

    def get(self, run_id: str) -> Scene | None:
        """The run's scene if it is open."""
        return self._open.get(run_id)

    def open(self, run_id: str) -> Scene:
        """The run's scene, made now if need be; blocking. NotFoundError, BusyError."""
        revision = self._revision(run_id)
        with self._lock:
            making = self._making.setdefault(run_id, threading.Lock())
        with making:
            with self._lock:
                scene = self._open.get(run_id)
                if scene is not None and scene.data.revision == revision:
                    self._open.move_to_end(run_id)
                    scene.touched = time.monotonic()
                    return scene
                self._make_room()
            scene = self._made(run_id, revision)
            with self._lock:
                if run_id in self._open:
                    self._retired.append(self._open.pop(run_id))
                self._open[run_id] = scene
                self._making.pop(run_id, None)
                self._watch()
        return scene

    def _made(self, run_id: str, revision: str) -> Scene:
        from app.scene.live import LiveScene  # viser takes a third of a second to import: not at the start
        from app.scene.servers import Scene

        feed = self._live(run_id)
        return LiveScene(feed, revision) if feed else Scene(self._load(run_id))

    def close_idle(self, idle: float | None = None) -> int:
        """Stop scenes that nobody has looked at for `idle` seconds; how many."""
        limit = self._idle if idle is None else idle
        clock = time.monotonic()
        with self._lock:
            stale = [s for s in self._all() if not s.in_use and clock - s.touched >= limit]
            stale += [s for s in self._retired if not s.in_use and s not in stale]
            self._forget(stale)
        for scene in stale:
            scene.stop()
        return len(stale)

    def stop(self) -> None:
        """Stop everything."""
        self._stopping.set()
        with self._lock:
            scenes, reaper = self._all(), self._reaper
            self._forget(scenes)
        for scene in scenes:
            scene.stop()
        if reaper is not None:
            reaper.join(timeout=5)

    def _all(self) -> list[Scene]:
        return list(itertools.chain(self._open.values(), self._retired))

    def _forget(self, scenes: list[Scene]) -> None:
        self._open = OrderedDict((k, s) for k, s in self._open.items() if s not in scenes)
        self._retired = [s for s in self._retired if s not in scenes]

    def _make_room(self) -> None:
        while len(self) >= self._limit:
            clock = time.monotonic()
            free = (s for s in self._all() if not s.in_use and clock - s.touched >= self._grace)
            oldest = next(free, None)
            if oldest is None:
                raise BusyError(
                    f"{len(self)} 3D scenes are open and all are being looked at; close one and try again",
                    expected=f"below {self._limit}",
                    found=len(self),
                )
            self._forget([oldest])
            oldest.stop()

    def _watch(self) -> None:
        """Start the thread that closes idle scenes, unless it runs."""
        if self._reaper is None or not self._reaper.is_alive():
            self._reaper = threading.Thread(target=self._reap, name="scene-reaper", daemon=True)
            self._reaper.start()

    def _reap(self) -> None:
        while not self._stopping.wait(max(min(self._idle / 4, 30.0), 0.05)):
            closed = self.close_idle()
            if closed:
                log.info("closed %d idle 3D scenes", closed)
