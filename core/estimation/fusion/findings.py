"""What the filter found out beside the path: parameters, innovations per sensor, beacon events, plain sentences."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from core.estimation.fusion.events import Events
from core.estimation.fusion.layout import (
    ACCEPTED,
    BA,
    BR,
    DT,
    FIX,
    KB,
    KD,
    KE,
    KG,
    KR,
    NONE,
    RANGE,
    REJECTED,
    RELOCATED,
    STILL,
    WHEEL,
)  # fmt: skip
from core.estimation.fusion.walk import Problem, Walk
from core.estimation.result import Event, Innovations, Value

Array = npt.NDArray[np.float64]

LOSS_FACTOR, LOSS_FLOOR = 5.0, 1.0  # a beacon is lost after this many typical steps, and this many seconds at least
LIES = {FIX: (4, 2), RANGE: (10, 3)}  # refused readings that are a lie, and their largest distance in a row
CARRIED_FAR = 0.15  # m
LEARNT = 0.9  # of its first sd: a parameter that keeps more has not been shown by the run
WORDS = {FIX: "fixes", RANGE: "ranges"}

PARAMETERS = {
    KG: ("gyro_scale", "1"), KD: ("distance_scale", "1"), KE: ("wheel_inequality", "1"), KB: ("track_scale", "1"),
    KR: ("range_scale", "1"), BR: ("range_bias", "m"), BA: ("accelerometer_bias", "m/s^2"), DT: ("beacon_delay", "s"),
}  # fmt: skip


def parameters(events: Events, walked: Walk) -> dict[str, Value]:
    """Last estimate of each scale and bias that was free to move, and of the lasting error of each beacon."""
    sd = np.sqrt(np.diag(walked.P))
    found = {name: Value(float(walked.x[i]), float(sd[i]), unit) for i, (name, unit) in PARAMETERS.items() if sd[i] > 0}
    for i, name in enumerate(events.lasting, events.first_offset):
        if i < len(sd) and sd[i] > 0:
            found[f"lasting_error.{name}"] = Value(float(walked.x[i]), float(sd[i]), "m")
    return found


def innovations(events: Events, walked: Walk) -> dict[str, Innovations]:
    """NIS per sensor; fixes with and without heading apart, as their degrees of freedom differ."""
    headed = np.isfinite(events.data[:, 2])
    sensors = (
        ("wheels.distance", WHEEL, 0, 1, None),
        ("wheels.turn", WHEEL, 1, 1, None),
        ("beacon", FIX, 0, 3, headed),
        ("beacon.position", FIX, 0, 2, ~headed),
        ("ranges", RANGE, 0, 1, None),
    )
    found = {}
    for name, kind, column, dof, only in sensors:
        rows = (events.kind == kind) & (walked.status[:, column] != NONE)
        if only is not None:
            rows &= only
        if rows.any():
            accepted = walked.status[rows, column] == ACCEPTED
            signed = slice(0, 2) if kind == FIX else slice(column, column + 1)
            score = None if walked.score is None else walked.score[rows, signed]
            found[name] = Innovations(events.t[rows], walked.nis[rows, column], dof, accepted, score)
    return found


def all_events(events: Events, walked: Walk, disturbed: tuple[Event, ...]) -> tuple[Event, ...]:
    """What disturbed the robot, and what the innovations show: beacon lost, beacon lying, robot found elsewhere."""
    carried = [_carried(event, events, walked) for event in disturbed]
    others = (*_losses(events, walked), *_lies(events, walked), *_moves(events, walked, disturbed))
    return tuple(sorted((*(c or e for c, e in zip(carried, disturbed, strict=True)), *others), key=lambda e: e.t0))


def leaps(walked: Walk, disturbed: tuple[Event, ...]) -> tuple[Event, ...]:
    """Where only later readings show that the robot moved otherwise than its wheels, and nothing known explains it."""
    return tuple(
        Event(
            "slip", leap.t, leap.t, replaced="later readings replaced wheels and IMU",
            evidence=f"with hindsight {np.hypot(leap.x, leap.y):.2f} m elsewhere, {np.sqrt(leap.statistic):.0f} sigma",
        )
        for leap in walked.leaps
        if not any(e.t0 - 1.0 < leap.t < e.t1 + 1.0 for e in disturbed)
    )  # fmt: skip


def _carried(event: Event, events: Events, walked: Walk) -> Event | None:
    """The event as a kidnapping, where the robot was elsewhere after it and its wheels had not turned."""
    at = np.clip(np.searchsorted(events.out, (event.t0 - 0.2, event.t1 + 0.3)), 0, len(events.out) - 1)
    inside = (events.t > event.t0 + 0.3) & (events.t < event.t1 - 0.1)
    if not inside.any() or np.mean(events.flags[inside] & STILL != 0) < 0.9:
        return None
    moved = walked.pose[at[1]] - walked.pose[at[0]]
    far = float(np.hypot(moved[0], moved[1]))
    if far < CARRIED_FAR:
        return None
    why = f"{far:.2f} m and {moved[2]:+.2f} rad elsewhere while no wheel turned; {event.evidence}"
    return Event("kidnap", event.t0, event.t1, evidence=why, replaced="fixes replaced wheels and accelerometer")


def _losses(events: Events, walked: Walk) -> list[Event]:
    """Times without an accepted fix (or range), longer than the sensor's own rhythm explains."""
    found = []
    end = float(events.t[-1])
    for kind in (FIX, RANGE):
        all_t = events.t[events.kind == kind]
        if all_t.size < 3:
            continue
        t = events.t[(events.kind == kind) & (walked.status[:, 0] != REJECTED)]
        steps = np.diff(all_t)
        # A ranging system speaks in bursts: its rhythm is its pauses, not its median step.
        longest = max(LOSS_FLOOR, LOSS_FACTOR * float(np.median(steps)), 1.5 * float(np.quantile(steps, 0.95)))
        edges = np.concatenate((all_t[:1], t, [end]))
        for i in np.flatnonzero(np.diff(edges) > longest):
            a, b = float(edges[i]), float(edges[i + 1])
            refused = int(np.sum((all_t > a) & (all_t < b)))
            why = f"{refused} {WORDS[kind]} in between were refused" if refused else f"no {WORDS[kind]} came"
            found.append(Event("beacon_loss", a, b, evidence=why, replaced="wheels and gyro carry the path"))
    return found


def _lies(events: Events, walked: Walk) -> list[Event]:
    """Stretches of refused fixes or ranges, with few accepted in between."""
    return [event for kind in (FIX, RANGE) for event in _lies_of(kind, events, walked)]


def _lies_of(kind: int, events: Events, walked: Walk) -> list[Event]:
    fewest, apart = LIES[kind]
    rows = np.flatnonzero(events.kind == kind)
    bad, t = walked.status[rows, 0] == REJECTED, events.t[rows]
    at = np.flatnonzero(bad)
    if at.size < fewest:
        return []
    cuts = np.flatnonzero(np.diff(at) > apart)
    first, last = np.concatenate(([0], cuts + 1)), np.concatenate((cuts, [at.size - 1]))
    return [
        Event(
            "beacon_lying", float(t[at[a]]), float(t[at[b]]), evidence=f"{b - a + 1} {WORDS[kind]} refused in a row",
            replaced="wheels and IMU carry the path",
        )
        for a, b in zip(first, last, strict=True) if b - a + 1 >= fewest
    ]  # fmt: skip


def _moves(events: Events, walked: Walk, disturbed: tuple[Event, ...]) -> list[Event]:
    """Where the pose was given up for what many refused fixes agreed on: a kidnapping, unless something else that is
    known to have happened since the last accepted fix explains it."""
    fixes = np.flatnonzero(events.kind == FIX)
    status, t = walked.status[fixes, 0], events.t[fixes]
    found = []
    for i in np.flatnonzero(status == RELOCATED):
        before = np.flatnonzero(status[:i] != REJECTED)
        a = float(t[before[-1]]) if before.size else float(t[0])
        if any(e.t0 < t[i] and e.t1 > a - 1.0 for e in disturbed):
            continue
        why = f"{int(np.sum(status[:i][t[:i] > a] == REJECTED))} fixes agreed on another place"
        found.append(Event("kidnap", a, float(t[i]), evidence=why, replaced="the fixes replaced the path"))
    return found


def findings(events: Events, problem: Problem, walked: Walk) -> tuple[str, ...]:
    """What a user should know afterwards: refused readings, parameters not shown, an unobserved heading."""
    notes = []
    for kind, column, what in ((FIX, 0, "fixes"), (RANGE, 0, "ranges"), (WHEEL, 1, "wheel turns")):
        rows = (events.kind == kind) & (walked.status[:, column] != NONE)
        share = float(np.mean(walked.status[rows, column] == REJECTED)) if rows.any() else 0.0
        if share > 0.02:
            notes.append(f"{share:.0%} of {what} were outside their gate.")
    notes += _not_shown(problem, walked)
    sd = float(np.sqrt(walked.covariance[-1, 2, 2]))
    if not events.of(FIX, RANGE).any():
        notes.append(f"Nothing observes the heading: its sd has grown to {sd:.2g} rad.")
    elif sd > 0.5:
        notes.append(f"The heading is hardly observable: its sd at the end is {sd:.2g} rad.")
    return tuple(notes)


def _not_shown(problem: Problem, walked: Walk) -> list[str]:
    before, after = np.diag(problem.begin.P), np.diag(walked.P)
    frozen = [name for i, (name, _) in PARAMETERS.items() if before[i] > 0 and after[i] > LEARNT**2 * before[i]]
    if not frozen:
        return []
    return [f"Not identifiable from this run, held at their first value: {', '.join(frozen)}."]
