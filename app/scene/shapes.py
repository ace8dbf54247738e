"""Geometry of the scene as plain arrays: decimated polylines, dashes, ellipses, grid pitch, camera. No viser."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from tsdownsample import MinMaxLTTBDownsampler

Floats = npt.NDArray[np.floating]

MAX_SEGMENTS = 20_000
MAX_DASHES = 2_000
CAMERA_FOV = 0.85  # rad, vertical
CAMERA_TILT = 0.93  # rad above the floor
CAMERA_ASPECT = 1.35  # the narrowest view in which everything is seen


@dataclass(frozen=True)
class Extent:
    """The box around all that is drawn [m]."""

    x0: float
    y0: float
    x1: float
    y1: float
    height: float = 0.0

    @property
    def centre(self) -> tuple[float, float]:
        """Its middle on the ground."""
        return (self.x0 + self.x1) / 2, (self.y0 + self.y1) / 2

    @property
    def size(self) -> float:
        """The longer side, never below 1 m: a robot at rest still stands on a floor."""
        return max(self.x1 - self.x0, self.y1 - self.y0, 1.0)

    def floor(self) -> tuple[float, float, float, float]:
        """x0, y0, x1, y1 of the ground grid: whole cells, half a cell clear of what stands on it."""
        pitch = grid_pitch(self.size)
        x0, y0 = (np.floor(v / pitch - 0.5) * pitch for v in (self.x0, self.y0))
        x1, y1 = (np.ceil(v / pitch + 0.5) * pitch for v in (self.x1, self.y1))
        return float(x0), float(y0), float(x1), float(y1)


def extent_of(clouds: list[Floats], height: float = 0.0) -> Extent:
    """The extent of (N, 2) clouds, without what is not finite."""
    lows, highs = [], []
    for cloud in clouds:
        rows = cloud[np.isfinite(cloud).all(axis=1)]
        if len(rows):
            lows.append(rows.min(axis=0))
            highs.append(rows.max(axis=0))
    if not lows:
        return Extent(-1.0, -1.0, 1.0, 1.0, height)
    (x0, y0), (x1, y1) = np.min(lows, axis=0), np.max(highs, axis=0)
    return Extent(float(x0), float(y0), float(x1), float(y1), height)


def rows_to_draw(x: Floats, y: Floats, limit: int = MAX_SEGMENTS) -> npt.NDArray[np.intp]:
    """Rows that keep the shape of a path in at most `limit` points; the edges of gaps (NaN) stay."""
    n = len(x)
    if n <= limit:
        return np.arange(n, dtype=np.intp)
    sampler = MinMaxLTTBDownsampler()  # type: ignore[no-untyped-call]  # tsdownsample has no types
    picked = [sampler.downsample(np.ascontiguousarray(c), n_out=limit // 2 - 2) for c in (x, y)]
    missing = np.isnan(x) | np.isnan(y)
    edges = np.flatnonzero(missing[1:] != missing[:-1]) + 1
    rows = np.unique(np.concatenate([*picked, edges[: limit // 10], [0, n - 1]]).astype(np.intp))
    return rows[:: -(-len(rows) // limit)]


def polyline(x: Floats, y: Floats, dash: tuple[float, ...], z: float, unit: float) -> Floats:
    """(M, 2, 3) float32 segments through the points, cut to a dash pattern; nothing is drawn across NaN.

    dash: lengths of pen down, pen up, ... in multiples of `unit` [m]; () draws a full line.
    """
    points = np.column_stack((x, y)).astype(np.float64)
    pen = np.ones(max(len(points) - 1, 0), bool)
    if dash and len(points) > 1:
        points, pen = _dashed(points, np.asarray(dash) * unit)
    ok = np.isfinite(points[:, 0]) & np.isfinite(points[:, 1])
    keep = pen & ok[1:] & ok[:-1]
    segments = np.zeros((int(keep.sum()), 2, 3), np.float32)
    segments[:, 0, :2], segments[:, 1, :2], segments[:, :, 2] = points[:-1][keep], points[1:][keep], z
    return segments


def _dashed(
    points: npt.NDArray[np.float64], dash: npt.NDArray[np.float64]
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
    """The points with the dashes' ends put in, and which of the segments between them the pen draws."""
    step = np.hypot(np.diff(points[:, 0]), np.diff(points[:, 1]))
    s = np.concatenate(([0.0], np.cumsum(np.nan_to_num(step))))
    period = float(dash.sum())
    if s[-1] > MAX_DASHES * period:  # a path of kilometres in one hall: longer dashes, not more of them
        dash = dash * (s[-1] / (MAX_DASHES * period))
        period = float(dash.sum())
    if s[-1] <= 0:
        return points, np.ones(len(points) - 1, np.bool_)
    ends = (np.arange(int(s[-1] / period) + 1)[:, None] * period + np.cumsum(dash)).ravel()
    ends = ends[ends < s[-1]]
    at = np.searchsorted(s, ends, side="right")
    fraction = ((ends - s[at - 1]) / (s[at] - s[at - 1]))[:, None]
    points = np.insert(points, at, points[at - 1] + fraction * (points[at] - points[at - 1]), axis=0)
    s = np.insert(s, at, ends)
    middle = (s[1:] + s[:-1]) / 2 % period
    return points, np.searchsorted(np.cumsum(dash), middle, side="right") % 2 == 0


def ellipses(covariance: Floats, sigmas: float = 2.0) -> tuple[Floats, Floats]:
    """(M, 2) half axes [m] of the `sigmas` ellipses of (M, 2, 2) covariances, and (M,) angles of the first axis."""
    values, vectors = np.linalg.eigh(covariance)
    axes = sigmas * np.sqrt(np.maximum(values[:, ::-1], 0.0))
    return axes, np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1])


def yaw(angle: Floats | float) -> Floats:
    """(M, 4) wxyz quaternions of turns about z, or (4,) for one."""
    half = np.asarray(angle, dtype=np.float64) / 2
    zero = np.zeros_like(half)
    return np.stack((np.cos(half), zero, zero, np.sin(half)), axis=-1)


def disc(points: int = 36) -> tuple[Floats, npt.NDArray[np.uint32]]:
    """A flat unit disc as a mesh: (V, 3) vertices, (F, 3) faces, seen from above."""
    angle = np.linspace(0, 2 * np.pi, points, endpoint=False)
    rim = np.column_stack((np.cos(angle), np.sin(angle), np.zeros(points)))
    i = np.arange(points)
    faces = np.column_stack((np.zeros(points), 1 + i, 1 + (i + 1) % points))
    return np.vstack((np.zeros((1, 3)), rim)).astype(np.float32), faces.astype(np.uint32)


def outlines(centres: Floats, axes: Floats, angle: Floats, z: float, points: int = 36) -> Floats:
    """(M * points, 2, 3) segments around M ellipses: centres, half axes (M, 2), angles of the first axis (M,)."""
    turn = np.linspace(0, 2 * np.pi, points + 1)
    u, v = axes[:, :1] * np.cos(turn), axes[:, 1:] * np.sin(turn)
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    rim = np.stack((centres[:, :1] + c * u - s * v, centres[:, 1:] + s * u + c * v, np.full_like(u, z)), axis=-1)
    return np.stack((rim[:, :-1], rim[:, 1:]), axis=2).reshape(-1, 2, 3).astype(np.float32)


def grid_pitch(size: float) -> float:
    """The cell of the ground grid [m]: 1, 2 or 5 times a power of ten, about a dozen over the longer side."""
    raw = size / 12
    power = 10.0 ** np.floor(np.log10(raw))
    return float(power * next(m for m in (1, 2, 5, 10) if raw <= m * power * 1.001))


def apart(centres: Floats, radius: Floats, gap: float, widest: float) -> list[int]:
    """Which of the discs (M, 2), (M,) along a path to draw: each clear of those before it by `gap`, none too wide."""
    chosen: list[int] = []
    for i in np.flatnonzero((radius > 0) & (radius <= widest)):
        distance = np.hypot(*(centres[chosen] - centres[i]).T) if chosen else np.array([np.inf])
        if (distance >= np.maximum(gap, 0.8 * (radius[i] + (radius[chosen] if chosen else 0.0)))).all():
            chosen.append(int(i))
    return chosen


def camera(extent: Extent) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Position and look-at from the south, tilted, x to the right as on the map, as near as all of it is seen."""
    half = np.tan(CAMERA_FOV / 2)
    x0, y0, x1, y1 = extent.floor()
    corners = np.array([(x, y, z) for x in (x0, x1) for y in (y0, y1) for z in (0.0, extent.height)])
    back = np.array((0.0, -np.cos(CAMERA_TILT), np.sin(CAMERA_TILT)))
    up = np.array((0.0, np.sin(CAMERA_TILT), np.cos(CAMERA_TILT)))
    for reach in extent.size * np.geomspace(0.5, 8.0, 80):
        target = np.array((*extent.centre, 0.0))
        for _ in range(12):  # shift the target until top and bottom have the same margin
            seen = corners - (target + reach * back)
            depth = np.maximum(seen @ -back, 0.05 * reach)
            height, side = (seen @ up) / depth / half, np.abs(seen[:, 0]) / depth / (half * CAMERA_ASPECT)
            target[1] += 0.5 * (height.max() + height.min()) * half * reach
        if height.max() <= 0.94 and height.min() >= -0.94 and side.max() <= 0.94:
            break
    position = target + reach * back
    return (float(position[0]), float(position[1]), float(position[2])), (float(target[0]), float(target[1]), 0.0)


def linear(colours: Sequence[tuple[int, int, int]]) -> npt.NDArray[np.uint8]:
    """(N, 3) colours as lines of many colours are given them: of single points viser takes linear light."""
    return np.asarray(255.0 * (np.array(colours) / 255.0) ** 2.2).astype(np.uint8)
