"""A robot of the server's own: `driftscope robot` as a child process, so that a newcomer has something to drive.

`serve --demo` starts one; any server on loopback starts one on request; a server for others does not. It stops with the
server, or once nobody has looked at it for a while, so that no run grows for ever; what it drove is a stored run.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import subprocess
import sys
import threading
import time
from collections.abc import AsyncIterator
from pathlib import Path

from fastapi import FastAPI

from app.errors import ForbiddenError
from app.settings import Settings

NAME = "virtual"
LOG = "virtual-robot.log"  # in the data folder: what the last one said
IDLE_S = 600.0  # unwatched for so long, it stops
CHECK_S = 5.0
STOP_S = 3.0  # for it to say good-bye


@contextlib.asynccontextmanager
async def service(app: FastAPI) -> AsyncIterator[None]:
    """The application's robot, not started: it needs to know where the server listens (`app.serve`)."""
    robot = app.state.virtual_robot = VirtualRobot(app.state.settings)
    watching = asyncio.create_task(_watch(app, robot))
    try:
        yield
    finally:
        watching.cancel()
        await asyncio.to_thread(robot.stop)


async def _watch(app: FastAPI, robot: VirtualRobot) -> None:
    """Stop it when nobody has looked at it for IDLE_S."""
    seen = time.monotonic()
    while True:
        await asyncio.sleep(CHECK_S)
        watched = any(one["robot"] == NAME and one["viewers"] for one in app.state.live.robots())
        if watched or not robot.running:
            seen = time.monotonic()
        elif time.monotonic() - seen > IDLE_S:
            await asyncio.to_thread(robot.stop)


class VirtualRobot:
    """At most one child; `address` is where the server listens, None before it does."""

    def __init__(self, settings: Settings) -> None:
        self._settings, self.address = settings, ""
        self._lock = threading.Lock()
        self._child: subprocess.Popen[bytes] | None = None

    @property
    def available(self) -> bool:
        """Whether this server may start one: for its own user, or where it was asked for."""
        return bool(self.address) and (self._settings.is_loopback or self._settings.demo)

    @property
    def running(self) -> bool:
        """Whether the child lives."""
        return self._child is not None and self._child.poll() is None

    def start(self) -> None:
        """Start it unless it runs. ForbiddenError where this server starts none."""
        if not self.available:
            raise ForbiddenError("this server starts no virtual robot: `driftscope robot --to URL` does, anywhere")
        with self._lock:
            if self.running:
                return
            command = [sys.executable, "-m", "app.virtual_child", "robot", "--to", self.address, "--name", NAME]
            token = {"DRIFTSCOPE_TOKEN": self._settings.token} if self._settings.token else {}
            paths = os.pathsep.join([str(Path(__file__).resolve().parents[1]), os.environ.get("PYTHONPATH", "")])
            environment = {**os.environ, **token, "PYTHONPATH": paths.rstrip(os.pathsep)}
            with (self._settings.data / LOG).open("wb") as log:
                self._child = subprocess.Popen(
                    command, env=environment, stdin=subprocess.DEVNULL, stdout=log, stderr=log
                )

    def stop(self) -> None:
        """Stop it and wait until it is gone; blocking."""
        with self._lock:
            child, self._child = self._child, None
        if child is None:
            return
        child.terminate()
        try:
            child.wait(STOP_S)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()
