"""Readings of a run's streams, thinned for plots, as JSON or Arrow."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Path, Query, Response
from fastapi.responses import JSONResponse

from app.api import schemas
from app.api.deps import ReadSession, RunId, SettingsDep
from app.figures import series as figures
from app.figures.signals import signals, stream_of
from app.store import runs as store
from core.sensors import STREAMS

router = APIRouter(tags=["streams"])
ARROW = "application/vnd.apache.arrow.stream"
ARROW_RESPONSE: dict[int | str, dict[str, Any]] = {
    200: {
        "model": schemas.StreamSeries,
        "description": "JSON; or, with format=arrow, an Arrow IPC stream with columns `column`, `t`, `y`",
        "content": {ARROW: {"schema": {"type": "string", "format": "binary"}}},
    }
}
Columns = Annotated[str | None, Query(description="names with commas; default: all", max_length=2000)]
From = Annotated[float | None, Query(description="first second to show", allow_inf_nan=False, examples=[10.0])]
To = Annotated[float | None, Query(description="last second to show", allow_inf_nan=False, examples=[20.0])]
Points = Annotated[
    int, Query(ge=figures.MIN_POINTS, le=figures.MAX_POINTS, description="at most so many readings per series")
]
Form = Annotated[Literal["json", "arrow"], Query(alias="format")]


@router.get(
    "/runs/{run_id}/streams/{stream}", summary="Readings over time, thinned for a plot", responses=ARROW_RESPONSE
)
def get_stream(
    session: ReadSession,
    settings: SettingsDep,
    run_id: RunId,
    stream: Annotated[str, Path(description=f"one of {', '.join(STREAMS)}", examples=["imu"], max_length=40)],
    columns: Columns = None,
    t0: From = None,
    t1: To = None,
    points: Points = 2000,
    form: Form = "json",
) -> Response:
    """Columns of a stream between `t0` and `t1`, with one reading beyond each end so that lines reach the edges.

    Each column is thinned by itself and keeps its minima and maxima; `total` and `shown` say how much is left out.
    Columns of `ranges` are the beacons' names.
    """
    found = stream_of(store.manifest(session, run_id), stream)
    made = signals(settings.data, found, split(columns), t0=t0, t1=t1, points=points)
    return answer(stream, made, found["gaps"], form)


def split(columns: str | None) -> list[str] | None:
    """`a,b` as a list; None where nothing is asked for."""
    names = [c.strip() for c in (columns or "").split(",")]
    return [c for c in names if c] or None


def answer(stream: str, made: Sequence[figures.Series], gaps: Sequence[Sequence[float]], form: str) -> Response:
    """Series as `schemas.StreamSeries` or as an Arrow IPC stream with the counts in headers."""
    total = max((s.total for s in made), default=0)
    shown = max((s.shown for s in made), default=0)
    if form == "arrow":
        headers = {"X-Total": str(total), "X-Shown": str(shown)}
        return Response(figures.table(made), media_type=ARROW, headers=headers)
    body = {
        "stream": stream,
        "total": total,
        "shown": shown,
        "gaps": [list(g) for g in gaps],
        "series": [figures.plain(s) for s in made],
    }
    return JSONResponse(body)
