"""Why other effects are not the cause, what runs could not show, what is too small: the lists of a report, in words."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from app.figures.gap_sentence import STREAMS, stream_name
from app.figures.gap_words import as_set, difference, label, quantity
from core.effects import EFFECTS

Result = Mapping[str, Any]
Evidence = Mapping[str, Any]

NOTHING = "adds nothing: with it the fit gets no better than by chance"
LITTLE = "fits a little of what is left, not enough to be a cause"
BLIND = "at no size: nothing in these runs shows it"
PLURAL = {
    NOTHING: "add nothing, with none of them the fit gets better than by chance",
    LITTLE: "each fit a little of what is left, not enough to be a cause",
    BLIND: "at no size, nothing in these runs shows them",
}
ALIKE = 3  # more effects than this that are told the same share one line
_NOTHING = re.compile(r"adds nothing beside the causes \(drop of deviance (\d+); chance gives up to (\d+)\)")
_INSTEAD = re.compile(r"refitted, it takes ([\d.]+)% of what (.+) takes")
_SHAPE = re.compile(r"^(.*), like (.+); that shape takes (\d+)% of what is left there \(drop of deviance \d+\)\.?$")
_NAME = re.compile(r"\b[a-z]+(?:[._][a-z]+)+\b")
SYMBOLS = {"v": "speed", "w": "turn rate", "a": "acceleration", "t": "time", "theta": "heading"}


@dataclass(frozen=True)
class Line:
    """An effect with a word on it."""

    effect: str
    label: str
    text: str
    number: str = ""


def plain(text: str) -> str:
    """A remark of the diagnosis with effects and streams by their names, and percent apart from its number."""

    def named(match: re.Match[str]) -> str:
        name = match.group()
        return label(name) if name in EFFECTS else stream_name(name) if name in STREAMS else name

    text = text.replace("of what the shape takes, its parameters fitted", "of that shape, fitted to it")
    text = text.replace("refitted, they still differ by", "even refitted, they would differ there by")
    return re.sub(r"(\d)%", "\\1 %", _NAME.sub(named, text))


def described(text: str) -> str:
    """What is left, a whole sentence: `The gyro is off, like w³ (w: turn rate); that shape takes 98 % of it.`"""
    if match := _SHAPE.match(text):
        part, shape, share = match.groups()
        used = [f"{s}: {SYMBOLS[s]}" for s in re.findall(r"\b[a-z]+", shape) if s in SYMBOLS]
        where = f" ({', '.join(dict.fromkeys(used))})" if used else ""
        the = "the " if part.split(" ")[0] in STREAMS else ""
        text = f"{the}{part}, like {shape}{where}; that shape takes {share}% of it"
    told = plain(text).rstrip(".")
    return f"{told[:1].upper()}{told[1:]}." if told else ""


def considered(result: Result, evidence: Evidence) -> list[Line]:
    """What was explained away: first what would do in a cause's place, the nearest on top, then what adds nothing."""
    rows = evidence.get("considered") or result.get("rejected") or ()
    rivals: list[tuple[float, Line]] = []
    others: list[Line] = []
    for one in rows:
        effect, reason = one["effect"], one["reason"]
        if match := _INSTEAD.fullmatch(reason):
            share, of = float(match.group(1)), match.group(2)
            of = "the cause that is in no list" if of.startswith("a shape") else label(of)
            told = f"explains so much of what {of} explains, fitted in its place"
            rivals.append((share, Line(effect, label(effect), told, f"{share:.0f} %")))
        else:
            others.append(Line(effect, label(effect), _added(reason)))
    ranked = [line for _, line in sorted(rivals, key=lambda pair: -pair[0])]
    return [*ranked, *_together(others)]


def _added(reason: str) -> str:
    match = _NOTHING.fullmatch(reason)
    if match is None:
        return plain(reason)
    if int(match.group(1)) <= int(match.group(2)):
        return NOTHING
    return LITTLE


def _together(lines: Sequence[Line]) -> list[Line]:
    """Lines that say the same become one, so that the others can be found."""
    by_text: dict[str, list[Line]] = {}
    for line in lines:
        by_text.setdefault(line.text, []).append(line)
    out: list[Line] = []
    for text, same in by_text.items():
        names = ", ".join(line.label for line in same)
        out += same if len(same) <= ALIKE else [Line("", f"{len(same)} effects", f"{PLURAL.get(text, text)}: {names}")]
    return out


def cannot_see(result: Result, evidence: Evidence) -> list[Line]:
    """What these runs could not have shown, by effect: from which size on they could, or that they could at none."""
    by_effect: dict[str, list[Mapping[str, Any]]] = {}
    for one in evidence.get("cannot_see") or result.get("unseen") or ():
        by_effect.setdefault(one["effect"], []).append(one)
    sized, never = [], []
    for effect, entries in by_effect.items():
        seen = [one for one in entries if _within_reach(effect, one)]
        told = [_from(effect, one) for one in seen]
        blind = [one["parameter"] for one in entries if one not in seen]
        if told:
            more = [f"{', '.join(blind)}: at no size"] if blind else []
            sized.append(Line(effect, label(effect), "; ".join([*told, *more])))
        else:
            of = len([p for p in EFFECTS[effect].parameters if p.small is not None]) if effect in EFFECTS else 0
            which = f" ({', '.join(blind)})" if len(blind) < of else ""
            never.append(Line(effect, f"{label(effect)}{which}", BLIND))
    return [*sized, *_together(never)]


def _within_reach(effect: str, one: Mapping[str, Any]) -> bool:
    """Whether there is a size that shows, and one that a robot can have."""
    size, parameter = one.get("visible_from"), _parameter(effect, one["parameter"])
    return size is not None and (parameter is None or size <= max(abs(parameter.low), abs(parameter.high)))


def _from(effect: str, one: Mapping[str, Any]) -> str:
    unit = one.get("unit")
    if unit is None:
        unit = unit_of(effect, one["parameter"])
    return f"{one['parameter']}: from {quantity(one['visible_from'], unit)} on"


def unit_of(effect: str, parameter: str) -> str:
    """SI unit of an effect's parameter."""
    known = _parameter(effect, parameter)
    return known.unit if known else ""


def _parameter(effect: str, name: str) -> Any | None:
    known: Iterable[Any] = EFFECTS[effect].parameters if effect in EFFECTS else ()
    return next((p for p in known if p.name == name), None)


def immaterial(result: Result) -> list[Line]:
    """What is real but below its tolerance: how robot and simulator differ, and the setting."""
    return [
        Line(one["effect"], label(one["effect"]), difference(one["effect"], one["parameters"]),
             as_set(one["effect"], one["parameters"]))
        for one in result.get("immaterial") or ()
    ]  # fmt: skip
