"""A scene as a tree of named frames, from plain data. The same builder serves live viewers and the HTML export.

/world                        a viewer's own frame: moved, it is the follow camera
  ground/{light,dark}         grid sized to the data, its pitch as a label, the map's axes
  beacons/{name}              mast, head and label at the surveyed height
  events/{n}                  a pin with its name where the run's path was when something happened
  fixes                       raw beacon fixes, switched like a method
  methods/{method}            what a viewer switches on and off
    {light,dark}              path (at most 20,000 segments) and two-sigma ellipses along it
  robots/{method}             a viewer's own: body, wheels and heading axes at the viewer's time
  now/{method}                a viewer's own: the two-sigma ellipse at the viewer's time

Shared nodes carry the run and are replayed to whoever connects; a viewer shadows the frames `ground/*`, `methods/*`
with frames of its own to choose theme and methods, so that only poses travel afterwards.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import viser

from app.scene import shapes
from app.scene.data import DEFAULT_TRACK_WIDTH, DEFAULT_WHEEL_RADIUS, SceneData, SceneEvent, ScenePath
from app.scene.style import BEACON, EVENT_OTHER, EVENTS, FIXES, THEME, THEMES, slug, stroke

MAX_BEACONS = 200
MAX_EVENTS = 200
CROWD = (0.3, 0.09)  # of the scene, along x and along y (away from the camera): nearer events share one label
CANDIDATES = 240  # rows of a path where an ellipse may stand
WIDEST = 0.2  # half axis of the widest ellipse drawn, as a share of the scene
SIGMAS = 2.0


@dataclass(frozen=True)
class Layout:
    """Sizes that the whole scene shares."""

    extent: shapes.Extent
    robot_scale: float  # robots are drawn larger than life where they would be lost in the hall

    @property
    def unit(self) -> float:
        """The line unit: a hundredth of the scene [m]."""
        return self.extent.size / 100

    def level(self, layer: float) -> float:
        """Height of a layer of lines, so that none flickers through another [m]."""
        return self.extent.size * 4e-4 * (1 + layer)


def layout(data: SceneData) -> Layout:
    """The sizes for this run."""
    clouds = [*map(_sample, data.paths), data.fixes]
    clouds.append(np.array([p[:2] for p in data.beacons.values()], dtype=np.float64).reshape(-1, 2))
    heights = [p[2] for p in data.beacons.values()]
    extent = shapes.extent_of(clouds, max(heights, default=0.0))
    return Layout(extent, robot_scale(extent, data))


def robot_scale(extent: shapes.Extent, data: SceneData) -> float:
    """How much larger than life robots are drawn."""
    length = 1.25 * (data.robot.track_width or DEFAULT_TRACK_WIDTH)
    return max(1.0, extent.size / 20 / length)


def _sample(path: ScenePath) -> shapes.Floats:
    step = max(1, len(path.t) // shapes.MAX_SEGMENTS)
    return np.column_stack((path.x[::step], path.y[::step]))


def add_run(server: viser.ViserServer, data: SceneData, theme: str | None = None) -> Layout:
    """All that viewers share. `theme` shows one set of colours outright (export); None leaves it to each viewer."""
    sizes, scene = layout(data), server.scene
    with server.atomic():
        add_stage(server, data, sizes, theme)
        shown = data.events[:MAX_EVENTS]
        names = event_labels(shown, sizes.extent.size * CROWD[0], sizes.extent.size * CROWD[1])
        for i, event in enumerate(shown):
            add_event(scene, f"/world/events/{i}", event, sizes, names[i])
        if len(data.fixes):
            _add_fixes(scene, data, sizes)
        for layer, path in enumerate(data.paths):
            add_method(scene, f"/world/methods/{slug(path.method)}", path, sizes, layer, theme)
    return sizes


def add_stage(server: viser.ViserServer, data: SceneData, sizes: Layout, theme: str | None = None) -> None:
    """What does not move: camera, ground, beacons."""
    scene = server.scene
    scene.set_up_direction("+z")
    _set_camera(server, sizes)
    for name in THEMES:
        scene.add_frame(f"/world/ground/{name}", show_axes=False, visible=name == theme)
        add_ground(scene, f"/world/ground/{name}", sizes, name)
    for name, position in list(data.beacons.items())[:MAX_BEACONS]:
        add_beacon(scene, f"/world/beacons/{slug(name)}", name, position, sizes)


def _set_camera(server: viser.ViserServer, sizes: Layout) -> None:
    position, look_at = shapes.camera(sizes.extent)
    start = server.initial_camera
    start.fov = shapes.CAMERA_FOV
    start.near, start.far = sizes.extent.size / 2000, sizes.extent.size * 60
    start.position, start.look_at = position, look_at


def add_ground(scene: viser.SceneApi, name: str, sizes: Layout, theme: str) -> None:
    """Grid, its pitch in words, and the map's axes at the origin where that is near."""
    extent, colours, pitch = sizes.extent, THEME[theme], shapes.grid_pitch(sizes.extent.size)
    x0, y0, x1, y1 = extent.floor()
    lines = _grid_lines(x0, y0, x1, y1, pitch)
    scene.add_line_segments(f"{name}/grid", lines, colours.cell, thickness=1.0, thickness_units="screen")
    border = np.array([[[x0, y0], [x1, y0]], [[x1, y0], [x1, y1]], [[x1, y1], [x0, y1]], [[x0, y1], [x0, y0]]])
    border = np.concatenate((border, np.zeros((4, 2, 1))), axis=2)
    scene.add_line_segments(f"{name}/border", border, colours.section, thickness=1.5, thickness_units="screen")
    scene.add_label(f"{name}/pitch", f"grid {pitch:g} m", position=(x1, y0, 0.0), anchor="bottom-right")
    if x0 <= 0 <= x1 and y0 <= 0 <= y1:
        scene.add_frame(f"{name}/map", axes_length=pitch * 0.8, axes_radius=sizes.unit * 0.16)


def _grid_lines(x0: float, y0: float, x1: float, y1: float, pitch: float) -> shapes.Floats:
    """(M, 2, 3) lines of a grid over a rectangle."""
    xs, ys = np.arange(x0 + pitch, x1 - pitch / 2, pitch), np.arange(y0 + pitch, y1 - pitch / 2, pitch)
    lines = np.zeros((len(xs) + len(ys), 2, 3), np.float32)
    lines[: len(xs), :, 0], lines[: len(xs), 0, 1], lines[: len(xs), 1, 1] = xs[:, None], y0, y1
    lines[len(xs) :, :, 1], lines[len(xs) :, 0, 0], lines[len(xs) :, 1, 0] = ys[:, None], x0, x1
    return lines


def add_beacon(
    scene: viser.SceneApi, name: str, label: str, position: tuple[float, float, float], sizes: Layout
) -> None:
    """A mast from the floor to the beacon, its head, its name and height."""
    x, y, z = map(float, position)
    scene.add_frame(name, show_axes=False, position=(x, y, 0.0))
    if abs(z) > sizes.unit:
        mast = np.array([[[0, 0, 0], [0, 0, z]]], np.float32)
        scene.add_line_segments(f"{name}/mast", mast, BEACON, thickness=1.5, thickness_units="screen")
    scene.add_icosphere(f"{name}/head", radius=sizes.unit * 0.9, color=BEACON, position=(0, 0, z), cast_shadow=False)
    text = f"{label}  {z:g} m" if z else label
    scene.add_label(f"{name}/label", text, position=(0, 0, z + sizes.unit * 1.4), anchor="bottom-center")


def event_labels(events: Sequence[SceneEvent], wide: float, deep: float) -> list[str]:
    """A label per event, empty where one that is no `wide` [m] along x and `deep` along y away speaks for it.

    `slip × 3`, or with several kinds `slip × 3, 4 more`: a label must not grow into the next one.
    """
    speakers: list[int] = []
    kinds: dict[int, Counter[str]] = {}
    for i, event in enumerate(events):
        near = (j for j in speakers if abs(events[j].x - event.x) < wide and abs(events[j].y - event.y) < deep)
        speaker = next(near, i)
        if speaker == i:
            speakers.append(i)
        kinds.setdefault(speaker, Counter())[event.kind.replace("_", " ")] += 1
    return [_counted(kinds[i]) if i in kinds else "" for i in range(len(events))]


def _counted(kinds: Counter[str]) -> str:
    (kind, n), *rest = kinds.most_common()
    told = kind if n == 1 else f"{kind} × {n}"
    return f"{told}, {sum(more for _, more in rest)} more" if rest else told


def add_event(scene: viser.SceneApi, name: str, event: SceneEvent, sizes: Layout, label: str) -> None:
    """A pin with the event's name: an edged head for what befell robot or wheels, a round one for beacon and place."""
    colour, corners = EVENTS.get(event.kind, EVENT_OTHER)
    unit = sizes.unit
    pin = np.array([[[0, 0, 0], [0, 0, 2.2 * unit]]], np.float32)
    scene.add_frame(name, show_axes=False, position=(event.x, event.y, 0.0))
    scene.add_line_segments(f"{name}/pin", pin, colour, thickness=1.5, thickness_units="screen")
    scene.add_icosphere(f"{name}/head", radius=0.7 * unit, color=colour, subdivisions=corners,
                        flat_shading=corners < 3, position=(0, 0, 2.8 * unit), cast_shadow=False)  # fmt: skip
    if label:
        scene.add_label(f"{name}/label", label, position=(0, 0, 3.8 * unit), anchor="bottom-center")


def _add_fixes(scene: viser.SceneApi, data: SceneData, sizes: Layout) -> None:
    rows = data.fixes[np.isfinite(data.fixes).all(axis=1)]
    points = np.column_stack((rows, np.full(len(rows), sizes.level(-0.5)))).astype(np.float32)
    size = sizes.unit * (0.5 if len(points) < 2000 else 0.3)
    scene.add_point_cloud(
        "/world/fixes/points", points, FIXES.light, point_size=size, point_shape="circle", precision="float32",
        point_shading="flat",
    )  # fmt: skip


def add_method(scene: viser.SceneApi, name: str, path: ScenePath, sizes: Layout, layer: int, theme: str | None) -> None:
    """One method's path and ellipses, in the colours of both themes."""
    line, z = stroke(path.method), sizes.level(layer)
    rows = shapes.rows_to_draw(path.x, path.y)
    segments = shapes.polyline(np.asarray(path.x[rows]), np.asarray(path.y[rows]), line.dash, z, sizes.unit)
    for variant in THEMES:
        scene.add_frame(f"{name}/{variant}", show_axes=False, visible=variant == theme)
        if len(segments):
            scene.add_line_segments(
                f"{name}/{variant}/path", segments, line.colour(variant), thickness=line.width, thickness_units="screen"
            )
        if path.spread is not None:
            _add_ellipses(scene, f"{name}/{variant}/spread", path, sizes, line.colour(variant), z)


def _add_ellipses(
    scene: viser.SceneApi, name: str, path: ScenePath, sizes: Layout, colour: tuple[int, int, int], z: float
) -> None:
    """Ellipses that stand clear of each other; those wider than the hall say only that the place is unknown."""
    assert path.spread is not None
    rows = np.unique(np.linspace(0, len(path.t) - 1, CANDIDATES).astype(np.intp))
    centres, covariance = np.column_stack((path.x[rows], path.y[rows])), path.spread.covariance(rows)
    ok = np.isfinite(covariance).all(axis=(1, 2)) & np.isfinite(centres).all(axis=1)
    centres, (axes, angle) = centres[ok], shapes.ellipses(covariance[ok], SIGMAS)
    clear = shapes.apart(centres, axes[:, 0], sizes.extent.size / 16, sizes.extent.size * WIDEST)
    if len(clear):
        rims = shapes.outlines(centres[clear], axes[clear], angle[clear], z)
        scene.add_line_segments(name, rims, colour, thickness=1.2, thickness_units="screen")


def add_robot(
    scene: viser.SceneApi, name: str, path: ScenePath, data: SceneData, sizes: Layout, theme: str, *, leads: bool
) -> viser.FrameHandle:
    """One method's robot at the viewer's time: body, wheels, heading axes; a plain puck where there is no heading."""
    r = (data.robot.wheel_radius or DEFAULT_WHEEL_RADIUS) * sizes.robot_scale
    b = (data.robot.track_width or DEFAULT_TRACK_WIDTH) * sizes.robot_scale
    colour = stroke(path.method).body(theme)
    ghost = None if leads else 0.45
    if not leads:  # a little smaller, so that faces of robots in one place don't flicker
        r, b = r * 0.96, b * 0.96
    heading = bool(np.isfinite(path.theta[:1000]).any())
    frame = scene.add_frame(
        name, show_axes=heading and leads, axes_length=b * 1.15, axes_radius=b * 0.025, origin_radius=b * 0.05
    )
    if not heading:
        scene.add_cylinder(f"{name}/body", radius=b * 0.4, height=r * 1.2, color=colour, opacity=ghost,
                           position=(0, 0, r * 0.6), cast_shadow=False)  # fmt: skip
        return frame
    scene.add_box(f"{name}/body", dimensions=(b * 1.25, b * 0.8, b * 0.3), color=colour, opacity=ghost,
                  position=(b * 0.2, 0, r + b * 0.05), cast_shadow=leads)  # fmt: skip
    for side, y in (("left", b / 2), ("right", -b / 2)):
        scene.add_cylinder(
            f"{name}/{side}", radius=r, height=b * 0.14, color=THEME[theme].wheel, opacity=ghost,
            position=(0, y, r), wxyz=(np.sqrt(0.5), np.sqrt(0.5), 0, 0), cast_shadow=False,
        )  # fmt: skip
    return frame


def add_now(scene: viser.SceneApi, name: str, path: ScenePath, theme: str) -> viser.MeshHandle:
    """The two-sigma ellipse at the viewer's time: a unit disc that poses and scales move."""
    vertices, faces = shapes.disc()
    return scene.add_mesh_simple(
        name, vertices, faces, color=stroke(path.method).colour(theme), opacity=0.35, side="double",
        cast_shadow=False, receive_shadow=False,
    )  # fmt: skip
