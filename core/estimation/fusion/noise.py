"""Noise that nobody stated, learnt from the run's own innovations: what the filter was surprised by, it did not know.

The sd of fixes or ranges, where the data sheet is silent, is scaled until the median innovation is what it claims to be
(the median, so that outliers do not count). Slip is the one of a few levels under which fixes and ranges are most
likely. Both are constants of the run, found from its leading stretch; the path itself stays causal.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from core.estimation.assumptions import Assumptions, Config
from core.estimation.fusion.events import Events
from core.estimation.fusion.layout import FIX, KB, RANGE, WHEEL
from core.estimation.fusion.walk import Walk
from core.estimation.fusion.witness import Evidence, TurnSlip
from core.run import Run

Array = npt.NDArray[np.float64]

ENOUGH = 50  # readings to learn from
LEADING = 40_000  # events that are looked at
PASSES = 4  # for the sd of fixes and ranges
TYPICAL_SLIP, SLIP_SPREAD = 4e-3, 1.0  # m/sqrt(m), of tyres on a floor; sd of its logarithm
SLIP_STEP, SLIP_STEPS = 2.0, 5  # levels of slip are this far apart, this many each way at most
WALK_STEP, WALK_STEPS, WALK_SPREAD = 3.0, 4, 1.5  # the same of the walk of the gyro's bias
IMPOSSIBLE = 4.0  # sd from the stated track width
CONTRADICTED = 0.3  # share of the time that wheels and gyro may disagree about turning
ROUGH = 0.01  # m/sqrt(m): slip that is no contradiction
SKID, SKID_SCALE = 0.6, 0.2  # m, relative: what wheels that skid do to the distance
OUTLIER = 16.0  # a normalised innovation squared counts no more than this
MEDIAN_CHI2 = {1: 0.4549, 2: 1.3863, 3: 2.3660}


Walker = Callable[[Events, Assumptions], Walk]
Likely = Callable[[Assumptions], float]


def learn(
    run: Run,
    events: Events,
    numbers: Assumptions,
    config: Config,
    walk: Walker,
    wheels: TurnSlip | None,
    bias: Evidence,
) -> tuple[Assumptions, tuple[str, ...]]:
    """The numbers with learnt noise in place of assumed noise, and notes that say which.

    wheels, bias: what wheels and gyro say of slip, and the gyro at rest of its bias (`witness`).
    """
    absolute = int(np.sum((events.kind == FIX) | (events.kind == RANGE)))
    leading = events.leading(LEADING)
    notes: tuple[str, ...] = ()
    if absolute >= ENOUGH:
        numbers, notes = _readings(run, leading, numbers, config, walk)

    def likely(tried: Assumptions) -> float:
        return _log_likelihood(leading, walk(leading, tried)) if absolute >= ENOUGH else 0.0

    if "slip" not in config and (absolute >= ENOUGH or wheels is not None):
        numbers, more = _slip(numbers, likely, wheels)
        notes += more
    if "bias_walk" not in config and (numbers.bias_sd > 0 and run.imu is not None):
        numbers, more = _bias_walk(numbers, likely, bias)
        notes += more
    return numbers, notes


def trusted_turns(
    events: Events, numbers: Assumptions, alone: Callable[[Events, Assumptions], tuple[Events, Walk]]
) -> tuple[Events, Assumptions, tuple[str, ...]]:
    """Whether the wheels' turn can be believed beside the gyro's: with a wide prior of the track width where the stated
    one cannot be right, and not at all where the two keep contradicting each other (a skid, a wrong sign).

    alone: walks over wheels and gyro alone, and returns these events with what it found.
    """
    leading = events.leading(LEADING)
    notes: tuple[str, ...] = ()
    patient = dataclasses.replace(numbers, slip=max(numbers.slip, ROUGH))
    inner, walked = alone(leading, patient)
    asked = (inner.kind == WHEEL) & np.isfinite(inner.data[:, 1])
    if not asked.any():
        return events, numbers, ()
    if abs(walked.x[KB]) > IMPOSSIBLE * numbers.track_scale_sd:
        numbers = dataclasses.replace(numbers, track_scale_sd=1.0)
        inner, walked = alone(leading, dataclasses.replace(patient, track_scale_sd=1.0))
        notes = (f"The gyro shows a track width {1 + walked.x[KB]:.2f} times the stated one (skid steering?).",)
    refused = float(np.mean(walked.status[asked, 1] != 1))
    if refused < CONTRADICTED:
        return events, numbers, notes
    data = events.data.copy()
    data[events.kind == WHEEL, 1] = np.nan
    numbers = dataclasses.replace(
        numbers, skid=max(numbers.skid, SKID), distance_scale_sd=max(numbers.distance_scale_sd, SKID_SCALE)
    )
    note = f"Wheels and gyro disagree about turning {refused:.0%} of the time (skid steering?): the gyro alone is used."
    return dataclasses.replace(events, data=data), numbers, (note,)


def _readings(
    run: Run, events: Events, numbers: Assumptions, config: Config, walk: Walker
) -> tuple[Assumptions, tuple[str, ...]]:
    sheet = run.meta.noise
    sensors = (
        (FIX, "fixes", ("fix_xy", "fix_theta"), sheet.beacon_xy or "fix_xy" in config),
        (RANGE, "ranges", ("range",), sheet.range or "range" in config),
    )
    unknown = [s for s in sensors if not s[3] and np.sum(events.kind == s[0]) >= ENOUGH]
    for _ in range(PASSES if unknown else 0):
        walked = walk(events, numbers)
        factors = {names: _factor(events, walked, kind) for kind, _, names, _ in unknown}
        scaled = {name: getattr(numbers, name) * f for names, f in factors.items() for name in names}
        numbers = dataclasses.replace(numbers, **scaled)
        if all(0.9 < factor < 1.1 for factor in factors.values()):
            break
    notes = [
        f"Noise of {word} learnt from this run: {getattr(numbers, names[0]):.2g} m." for _, word, names, _ in unknown
    ]
    return numbers, tuple(notes)


def _factor(events: Events, walked: Walk, kind: int) -> float:
    """By how much the sd of a sensor must grow for its median innovation to be what it claims."""
    rows = (events.kind == kind) & (walked.status[:, 0] > 0)
    headed = (events.kind == FIX) & np.isfinite(events.data[:, 2])
    medians = [
        float(np.median(walked.nis[mine, 0])) / MEDIAN_CHI2[dof]
        for mine, dof in ((rows & headed, 3), (rows & ~headed, 2 if kind == FIX else 1))
        if mine.any()
    ]
    return float(np.clip(np.sqrt(np.mean(medians)), 0.1, 10.0)) if medians else 1.0


def _slip(numbers: Assumptions, likely: Likely, wheels: TurnSlip | None) -> tuple[Assumptions, tuple[str, ...]]:
    """Climb from the typical slip, up or down by SLIP_STEP, while it becomes likelier: by the innovations of fixes and
    ranges, by the wheels' turn against the gyro's, and by what wheels on a floor usually do (SLIP_SPREAD, a factor of e
    in one sigma)."""
    across = numbers.side_slip / max(numbers.slip, 1e-9)

    def at(k: int) -> tuple[Assumptions, float]:
        slip = TYPICAL_SLIP * SLIP_STEP**k
        tried = dataclasses.replace(numbers, slip=slip, side_slip=across * slip)
        usual = (k * np.log(SLIP_STEP) / SLIP_SPREAD) ** 2
        told = wheels.log_likelihood(slip) if wheels is not None else 0.0
        return tried, likely(tried) + told - 0.5 * float(usual)

    best = _climb(at, SLIP_STEPS)
    return best, (
        f"Slip learnt from this run: {best.slip:.2g} m after one metre (assumed at first: {numbers.slip:.2g}).",
    )


def _bias_walk(numbers: Assumptions, likely: Likely, bias: Evidence) -> tuple[Assumptions, tuple[str, ...]]:
    """Climb from the assumed walk of the gyro's bias in the same way; by the gyro at rest as well."""

    def at(k: int) -> tuple[Assumptions, float]:
        tried = dataclasses.replace(numbers, bias_walk=numbers.bias_walk * WALK_STEP**k)
        usual = (k * np.log(WALK_STEP) / WALK_SPREAD) ** 2
        return tried, likely(tried) + bias(tried.bias_walk) - 0.5 * float(usual)

    best = _climb(at, WALK_STEPS)
    if best.bias_walk == numbers.bias_walk:
        return best, ()
    return best, (f"Walk of the gyro's bias learnt from this run: {best.bias_walk:.2g} rad/s/√s.",)


def _climb(at: Callable[[int], tuple[Assumptions, float]], steps: int) -> Assumptions:
    """The likeliest level, from 0 up as long as it becomes likelier, else down."""
    begun, likelihood = at(0)
    best = begun
    for way in (1, -1):
        for k in range(1, steps + 1):
            tried, value = at(way * k)
            if not value > likelihood:
                break
            best, likelihood = tried, value
        if best is not begun:
            break
    return best


def _log_likelihood(events: Events, walked: Walk) -> float:
    """Of fixes and ranges, each counted at most as bad as a clear outlier."""
    rows = ((events.kind == FIX) | (events.kind == RANGE)) & (walked.status[:, 0] > 0)
    return -0.5 * float(np.sum(np.minimum(walked.nis[rows, 0], OUTLIER) + walked.nis[rows, 1]))
