"""Scenes by REST: who looks at what, a viewer's cursor over a small WebSocket, the scene as one HTML file."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
from typing import TYPE_CHECKING, Annotated, Any, Literal

from fastapi import APIRouter, Query, Request, Response, WebSocket
from pydantic import BaseModel, ConfigDict, Field
from starlette.websockets import WebSocketDisconnect

from app.errors import NotFoundError, problem_of
from app.scene.cursor import check_change
from app.scene.pool import BusyError, Scenes
from app.scene.proxy import GONE, NOT_FOUND, TRY_AGAIN, RunId, scenes
from core.errors import ParameterError

if TYPE_CHECKING:
    from app.scene.servers import Scene

router = APIRouter(tags=["scenes"])

ViewerQuery = Annotated[str, Query(pattern=r"^[A-Za-z0-9_-]{1,64}$")]
OverlayName = Annotated[
    Literal["path", "gap", "simulated", "patched"], Query(description="which of the viewer's overlays")
]
MAX_MESSAGE = 4096
MAX_OVERLAY = 5000
Finite = Annotated[float, Field(allow_inf_nan=False, ge=-1e7, le=1e7)]


@router.get("/scenes/{run}", summary="The 3D scene of a run: its viewers and their cursors")
async def get_scene(run: RunId, request: Request) -> dict[str, Any]:
    """Never opens a scene; `open` says whether anybody has."""
    scene = scenes(request).get(run)
    viewers = await asyncio.to_thread(scene.states) if scene else []
    return {"run_id": run, "open": scene is not None, "page": f"/scene/{run}/", "viewers": viewers}


class OverlayPath(BaseModel):
    """A path that is not stored: seconds of the run, increasing, and metres in the map."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"t": [0.0, 1.0], "x": [0.0, 0.2], "y": [0.0, 0.0]}]})
    t: list[Finite] = Field(min_length=2, max_length=MAX_OVERLAY)
    x: list[Finite] = Field(min_length=2, max_length=MAX_OVERLAY)
    y: list[Finite] = Field(min_length=2, max_length=MAX_OVERLAY)
    levels: list[Annotated[int, Field(ge=0, le=6)]] | None = Field(
        default=None, max_length=MAX_OVERLAY, description="steps of the gap at each point, in whose colours it is drawn"
    )


@router.put("/scenes/{run}/overlay", status_code=204, summary="A path beside the stored ones, for one viewer")
def put_scene_overlay(
    run: RunId, request: Request, viewer: ViewerQuery, path: OverlayPath, name: OverlayName = "path"
) -> None:
    """Shown to this viewer in place of the one of that name, for as long as it looks. 404 where no scene is open."""
    import numpy as np

    from app.scene.viewer import Overlay

    scene = scenes(request).get(run)
    if scene is None:
        raise NotFoundError(f"nobody looks at a 3D scene of run {run}", what="scene", id=run)
    if not len(path.t) == len(path.x) == len(path.y) or any(b <= a for a, b in itertools.pairwise(path.t)):
        raise ParameterError("t, x and y must be of one length, t increasing", parameter="t")
    if path.levels is not None and len(path.levels) != len(path.t):
        raise ParameterError("levels must be as long as t", parameter="levels")
    t, x, y = (np.array(column, dtype=np.float64) for column in (path.t, path.x, path.y))
    levels = None if path.levels is None else np.array(path.levels, dtype=np.int64)
    scene.lay(viewer, Overlay(t, x, y, levels), name)


@router.get(
    "/runs/{run}/files/scene.html",
    summary="The 3D scene as one self-contained HTML file",
    response_class=Response,
)
async def get_scene_file(
    run: RunId, request: Request, theme: Annotated[Literal["light", "dark"], Query()] = "light"
) -> Response:
    """Opens anywhere, without this server; robots stand where their paths end."""
    html = await asyncio.to_thread(_export, scenes(request), run, theme)
    headers = {
        "Content-Disposition": f'attachment; filename="{run}-scene.html"',
        "Content-Security-Policy": "sandbox; default-src 'none'",  # to be kept, not to be shown from here
    }
    return Response(html, media_type="text/html", headers=headers)


def _export(pool: Scenes, run: str, theme: str) -> str:
    from app.scene.export import export_html

    return export_html(pool.data(run), theme)


@router.websocket("/scenes/{run}/cursor")
async def cursor(ws: WebSocket, run: RunId, viewer: ViewerQuery) -> None:
    """A page's time cursor, both ways (protocol: `app.scene`)."""
    await ws.accept()
    try:
        scene = await asyncio.to_thread(scenes(ws).open, run)
    except (NotFoundError, BusyError) as error:
        with contextlib.suppress(*GONE):
            await ws.send_json({**problem_of(error), "type": "problem"})
            await ws.close(NOT_FOUND if isinstance(error, NotFoundError) else TRY_AGAIN)
        return
    loop, outbox = asyncio.get_running_loop(), asyncio.Queue[dict[str, Any]](maxsize=64)

    def put(state: dict[str, Any]) -> None:
        if outbox.full():  # a page that doesn't read gets the newest, not all
            outbox.get_nowait()
        outbox.put_nowait(state)

    def hear(state: dict[str, Any]) -> None:
        with contextlib.suppress(RuntimeError):  # the web server's loop has ended
            loop.call_soon_threadsafe(put, state)

    scene.listen(viewer, hear)
    tasks = [asyncio.create_task(_receive(ws, scene, viewer, hear, put)), asyncio.create_task(_send(ws, outbox))]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        scene.unlisten(viewer, hear)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _send(ws: WebSocket, outbox: asyncio.Queue[dict[str, Any]]) -> None:
    while True:
        await ws.send_json(await outbox.get())


async def _receive(ws: WebSocket, scene: Scene, viewer: str, hear: Any, put: Any) -> None:
    """Changes from the page; a wrong one is answered with a problem and changes nothing."""
    with contextlib.suppress(WebSocketDisconnect):
        while True:
            text = await ws.receive_text()
            try:
                if len(text) > MAX_MESSAGE:
                    raise ParameterError("a cursor message is too long", expected=MAX_MESSAGE, found=len(text))
                change = check_change(json.loads(text))
            except json.JSONDecodeError as error:
                put({**problem_of(ParameterError(f"not JSON: {error.msg}")), "type": "problem"})
            except ParameterError as error:
                put({**problem_of(error), "type": "problem"})
            else:
                scene.change(viewer, change, hear)
