"""A diagnosis as figures: what the report page and the self-contained report draw, from gap/1 and gap-evidence/1.

Whatever the evidence lacks gives an empty figure. Numbers come as people read them; gaps are in units of the noise.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from app.figures.gap_reasons import Line, plain
from app.figures.gap_sentence import joint, regressor_name, stream_name, times
from app.figures.gap_which import across, regressor_unit, residual_unit, scaled
from app.figures.gap_words import edge, label, percent, quantity, share
from app.figures.plot import Band, Curve, Plot, plot, tick_text
from app.figures.units import significant

Result = Mapping[str, Any]
Evidence = Mapping[str, Any]

LEVELS = (1.1, 1.5, 2.5, 4.0, 8.0, 16.0)
"""Excess over the floor at which the colour steps up: classes heat-0 to heat-6."""
LEAST_POWER = 15  # smaller p say no more


def level(excess: float | None) -> int:
    """The colour class of a gap over its floor."""
    return 0 if excess is None else sum(excess >= edge for edge in LEVELS)


def over(value: float | None, floor: float | None) -> float | None:
    """How many times the floor."""
    return None if value is None or not floor else value / floor


# ---- where


@dataclass(frozen=True)
class Link:
    """One link of the chain: its excess over the floor before and after."""

    name: str
    streams: str
    before: str
    after: str
    floor: str
    p_value: str
    level: int
    left: int
    guilty: bool


@dataclass(frozen=True)
class Cell:
    """A cell of the heat map."""

    text: str
    level: int
    significant: bool
    hint: str


@dataclass(frozen=True)
class Heat:
    """Streams by regimes."""

    regimes: tuple[str, ...]
    rows: tuple[tuple[str, str, tuple[Cell | None, ...]], ...]  # stream, its name, cells


@dataclass(frozen=True)
class Spot:
    """A line of `where`."""

    text: str
    share: str
    p_value: str
    intervals: tuple[tuple[float, float], ...]


def links(result: Result, evidence: Evidence) -> list[Link]:
    """The chain, in its order."""
    chain = evidence.get("links") or ()
    guilty = result.get("link")
    if guilty not in {one["link"] for one in chain} and result.get("unexplained"):
        left = result["unexplained"]["stream"]
        guilty = next((one["link"] for one in chain if left in one["streams"]), None)
    return [
        Link(
            one["link"],
            ", ".join(stream_name(s) for s in one["streams"]),
            times(one["before"]),
            times(one["after"]),
            times(one["floor"]),
            p_text(one["p_value"]),
            level(over(one["before"], one["floor"])),
            level(over(one["after"], one["floor"])),
            one["link"] == guilty,
        )
        for one in chain
    ]


def heat(evidence: Evidence) -> Heat:
    """The heat map; streams and regimes in the order in which they first come."""
    cells = [cell for cell in evidence.get("cells") or () if cell["rows"]]
    regimes = tuple(dict.fromkeys(c["regime"] for c in cells))
    streams = tuple(dict.fromkeys(c["stream"] for c in cells))
    by = {(c["stream"], c["regime"]): c for c in cells}
    rows = tuple((s, stream_name(s), tuple(_cell(by.get((s, r))) for r in regimes)) for s in streams)
    return Heat(regimes, rows)


def _cell(cell: Mapping[str, Any] | None) -> Cell | None:
    if cell is None:
        return None
    excess = over(cell["before"], cell["floor"])
    hint = (
        f"{stream_name(cell['stream'])}, {cell['regime']}: {times(cell['before'])} times the noise before, "
        f"{times(cell['after'])} after, floor {times(cell['floor'])}; {cell['rows']:,} readings, "
        f"p {p_text(cell['p_value'])}{', significant' if cell['significant'] else ''}"
    )
    return Cell(times(excess) if excess is not None else "–", level(excess), bool(cell["significant"]), hint)


def spots(result: Result) -> list[Spot]:
    """Where, in words, the strongest first."""
    out = []
    for one in result["where"][:8]:
        place = one.get("place")
        at = f", within {significant(place['radius'], 2)} m of x {place['x']:.1f}, y {place['y']:.1f}" if place else ""
        spans = tuple((float(a), float(b)) for a, b in one.get("intervals") or ())
        while_ = "" if place and one["regime"] == "place" else f", {one['regime']}"
        said = f"{stream_name(one['stream'])}{while_}{at}"
        out.append(Spot(said, share(one["share"]), p_text(one["p_value"]), spans))
    return out


def p_text(p: float | None) -> str:
    """0.31, 0.002, < 10⁻⁹."""
    if p is None:
        return "–"
    if p >= 0.001:
        return f"{p:.2g}"
    power = max(math.floor(math.log10(p)) if p > 0 else -LEAST_POWER, -LEAST_POWER)
    raised = str(power).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
    return f"{'< ' if power == -LEAST_POWER else ''}10{raised}"


# ---- how far


@dataclass(frozen=True)
class FarRow:
    """A stream's gap before, after and at the floor, with their places on a common axis [px]."""

    stream: str
    name: str
    y: float
    before: str
    after: str
    floor: str
    x_before: float
    x_after: float
    x_floor: float


@dataclass(frozen=True)
class Far:
    """Dumbbells on a logarithmic axis."""

    rows: tuple[FarRow, ...]
    width: float
    height: float
    ticks: tuple[tuple[float, str], ...]


def far(result: Result, width: float = 560.0) -> Far:
    """In total first, then the streams, the loudest first."""
    gap = result["gap"]
    streams = sorted(gap["by_stream"].items(), key=lambda item: -(over(item[1]["before"], item[1]["floor"]) or 0.0))
    rows = [("", "all streams", gap), *((s, stream_name(s), g) for s, g in streams)]
    rows = [r for r in rows if all(isinstance(r[2][k], int | float) for k in ("before", "after", "floor"))]
    values = [max(r[2][k], 1e-3) for r in rows for k in ("before", "after", "floor")]
    lo, hi = math.log10(min([0.8, *values]) * 0.85), math.log10(max([2.0, *values]) * 1.15)

    def at(value: float) -> float:
        return round((math.log10(max(value, 1e-3)) - lo) / (hi - lo) * width, 1)

    marks = [k * 10.0**p for p in range(-3, 5) for k in (1, 2, 5) if lo <= math.log10(k * 10.0**p) <= hi]
    if len(marks) > 8:
        marks = [m for m in marks if f"{m:e}".startswith("1")]
    return Far(
        tuple(
            FarRow(
                s, name, 14.0 + 24.0 * i, times(g["before"]), times(g["after"]), times(g["floor"]),
                at(g["before"]), at(g["after"]), at(g["floor"]),
            )
            for i, (s, name, g) in enumerate(rows)
        ),
        width,
        24.0 * len(rows) + 26.0,
        tuple((at(m), tick_text(m)) for m in marks),
    )  # fmt: skip


def shrunk(result: Result) -> str:
    """How much of the gap goes, with its interval."""
    gap = result["gap"]
    if gap["shrink"] is None or not joint(result):
        return ""
    ci = gap.get("shrink_ci")
    between = f" (90 %: {_near_all(ci[0])} to {_near_all(ci[1])})" if ci and None not in ci else ""
    return f"{_near_all(gap['shrink'])}{between}"


def _near_all(share_: float) -> str:
    """98.7 %: what is left of the whole must show."""
    return f"{100.0 * share_:.1f} %" if 0.9 < share_ < 1.0 else percent(share_, 3)


# ---- drawn on the server for the report that needs nothing else


def path_plot(run: Mapping[str, Any]) -> Plot | None:
    """The path in pieces by the gap there."""
    path = finest(run)
    if path is None:
        return None
    levels = [level(g) for g in path["gap"]]
    curves, first = [], 0
    for i in range(1, len(levels)):
        if levels[i] != levels[first] or i == len(levels) - 1:
            rows = slice(first, i + 1)
            curves.append(Curve("", f"g-path heat-{levels[first]}", path["x"][rows], path["y"][rows]))
            first = i
    return plot(curves, x_label="x, m", y_label="y, m", width=440, height=340, equal=True)


def finest(run: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """t, x, y and gap of the path; where the whole drive is known at more points, on those."""
    path, free = run.get("path"), run.get("free_run")
    if not path or len(path["t"]) < 2:
        return None
    if not free or len(free["t"]) <= len(path["t"]):
        return {name: path[name] for name in ("t", "x", "y", "gap")}
    last = len(path["t"]) - 1
    gaps = [path["gap"][min(max(bisect_left(path["t"], t), 0), last)] for t in free["t"]]
    return {"t": free["t"], "x": free["real"]["x"], "y": free["real"]["y"], "gap": gaps}


def timeline_plot(run: Mapping[str, Any]) -> Plot | None:
    """Root mean square over streams, before and after, by blocks of time."""
    line_ = run.get("timeline")
    if not line_ or len(line_["t"]) < 2:
        return None
    curves = [
        Curve("simulated", "g-nominal", line_["t"], rms(line_["before"], len(line_["t"]))),
        Curve("patched", "g-patched", line_["t"], rms(line_["after"], len(line_["t"]))),
    ]
    return plot(curves, x_label="time, s", y_label="× noise", width=720, height=170, from_zero=True)


def rms(by_stream: Mapping[str, Sequence[float | None]], n: int) -> list[float | None]:
    """Root mean square over streams in each block; None where no stream has a reading."""
    out: list[float | None] = []
    for k in range(n):
        known = [v for column in by_stream.values() if (v := column[k]) is not None]
        out.append(math.sqrt(sum(v * v for v in known) / len(known)) if known else None)
    return out


@dataclass(frozen=True)
class Shape:
    """A curve of what is left."""

    title: str
    share: str
    drawn: Plot


def shapes(evidence: Evidence) -> list[Shape]:
    """What is left by each regressor, with its band."""
    rest = evidence.get("unexplained") or {}
    out = []
    for one in rest.get("shapes") or ():
        x = scaled(one["x"], regressor_unit(one["regressor"]))
        unit = residual_unit(rest["stream"])
        y, lo, hi = (scaled(one[name], unit) for name in ("y", "lo", "hi"))
        drawn = plot(
            (Curve("what is left", "g-real", x, y),), (Band("g-band", x, lo, hi),), x_label=across(one["regressor"]),
            y_label=f"residual, {edge(unit)[1]}", width=360, height=180,
        )  # fmt: skip
        out.append(Shape(f"by {regressor_name(one['regressor'])}", share(one["share"]), drawn))
    return out


def left_facts(evidence: Evidence) -> list[str]:
    """Period, onset and place of what is left, in words."""
    rest = evidence.get("unexplained") or {}
    out = []
    if period := rest.get("period"):
        out.append(
            f"It repeats every {quantity(period['value'], period['unit'])} of {regressor_name(period['regressor'])}."
        )
    if onset := rest.get("onset"):
        out.append(f"It begins at {significant(onset['t'], 4)} ± {significant(onset['sd'], 2)} s.")
    if place := rest.get("place"):
        at = f"x {significant(place['x'])} m, y {significant(place['y'])} m"
        out.append(f"It stands within {significant(place['radius'], 2)} m of {at}.")
    return out


def nearest(evidence: Evidence) -> list[Line]:
    """Listed effects close to what is left."""
    rest = evidence.get("unexplained") or {}
    return [
        Line(o["effect"], label(o["effect"]), plain(o["reason"]), share(o["takes"])) for o in rest.get("nearest") or ()
    ]


def drive_plot(evidence: Evidence) -> Plot | None:
    """The next manoeuvre from above."""
    drive = evidence.get("next")
    if not drive or len(drive["path"]["x"]) < 2:
        return None
    return plot(
        (Curve("", "g-real", drive["path"]["x"], drive["path"]["y"]),),
        x_label="x, m", y_label="y, m", width=320, height=260, equal=True,
    )  # fmt: skip
