"""`/live/{robot}`: the monitor of one robot: control, signals, map and 3D, positions by method, links, connection."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from fastapi import APIRouter, Path, Request, Response

from app.pages.base import Page, render, route
from app.pages.live import listed, sentence
from app.virtual_robot import NAME

router = APIRouter()
Robot = Annotated[str, Path(pattern=r"^[A-Za-z0-9._-]{1,64}$")]


@dataclass(frozen=True)
class MonitorPage(Page):
    """`live`: the robot as `GET /api/v1/live` lists it, None while it is not connected; all else comes over the feed,
    `/api/v1/live/{robot}/watch`."""

    template: ClassVar[str] = "monitor.html"
    place: ClassVar[str] = "live"
    robot: str
    live: dict[str, Any] | None
    feed: str
    can_start: bool  # this server's own robot, which it can start


@route(router, "/live/{robot}")
async def monitor(request: Request, robot: Robot) -> Response:
    found = next((one for one in listed(request) if one["robot"] == robot), None)
    waiting = f"No robot called {robot} is connected. This page begins by itself when it is."
    told = sentence([found]) if found else waiting
    mine = robot == NAME and request.app.state.virtual_robot.available
    return render(request, MonitorPage(robot, told, robot, found, f"/api/v1/live/{robot}/watch", mine))
