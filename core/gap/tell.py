"""The evidence of a diagnosis, gathered: every figure of the report from what the search and the replays hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from core.gap.candidates import Reach
from core.gap.described import described
from core.gap.energy import energies
from core.gap.evidence import Drive, Evidence, RunEvidence
from core.gap.explain import Search
from core.gap.floor import Floor, stated
from core.gap.judged import Judged
from core.gap.links import links, noise_floor
from core.gap.motion import motion
from core.gap.paths import run_evidence
from core.gap.rejected import considered
from core.gap.shrink import Shown
from core.gap.signatures import signatures
from core.gap.types import Cause, NextExperiment
from core.gap.visible import cannot_see
from core.gap.where import Findings, Ground
from core.gap.world import World
from core.robot import EffectSet

TOGETHER = 0.02
"""A rival of at least this probability stands in one set with the cause that it could replace."""


@dataclass(frozen=True)
class Told:
    """What was concluded, as far as the evidence needs it. model: all effects that were fitted."""

    model: EffectSet
    judged: Judged
    causes: Sequence[Cause]
    reach: Reach
    advised: tuple[NextExperiment, Drive] | None
    seed: int


def evidence_of(
    found: Search, told: Told, ground: Ground, shown: Sequence[Shown], looked: Findings,
    kept: Sequence[World], kept_shown: Sequence[Shown],
) -> Evidence:  # fmt: skip
    """Everything that a report shows."""
    floor = found.floor
    screens = [one.screen for one in found.links if one.screen is not None]
    return Evidence(
        noise_floor=noise_floor(floor, stated(ground.worlds[0].run)),
        links=links(found),
        cells=looked.cells,
        runs=_runs(told, ground, kept, kept_shown, floor),
        signatures=signatures(ground, shown, told.judged.causing, floor),
        sets=sets_of(told.causes),
        considered=considered(found, list(told.judged.causing), told.judged.chances),
        unexplained=None
        if told.judged.unexplained is None
        else described(ground, shown, told.judged.unexplained, found, floor, told.seed),
        next=None if told.advised is None else told.advised[1],
        cannot_see=cannot_see(screens, told.model, ground.worlds[0].channels, told.reach, floor),
    )


def _runs(
    told: Told, ground: Ground, kept: Sequence[World], kept_shown: Sequence[Shown], floor: Floor
) -> tuple[RunEvidence, ...]:
    """Curves of the fitted runs, then of those kept apart."""
    out = [
        run_evidence(k, world, moved, energy, told.model, False)
        for k, (world, moved, energy) in enumerate(zip(ground.worlds, ground.moved, ground.energy, strict=True))
    ]
    for world, one in zip(kept, kept_shown, strict=True):
        energy = energies(world, one.bare, one.base, one.full, floor)
        out.append(run_evidence(len(out), world, motion(world), energy, told.model, True))
    return tuple(out)


def sets_of(causes: Sequence[Cause]) -> tuple[tuple[str, ...], ...]:
    """Causes with the rivals that these runs do not tell from them."""
    likely = {one.effect for one in causes if one.probability > TOGETHER}
    out = [
        (one.effect, *(name for name in one.confusable_with if name in likely or name == "missed_ticks"))
        for one in causes
        if one.probability > 0.5
    ]
    return tuple(group for group in out if len(group) > 1)
