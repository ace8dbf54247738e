"""`fused`: our best causal path, all sensors in one error-state Kalman filter on SE(2), with gyro bias and scales.

Given: wheels, and what there is of gyro, fixes and ranges. Done: a start pose is found (`start.py`), all readings are
put into one list (`events.py`), and the compiled filter (`_filter_numba.py`) walks over it once: the gyro turns the
body, cumulative wheel readings, fixes and ranges are measurements, each through a chi-square gate; at rest heading is
held and the gyro reads its own bias. A noise level that nobody gave is learnt from the run's own innovations.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from core.estimation.assumptions import Assumptions, Config, assume, encoder_quantum
from core.estimation.fusion.events import FIX, RANGE, WHEEL, Events, merge
from core.estimation.fusion.noise import Walk, learn, trusted_turns
from core.estimation.fusion.start import Start, find_start
from core.estimation.odometry import chi2_gate
from core.estimation.rest import Rest, at_rest
from core.estimation.result import Curve, Estimate, Event, Innovations, Value
from core.run import Run
from core.trajectory import Trajectory

Array = npt.NDArray[np.float64]

LOSS_FACTOR, LOSS_FLOOR = 5.0, 1.0  # a beacon is lost after this many typical steps, and this many seconds at least

START_SPEED, START_TURN = 0.5, 0.5  # m/s, rad/s: sd of both before the first wheel reading
STILL_SPEED = 1e-3  # m/s, how still rest is
WORDS = {FIX: "fixes", RANGE: "ranges"}

PARAMETERS = {
    7: ("gyro_scale", "1"), 8: ("distance_scale", "1"), 9: ("wheel_inequality", "1"), 10: ("track_scale", "1"),
    11: ("range_scale", "1"), 12: ("range_bias", "m"),
}  # fmt: skip


def fused(run: Run, config: Config | None = None) -> Estimate:
    """Causal path with covariance, gyro bias, parameters and innovations; one pose per IMU stamp (else wheel stamp)."""
    numbers, notes = assume(run, config)
    rest = at_rest(run, numbers) if run.imu is not None and len(run.imu) >= 2 else None
    events = merge(run, numbers, rest)
    trusted: tuple[str, ...] = ()
    if rest is not None:
        events, numbers, trusted = trusted_turns(events, numbers, lambda e, n: _alone(run, e, n, rest))
    start = find_start(run, events, numbers, lambda: _reckoned(*_alone(run, events, numbers, rest)))
    events = start.without_used(events)
    numbers, learnt = learn(run, events, numbers, config or {}, lambda e, n: _walk(run, e, start, n, rest))
    walk = _walk(run, events, start, numbers, rest)
    t, pose = events.out, walk.pose
    return Estimate(
        "fused",
        Trajectory(t, pose[:, 0], pose[:, 1], pose[:, 2], walk.covariance),
        gyro_bias=Curve(t, walk.bias, np.sqrt(walk.bias_var)) if rest is not None else None,
        parameters=_parameters(walk),
        events=_losses(events, walk),
        innovations=_innovations(events, walk),
        notes=(*start.notes, *trusted, *learnt, *notes, *events.notes, *_findings(events, walk)),
    )


def _walk(run: Run, events: Events, start: Start, numbers: Assumptions, rest: Rest | None) -> Walk:
    from core.estimation.fusion._filter_numba import N, run_filter

    m, e = len(events.out), len(events.t)
    x, P = np.zeros(N), np.zeros((N, N))
    x[:3], P[:3, :3] = start.pose, start.covariance
    P[range(3, N), range(3, N)] = _priors(run, events, numbers, rest)
    nis, status = np.full((e, 2), np.nan), np.zeros((e, 2), np.int8)
    pose, covariance, bias, bias_var = np.empty((m, 3)), np.empty((m, 3, 3)), np.empty(m), np.empty(m)
    run_filter(
        events.dt, events.kind, events.data, events.raw, events.q_extra, events.flags, x, P,
        _constants(run, numbers, rest), nis, status, pose, covariance, bias, bias_var,
    )  # fmt: skip
    return Walk(nis, status, pose, covariance, bias, bias_var, x, P)


def _alone(run: Run, events: Events, numbers: Assumptions, rest: Rest | None) -> tuple[Events, Walk]:
    """Wheels and gyro alone from the origin, by the same filter; the events that it walked over."""
    origin = Start(np.zeros(3), np.zeros((3, 3)), np.flatnonzero((events.kind == FIX) | (events.kind == RANGE)))
    inner = origin.without_used(events)
    return inner, _walk(run, inner, origin, numbers, rest)


def _reckoned(events: Events, walk: Walk) -> Trajectory:
    return Trajectory(events.out, walk.pose[:, 0], walk.pose[:, 1], walk.pose[:, 2])


def _priors(run: Run, events: Events, numbers: Assumptions, rest: Rest | None) -> Array:
    """(10,) variances of s, phi, v, b, kg, kd, ke, kb, kr, br; 0 freezes what this run cannot show."""
    gyro, track = rest is not None, run.meta.robot.track_width is not None
    ranged = (events.kind == RANGE).any()
    sd = (
        0.0, 0.0, START_SPEED, numbers.bias_sd if gyro else START_TURN, numbers.gyro_scale_sd * gyro,
        numbers.distance_scale_sd, numbers.inequality_sd * track, numbers.track_scale_sd * track,
        numbers.range_scale_sd * ranged, numbers.range_bias_sd * ranged,
    )  # fmt: skip
    return np.square(np.array(sd, np.float64))


def _constants(run: Run, numbers: Assumptions, rest: Rest | None) -> object:
    from core.estimation.fusion._filter_numba import Constants

    robot = run.meta.robot
    step = encoder_quantum(run, numbers) * float(robot.wheel_radius or 0.0)
    inverse_track = 1.0 / robot.track_width if robot.track_width else 0.0
    rate = run.imu.rate if rest is not None and run.imu is not None else 0.0
    constants = Constants(
        has_gyro=float(rest is not None),
        inverse_track=inverse_track,
        tag_x=robot.tag.x,
        tag_y=robot.tag.y,
        tag_z=robot.tag.z,
        tau=numbers.memory,
        q_speed=numbers.accel**2,
        q_turn=numbers.turn_accel**2,
        q_gyro=numbers.gyro_density**2 / 2,
        q_bias=numbers.bias_walk**2,
        q_scale=numbers.parameter_walk**2,
        q_slip=numbers.slip**2,
        q_side=numbers.side_slip**2,
        r_distance=step**2 / 24,
        r_turn=step**2 / 6 * inverse_track**2,
        r_rate=rest.gyro_sd**2 if rest is not None else 1.0,
        r_still=STILL_SPEED**2,
        r_fix=numbers.fix_xy**2,
        r_fix_theta=numbers.fix_theta**2,
        r_range=numbers.range**2,
        top_speed=numbers.top_speed,
        gate1=chi2_gate(1, numbers),
        gate2=chi2_gate(2, numbers),
        gate3=chi2_gate(3, numbers),
        patience=numbers.reaccept,
        patience_rest=numbers.reaccept * rate / 2,
    )
    return Constants(*(float(value) for value in constants))  # one type, so that it is compiled once


def _parameters(walk: Walk) -> dict[str, Value]:
    """Last estimate of each scale and bias that was free to move."""
    sd = np.sqrt(np.diag(walk.P))
    return {name: Value(float(walk.x[i]), float(sd[i]), unit) for i, (name, unit) in PARAMETERS.items() if sd[i] > 0}


def _innovations(events: Events, walk: Walk) -> dict[str, Innovations]:
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
        rows = (events.kind == kind) & (walk.status[:, column] > 0)
        if only is not None:
            rows &= only
        if rows.any():
            accepted = walk.status[rows, column] == 1
            found[name] = Innovations(events.t[rows], walk.nis[rows, column], dof, accepted)
    return found


def _losses(events: Events, walk: Walk) -> tuple[Event, ...]:
    """Times without an accepted fix (or range), longer than the sensor's own rhythm explains."""
    found = []
    end = float(events.t[-1])
    for kind in (FIX, RANGE):
        all_t = events.t[events.kind == kind]
        if all_t.size < 3:
            continue
        t = events.t[(events.kind == kind) & (walk.status[:, 0] == 1)]
        steps = np.diff(all_t)
        # A ranging system speaks in bursts: its rhythm is its pauses, not its median step.
        longest = max(LOSS_FLOOR, LOSS_FACTOR * float(np.median(steps)), 1.5 * float(np.quantile(steps, 0.95)))
        edges = np.concatenate((all_t[:1], t, [end]))
        for i in np.flatnonzero(np.diff(edges) > longest):
            a, b = float(edges[i]), float(edges[i + 1])
            refused = int(np.sum((all_t > a) & (all_t < b)))
            why = f"{refused} {WORDS[kind]} in between were refused" if refused else f"no {WORDS[kind]} came"
            found.append(Event("beacon_loss", a, b, evidence=why, replaced="wheels and gyro carry the path"))
    return tuple(sorted(found, key=lambda event: event.t0))


def _findings(events: Events, walk: Walk) -> tuple[str, ...]:
    """What the user should know afterwards: refused readings, heading nobody observed."""
    notes = []
    for kind, column, what in ((FIX, 0, "fixes"), (RANGE, 0, "ranges"), (WHEEL, 1, "wheel turns")):
        rows = (events.kind == kind) & (walk.status[:, column] > 0)
        share = float(np.mean(walk.status[rows, column] == 2)) if rows.any() else 0.0
        if share > 0.02:
            notes.append(f"{share:.0%} of {what} were outside their gate.")
    sd = float(np.sqrt(walk.covariance[-1, 2, 2]))
    absolute = ((events.kind == FIX) | (events.kind == RANGE)).any()
    if not absolute:
        notes.append(f"Nothing observes the heading: its sd has grown to {sd:.2g} rad.")
    elif sd > 0.5:
        notes.append(f"The heading is hardly observable: its sd at the end is {sd:.2g} rad.")
    return tuple(notes)
