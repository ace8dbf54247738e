"""The server's own robot by REST."""

from __future__ import annotations

from fastapi import APIRouter, Request
from pydantic import BaseModel

from app.virtual_robot import NAME

router = APIRouter(tags=["live"])


class VirtualRobotStarted(BaseModel):
    """Where to look: it appears in `GET /live` under `robot` a few seconds later."""

    robot: str
    page: str


@router.post("/live/virtual", status_code=202, summary="Start the virtual robot of this server")
def start_virtual_robot(request: Request) -> VirtualRobotStarted:
    """Does nothing where it runs already. 403 on a server for others that was not started with `--demo`."""
    request.app.state.virtual_robot.start()
    return VirtualRobotStarted(robot=NAME, page=f"/live/{NAME}")
