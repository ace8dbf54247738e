"""`Disturbances`: what befell the robot, and from when to when which sensor is not to be believed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from core.estimation.result import Event

Array = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]

SLIP, COLLISION, BOUNCE, PUSHED, STUCK, DEAD_ENCODER = KINDS = (
    "slip", "collision", "bounce", "pushed", "stuck", "dead_encoder",
)  # fmt: skip

TOUCH = 0.5  # s between the end of one and the onset of the next that is still the same


@dataclass(frozen=True)
class Disturbance:
    """One of KINDS between onset t0 and end t1 [s], dated back; `alarm` is when it was known, `release` its end.

    left, right: that wheel's reading is wrong; turn: it is the difference of both (which wheel, nobody can say);
    accelerometer: it is blinded; stopped: the body stands still, whatever the wheels say.
    statistic: in sigma of its residual; size [m/s], of a bounce [m/s^2]; peak [m/s^2];
    along: speed gained in a blow, or by which the wheels ran ahead of the accelerometer [m/s];
    wheels: their speed in a blow [m/s].
    """

    kind: str
    t0: float
    t1: float
    alarm: float
    release: float
    left: bool = False
    right: bool = False
    turn: bool = False
    accelerometer: bool = False
    stopped: bool = False
    statistic: float = 0.0
    size: float = 0.0
    peak: float = 0.0
    along: float = 0.0
    wheels: float = 0.0
    evidence: str = ""
    replaced: str = ""

    @property
    def event(self) -> Event:
        """As a row of an estimate."""
        return Event(self.kind, self.t0, self.t1, evidence=self.evidence, replaced=self.replaced)


@dataclass(frozen=True)
class Flags:
    """Per stamp (M,): left, right wheel not to be believed over the interval that ends there; their difference not;
    accelerometer not; body at a standstill."""

    left: Bools
    right: Bools
    turn: Bools
    accelerometer: Bools
    stopped: Bools


@dataclass(frozen=True)
class Disturbances:
    """All that was found in a run. `found` by onset; `noise` learnt (SI, by name); notes on what could not be seen;
    clocks: a sentence where the streams' stamps are apart.

    live(t): flags as they were known at each stamp t, alarms to releases: what a causal filter may use.
    dated(t): flags from onset to end, with hindsight: for a smoother, or for a filter that goes back to the onset.
    """

    found: tuple[Disturbance, ...] = ()
    noise: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    clocks: tuple[str, ...] = ()

    @property
    def events(self) -> tuple[Event, ...]:
        """Rows of an estimate: disturbances of one kind that touch are one event."""
        rows: list[Event] = []
        for one in self.found:
            last = next((row for row in reversed(rows) if row.kind == one.kind), None)
            if last is None or one.t0 > last.t1 + TOUCH:
                rows.append(one.event)
                continue
            evidence = last.evidence if one.evidence in last.evidence else f"{last.evidence}; {one.evidence}"
            rows[rows.index(last)] = Event(
                last.kind, last.t0, max(last.t1, one.t1), evidence=evidence, replaced=last.replaced or one.replaced
            )
        return tuple(rows)

    def live(self, t: Array) -> Flags:
        """Flags (M,) at sorted stamps t: interval (t[k-1], t[k]] is flagged from the alarm on, to the release."""
        return _flags(t, self.found, [(d.alarm, d.release) for d in self.found])

    def dated(self, t: Array) -> Flags:
        """Flags (M,) at sorted stamps t: every interval that touches onset to end."""
        return _flags(t, self.found, [(d.t0, d.t1) for d in self.found])


def _flags(t: Array, found: Sequence[Disturbance], spans: Sequence[tuple[float, float]]) -> Flags:
    begin = np.searchsorted(t, np.array([a for a, _ in spans]), "left")
    end = np.minimum(np.searchsorted(t, np.array([b for _, b in spans]), "left") + 1, len(t))

    def rows(name: str) -> Bools:
        steps = np.zeros(len(t) + 1, np.int64)
        chosen = np.array([bool(getattr(one, name)) for one in found], bool)
        np.add.at(steps, begin[chosen], 1)
        np.add.at(steps, np.maximum(end, begin)[chosen], -1)
        return np.asarray(np.cumsum(steps[:-1]) > 0)

    return Flags(rows("left"), rows("right"), rows("turn"), rows("accelerometer"), rows("stopped"))
