"""Collision and bounce by the accelerometers' signature.

The paper says "specific form" and shows none. Ours: a peak well above the vibration of driving is a shock. It is a
collision where its first peak points against the motion and a bounce where peaks of both signs follow each other, as
the body leans back and forth; a collision may go over into a bounce.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.estimation.published.decisions import Decisions
from core.estimation.published.signals import Signals, lowpass
from core.estimation.published.substitution import stretches
from core.estimation.result import Event

Array = npt.NDArray[np.float64]

MOVING = 0.05  # m/s: a slower robot collides with nothing
USUAL_TIME = 0.1  # Hz, of the low-pass under the usual vibration


@dataclass(frozen=True)
class Shock:
    """A collision, a bounce, or one that goes over into the other; rows of first and last peak."""

    first: int
    last: int
    events: tuple[Event, ...]


def shocks(s: Signals, choice: Decisions) -> list[Shock]:
    """All shocks in order."""
    size = np.hypot(s.sharp[:, 0], s.sharp[:, 1])
    hz = 1.0 / max(float(np.median(s.dt[1:])), 1e-6) if len(s.t) > 1 else 1.0
    # Peaks are clipped, so that a shock does not raise its own limit.
    usual = np.sqrt(np.maximum(lowpass(np.minimum(size, choice.shock) ** 2, hz, USUAL_TIME), 0.0))
    limit = np.maximum(choice.shock, choice.shock_factor * np.concatenate((usual[:1], usual[:-1])))
    return [_shock(s, size, limit, a, b) for a, b in stretches(s.t, size > limit, choice.quiet, 0.0)]


def _shock(s: Signals, size: Array, limit: Array, a: int, b: int) -> Shock:
    rows = np.arange(a, b + 1)[size[a : b + 1] > limit[a : b + 1]]
    along = s.sharp[rows, 0]
    before = max(a - round(0.1 / max(float(np.median(s.dt[1:])), 1e-6)), 0)
    v = float(s.speed[before])
    against = abs(v) > MOVING and along[0] * v < 0 and abs(along[0]) > abs(s.sharp[rows[0], 1]) / 2
    turned = rows[np.sign(along) != np.sign(along[0])]
    t0, t1 = float(s.t[a]), float(s.t[b])
    peak = float(size[a : b + 1].max())
    replaced = "position by beacon, once it ends"
    if not against:
        return Shock(a, b, (Event("bounce", t0, t1, f"peak of {peak:.2g} m/s², limit {limit[a]:.2g} m/s²", replaced),))
    turn = float(s.t[turned[0]]) if turned.size else t1
    hit = f"{along[0]:+.2g} m/s² against {v:+.2g} m/s, limit {limit[a]:.2g} m/s²"
    found = [Event("collision", t0, turn, hit, replaced)]
    if turned.size:
        found.append(Event("bounce", turn, t1, f"peaks of both signs follow, up to {peak:.2g} m/s²", replaced))
    return Shock(a, b, tuple(found))
