"""A viewer inside the server: the 3D scene of a live run hears what every other viewer hears, without a socket."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import msgpack

from app.live.feed import Viewer

if TYPE_CHECKING:
    from app.live.robot import Robot
    from app.live.run import LiveRun
    from core.run import RunMeta

Hear = Callable[[Mapping[str, Any]], None]


class Tap(Viewer):
    """Hands messages on at once instead of queueing them; `hear` must not wait."""

    def __init__(self, hear: Hear) -> None:
        super().__init__("3D", binary=True)
        self._hear = hear

    def post(self, frame: str | bytes) -> bool:
        """An update, as it goes to all viewers."""
        self._hear(msgpack.unpackb(frame))
        return True

    def tell(self, message: Mapping[str, Any]) -> None:
        """A message for this viewer."""
        self._hear(message)


class LiveFeed:
    """A live run as `app.scene.live.Feed` wants it. `on_loop`: calls on the hub's loop; `left`: a viewer went."""

    def __init__(
        self, robot: Robot, run: LiveRun, on_loop: Callable[[Callable[[], None]], None], left: Callable[[Robot], None]
    ) -> None:
        self._robot, self._on_loop, self._left = robot, on_loop, left
        self.run_id, self.name, self.meta = run.id, run.said.meta.name or robot.name, run.said.meta

    run_id: str
    name: str
    meta: RunMeta

    def subscribe(self, hear: Hear) -> Callable[[], None]:
        """Call `hear` on the hub's loop with a Snapshot and then every Update; returns what ends that. Thread-safe."""
        tap = Tap(hear)

        def join() -> None:
            tap.tell(self._robot.snapshot(tap))
            self._robot.viewers[tap] = None

        def leave() -> None:
            self._robot.viewers.pop(tap, None)
            self._left(self._robot)

        self._on_loop(join)
        return lambda: self._on_loop(leave)
