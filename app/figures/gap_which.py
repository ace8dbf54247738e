"""Which effects: their probabilities, sizes, signatures, and why others are not. From gap/1 and gap-evidence/1."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from app.figures.gap_sentence import JOINT, joint, parts_of, regressor_name, stream_name
from app.figures.gap_words import as_set, difference, digits_of, edge, label, quantity, share
from app.figures.plot import Band, Curve, Plot, plot
from core.effects import EFFECTS

Result = Mapping[str, Any]
Evidence = Mapping[str, Any]

Z90 = 1.645
BAR = 200.0  # px of probability 1


@dataclass(frozen=True)
class Chance:
    """A bar of probability; `bracket` numbers the set of effects that cannot be told apart."""

    effect: str
    label: str
    probability: float
    text: str
    width: float
    joint: bool
    bracket: int | None


@dataclass(frozen=True)
class Size:
    """A parameter with its 90 % interval."""

    name: str
    value: str
    interval: str
    si: str


@dataclass(frozen=True)
class Found:
    """One cause."""

    effect: str
    label: str
    difference: str
    equation: str
    setting: str
    probability: str
    part: str
    share: str
    sizes: tuple[Size, ...]
    confusable: tuple[str, ...]
    joint: bool
    signature: Plot | None
    signature_of: str


def chances(result: Result, evidence: Evidence) -> list[Chance]:
    """Every effect with a probability over 0.01, "none" and "unknown" too; sets stand together."""
    known = {cause["effect"]: cause["probability"] or 0.0 for cause in result["causes"]}
    known |= {k: v for k, v in (result.get("probabilities") or {}).items() if v}
    brackets = {effect: k for k, group in enumerate(evidence.get("sets") or ()) for effect in group}
    best = {k: max((known.get(e, 0.0) for e in group), default=0.0) for k, group in enumerate(evidence["sets"])}
    shown = [effect for effect, p in known.items() if p > 0.01]

    def rank(effect: str) -> tuple[float, int, float]:
        group = brackets.get(effect)
        lead = known[effect] if group is None else max(best[group], known[effect])
        return -round(lead, 2), -1 if group is None else group, -round(known[effect], 2)  # then by share, as they come

    return [
        Chance(
            effect,
            {"none": "no gap at all", "unknown": "something in no list"}.get(effect, label(effect)),
            known[effect],
            f"{known[effect]:.2f}",
            round(BAR * known[effect], 1),
            known[effect] > JOINT,
            brackets.get(effect),
        )
        for effect in sorted(shown, key=rank)
    ]


def found(result: Result, evidence: Evidence) -> list[Found]:
    """The causes with their sizes and signatures."""
    of_gap = {cause["effect"]: part for cause, part in parts_of(joint(result), result["gap"])}
    return [_found(cause, of_gap.get(cause["effect"]), evidence) for cause in result["causes"]]


def _found(cause: Mapping[str, Any], part: float | None, evidence: Evidence) -> Found:
    effect = cause["effect"]
    signature = (evidence.get("signatures") or {}).get(effect)
    return Found(
        effect,
        label(effect),
        difference(effect, cause["parameters"]),
        EFFECTS[effect].equation if effect in EFFECTS else "",
        as_set(effect, cause["parameters"]),
        f"{cause['probability']:.2f}",
        share(part),
        share(cause["share"]),
        sizes(effect, cause["parameters"]),
        tuple(label(name) for name in cause.get("confusable_with") or ()),
        (cause["probability"] or 0.0) > JOINT,
        signature_plot(signature) if signature else None,
        f"{stream_name(signature['stream'])} by {regressor_name(signature['regressor'])}" if signature else "",
    )


def sizes(effect: str, parameters: Mapping[str, Mapping[str, Any]]) -> tuple[Size, ...]:
    """Parameters with their intervals; a name has none."""
    units = {p.name: p.unit for p in EFFECTS[effect].parameters} if effect in EFFECTS else {}
    out = []
    for name, entry in parameters.items():
        value, std, unit = entry.get("value"), entry.get("std"), units.get(name, "")
        interval, digits = "", 3
        if std is not None and isinstance(value, int | float):
            digits = digits_of(value, std)
            lo, hi = value - Z90 * std, value + Z90 * std
            interval = between(*(quantity(v, unit, digits_of(v, std)) for v in (lo, hi)))
        si = f"{value} {unit}".strip() + (f", sd {std:.3g}" if std is not None else "")
        out.append(Size(name, quantity(value, unit, digits), interval, si))
    return tuple(out)


def between(lo: str, hi: str) -> str:
    """`1.2 to 1.8 m`: a unit that both have is said once."""
    head, gap, unit = lo.partition(" ")
    return f"{head} to {hi}" if gap and hi.partition(" ")[2] == unit else f"{lo} to {hi}"


def signature_plot(one: Mapping[str, Any], width: float = 360.0, height: float = 170.0) -> Plot:
    """What the effect does to its stream: residual with two deviations, the fit, and what is left."""
    unit = residual_unit(one["stream"])
    shown = {name: scaled(one[name], unit) for name in ("residual", "sd", "fitted", "after")}
    lo, hi = around(shown["residual"], shown["sd"])
    x = scaled(one["x"], regressor_unit(one["regressor"]))
    curves = (
        Curve("without it", "g-real", x, shown["residual"], dots=True),
        Curve("the effect", "g-patched", x, shown["fitted"]),
        Curve("what is left", "g-left", x, shown["after"]),
    )
    return plot(
        curves, (Band("g-band", x, lo, hi),), x_label=across(one["regressor"]),
        y_label=f"residual, {edge(unit)[1]}", width=width, height=height,
    )  # fmt: skip


def scaled(values: Sequence[float | None], unit: str) -> list[float | None]:
    """SI values in the unit that people read."""
    factor = edge(unit)[0]
    return [None if v is None else factor * v for v in values]


def around(middle: Sequence[float | None], sd: Sequence[float | None]) -> tuple[list[float | None], list[float | None]]:
    """Two deviations below and above."""
    rows = [(None, None) if m is None or s is None else (m - 2 * s, m + 2 * s) for m, s in zip(middle, sd, strict=True)]
    return [row[0] for row in rows], [row[1] for row in rows]


def regressor_unit(regressor: str) -> str:
    """SI unit of what a residual is set against."""
    return REGRESSORS.get(regressor, "")


def residual_unit(stream: str) -> str:
    """SI unit of a residual in curves: of encoders and of the reference it is the rate at which it builds up."""
    if stream.startswith("imu."):
        return "rad/s" if stream == "imu.gz" else "m/s²"
    plain = "rad" if stream.startswith("wheels.") or stream.endswith(".theta") else "m"
    return f"{plain}/s" if stream.startswith(("wheels.", "truth.")) else plain


def across(regressor: str) -> str:
    """The label of its axis."""
    unit = edge(regressor_unit(regressor))[1]
    return regressor_name(regressor) + (f", {unit}" if unit else "")


REGRESSORS = {
    "speed": "m/s", "turn rate": "rad/s", "left rim speed": "m/s", "right rim speed": "m/s", "acceleration": "m/s²",
    "turn acceleration": "rad/s²", "speed times turn rate": "m/s²", "time": "s", "temperature": "K", "heading": "rad",
    "x": "m", "y": "m", "velocity along x": "m/s", "velocity along y": "m/s", "left wheel angle": "rad",
    "right wheel angle": "rad",
}  # fmt: skip
"""What residuals are set against, with SI units."""
