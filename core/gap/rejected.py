"""Effects that are no cause, and why; parameters that no stream of these runs shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from core.effects import EFFECTS
from core.gap.candidates import Reach, tolerance
from core.gap.evidence import Considered
from core.gap.explain import Search
from core.gap.selection import WORTH
from core.gap.types import Rejected, Unseen


def rejected(found: Search, material: Sequence[str], chances: Mapping[str, float]) -> tuple[Rejected, ...]:
    out: dict[str, str] = {}
    for one in found.links:
        for name, gain in one.gains.items():
            if name not in one.fit.model and chances.get(name, 0.0) < 0.5:
                out[name] = (
                    f"adds nothing beside the causes (drop of deviance {gain:.0f}; chance gives up to {WORTH:.0f})"
                )
        for step in one.steps:
            strange = step.action.startswith("unknown")
            what = "a shape of no listed effect" if strange else step.action[4:]
            best = one.unknown[1] if strange and one.unknown else dict(step.gains).get(what, 0.0)
            for name, gain in step.gains:
                if name not in one.fit.model:
                    out[name] = (
                        f"refitted, it takes {min(max(gain, 0.0) / max(best, 1.0), 1.0):.1%} of what {what} takes"
                    )
    return tuple(Rejected(name, reason) for name, reason in out.items() if name not in material)


def considered(found: Search, material: Sequence[str], chances: Mapping[str, float]) -> tuple[Considered, ...]:
    """Effects that were weighed and are no cause, the nearest first."""
    why = {one.effect: one.reason for one in rejected(found, material, chances)}
    out: dict[str, Considered] = {}
    for link in found.links:
        best = max([*link.gains.values(), *link.earned.values()], default=0.0)
        for name, gain in link.gains.items():
            if name in why:
                out[name] = Considered(name, chances.get(name, 0.0), gain, _part(gain, best), why[name])
        for step in link.steps:
            gains = dict(step.gains)
            best = max(gains.get(step.action[4:], 0.0), *gains.values(), 1.0) if gains else 1.0
            for name, gain in gains.items():
                if name in why and (name not in out or gain > out[name].drop):
                    out[name] = Considered(name, chances.get(name, 0.0), gain, _part(gain, best), why[name])
    return tuple(sorted(out.values(), key=lambda one: -one.drop))


def _part(gain: float, best: float) -> float:
    return min(max(gain, 0.0) / best, 1.0) if best > 0.0 else 0.0


def unseen(found: Search, reach: Reach) -> tuple[Unseen, ...]:
    """Parameters whose size at twice the search's threshold exceeds five tolerances."""
    out = []
    for effect in EFFECTS.values():
        if not any(set(effect.streams) & set(one.fit.normal.channels) for one in found.links):
            for parameter in effect.parameters:
                small = tolerance(effect.id, parameter.name, reach)
                out += [Unseen(effect.id, parameter.name, None)] if small is not None else []
    return tuple(out)
