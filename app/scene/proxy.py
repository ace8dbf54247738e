"""The 3D view's page and its websocket, on the dashboard's own port and origin: `/scene/{run}/{viewer}/`.

viser's client is one file, served here as it is (plus a style that hides what the page around it already has); its
websocket goes to `/scene/{run}/{viewer}`, and from there to the run's own viser server on loopback. Who may come in is
checked before (`app.security.Guard`: host, origin, token). From browsers only camera poses and moves of the viewer's
own panel pass; uploads, clicks and requests for a public address, which viser would act on, don't.
"""

from __future__ import annotations

import asyncio
import contextlib
import gzip
import secrets
from collections.abc import AsyncIterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Annotated

import msgpack
import websockets
from fastapi import APIRouter, Path, Request, Response, WebSocket
from fastapi.responses import RedirectResponse
from starlette.websockets import WebSocketDisconnect, WebSocketState
from websockets.asyncio.client import ClientConnection, connect

from app.errors import NotFoundError
from app.scene.headers import KEY_HEADER, VIEWER_HEADER
from app.scene.pool import BusyError, Scenes

if TYPE_CHECKING:
    from app.scene.servers import Scene

router = APIRouter(include_in_schema=False)

RunId = Annotated[str, Path(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
ViewerKey = Annotated[str, Path(pattern=r"^[A-Za-z0-9_-]{1,64}$")]

CSP = (
    "default-src 'none'; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval' blob:; worker-src blob:; "
    "connect-src 'self' data: blob:; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; "
    "font-src 'self' data:; frame-ancestors 'self'; base-uri 'none'; form-action 'none'"
)
PASSES = frozenset({"ViewerCameraMessage", "GuiUpdateMessage"})  # from the browser to viser
MAX_FROM_BROWSER = 64 << 10
TRY_AGAIN, NOT_FOUND, GOING_AWAY = 1013, 4404, 1001

# The page around the frame says what viser's notes and panel would say over the picture. Its sorter for Gaussian
# splats, which no scene here has, asks for eval at start; the policy refuses, and nobody needs to read about it.
SCRIPT = (
    "<script>addEventListener('unhandledrejection',e=>{if(e.reason instanceof EvalError)e.preventDefault()})</script>"
)
STYLE = "<style>.mantine-Notifications-root{display:none!important}</style>"
NO_PANEL = "<style>.mantine-Paper-root{display:none!important}</style>"


@dataclass(frozen=True)
class Client:
    """viser's page, plain and compressed."""

    html: bytes
    gzipped: bytes


@cache
def client(panel: bool) -> Client:
    """viser's own client, with or without its panel."""
    import viser

    text = (FilePath(viser.__file__).parent / "client" / "build" / "index.html").read_text(encoding="utf-8")
    head = text.index("</head>")
    html = (text[:head] + SCRIPT + STYLE + ("" if panel else NO_PANEL) + text[head:]).encode()
    return Client(html, gzip.compress(html, 6))


def scenes(connection: Request | WebSocket) -> Scenes:
    """The application's open scenes."""
    found: Scenes = connection.app.state.scenes
    return found


@router.get("/scene/{run}")
@router.get("/scene/{run}/")
async def new_viewer(run: RunId, request: Request) -> Response:
    """A scene opened by itself gets a viewer of its own, with a panel, since no page brings a cursor."""
    query = request.url.query or "panel"
    if "panel" not in request.query_params:
        query += "&panel"
    return RedirectResponse(f"/scene/{run}/{secrets.token_hex(8)}/?{query}", 307)


@router.get("/scene/{run}/{viewer}/")
async def page(run: RunId, viewer: ViewerKey, request: Request) -> Response:
    """viser's client. The scene is made here, so that an unknown run is a 404 page and not a grey canvas."""
    query = request.query_params
    panel, dark = "panel" in query, "darkMode" in query or query.get("theme") == "dark"
    scene = await asyncio.to_thread(scenes(request).open, run)
    await asyncio.to_thread(scene.prepare, viewer, panel=panel, theme="dark" if dark else "light")
    body = await asyncio.to_thread(client, panel)
    headers = {"Cache-Control": "no-cache", "Content-Security-Policy": CSP, "Vary": "Accept-Encoding"}
    if "gzip" in request.headers.get("accept-encoding", ""):
        return Response(body.gzipped, media_type="text/html", headers=headers | {"Content-Encoding": "gzip"})
    return Response(body.html, media_type="text/html", headers=headers)


@router.websocket("/scene/{run}/{viewer}")
async def websocket(ws: WebSocket, run: RunId, viewer: ViewerKey) -> None:
    """The client's connection, passed on to the run's viser server."""
    offered = [p for p in ws.scope.get("subprotocols", []) if p.startswith("viser-v")]
    try:
        scene = await asyncio.to_thread(scenes(ws).open, run)
        async with _upstream(scene, viewer, offered) as upstream:
            await ws.accept(subprotocol=upstream.subprotocol)
            await _relay(ws, upstream)
    except NotFoundError:
        await _close(ws, NOT_FOUND)
    except (BusyError, OSError, TimeoutError, websockets.WebSocketException):
        await _close(ws, TRY_AGAIN)
    else:
        await _close(ws, GOING_AWAY)


@contextlib.asynccontextmanager
async def _upstream(scene: Scene, viewer: str, offered: list[str]) -> AsyncIterator[ClientConnection]:
    async with connect(
        scene.address,
        subprotocols=[websockets.Subprotocol(p) for p in offered] or None,
        additional_headers={KEY_HEADER: scene.key, VIEWER_HEADER: viewer},
        compression=None,
        max_size=None,
        ping_interval=None,
        proxy=None,
    ) as connection:
        yield connection


async def _relay(ws: WebSocket, upstream: ClientConnection) -> None:
    """Messages both ways until either side ends."""
    ways = [asyncio.create_task(_from_browser(ws, upstream)), asyncio.create_task(_to_browser(ws, upstream))]
    try:
        await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for way in ways:
            way.cancel()
        for outcome in await asyncio.gather(*ways, return_exceptions=True):
            if isinstance(outcome, Exception) and not isinstance(outcome, GONE):
                raise outcome


# What a side that went away looks like, depending on the moment.
GONE = (WebSocketDisconnect, websockets.ConnectionClosed, ConnectionError, RuntimeError)


async def _from_browser(ws: WebSocket, upstream: ClientConnection) -> None:
    while (message := await ws.receive())["type"] != "websocket.disconnect":
        data = message.get("bytes")
        if data is not None and len(data) <= MAX_FROM_BROWSER and _kind(data) in PASSES:
            await upstream.send(data)


async def _to_browser(ws: WebSocket, upstream: ClientConnection) -> None:
    async for message in upstream:
        if isinstance(message, bytes):
            await ws.send_bytes(message)


def _kind(data: bytes) -> str | None:
    """The type of a message, None where it is none."""
    try:
        message = msgpack.unpackb(data)
    except (ValueError, msgpack.UnpackException):
        return None
    return message.get("type") if isinstance(message, dict) else None


async def _close(ws: WebSocket, code: int) -> None:
    """Close whatever is left to close; before acceptance this answers 403."""
    if ws.client_state is not WebSocketState.DISCONNECTED and ws.application_state is not WebSocketState.DISCONNECTED:
        with contextlib.suppress(*GONE):
            await ws.close(code)
