"""The small panel of a scene opened in its own tab, where no page brings a time cursor: play, speed, time, methods.

Nothing that matters can be done from here: it moves the viewer's own cursor, no more.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import viser

from app.scene.cursor import Cursor
from app.scene.data import FIXES, SceneData

SPEEDS = ("0.25", "0.5", "1", "2", "5", "10", "60")
REFRESH = 0.2  # s between moves of the slider while playing


class Panel:
    """viser's own widgets in one browser, bound to one viewer's cursor."""

    def __init__(
        self, handle: viser.ClientHandle, data: SceneData, cursor: Cursor, change: Callable[[dict[str, Any]], None]
    ) -> None:
        gui, self._change, self._last = handle.gui, change, 0.0
        gui.set_panel_label(data.name[:40])
        gui.main_panel.dock_right()
        self._time: viser.GuiSliderHandle[float] | None = None
        if not data.live:  # a run that goes on shows its newest moment, and no other
            self._add_time(gui, data, cursor)
        self._follow = gui.add_checkbox("follow", cursor.follow)
        labels = {path.method: path.label for path in data.paths} | ({FIXES: "Beacon fixes"} if len(data.fixes) else {})
        self._methods = {method: gui.add_checkbox(label, True) for method, label in labels.items()}
        self._bind(self._follow, lambda: {"follow": bool(self._follow.value)})
        for box in self._methods.values():
            self._bind(box, lambda: {"methods": tuple(m for m, b in self._methods.items() if b.value)})

    def _add_time(self, gui: viser.GuiApi, data: SceneData, cursor: Cursor) -> None:
        span = max(data.t1 - data.t0, 1e-3)
        time_s = self._time = gui.add_slider("time / s", data.t0, data.t0 + span, max(span / 5000, 1e-3), data.t0)
        play = self._play = gui.add_checkbox("play", cursor.playing)
        speed = gui.add_dropdown("speed ×", SPEEDS, initial_value="1")
        self._bind(time_s, lambda: {"t": float(time_s.value)})
        self._bind(play, lambda: {"playing": bool(play.value)})
        self._bind(speed, lambda: {"speed": float(speed.value)})

    def _bind(self, widget: Any, change: Callable[[], dict[str, Any]]) -> None:
        async def changed(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:  # the user's hand, not our own echo
                self._change(change())

        widget.on_update(changed)

    def show(self, cursor: Cursor, t: float) -> None:
        """Widgets to where the cursor is; the slider only a few times a second."""
        shown: list[tuple[Any, Any]] = [(self._follow, cursor.follow)]
        shown += [(box, cursor.shows(method)) for method, box in self._methods.items()]
        clock = time.monotonic()
        if self._time is not None:
            shown.append((self._play, cursor.playing))
            if not cursor.playing or clock - self._last > REFRESH:
                self._last = clock
                shown.append((self._time, t))
        for widget, value in shown:
            widget.value = value
