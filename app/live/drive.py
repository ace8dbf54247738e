"""Who drives: one at a time, handed over on request, stopped when nothing is heard for DEAD_MAN_S."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from app.live.feed import Viewer
from app.live.protocol import DEAD_MAN_S, Command, DriveLimits, DriverState, Refused, Stop

OFF = "driving real robots is off: start the server with `driftscope serve --drive`"
DEAF = "this robot does not take commands"
AWAY = "the robot is not connected"


class Drive:
    """The stick of one robot. send: to the robot, False where it is not connected; record: what was commanded."""

    def __init__(
        self, allowed: bool, send: Callable[[Mapping[str, Any]], bool], record: Callable[[float, float], None]
    ) -> None:
        self._allowed, self._send, self._record = allowed, send, record
        self.obeys = self.virtual = self.connected = False
        self.limits = DriveLimits(v=0.0, w=0.0)
        self.driver: Viewer | None = None
        self._seq = 0
        self._heard = 0.0
        self._moving = False

    @property
    def reason(self) -> str | None:
        """Why nobody may drive, or None."""
        if not self.obeys:
            return DEAF
        if not self.virtual and not self._allowed:
            return OFF
        return None if self.connected else AWAY

    def state(self, viewer: Viewer) -> DriverState:
        """As a viewer is told."""
        who = self.driver.name if self.driver is not None else None
        reason = self.reason
        return DriverState(
            who=who, you=self.driver is viewer, allowed=reason is None, reason=reason, limits=self.limits
        )

    def request(self, viewer: Viewer, take_over: bool, now: float) -> Refused | None:
        """Ask for the stick."""
        reason = self.reason
        if reason is not None:
            return Refused(type="refused", code="drive_off" if reason in (OFF, DEAF) else "no_robot", detail=reason)
        if self.driver is not None and self.driver is not viewer:
            if not take_over:
                return Refused(type="refused", code="driving", detail=f"{self.driver.name} drives; ask to take over")
            self.stop()
        self.driver, self._heard = viewer, now
        return None

    def release(self, viewer: Viewer) -> bool:
        """Give it back; whether the viewer had it."""
        if self.driver is not viewer:
            return False
        self.stop()
        self.driver = None
        return True

    def drive(self, viewer: Viewer, v: float, w: float, now: float) -> Refused | None:
        """Where the stick stands, cut to the robot's limits."""
        if self.driver is not viewer:
            return Refused(type="refused", code="not_driver", detail="ask for the stick first")
        if (reason := self.reason) is not None:
            return Refused(type="refused", code="no_robot", detail=reason)
        self._heard = now
        v = max(-self.limits["v"], min(self.limits["v"], v))
        w = max(-self.limits["w"], min(self.limits["w"], w))
        self._moving = v != 0.0 or w != 0.0
        self._seq += 1
        if self._send(Command(type="command", v=v, w=w, seq=self._seq, valid_s=DEAD_MAN_S)):
            self._record(v, w)
        return None

    def halt(self, viewer: Viewer) -> bool:
        """Stop the robot; anybody may. Who drove must ask for the stick again, else it would set off at once; whether
        it was taken from another."""
        self.stop()
        taken = self.driver is not None and self.driver is not viewer
        if taken:
            self.driver = None
        return taken

    def stop(self) -> None:
        """Stop the robot."""
        self._seq += 1
        self._moving = False
        if self.obeys and self._send(Stop(type="stop", seq=self._seq)):
            self._record(0.0, 0.0)

    def watch(self, now: float) -> None:
        """Stop a robot whose driver has gone silent."""
        if self._moving and now - self._heard > DEAD_MAN_S:
            self.stop()
