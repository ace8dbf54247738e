"""`fused`: our best causal path, and `smoothed`: our best with hindsight. All sensors in one error-state Kalman filter.

Given: wheels, and what there is of IMU, fixes and ranges. Done: all readings are put into one list (`events.py`), what
disturbed the robot is found (`core.estimation.events`), a start pose is found (`start.py`), noise that nobody gave is
learnt from the run's own innovations (`noise.py`), and the compiled filter walks over the list (`walk.py`): gyro and
accelerometer carry the body, cumulative wheel readings, fixes and ranges are measurements, each through a chi-square
gate. `smoothed` walks back as well. What there is to say of it is in `findings.py`.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from core.estimation.assumptions import Assumptions, Config, assume
from core.estimation.events import Disturbances, detect
from core.estimation.fusion.events import Events, merge
from core.estimation.fusion.findings import all_events, findings, innovations, leaps, parameters
from core.estimation.fusion.layout import FIX, RANGE, WHEEL
from core.estimation.fusion.noise import learn, trusted_turns
from core.estimation.fusion.start import Start, find_start
from core.estimation.fusion.walk import Problem, Walk, problem, smooth, walk
from core.estimation.fusion.witness import rest_walk, turn_slip
from core.estimation.rest import Rest, at_rest
from core.estimation.result import Curve, Estimate, Innovations
from core.run import Run
from core.trajectory import Trajectory

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Prepared:
    """A run ready for the filter: events, numbers, problem, what disturbed it, and what there is to say so far."""

    run: Run
    events: Events
    numbers: Assumptions
    problem: Problem
    disturbances: Disturbances
    rest: Rest | None
    notes: tuple[str, ...]


def fused(run: Run, config: Config | None = None) -> Estimate:
    """Causal path with covariance, gyro bias, parameters and innovations; one pose per IMU stamp (else wheel stamp)."""
    ready = prepare(run, config)
    found = walk(ready.problem, ready.events, ready.disturbances)
    return _estimate("fused", ready, found, found, innovations(ready.events, found))


def smoothed(run: Run, config: Config | None = None) -> Estimate:
    """As `fused`, each pose by the whole run: a fixed-interval smoother over the filter's own steps."""
    ready = prepare(run, config)
    forward, back = smooth(ready.problem, ready.events, ready.disturbances)
    return _estimate("smoothed", ready, back, forward, innovations(ready.events, forward))


def fused_and_smoothed(run: Run, config: Config | None = None) -> tuple[Estimate, Estimate]:
    """Both from one preparation, side by side in two threads: what each alone gives, in about half of the time."""
    ready = prepare(run, config)
    with ThreadPoolExecutor(1) as aside:
        calm = not ready.disturbances.found  # then the smoother's own filter is the causal one
        causal = None if calm else aside.submit(walk, ready.problem, ready.events, ready.disturbances)
        forward, back = smooth(ready.problem, ready.events, ready.disturbances)
        if causal is not None:
            found = causal.result()
        else:
            found = walk(ready.problem, ready.events) if back.leaps else forward
    told = innovations(ready.events, forward)
    mine = told if found is forward else innovations(ready.events, found)
    return _estimate("fused", ready, found, found, mine), _estimate("smoothed", ready, back, forward, told)


def prepare(run: Run, config: Config | None = None) -> Prepared:
    """All that comes before the walk, of a run that is sound (`core.estimation.sanity`)."""
    numbers, notes = assume(run, config)
    first = numbers
    with ThreadPoolExecutor(1) as aside:
        disturbed = aside.submit(detect, run, numbers)
        rest = at_rest(run, numbers) if run.imu is not None and len(run.imu) >= 2 else None
        events = merge(run, numbers, rest)
        trusted: tuple[str, ...] = ()
        if rest is not None:
            events, numbers, trusted = trusted_turns(events, numbers, lambda e, n: _alone(run, e, n, rest))
        found = disturbed.result() if numbers.track_scale_sd == first.track_scale_sd else detect(run, numbers)
    disturbances = _believed(found, events)
    start = find_start(run, events, numbers, lambda: reckoned_alone(run, events, numbers, rest))
    events = start.without_used(events)

    def trial(e: Events, n: Assumptions) -> Walk:
        return walk(problem(run, e, start, n, rest), e, disturbances)

    wheels = turn_slip(run, events, numbers, disturbances) if rest is not None else None
    numbers, learnt = learn(run, events, numbers, config or {}, trial, wheels, rest_walk(run, rest))
    notes = (*start.notes, *trusted, *learnt, *found.clocks, *notes, *events.notes)
    return Prepared(run, events, numbers, problem(run, events, start, numbers, rest), disturbances, rest, notes)


def _believed(found: Disturbances, events: Events) -> Disturbances:
    """Without those that only a turn of the wheels shows, where that is no witness."""
    wheels = events.kind == WHEEL
    if np.isfinite(events.data[wheels, 1]).any():
        return found
    return replace(found, found=tuple(d for d in found.found if not d.turn))


def _alone(run: Run, events: Events, numbers: Assumptions, rest: Rest | None) -> tuple[Events, Walk]:
    """Wheels and IMU alone from the origin, by the same filter; the events that it walked over."""
    origin = Start(np.zeros(3), np.zeros((3, 3)))
    inner = events.kept(~events.of(FIX, RANGE))
    return inner, walk(problem(run, inner, origin, numbers, rest), inner)


def reckoned_alone(run: Run, events: Events, numbers: Assumptions, rest: Rest | None) -> Trajectory:
    """The path of wheels and IMU alone from the origin, by the same filter."""
    return _reckoned(*_alone(run, events, numbers, rest))


def _reckoned(events: Events, walked: Walk) -> Trajectory:
    return Trajectory(events.out, walked.pose[:, 0], walked.pose[:, 1], walked.pose[:, 2])


def _estimate(method: str, ready: Prepared, path: Walk, forward: Walk, told: dict[str, Innovations]) -> Estimate:
    t, pose = ready.events.out, path.pose
    return Estimate(
        method,
        Trajectory(t, pose[:, 0], pose[:, 1], pose[:, 2], path.covariance),
        gyro_bias=Curve(t, path.bias, np.sqrt(path.bias_var)) if ready.rest is not None else None,
        parameters=parameters(ready.events, forward),
        events=all_events(ready.events, forward, (*ready.disturbances.events, *leaps(path, ready.disturbances.events))),
        innovations=told,
        notes=(*ready.notes, *findings(ready.events, ready.problem, forward)),
    )
