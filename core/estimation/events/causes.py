"""One thing that happens is seen by several detectors: which of them tells the cause, and which only its traces."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from core.estimation.events.disturbances import BOUNCE, COLLISION, DEAD_ENCODER, PUSHED, SLIP, Disturbance

HARD = 7.0  # m/s^2: no motor brakes or starts like this; a softer blow needs the wheels as witness
GRIP = 10.0  # m/s^2: what tyres can do at most
BEFORE, AFTER = 0.2, 0.5  # s: a contradiction from so early to so late belongs to the blow,
SHORT = 1.0  # s: unless it goes on for longer than that


def by_cause(found: Sequence[Disturbance]) -> tuple[Disturbance, ...]:
    """By onset; blows that are a bounce's or a slip's own trace are left out, slips that a blow made get its name."""
    incidents = [d for d in found if d.kind not in (COLLISION, BOUNCE)]
    blows = _blows([d for d in found if d.kind in (COLLISION, BOUNCE)], incidents)
    dead = {d.t0 for d in incidents if d.kind == DEAD_ENCODER}
    named = [_named(d, blows, dead) for d in incidents]
    return tuple(sorted((*named, *blows), key=lambda d: (d.t0, d.alarm)))


def _near(a: Disturbance, b: Disturbance, before: float, after: float) -> bool:
    return b.t0 - before <= a.t0 <= b.t1 + after


def _blows(blows: list[Disturbance], incidents: list[Disturbance]) -> list[Disturbance]:
    kept = []
    for blow in blows:
        rivals = [b for b in blows if b is not blow and b.kind != blow.kind and _near(b, blow, 0.15, 0.1)]
        if any(_stronger(rival, blow) for rival in rivals):
            continue
        if blow.kind == BOUNCE or blow.peak >= HARD:
            witness: Disturbance | None = blow
        else:
            witness = next((d for d in incidents if d.kind != PUSHED and _near(d, blow, BEFORE, AFTER)), None)
        if witness is None or any(_goes_on(d, blow) for d in incidents):
            continue
        kept.append(dataclasses.replace(blow, alarm=max(blow.alarm, witness.alarm)))
    return kept


def _stronger(rival: Disturbance, blow: Disturbance) -> bool:
    """A blow upwards counts where it shakes at least 0.7 as hard as the one in the plane."""
    if rival.kind == BOUNCE:
        return rival.peak >= 0.7 * blow.peak
    return rival.peak > blow.peak / 0.7


def _goes_on(d: Disturbance, blow: Disturbance) -> bool:
    """A contradiction that began before: the blow is what a push does, or grip coming back."""
    if d.kind not in (SLIP, PUSHED, DEAD_ENCODER) or not d.t0 - BEFORE < blow.t0 <= d.t1 + BEFORE:
        return False
    if d.t0 + BEFORE < blow.t0:
        return True
    if blow.kind == BOUNCE or d.kind == PUSHED:
        return False
    # Wheels that ran away from the ground first, the way of the blow: what followed is tyres dragging the body along.
    heals = d.t0 < blow.t0 and d.along * blow.along > 0.0 and blow.peak < GRIP
    return heals or (blow.along * blow.wheels > 0.0 and abs(blow.wheels) > 0.05)


def _named(d: Disturbance, blows: Sequence[Disturbance], dead: set[float]) -> Disturbance:
    if d.kind != SLIP:
        return d
    if d.t0 in dead:
        return dataclasses.replace(d, kind=DEAD_ENCODER)
    cause = next((b for b in blows if _near(d, b, BEFORE, AFTER) and d.t1 < b.t1 + SHORT), None)
    return d if cause is None else dataclasses.replace(d, kind=cause.kind)
