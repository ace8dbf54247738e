"""Small plots as SVG geometry, made on the server: what a template draws with no script. Plain data, pixels inside."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from app.figures.units import significant

Values = Sequence[float | None]
MARGIN = (8.0, 12.0, 34.0, 52.0)  # top, right, bottom, left [px]
TICKS = 5


@dataclass(frozen=True)
class Curve:
    """A curve by its points; `style` is a class of gap.css, `width` None for dots."""

    label: str
    style: str
    x: Values
    y: Values
    dots: bool = False


@dataclass(frozen=True)
class Band:
    """Between two curves over x."""

    style: str
    x: Values
    lo: Values
    hi: Values


@dataclass(frozen=True)
class Tick:
    """Where on the axis [px], and what it says."""

    at: float
    text: str


@dataclass(frozen=True)
class Drawn:
    """A path's `d` and its class."""

    label: str
    style: str
    d: str
    dots: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class Plot:
    """An SVG ready to be written: sizes, axes, bands, curves."""

    width: float
    height: float
    box: tuple[float, float, float, float]  # left, top, right, bottom
    x_ticks: tuple[Tick, ...]
    y_ticks: tuple[Tick, ...]
    x_label: str
    y_label: str
    bands: tuple[Drawn, ...]
    curves: tuple[Drawn, ...]
    zero: float | None = None  # where y = 0 lies, if inside
    legend: tuple[tuple[str, str], ...] = field(default_factory=tuple)


def plot(
    curves: Sequence[Curve],
    bands: Sequence[Band] = (),
    *,
    x_label: str,
    y_label: str,
    width: float = 420.0,
    height: float = 190.0,
    from_zero: bool = False,
    equal: bool = False,
) -> Plot:
    """Curves over a common pair of axes; `equal`: metres as long in x as in y. Missing values break a curve."""
    columns = [c.x for c in curves] + [b.x for b in bands]
    xs = [v for column in columns for v in column if v is not None]
    ys = [v for c in curves for v in c.y if v is not None] + [v for b in bands for v in (*b.lo, *b.hi) if v is not None]
    x_range, y_range = _range(xs, 0.0), _range([*ys, *([0.0] if from_zero else [])], 0.06)
    top, right, bottom, left = MARGIN
    box = (left, top, width - right, height - bottom)
    if equal:
        x_range, y_range = _equal(_range(xs, 0.06), y_range, box)

    def to_x(v: float) -> float:
        return box[0] + (v - x_range[0]) / (x_range[1] - x_range[0]) * (box[2] - box[0])

    def to_y(v: float) -> float:
        return box[3] - (v - y_range[0]) / (y_range[1] - y_range[0]) * (box[3] - box[1])

    drawn = []
    for curve in curves:
        points = [None if x is None or y is None else (to_x(x), to_y(y)) for x, y in zip(curve.x, curve.y, strict=True)]
        dots = tuple((round(p[0], 1), round(p[1], 1)) for p in points if p is not None) if curve.dots else ()
        drawn.append(Drawn(curve.label, curve.style, "" if curve.dots else line(points), dots))
    return Plot(
        width, height, box,
        tuple(Tick(round(to_x(v), 1), tick_text(v)) for v in ticks(x_range)),
        tuple(Tick(round(to_y(v), 1), tick_text(v)) for v in ticks(y_range)),
        x_label, y_label,
        tuple(_band(b, to_x, to_y) for b in bands),
        tuple(drawn),
        round(to_y(0.0), 1) if y_range[0] < 0.0 < y_range[1] and not equal else None,
        tuple((c.label, c.style) for c in curves if c.label),
    )  # fmt: skip


def line(points: Sequence[tuple[float, float] | None]) -> str:
    """The `d` of a polyline through points [px], broken where one is None."""
    out: list[str] = []
    pen = False
    for point in points:
        if point is None:
            pen = False
            continue
        out.append(f"{'L' if pen else 'M'}{point[0]:.1f} {point[1]:.1f}")
        pen = True
    return "".join(out)


def ticks(span: tuple[float, float], about: int = TICKS) -> list[float]:
    """Round values inside a span, 1, 2 or 5 times a power of ten apart."""
    step = (span[1] - span[0]) / about
    power = 10.0 ** math.floor(math.log10(step))
    step = next(k * power for k in (1, 2, 5, 10) if k * power >= step * 0.999)
    first = math.ceil(span[0] / step - 1e-9)
    return [k * step for k in range(first, math.floor(span[1] / step + 1e-9) + 1)]


def tick_text(value: float) -> str:
    """As short as it is exact."""
    if abs(value) < 1e-12:
        return "0"
    if abs(value) >= 1e5 or abs(value) < 1e-3:
        return f"{value:.3g}".replace("-", "−")
    text = significant(round(value, 9), 6)
    return (text.rstrip("0").rstrip(".") if "." in text else text) or "0"


def _range(values: Sequence[float], room: float) -> tuple[float, float]:
    lo, hi = (min(values), max(values)) if values else (0.0, 1.0)
    if hi - lo < 1e-12 * max(abs(hi), 1.0):
        half = max(abs(hi) * 0.05, 1e-6)
        lo, hi = lo - half, hi + half
    return lo - room * (hi - lo), hi + room * (hi - lo)


def _equal(
    x: tuple[float, float], y: tuple[float, float], box: tuple[float, float, float, float]
) -> tuple[tuple[float, float], tuple[float, float]]:
    scale = max((x[1] - x[0]) / (box[2] - box[0]), (y[1] - y[0]) / (box[3] - box[1]))
    out = []
    for (lo, hi), size in ((x, box[2] - box[0]), (y, box[3] - box[1])):
        middle, half = (lo + hi) / 2, scale * size / 2
        out.append((middle - half, middle + half))
    return out[0], out[1]


def _band(band: Band, to_x: Callable[[float], float], to_y: Callable[[float], float]) -> Drawn:
    rows = [
        (x, lo, hi)
        for x, lo, hi in zip(band.x, band.lo, band.hi, strict=True)
        if x is not None and lo is not None and hi is not None
    ]
    there = [(to_x(x), to_y(hi)) for x, _, hi in rows]
    back = [(to_x(x), to_y(lo)) for x, lo, _ in reversed(rows)]
    return Drawn("", band.style, f"{line([*there, *back])}Z" if rows else "")
