"""`/live`: the robots that stream now, and how to start one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from fastapi import APIRouter, Request, Response

from app.pages.base import Page, render, route

router = APIRouter()


@dataclass(frozen=True)
class LivePage(Page):
    """`robots` as `GET /api/v1/live` lists them; `virtual`: whether this server can start a robot of its own; `url`:
    where robots connect to."""

    template: ClassVar[str] = "live.html"
    place: ClassVar[str] = "live"
    robots: list[dict[str, Any]]
    virtual: bool
    url: str


def sentence(robots: list[dict[str, Any]]) -> str:
    """What a colleague could repeat of the robots that are connected."""
    if not robots:
        return "No robot is connected."
    if len(robots) == 1:
        one = robots[0]
        driven = f"driven by {one['driver']}" if one["driver"] else "nobody drives it"
        return f"{one['robot']} is {one['state']}; {driven}."
    silent = sum(one["state"] != "live" for one in robots)
    return f"{len(robots)} robots are connected" + (f", {silent} of them silent." if silent else ", all of them live.")


@route(router, "/live")
async def live(request: Request) -> Response:
    robots = listed(request)
    can_start = request.app.state.virtual_robot.available
    page = LivePage("Live", sentence(robots), robots, can_start, str(request.base_url).rstrip("/"))
    return render(request, page)


def listed(request: Request) -> list[dict[str, Any]]:
    """The connected robots, plain; on the event loop."""
    return [dict(robot) for robot in request.app.state.live.robots()]
