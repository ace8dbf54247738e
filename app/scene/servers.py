"""One viser server per open run: made when first looked at, bound to loopback, stopped when nobody has looked a while.

Calls come from the web server's threads; each scene's viewers live on its viser server's own event loop.
"""

from __future__ import annotations

import asyncio
import itertools
import logging
import secrets
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Any, TypeVar

import rich
import viser

from app.scene import build
from app.scene.data import SceneData
from app.scene.viewer import Listener, Viewer
from core.errors import DriftscopeError

log = logging.getLogger(__name__)
T = TypeVar("T")

KEY_HEADER, VIEWER_HEADER = "x-scene-key", "x-scene-viewer"
ANSWER_WITHIN = 5.0  # s for a scene's loop to answer


class BusyError(DriftscopeError):
    """As many scenes are open as may be, and all of them are looked at."""

    code = "busy"


class LocalServer(viser.ViserServer):
    """A viser server on loopback, any free port, without viser's tunnel to the outside and without its chatter."""

    def __init__(self) -> None:
        rich.get_console().quiet = True  # viser prints its address, verbose or not
        super().__init__(host="127.0.0.1", port=0, verbose=False)
        self.gui.configure_theme(show_logo=False, show_share_button=False, control_width="small")

    def request_share_url(self, verbose: bool = True) -> None:
        """Never: a browser may ask for this, and it would publish the scene through an outside host."""


class Scene:
    """One open run."""

    def __init__(self, data: SceneData) -> None:
        self.data, self.key = data, secrets.token_urlsafe(24)
        self.touched = time.monotonic()
        self._server = LocalServer()
        self._loop = self._server.get_event_loop()
        self._viewers: dict[str, Viewer] = {}
        self._prepared: OrderedDict[str, tuple[bool, str]] = OrderedDict()  # viewer -> with panel, theme
        self._key_of_client: dict[int, str] = {}
        self._server._websock_server.on_client_connect(self._admit)
        self._server._websock_server.on_client_disconnect(self._gone)
        self._server.on_client_connect(self._connected)
        self._server.on_client_disconnect(self._disconnected)
        self.sizes = build.add_run(self._server, data)

    @property
    def address(self) -> str:
        """Where the proxy connects to."""
        return f"ws://127.0.0.1:{self._server.get_port()}/"

    def prepare(self, viewer: str, *, panel: bool, theme: str) -> None:
        """How the viewer wants to start, known from the page's address before its browser connects."""

        def remember() -> None:
            self._prepared[viewer] = (panel, theme)
            while len(self._prepared) > 1000:
                self._prepared.popitem(last=False)

        self.call(remember)

    def change(self, viewer: str, change: dict[str, Any], source: Listener | None = None) -> None:
        """Move a viewer's cursor."""
        self._post(lambda: self._viewer(viewer).change(change, source))

    def listen(self, viewer: str, listener: Listener) -> None:
        """A page joins a viewer; the listener is called on the scene's loop."""
        self._post(lambda: self._viewer(viewer).listen(listener))

    def unlisten(self, viewer: str, listener: Listener) -> None:
        """A page leaves."""

        def leave() -> None:
            self._viewer(viewer).unlisten(listener)
            self._drop_if_idle(viewer)

        self._post(leave)

    def states(self) -> list[dict[str, Any]]:
        """The state of every viewer."""
        return self.call(lambda: [v.state() for v in self._viewers.values()])

    @property
    def in_use(self) -> bool:
        """Whether anybody looks or listens."""
        return bool(self._viewers)

    def stop(self) -> None:
        """Stop the server and its threads."""
        self._server.stop()

    def call(self, function: Callable[[], T]) -> T:
        """Run on the scene's loop and wait for the answer."""

        async def run() -> T:
            return function()

        return asyncio.run_coroutine_threadsafe(run(), self._loop).result(ANSWER_WITHIN)

    def _post(self, function: Callable[[], None]) -> None:
        self.touched = time.monotonic()
        self._loop.call_soon_threadsafe(function)

    def _viewer(self, key: str) -> Viewer:
        if key not in self._viewers:
            panel, theme = self._prepared.get(key, (False, "light"))
            self._viewers[key] = Viewer(key, self.data, self.sizes, self._loop, panel=panel, theme=theme)
        return self._viewers[key]

    def _drop_if_idle(self, key: str) -> None:
        if key in self._viewers and self._viewers[key].idle:
            del self._viewers[key]
        self.touched = time.monotonic()

    async def _admit(self, connection: viser.infra.WebsockClientConnection) -> None:
        """Only our proxy may connect: viser itself asks nobody who they are, and any page or user of this machine
        could open its port."""
        live = self._server._websock_server._live_connections[connection.client_id]
        headers = live.request.headers if live.request is not None else {}
        if not secrets.compare_digest(headers.get(KEY_HEADER, ""), self.key):
            await live.close(1008, "not through the dashboard")
            return
        self._key_of_client[connection.client_id] = headers.get(VIEWER_HEADER, "")

    async def _connected(self, client: viser.ClientHandle) -> None:
        key = self._key_of_client.get(client.client_id)
        if key is not None:
            self._viewer(key).attach(client)
            self.touched = time.monotonic()

    async def _disconnected(self, client: viser.ClientHandle) -> None:
        key = self._key_of_client.get(client.client_id)
        if key in self._viewers:
            self._viewers[key].detach(client.client_id)
            self._drop_if_idle(key)

    def _gone(self, connection: viser.infra.WebsockClientConnection) -> None:
        """The connection is closed, whether its browser had become a client or not."""
        self._key_of_client.pop(connection.client_id, None)


class Scenes:
    """The open scenes, at most `limit`, least recently used first to go; made and stopped thread-safely.

    `load` gives a run's data (or raises NotFoundError); `revision` tells cheaply whether it would differ by now.
    """

    def __init__(
        self,
        load: Callable[[str], SceneData],
        revision: Callable[[str], str],
        *,
        limit: int = 24,
        idle_seconds: float = 180.0,
        grace_seconds: float = 10.0,
    ) -> None:
        self._load, self._revision, self._limit = load, revision, limit
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
            scene = Scene(self._load(run_id))
            with self._lock:
                if run_id in self._open:
                    self._retired.append(self._open.pop(run_id))
                self._open[run_id] = scene
                self._making.pop(run_id, None)
                self._watch()
        return scene

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
