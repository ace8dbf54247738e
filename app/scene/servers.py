"""One open run: a viser server bound to loopback, and its viewers, who live on that server's own event loop.

Calls come from the web server's threads and are brought over by `Scene.call`.
"""

from __future__ import annotations

import asyncio
import secrets
import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Any, TypeVar

import rich
import viser

from app.scene import build
from app.scene.data import SceneData
from app.scene.headers import KEY_HEADER, VIEWER_HEADER
from app.scene.viewer import Listener, Overlay, Viewer

T = TypeVar("T")

ANSWER_WITHIN = 5.0  # s for a scene's loop to answer


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
        self.sizes = self._build()

    def _build(self) -> build.Layout:
        return build.add_run(self._server, self.data)

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

    def lay(self, viewer: str, overlay: Overlay, name: str = "path") -> None:
        """Show a path that is not stored to one viewer."""
        self._post(lambda: self._viewer(viewer).lay(overlay, name))

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
