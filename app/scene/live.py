"""The scene of a run that is still going on: it grows with what the robot's feed tells (`app.live.protocol`).

Shared nodes as in `build`, but a method's path is in three pieces, so that what is new travels in small ones:

/world/methods/{method}/{light,dark}/path        all but the newest poses; drawn anew once a minute or so
/world/methods/{method}/{light,dark}/recent      poses since then, drawn anew every few seconds
/world/methods/{method}/{light,dark}/newest      the last few, drawn anew LINES times a second
/world/trail/{speed,gap}                         the leading path in colours, drawn anew twice a second if looked at
/world/ranges                                    last range of each beacon, as long as measured, towards the robot

Whoever looks sees the newest moment: there is no cursor in time. When the robot leaves the floor, a larger one is laid.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import viser

from app.scene import build, shapes
from app.scene.data import Floats, SceneData, ScenePath, Spread
from app.scene.servers import Scene
from app.scene.style import BEACON, STROKES, THEMES, TRAILS, primary, slug, stroke
from core.run import RunMeta

COLUMNS = ("t", "x", "y", "theta", "sd_x", "sd_y", "cov_xy", "gap")
MOST = 16_384  # poses of a method that are kept; the older, the fewer
UNTOUCHED = 2_048  # the newest are all kept
NEWEST, RECENT = 48, 1_024  # poses after which a piece goes over into the one before it
LINES = 8.0  # drawings of lines per second
TRAIL_EVERY, TRAIL_POINTS = 0.5, 800  # s between two drawings of a coloured trail, its points
SPEED_OVER = 0.2  # s over which a speed is told: of neighbours it would be noise
RANGE_HOLDS = 1.0  # s
TRAIL_WIDTH = 6.0
ROOM = 6.0  # m of floor at least

Message = Mapping[str, Any]
Hear = Callable[[Message], None]


class Feed(Protocol):
    """A live run as its viewers hear of it."""

    run_id: str
    name: str
    meta: RunMeta

    def subscribe(self, hear: Hear) -> Callable[[], None]:
        """Call `hear` with a Snapshot, then every Update, from any thread, until the returned function is called."""


class Growing:
    """The path by one method in a block of memory of fixed size."""

    def __init__(self, method: str, label: str) -> None:
        self.method, self.label, self.thinned = method, label, 0
        self._block = np.full((len(COLUMNS), MOST), np.nan)
        self._rows = 0

    def extend(self, path: Mapping[str, list[Any]]) -> None:
        """Poses later than the last one; what is no number is NaN."""
        rows = np.full((len(COLUMNS), len(path["t"])), np.nan)
        for i, name in enumerate(COLUMNS):
            if path.get(name) is not None:
                rows[i] = np.array(path[name], dtype=np.float64)  # None becomes NaN
        last = self._block[0, self._rows - 1] if self._rows else -np.inf
        rows = rows[:, rows[0] > last][:, -UNTOUCHED:]
        if self._rows + rows.shape[1] > MOST:
            self._thin()
        self._block[:, self._rows : self._rows + rows.shape[1]] = rows
        self._rows += rows.shape[1]

    def _thin(self) -> None:
        old = self._rows - UNTOUCHED
        kept = np.concatenate((np.arange(0, old, 2), np.arange(old, self._rows)))
        self._block[:, : len(kept)] = self._block[:, kept]
        self._rows = len(kept)
        self.thinned += 1

    def path(self) -> ScenePath:
        """The path so far, as views."""
        t, x, y, theta, sd_x, sd_y, cov, _ = self._block[:, : self._rows]
        spread = Spread(sd_x, sd_y, np.nan_to_num(cov)) if np.isfinite(sd_x[-1:]).any() else None
        return ScenePath(self.method, self.label, t, x, y, theta, spread)

    def trail(self, mode: str) -> tuple[Floats, Floats, Floats]:
        """x, y and what colours the path there: speed [m/s], or how far the chain was over its floor; thinned."""
        rows = np.unique(np.linspace(0, max(self._rows - 1, 0), min(TRAIL_POINTS, self._rows)).astype(np.int64))
        t, x, y, *_, gap = self._block[:, rows]
        if mode == "gap":
            return x, y, gap
        back = np.minimum(np.searchsorted(t, t - SPEED_OVER), np.maximum(np.arange(len(t)) - 1, 0))
        passed = np.maximum(t - t[back], 1e-9)
        return x, y, np.where(t > t[back], np.hypot(x - x[back], y - y[back]) / passed, 0.0)


class LiveScene(Scene):
    """One run that goes on. Messages are brought over to the scene's own loop and drawn there."""

    def __init__(self, feed: Feed, revision: str) -> None:
        self._paths: dict[str, Growing] = {}
        self._drawn: dict[str, tuple[int, int, int]] = {}  # method -> rows in `path`, rows before `newest`, thinned
        self._ranges: dict[str, tuple[float, float]] = {}
        self._ends: dict[str, tuple[float, float]] = {}  # where each path's drawing ends
        self._themes: set[str] = set()  # those that somebody sees
        self._drawn_at = self._trail_at = 0.0
        self._gap = np.nan  # worst excess of the links, as last heard
        self._lines: dict[str, viser.LineSegmentsHandle] = {}
        self._count = self._floors = 0
        start = SceneData(
            feed.run_id, feed.name, 0.0, 0.0, beacons=dict(feed.meta.beacons), robot=feed.meta.robot,
            revision=revision, live=True,
        )  # fmt: skip
        super().__init__(start)
        self._unsubscribe = feed.subscribe(self._bring)

    def stop(self) -> None:
        """Hear no more, then stop."""
        self._unsubscribe()
        super().stop()

    def _build(self) -> build.Layout:
        sizes = _roomy(self.data)
        with self._server.atomic():
            build.add_stage(self._server, self.data, sizes)
            for method in STROKES:  # now: a frame that came later would hide what a viewer has switched on
                for variant in THEMES:
                    name = f"/world/methods/{slug(method)}/{variant}"
                    self._server.scene.add_frame(name, show_axes=False, visible=False)
            for mode in TRAILS:
                self._server.scene.add_frame(f"/world/trail/{mode}", show_axes=False, visible=False)
        return sizes

    def _bring(self, message: Message) -> None:
        with contextlib.suppress(RuntimeError):  # the scene's loop has ended
            self._loop.call_soon_threadsafe(self._hear, message)

    # ---- what comes in, on the scene's loop

    def _hear(self, message: Message) -> None:
        if message["type"] not in ("snapshot", "update") or message.get("run_id", self.data.run_id) != self.data.run_id:
            return
        labels = {m["method"]: m["label"] for m in message.get("methods", ())}
        snapshot = message["type"] == "snapshot"
        for method, path in message["paths" if snapshot else "trail"].items():
            self._path(method, labels).extend({**path, "gap": [None if snapshot else self._gap] * len(path["t"])})
        for method, pose in message.get("poses", {}).items():
            self._path(method, labels).extend({name: [{**pose, "gap": self._gap}.get(name)] for name in COLUMNS})
        told = [link["excess"] for link in message.get("links", ()) if link["excess"] is not None]
        self._gap = max(told, default=self._gap)
        for name, last in message["ranges"].items():
            self._ranges[name] = (last["t"], last["range"])
        paths = tuple(g.path() for g in self._paths.values() if g.path().t.size)
        self.data = self.data.grown(message["t"], paths)
        with self._server.atomic():
            if self._outside():
                self._lay_larger_floor()
            if self._due():
                self._draw_paths()
                self._draw_ranges()
                self._draw_trails()
        for viewer in self._viewers.values():
            viewer.grow(self.data, self.sizes)

    def _due(self) -> bool:
        """Robots move with every message; lines, which cost a browser far more, LINES times a second."""
        themes = {viewer.cursor.theme for viewer in self._viewers.values()} or set(THEMES)
        if themes != self._themes:
            self._themes = themes
            self._drawn.clear()
            self._ends.clear()
        now = time.monotonic()
        if now - self._drawn_at < 1 / LINES and self._drawn:
            return False
        self._drawn_at = now
        return True

    def _path(self, method: str, labels: Mapping[str, str]) -> Growing:
        if method not in self._paths:
            self._paths[method] = Growing(method, labels.get(method, method))
        return self._paths[method]

    # ---- drawing

    def _outside(self) -> bool:
        x0, y0, x1, y1 = self.sizes.extent.floor()
        ends = [(p.x[-1], p.y[-1]) for p in self.data.paths if p.method != "beacon"]
        return any(not (x0 <= x <= x1 and y0 <= y <= y1) for x, y in ends if np.isfinite((x, y)).all())

    def _lay_larger_floor(self) -> None:
        self.sizes = _roomy(self.data)
        scene, self._floors = self._server.scene, self._floors + 1
        for variant in THEMES:
            name = f"/world/ground/{variant}"
            old = ("grid", "border", "pitch", "map") if self._floors == 1 else (f"floor-{self._floors - 1}",)
            for part in old:
                scene.remove_by_name(f"{name}/{part}")
            scene.add_frame(f"{name}/floor-{self._floors}", show_axes=False)
            build.add_ground(scene, f"{name}/floor-{self._floors}", self.sizes, variant)
        self._drawn.clear()
        self._ends.clear()

    def _draw_paths(self) -> None:
        for layer, path in enumerate(self.data.paths):
            end, drawn = (float(path.x[-1]), float(path.y[-1])), self._ends.get(path.method, (np.inf, np.inf))
            if max(abs(end[0] - drawn[0]), abs(end[1] - drawn[1])) < self.sizes.extent.size / 3000:
                continue  # it stands, or is nowhere
            self._ends[path.method] = end
            thinned = self._paths[path.method].thinned
            old, recent, before = self._drawn.get(path.method, (0, 0, -1))
            rows = len(path.t)
            if before != thinned or rows - old > RECENT:
                old = recent = rows
                self._draw(path, layer, "path", 0, rows)
                self._draw(path, layer, "recent", rows, rows)
            elif rows - recent > NEWEST:
                recent = rows
                self._draw(path, layer, "recent", old, rows)
            self._draw(path, layer, "newest", recent, rows)
            self._drawn[path.method] = (old, recent, thinned)

    def _draw(self, path: ScenePath, layer: int, piece: str, start: int, end: int) -> None:
        line, z = stroke(path.method), self.sizes.level(layer)
        rows = np.arange(max(start - 1, 0), end)
        if piece == "path":
            rows = rows[shapes.rows_to_draw(path.x[rows], path.y[rows])]
        segments = shapes.polyline(path.x[rows], path.y[rows], line.dash, z, self.sizes.unit)
        if not len(segments):  # viser draws no empty node: a point is as good
            segments = np.zeros((1, 2, 3), np.float32)
        for variant in self._themes:
            name = f"/world/methods/{slug(path.method)}/{variant}"
            self._replace(f"{name}/{piece}", segments, line.colour(variant), line.width)

    def _replace(self, name: str, segments: Floats, colour: Any, width: float) -> None:
        """Lines in place of those of that name; each under a new one, as browsers keep what they have under the old."""
        before = self._lines.pop(name, None)
        self._count += 1
        self._lines[name] = self._server.scene.add_line_segments(
            f"{name}-{self._count}", segments, colour, thickness=width, thickness_units="screen"
        )
        if before is not None:
            before.remove()

    def _draw_trails(self) -> None:
        """The leading path in colours, for those who look at it so."""
        wanted = {viewer.cursor.trail for viewer in self._viewers.values()} & set(TRAILS)
        leader = primary([path.method for path in self.data.paths])
        now = time.monotonic()
        if not wanted or leader is None or now - self._trail_at < TRAIL_EVERY:
            return
        self._trail_at = now
        for mode in wanted:
            x, y, value = self._paths[leader].trail(mode)
            segments, colours = coloured(x, y, value, mode, self.sizes.level(len(self.data.paths) + 3))
            if len(segments):
                self._replace(f"/world/trail/{mode}/line", segments, colours, TRAIL_WIDTH)

    def _draw_ranges(self) -> None:
        segments = range_lines(self.data, self._ranges)
        if len(segments):
            self._replace("/world/ranges", segments, BEACON, 1.0)
        elif (before := self._lines.pop("/world/ranges", None)) is not None:
            before.remove()


def coloured(x: Floats, y: Floats, value: Floats, mode: str, z: float) -> tuple[Floats, npt.NDArray[np.uint8]]:
    """(M, 2, 3) pieces of the path, and their colours: speed from rest to the fastest, gap from the floor to four times
    it or the worst, as on the map. Pieces where the value is unknown are left out."""
    lo, least = (1.0, 4.0) if mode == "gap" else (0.0, 0.1)
    points = np.column_stack((x, y, np.full(len(x), z)))
    known = np.isfinite(points[1:]).all(axis=1) & np.isfinite(points[:-1]).all(axis=1) & np.isfinite(value[1:])
    pieces, value = np.stack((points[:-1], points[1:]), axis=1)[known], value[1:][known]
    scale = TRAILS[mode]
    top = max(least, float(value.max())) if len(value) else least
    steps = np.clip((len(scale) * (value - lo) / (top - lo)).astype(np.int64), 0, len(scale) - 1)
    return pieces.astype(np.float32), np.repeat(shapes.linear(scale)[steps][:, None], 2, axis=1)


def range_lines(data: SceneData, ranges: Mapping[str, tuple[float, float]]) -> Floats:
    """(M, 2, 3) lines from beacons towards the robot, as long as was measured, of ranges younger than RANGE_HOLDS."""
    leader = primary([p.method for p in data.paths])
    path = next((p for p in data.paths if p.method == leader), None)
    lines = []
    for name, (t, length) in ranges.items():
        if path is None or name not in data.beacons or data.t1 - t > RANGE_HOLDS:
            continue
        beacon = np.array(data.beacons[name], dtype=np.float64)
        way = np.array([path.x[-1], path.y[-1], 0.0]) - beacon
        distance = float(np.linalg.norm(way))
        if np.isfinite(distance) and distance > 0:
            lines.append((beacon, beacon + way * (length / distance)))
    return np.array(lines, dtype=np.float32).reshape(-1, 2, 3)


def _roomy(data: SceneData) -> build.Layout:
    """Sizes with room to drive: a quarter more on every side, and ROOM at least."""
    e = build.layout(data).extent
    dx, dy = (max(0.25 * span, (ROOM - span) / 2) for span in (e.x1 - e.x0, e.y1 - e.y0))
    extent = shapes.Extent(e.x0 - dx, e.y0 - dy, e.x1 + dx, e.y1 + dy, e.height)
    return build.Layout(extent, build.robot_scale(extent, data))
