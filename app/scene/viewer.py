"""One viewer: a time cursor of its own, and in each browser that shows it the nodes that only this viewer sees.

Everything here runs on the scene server's own event loop (`Scene.call` brings work there), so nothing is locked.
While the cursor plays, a tick 30 times a second sends robot poses and nothing else; a resting viewer costs nothing.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import viser

from app.scene import build, shapes
from app.scene.cursor import Cursor
from app.scene.data import DEFAULT_TRACK_WIDTH, FIXES, SceneData, ScenePath
from app.scene.panel import Panel
from app.scene.style import GAP, GAPS, THEMES, TRAILS, primary, slug

TICK = 1 / 30  # s
OVERLAY, SIMULATED = (124, 91, 176), (128, 138, 148)
RAISED = 0.02  # of the scene: how high a path by the gap floats
Listener = Callable[[dict[str, Any]], None]


@dataclass(frozen=True)
class Overlay:
    """A path that is not stored (the sandbox's): t [s] increasing, x, y [m] in the map, each (N,).

    levels: (N,) steps 0 to 6 of the gap there, in whose colours it is drawn; it then has no marker of its own.
    """

    t: npt.NDArray[np.float64]
    x: npt.NDArray[np.float64]
    y: npt.NDArray[np.float64]
    levels: npt.NDArray[np.int64] | None = None


class Client:
    """The viewer's nodes in one connected browser."""

    def __init__(self, handle: viser.ClientHandle, data: SceneData, sizes: build.Layout) -> None:
        self.handle, self._data, self._sizes = handle, data, sizes
        self._robots: dict[str, viser.FrameHandle] = {}
        self._discs: dict[str, viser.MeshHandle] = {}
        self._shown: dict[str, viser.FrameHandle] = {}
        self._variants: dict[str, list[viser.FrameHandle]] = {name: [] for name in THEMES}
        self._theme = ""
        self._leader: str | None = None
        self._pucks: dict[str, viser.CylinderHandle] = {}
        self._anchor: tuple[float, float] | None = None  # where the followed robot was when following began
        self._camera = shapes.camera(sizes.extent)[0]  # where we have put it
        scene = handle.scene
        self._world = scene.add_frame("/world", show_axes=False)
        for variant in THEMES:
            self._variants[variant].append(scene.add_frame(f"/world/ground/{variant}", show_axes=False, visible=False))
        self._trails = {
            mode: scene.add_frame(f"/world/trail/{mode}", show_axes=False, visible=False)
            for mode in TRAILS
            if data.live
        }
        for path in data.paths:
            self._switch(path.method)
        if len(data.fixes):
            self._shown[FIXES] = scene.add_frame("/world/fixes", show_axes=False)

    def _switch(self, method: str) -> None:
        """This viewer's own switches of a method and its themes, over the shared nodes."""
        name, scene = f"/world/methods/{slug(method)}", self.handle.scene
        self._shown[method] = scene.add_frame(name, show_axes=False)
        for variant in THEMES:
            self._variants[variant].append(scene.add_frame(f"{name}/{variant}", show_axes=False, visible=False))

    def grow(self, data: SceneData, sizes: build.Layout, cursor: Cursor) -> None:
        """The run has gone on: new methods appear, robots and camera suit the floor where it has become larger."""
        new = [p.method for p in data.paths if p.method not in self._shown]
        spread = {p.method for p in data.paths if p.spread is not None}
        for method in new:
            self._switch(method)
        self._data = data
        if new or sizes is not self._sizes or not spread <= set(self._discs):
            if sizes is not self._sizes and not cursor.follow:
                self._step_back(sizes)
            self._sizes, self._theme = sizes, ""  # everything is dressed anew
            self.dress(cursor)
        self.move(data.t1, cursor)

    def _step_back(self, sizes: build.Layout) -> None:
        """All of the floor in sight, unless the user has moved the camera."""
        away = np.asarray(self.handle.camera.position) - np.asarray(self._camera)
        if float(np.linalg.norm(away)) < 0.02 * self._sizes.extent.size:
            self._camera, self.handle.camera.look_at = shapes.camera(sizes.extent)
            self.handle.camera.position = self._camera

    def dress(self, cursor: Cursor) -> None:
        """Theme and methods as the cursor has them."""
        shown = [p for p in self._data.paths if cursor.shows(p.method)]
        leader = primary([p.method for p in shown])
        if cursor.theme != self._theme:
            for variant, frames in self._variants.items():
                for frame in frames:
                    frame.visible = variant == cursor.theme
            self.handle.gui.configure_theme(
                dark_mode=cursor.theme == "dark", show_logo=False, show_share_button=False, control_width="small"
            )
        for method, frame in self._shown.items():
            frame.visible = cursor.shows(method)
        for mode, frame in self._trails.items():
            frame.visible = cursor.trail == mode
        if cursor.theme != self._theme or leader != self._leader:
            self._build_robots(cursor.theme, leader)
        for method, robot in self._robots.items():
            robot.visible = cursor.shows(method)
            if method in self._discs:
                self._discs[method].visible = cursor.shows(method)
        self._theme, self._leader = cursor.theme, leader

    def _build_robots(self, theme: str, leader: str | None) -> None:
        scene = self.handle.scene
        for path in self._data.paths:
            name = slug(path.method)
            self._robots[path.method] = build.add_robot(
                scene, f"/world/robots/{name}", path, self._data, self._sizes, theme, leads=path.method == leader
            )
            if path.spread is not None:
                self._discs[path.method] = build.add_now(scene, f"/world/now/{name}", path, theme)

    def move(self, t: float, cursor: Cursor) -> None:
        """Robots to where they are at t, and the world under a following camera."""
        for layer, path in enumerate(self._data.paths):
            if not cursor.shows(path.method):
                continue
            x, y, theta = path.pose_at(t)
            if not np.isfinite((x, y)).all():
                continue  # it stays where it was last seen
            robot = self._robots[path.method]
            robot.position = (x, y, 0.0)
            if np.isfinite(theta):
                robot.wxyz = shapes.yaw(theta)
            if path.spread is not None:
                self._spread(path, t, x, y, layer)
        self._follow(t, cursor)

    def _spread(self, path: ScenePath, t: float, x: float, y: float, layer: int) -> None:
        assert path.spread is not None
        covariance = path.spread.covariance(path.row(t)[0])
        if not np.isfinite(covariance).all():
            return
        axes, angle = shapes.ellipses(covariance, build.SIGMAS)
        disc = self._discs[path.method]
        disc.position = (x, y, self._sizes.level(layer + 0.5))
        if axes[0, 0] > self._sizes.extent.size / 2:  # it would cover the hall
            axes = np.full((1, 2), 1e-6)
        scale = (round(float(axes[0, 0]), 6), round(float(axes[0, 1]), 6), 1.0)
        if max(abs(a - b) for a, b in zip(scale, np.broadcast_to(disc.scale, 3), strict=True)) > 0.01 * scale[0]:
            disc.scale = scale
        disc.wxyz = shapes.yaw(angle[0])

    def lay(self, overlays: Mapping[str, Overlay]) -> None:
        """Paths that are not stored, as a page lays them in; those of the same name go."""
        scene = self.handle.scene
        for name, overlay in overlays.items():
            height = self._sizes.level(len(self._data.paths) + 3)
            if overlay.levels is not None:  # above all paths, or it would flicker through those that it lies on
                height = self._sizes.extent.size * RAISED
            points = np.column_stack((overlay.x, overlay.y, np.full(len(overlay.x), height)))
            pieces = np.stack((points[:-1], points[1:]), axis=1)
            colours: Any = SIMULATED if name == "simulated" else OVERLAY
            if overlay.levels is not None:
                colours = np.repeat(shapes.linear(GAPS.get(self._theme, GAP))[overlay.levels[1:]][:, None], 2, axis=1)
            width = 3.0 if overlay.levels is None else 6.0
            node = f"/world/overlay/{name}"
            scene.add_line_segments(f"{node}/path", pieces, colours, thickness=width, thickness_units="screen")
            if overlay.levels is None and name != "simulated" and name not in self._pucks:
                size = (self._data.robot.track_width or DEFAULT_TRACK_WIDTH) * self._sizes.robot_scale
                self._pucks[name] = scene.add_cylinder(
                    f"{node}/now", radius=0.35 * size, height=0.3 * size, color=OVERLAY, cast_shadow=False
                )

    def move_overlays(self, t: float, overlays: Mapping[str, Overlay]) -> None:
        """Their markers to where they are at t."""
        for name, puck in self._pucks.items():
            overlay = overlays[name]
            x, y = (float(np.interp(t, overlay.t, column)) for column in (overlay.x, overlay.y))
            puck.position = (x, y, 0.2 * (self._data.robot.track_width or DEFAULT_TRACK_WIDTH))

    def _follow(self, t: float, cursor: Cursor) -> None:
        """The world moves under the camera, so that the user's orbit and zoom stay his own."""
        path = next((p for p in self._data.paths if p.method == self._leader), None)
        if cursor.follow and path is not None:
            x, y, _ = path.pose_at(t)
            if not np.isfinite((x, y)).all():
                return
            if self._anchor is None:
                self._anchor = (x, y)
                self._look_at(x, y)
            self._world.position = (self._anchor[0] - x, self._anchor[1] - y, 0.0)
        elif self._anchor is not None:
            shift = np.array(self._world.position)  # a copy: viser writes into its own
            self._anchor = None
            self._world.position = (0.0, 0.0, 0.0)
            self.handle.camera.position = np.asarray(self.handle.camera.position) - shift

    def _look_at(self, x: float, y: float) -> None:
        """Bring the robot to the middle, nearer when the camera is far off."""
        camera = self.handle.camera
        away = np.asarray(camera.position) - np.asarray(camera.look_at)
        reach = min(float(np.linalg.norm(away)), self._sizes.extent.size * 0.7)
        target = np.array([x, y, 0.0])
        camera.position = target + away / max(float(np.linalg.norm(away)), 1e-9) * reach
        camera.look_at = target


class Viewer:
    """A cursor, the browsers that show it, and whoever listens to it (the page's sockets)."""

    def __init__(
        self,
        key: str,
        data: SceneData,
        sizes: build.Layout,
        loop: asyncio.AbstractEventLoop,
        *,
        panel: bool,
        theme: str,
    ) -> None:
        self.key, self._data, self._sizes, self._loop, self._with_panel = key, data, sizes, loop, panel
        self.cursor = Cursor(data.t0, time.monotonic(), theme=theme)
        self._clients: dict[int, Client] = {}
        self._panels: dict[int, Panel] = {}
        self._listeners: list[Listener] = []
        self._timer: asyncio.TimerHandle | None = None
        self._overlays: dict[str, Overlay] = {}
        self._due = 0.0  # of the next tick, on the loop's clock

    @property
    def idle(self) -> bool:
        """Whether nobody looks and nobody listens."""
        return not self._clients and not self._listeners

    def attach(self, handle: viser.ClientHandle) -> None:
        """A browser connected."""
        with handle.atomic():
            client = self._clients[handle.client_id] = Client(handle, self._data, self._sizes)
            client.dress(self.cursor)
            client.move(self.time(), self.cursor)
            client.lay(self._overlays)
            client.move_overlays(self.time(), self._overlays)
        if self._with_panel:
            self._panels[handle.client_id] = Panel(handle, self._data, self.cursor, self._by_panel)
        self._tell("scene")

    def detach(self, client_id: int) -> None:
        """A browser went away."""
        self._clients.pop(client_id, None)
        self._panels.pop(client_id, None)
        if self.idle:
            self._rest()
        self._tell("scene")

    def listen(self, listener: Listener) -> None:
        """Hear of the state now and of every change that somebody else makes."""
        self._listeners.append(listener)
        listener(self.state("scene"))

    def unlisten(self, listener: Listener) -> None:
        """Hear no more. A page that leaves takes its playing along."""
        self._listeners = [other for other in self._listeners if other is not listener]
        if not self._listeners and not self._with_panel:
            self.change({"playing": False})

    def grow(self, data: SceneData, sizes: build.Layout) -> None:
        """The run has gone on."""
        self._data, self._sizes = data, sizes
        for client in self._clients.values():
            with client.handle.atomic():
                client.grow(data, sizes, self.cursor)

    def change(self, change: dict[str, Any], source: Listener | None = None, by: str = "page") -> None:
        """Move the cursor; `change` has been checked. Everybody but the `source` hears of it."""
        if self._data.live:
            change = {k: v for k, v in change.items() if k not in ("t", "playing")}
        before = self.cursor
        self.cursor = before.moved(change, time.monotonic(), self._data.t0, self._data.t1)
        if "playing" in change and self.cursor.playing and self.time() >= self._data.t1:
            self.cursor = self.cursor.moved({"t": self._data.t0}, time.monotonic(), self._data.t0, self._data.t1)
        for client in self._clients.values():
            with client.handle.atomic():
                if any(getattr(before, k) != getattr(self.cursor, k) for k in ("theme", "methods", "trail")):
                    client.dress(self.cursor)
                if before.theme != self.cursor.theme:
                    client.lay({name: o for name, o in self._overlays.items() if o.levels is not None})
        self._tick()
        self._tell(by, source)

    def lay(self, overlay: Overlay, name: str = "path") -> None:
        """Show this path beside the stored ones, in place of the one before."""
        self._overlays[name] = overlay
        for client in self._clients.values():
            with client.handle.atomic():
                client.lay({name: overlay})
                client.move_overlays(self.time(), self._overlays)

    def _by_panel(self, change: dict[str, Any]) -> None:
        self.change(change, by="panel")

    def time(self) -> float:
        """The run's time at this moment [s]; of a live run the newest."""
        if self._data.live:
            return self._data.t1
        return self.cursor.now(time.monotonic(), self._data.t0, self._data.t1)

    def state(self, by: str = "") -> dict[str, Any]:
        """Plain data for pages and tests; `by` is whose hand it was: page, panel or scene."""
        t, methods = self.time(), [m for m in self._data.methods if self.cursor.shows(m)]
        return {
            "type": "state",
            "by": by,
            "viewer": self.key,
            "clients": len(self._clients),
            "t": t,
            "playing": self.cursor.playing,
            "speed": self.cursor.speed,
            "follow": self.cursor.follow,
            "methods": methods,
            "theme": self.cursor.theme,
            "trail": self.cursor.trail,
            "live": self._data.live,
            "leader": primary([m for m in methods if m != FIXES]),
            "robot_scale": round(self._sizes.robot_scale, 2),
            "poses": {p.method: _plain(p.pose_at(t)) for p in self._data.paths if self.cursor.shows(p.method)},
        }

    def _tell(self, by: str, source: Listener | None = None) -> None:
        for panel in self._panels.values():
            panel.show(self.cursor, self.time())
        others = [listener for listener in self._listeners if listener is not source]
        if others:
            state = self.state(by)
            for listener in others:
                listener(state)

    def _rest(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _tick(self) -> None:
        self._rest()
        t = self.time()
        for client in self._clients.values():
            with client.handle.atomic():
                client.move(t, self.cursor)
                client.move_overlays(t, self._overlays)
        if not self.cursor.playing:
            return
        if t >= self._data.t1:
            self.cursor = self.cursor.moved({"playing": False}, time.monotonic(), self._data.t0, self._data.t1)
            self._tell("scene")
            return
        for panel in self._panels.values():
            panel.show(self.cursor, t)
        if not self.idle:
            self._due = max(self._due + TICK, self._loop.time())
            self._timer = self._loop.call_at(self._due, self._tick)


def _plain(pose: tuple[float, float, float]) -> list[float | None]:
    return [round(v, 6) if np.isfinite(v) else None for v in pose]
