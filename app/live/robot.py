"""One robot by its name: its run, its connection, who watches it, who drives it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any, Protocol

from app.live.drive import Drive
from app.live.feed import Feed, Viewer
from app.live.protocol import Driver, LiveRobot
from app.live.quality import Gauge
from app.live.run import LiveRun, Sink


class Connection(Protocol):
    """A robot's end of the line."""

    def send(self, message: Mapping[str, Any]) -> None:
        """Queue a message."""

    def close(self, message: Mapping[str, Any]) -> None:
        """Send a last message and close."""


class Robot:
    """One robot by its name: its run, its connection, its viewers and its stick."""

    def __init__(self, name: str, drive_allowed: bool, sink: Callable[[LiveRun], Sink]) -> None:
        self.name, self._sink = name, sink
        self.run: LiveRun | None = None
        self.connection: Connection | None = None
        self.viewers: dict[Viewer, None] = {}
        self.drive = Drive(drive_allowed, self._send, self._record)
        self.state = "waiting"
        self.told = 0.0  # when its viewers were last told something

    def _send(self, message: Mapping[str, Any]) -> bool:
        if self.connection is None:
            return False
        self.connection.send(message)
        return True

    def _record(self, v: float, w: float) -> None:
        if self.run is not None:
            self.run.commanded(v, w, self._sink(self.run))

    def tell_driver(self) -> None:
        """Everybody hears who drives."""
        for viewer in self.viewers:
            viewer.tell(Driver(type="driver", **self.drive.state(viewer)))

    def snapshot(self, viewer: Viewer) -> dict[str, Any]:
        """All so far, for one who joins."""
        run = self.run
        head = {"type": "snapshot", "robot": self.name, "state": self.state, "driver": self.drive.state(viewer)}
        if run is None:
            empty = Feed().snapshot(Gauge().read(time.time()))
            return {**head, "run_id": "", "run": {}, **empty}
        return {**head, "run_id": run.id, "run": run.said.run, **run.feed.snapshot(run.gauge.read(time.time()))}

    def listed(self, run: LiveRun) -> LiveRobot:
        """As `GET /api/v1/live` lists it."""
        driver = self.drive.driver
        return LiveRobot(
            robot=self.name,
            run_id=run.id,
            name=str(run.said.run.get("name") or self.name),
            state="live" if self.state == "live" else "silent",
            virtual=run.said.virtual,
            started_at=datetime.fromtimestamp(run.started, UTC).isoformat(),
            duration_s=run.t,
            viewers=len(self.viewers),
            driver=driver.name if driver is not None else None,
            rows=dict(run.feed.rows),
            quality=run.quality(),
        )
