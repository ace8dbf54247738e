"""All figures of one diagnosis together, as both reports draw them: the page and the HTML file that needs nothing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from app.figures import gap, gap_free, gap_reasons, gap_which
from app.figures.gap_sentence import above_floor, joint, regressor_name, stream_name, times
from app.figures.gap_words import label, quantity
from app.figures.plot import Plot
from app.figures.units import significant

NOTHING: Mapping[str, Any] = {
    **{key: [] for key in ("noise_floor", "links", "cells", "runs", "sets", "considered", "cannot_see")},
    "signatures": {},
    "unexplained": None,
    "next": None,
}


@dataclass(frozen=True)
class RunFigures:
    """One run's path by the gap, timeline, and the whole drive overlaid; None where there is none."""

    name: str
    held_out: bool
    path: Plot | None
    timeline: Plot | None
    overlay: Plot | None
    driven: str  # how far simulated and patched paths end from the real one


@dataclass(frozen=True)
class Rivals:
    """A pair and the chance to tell it apart, now and after the next drive."""

    pair: str
    now: str
    after: str


@dataclass(frozen=True)
class Noise:
    """A stream's noise as found, and how many times what is stated."""

    name: str
    sigma: str
    ratio: str


@dataclass(frozen=True)
class Parts:
    """What the templates draw, in the order of the page."""

    links: list[gap.Link]
    heat: gap.Heat
    spots: list[gap.Spot]
    noise: list[Noise]
    chances: list[gap_which.Chance]
    found: list[gap_which.Found]
    considered: list[gap_reasons.Line]
    weighed: int  # effects that are in `considered`, those that share a line too
    cannot_see: list[gap_reasons.Line]
    immaterial: list[gap_reasons.Line]
    far: gap.Far
    shrunk: str
    unexplained: str
    shapes: list[gap.Shape]
    left_facts: list[str]
    nearest: list[gap_reasons.Line]
    drive: Plot | None
    next: Mapping[str, Any] | None
    why: str
    rivals: list[Rivals]


def parts(result: Mapping[str, Any], evidence: Mapping[str, Any] | None) -> Parts:
    """Every figure but those of single runs; `evidence` may lack anything."""
    known = {**NOTHING, **(evidence or {})}
    drive = known["next"]
    return Parts(
        links=gap.links(result, known),
        heat=gap.heat(known),
        spots=gap.spots(result),
        noise=[_noise(one) for one in known["noise_floor"]],
        chances=gap_which.chances(result, known),
        found=gap_which.found(result, known),
        considered=gap_reasons.considered(result, known),
        weighed=len(known["considered"] or result.get("rejected") or ()),
        cannot_see=gap_reasons.cannot_see(result, known),
        immaterial=gap_reasons.immaterial(result),
        far=gap.far(result),
        shrunk=gap.shrunk(result),
        unexplained=_unexplained(result),
        shapes=gap.shapes(known),
        left_facts=gap.left_facts(known),
        nearest=gap.nearest(known),
        drive=gap.drive_plot(known),
        next=drive or result.get("next_experiment"),
        why=gap_reasons.plain((drive or result.get("next_experiment") or {}).get("reason", "")),
        rivals=[
            Rivals(" or ".join(map(label, r["pair"])), f"{r['chance_now']:.2f}", f"{r['chance_after']:.2f}")
            for r in (drive or {}).get("rivals") or ()
        ],
    )


def runs(evidence: Mapping[str, Any] | None) -> list[RunFigures]:
    """The single runs' figures, drawn on the server."""
    return [
        RunFigures(
            run["name"], bool(run["held_out"]), gap.path_plot(run), gap.timeline_plot(run), gap_free.overlay_plot(run),
            gap_free.told(run),
        )
        for run in (evidence or {}).get("runs") or ()
    ]  # fmt: skip


def _unexplained(result: Mapping[str, Any]) -> str:
    rest, left = result.get("unexplained"), result["gap"]
    if rest:
        names = " and ".join(dict.fromkeys(regressor_name(name) for name in rest["depends_on"]))
        by = f", which depends on {names}" if names else ""
        told = gap_reasons.described(rest.get("description") or "")
        return f"No listed effect explains what is left in the {stream_name(rest['stream'])}{by}. {told}".rstrip()
    if joint(result) and above_floor(left):
        return (
            f"With the effects added the gap is still {times(left['after'])} times the noise, over a floor of "
            f"{times(left['floor'])}. What is left has no shape that these runs show: neither a listed effect nor a "
            "curve over speed, turning, time, place or temperature takes it."
        )
    return ""


def _noise(one: Mapping[str, Any]) -> Noise:
    ratio, sd = one.get("ratio"), one.get("ratio_sd")
    told = "not stated" if ratio is None else f"{significant(ratio)}{f' ± {significant(sd, 2)}' if sd else ''} times"
    return Noise(stream_name(one["stream"]), quantity(one["sigma"], one["unit"], hourly=False), told)
