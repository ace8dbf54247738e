"""Effects that are no cause, and why; parameters that no stream of these runs shows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from core.effects import EFFECTS
from core.gap.candidates import Reach, tolerance
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
            best = dict(step.gains).get(step.action[4:], 0.0)
            for name, gain in step.gains:
                if name not in one.fit.model:
                    out[name] = (
                        f"refitted, it takes {max(gain, 0.0) / max(best, 1.0):.1%} of what {step.action[4:]} takes"
                    )
    return tuple(Rejected(name, reason) for name, reason in out.items() if name not in material)


def unseen(found: Search, reach: Reach) -> tuple[Unseen, ...]:
    """Parameters whose size at twice the search's threshold exceeds five tolerances."""
    out = []
    for effect in EFFECTS.values():
        if not any(set(effect.streams) & set(one.fit.normal.channels) for one in found.links):
            for parameter in effect.parameters:
                small = tolerance(effect.id, parameter.name, reach)
                out += [Unseen(effect.id, parameter.name, None)] if small is not None else []
    return tuple(out)
