"""The compiled filter over a run's events: causal, going back where a disturbance is known only later; and smoothed.

A disturbance is known some tenths of a second after its onset. The causal path cannot be changed any more then, but the
filter's state can: it goes back to the onset, walks to the present once more with what it now knows, and goes on. So
does a reading that comes late (`replay.py`).
"""

from __future__ import annotations

import dataclasses
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.estimation.assumptions import Assumptions, encoder_quantum
from core.estimation.events import Disturbances, Flags
from core.estimation.fusion.events import Events
from core.estimation.fusion.layout import (
    ACCEL,
    BA,
    BR,
    CARRIED,
    DT,
    FIX,
    HAS_GYRO,
    KB,
    KD,
    KE,
    KG,
    KR,
    LEAP_VAR,
    LEFT,
    MEMORY,
    OUT,
    PAST,
    PHI,
    RANGE,
    RIGHT,
    SEEN,
    STARTED,
    STILL,
    STOPPED,
    STRANGE,
    T_FIX,
    T_IMU,
    T_OFFSET,
    T_RANGE,
    T_STRANGE,
    T_TRUST,
    T_WHEEL,
    TURN,
    B,
    Constants,
    N,
    Records,
    T,
    Tracks,
    V,
    records,
    scratch,
)  # fmt: skip
from core.estimation.fusion.start import Start
from core.estimation.odometry import chi2_gate, longest_hold
from core.estimation.rest import Rest
from core.run import Run

Array = npt.NDArray[np.float64]

START_SPEED, START_TURN = 0.5, 0.5  # m/s, rad/s: sd of both before the first wheel reading
STILL_SPEED = 1e-3  # m/s, how still rest is
SKID_TIME = 2.0  # s for which a skid is alike
STRETCH = 4096  # events that the smoother keeps at a time
LEAP, LEAP_APART, LEAP_ROUNDS = 30.0, 5.0, 3  # chi-square of a leap, s between two, times that they are looked for


@dataclass
class State:
    """All that the filter remembers, as arrays: x (N,), P (N, N), mem, past, as `layout` says; and the next row."""

    x: Array
    P: Array
    mem: Array
    past: Array
    row: int = 0

    def copy(self) -> State:
        """A state to come back to."""
        return State(self.x.copy(), self.P.copy(), self.mem.copy(), self.past.copy(), self.row)


@dataclass(frozen=True)
class Walk:
    """What the filter left behind: per event nis and status (E, 2), per row the pose and its covariance, last state."""

    nis: Array
    status: npt.NDArray[np.int8]
    pose: Array
    covariance: Array
    bias: Array
    bias_var: Array
    x: Array
    P: Array
    leaps: tuple[Leap, ...] = ()
    score: Array | None = None  # (E, 2), as `Tracks`


@dataclass(frozen=True)
class Leap:
    """The robot has moved by (x, y) [m] at t [s] as no sensor shows, by hindsight; chi-square of two."""

    t: float
    x: float
    y: float
    statistic: float


@dataclass(frozen=True)
class Problem:
    """A filter ready to walk: n states in use, the numbers of the run, the state that it begins with."""

    n: int
    constants: Array  # of `Constants`
    begin: State

    def step(self, events: Events, begin: int, end: int, state: State, out: Tracks, rec: Records | None = None) -> None:
        """Walk over events begin .. end, from `state` and into it. Pieces give what one walk over all would."""
        from core.estimation.fusion._filter_numba import run_filter

        state.row = run_filter(
            begin, end, state.row, events.readings, state.x, state.P.reshape(N * N), self.n, state.mem, state.past,
            self.constants, scratch(), out, rec if rec is not None else _NO_RECORDS, rec is not None,
        )  # fmt: skip


_NO_RECORDS = records(0, 0)


def problem(run: Run, events: Events, start: Start, numbers: Assumptions, rest: Rest | None) -> Problem:
    """The filter of a run: what it shows is estimated, what it cannot show is left out of the state."""
    sd = _priors(run, events, numbers, rest)
    wheels = sd.shape[0]
    x, P, mem = np.zeros(N), np.zeros((N, N)), np.zeros(MEMORY)
    x[:3], P[:3, :3] = start.pose, start.covariance
    P[range(3, wheels), range(3, wheels)] = np.square(sd[3:])
    begin = float(events.t[0]) if len(events.t) else 0.0
    mem[[T, STARTED, T_OFFSET]] = begin
    mem[[T_IMU, T_WHEEL, T_FIX, T_RANGE]] = -1.0
    mem[[T_STRANGE, T_TRUST]] = -1e9, begin
    active = np.flatnonzero(np.diag(P) > 0)
    n = max(int(active[-1]) + 1 if active.size else 0, PHI + 1)
    return Problem(n, _constants(run, events, numbers, rest), State(x, P, mem, np.zeros((PAST, SEEN))))


def _priors(run: Run, events: Events, numbers: Assumptions, rest: Rest | None) -> Array:
    """(N,) standard deviations at the start of all but the pose; 0 freezes what this run cannot show."""
    gyro, track = rest is not None, run.meta.robot.track_width is not None
    ranged, absolute = bool(events.of(RANGE).any()), bool(events.of(FIX, RANGE).any())
    sd = np.zeros(N)
    sd[V] = START_SPEED
    sd[B] = numbers.bias_sd if gyro else START_TURN
    sd[KD] = numbers.distance_scale_sd
    sd[[KE, KB]] = numbers.inequality_sd * track, numbers.track_scale_sd * track
    sd[KG], sd[BA] = numbers.gyro_scale_sd * gyro, numbers.accel_bias_sd * has_accelerometer(run, rest)
    sd[DT] = numbers.delay_sd * absolute
    sd[[KR, BR]] = (numbers.range_scale_sd, numbers.range_bias_sd) if ranged else (0.0, 0.0)
    first = events.first_offset
    if numbers.lasting_range > 0 and ranged and first + len(events.lasting) < N:
        sd[first : first + len(events.lasting)] = numbers.lasting_range
    offsets = events.data[events.kind == FIX, 3]
    if offsets.size and offsets[0] > 0:
        sd[int(offsets[0]) : int(offsets[0]) + 2] = numbers.lasting_fix
    return sd


def has_accelerometer(run: Run, rest: Rest | None) -> bool:
    """Whether the acceleration along the body is known."""
    imu = run.imu
    return rest is not None and imu is not None and imu.ax is not None and bool(np.isfinite(imu.ax).any())


def _constants(run: Run, events: Events, numbers: Assumptions, rest: Rest | None) -> Array:
    robot = run.meta.robot
    quantum = encoder_quantum(run, numbers) * float(robot.wheel_radius or 0.0)
    inverse_track = 1.0 / robot.track_width if robot.track_width else 0.0
    imu = run.imu if rest is not None else None
    hold, rate = 0.0, 0.0
    if imu is not None:  # both take a while: not anew for each trial
        hold = events.hold if events.hold is not None else longest_hold(np.diff(imu.t, prepend=imu.t[0]))
        rate = events.rate if events.rate is not None else imu.rate
    lasting = numbers.lasting_range if events.of(RANGE).any() else numbers.lasting_fix
    constants = Constants(
        has_gyro=imu is not None,
        has_accel=has_accelerometer(run, rest),
        inverse_track=inverse_track,
        tag_x=robot.tag.x,
        tag_y=robot.tag.y,
        tag_z=robot.tag.z,
        tau=numbers.memory,
        silence=events.silence,
        hold=hold,
        q_pause=numbers.pause_rate**2,
        q_speed=numbers.accel**2,
        q_accel=numbers.accel_noise**2,
        q_tilt=numbers.tilt_walk**2,
        q_turn=numbers.turn_accel**2,
        q_gyro=numbers.gyro_density**2 / 2,
        q_bias=numbers.bias_walk**2,
        q_scale=numbers.parameter_walk**2,
        q_slip=numbers.slip**2,
        q_side=numbers.side_slip**2,
        q_skid=numbers.skid**2 * SKID_TIME,
        q_slide=numbers.slide**2,
        q_carried=numbers.carried**2,
        q_carried_turn=numbers.carried_turn**2,
        r_distance=quantum**2 / 24,
        r_turn=quantum**2 / 6 * inverse_track**2,
        r_rate=rest.gyro_sd**2 if rest is not None else 1.0,
        r_still=STILL_SPEED**2,
        r_fix=numbers.fix_xy**2,
        r_fix_theta=numbers.fix_theta**2,
        r_range=numbers.range**2,
        offset_var=lasting**2,
        offset_tau=max(numbers.lasting_time, 1e-3),
        first_offset=events.first_offset,
        gate1=chi2_gate(1, numbers),
        gate2=chi2_gate(2, numbers),
        gate3=chi2_gate(3, numbers),
        patience=numbers.reaccept,
        patience_rest=numbers.reaccept * rate / 2,
        stubborn=numbers.stubborn,
        leap=numbers.leap,
        coast=numbers.coast,
        clock_var=numbers.clock**2
        + (0.25 / rate if rate > 0 else 0.0) ** 2,  # a reading may be the mean of its interval
    )
    return np.array(constants, np.float64)


def tracks(events: Events) -> Tracks:
    """Room for what a walk over the events writes."""
    e, m = len(events.t), len(events.out)
    return Tracks(
        np.full((e, 2), np.nan), np.zeros((e, 2), np.int8), np.empty((m, 5)), np.empty((m, 3, 3)),
        np.full((e, 2), np.nan),
    )  # fmt: skip


def _walked(out: Tracks, state: State) -> Walk:
    rows = out.rows
    return Walk(
        out.nis, out.status, rows[:, :3], out.covariance, rows[:, 3], rows[:, 4], state.x, state.P, score=out.score
    )


def walk(p: Problem, events: Events, disturbances: Disturbances | None = None) -> Walk:
    """The causal walk over all events."""
    out, state, end = tracks(events), p.begin.copy(), len(events.t)
    if disturbances is None or not disturbances.found:
        p.step(events, 0, end, state, out)
        return _walked(out, state)
    live, aside = flagged(events, disturbances.live(events.t)), tracks(events)
    onset = np.searchsorted(events.t, [d.t0 for d in disturbances.found], "left")
    alarm = np.searchsorted(events.t, [d.alarm for d in disturbances.found], "left")
    saved: dict[int, State] = {}
    at = 0
    for stop in sorted({*onset.tolist(), *alarm.tolist(), end}):
        p.step(live, at, stop, state, out)
        at = stop
        mine = np.flatnonzero((alarm == stop) & (onset < stop))
        if mine.size:
            begin = int(onset[mine].min())
            _tell(live, disturbances, begin, stop)
            state = _again(p, live, saved, begin, stop, aside)
        saved[stop] = state.copy()
    return _walked(out, state)


def _tell(live: Events, disturbances: Disturbances, begin: int, stop: int) -> None:
    """Mark events begin .. stop with what is known at `stop`; a disturbance that is not released yet goes on."""
    now = live.t[min(stop, len(live.t) - 1)]
    known = [d for d in disturbances.found if d.alarm <= now]
    dated = tuple(dataclasses.replace(d, t1=d.t1 if d.release <= now else np.inf) for d in known)
    span = live.kept(slice(begin, stop))
    live.flags[begin:stop] = flagged(span, Disturbances(dated).dated(span.t)).flags


def _again(p: Problem, live: Events, saved: dict[int, State], begin: int, stop: int, aside: Tracks) -> State:
    """From event `begin` to the present once more; states saved in between are saved anew."""
    state, at = saved[begin].copy(), begin
    for between in sorted(k for k in saved if begin < k < stop):
        p.step(live, at, between, state, aside)
        saved[between], at = state.copy(), between
    p.step(live, at, stop, state, aside)
    return state


def flagged(events: Events, flags: Flags) -> Events:
    """The events with what is not to be believed marked. Where something happens while the wheels stand, something else
    than the wheels moves the robot."""
    bits = events.flags.copy()
    pairs = (
        (flags.left, LEFT), (flags.right, RIGHT), (flags.turn, TURN), (flags.accelerometer, ACCEL),
        (flags.stopped, STOPPED),
    )  # fmt: skip
    for column, bit in pairs:
        bits[column] |= bit
    bits[(bits & STRANGE != 0) & (bits & STILL != 0)] |= CARRIED
    return dataclasses.replace(events, flags=bits)


def smooth(p: Problem, events: Events, disturbances: Disturbances | None = None) -> tuple[Walk, Walk]:
    """The filter with hindsight about disturbances, and the path smoothed back from its end: (filtered, smoothed).

    Where later readings show that the robot leapt between them as no sensor has felt (wheels that spin on wet grass),
    both walk once more with that place left open.
    """
    if disturbances is not None:
        events = flagged(events, disturbances.dated(events.t))
    forward, back, shock = _both_ways(p, events)
    leaps: tuple[Leap, ...] = ()
    for _ in range(LEAP_ROUNDS):
        fresh = _leaps(events.out, shock, leaps)
        if not fresh:
            break
        leaps = (*leaps, *fresh)
        events = _opened(events, leaps)
        forward, back, shock = _both_ways(p, events)
    return forward, dataclasses.replace(back, leaps=tuple(sorted(leaps, key=lambda leap: leap.t)))


def _leaps(t: Array, shock: Array, known: tuple[Leap, ...]) -> tuple[Leap, ...]:
    """The peaks above LEAP, one of each hill, away from those that are known."""
    high = shock[:, 2] > LEAP / 2
    begin = np.flatnonzero(high & ~np.concatenate(([False], high[:-1])))
    end = np.flatnonzero(high & ~np.concatenate((high[1:], [False]))) + 1
    peaks = [a + int(np.argmax(shock[a:b, 2])) for a, b in zip(begin, end, strict=True)]
    return tuple(
        Leap(float(t[i]), float(shock[i, 0]), float(shock[i, 1]), float(shock[i, 2]))
        for i in peaks
        if shock[i, 2] > LEAP and all(abs(leap.t - t[i]) > LEAP_APART for leap in known)
    )


def _opened(events: Events, leaps: tuple[Leap, ...]) -> Events:
    data, rows = events.data.copy(), np.flatnonzero(events.kind == OUT)
    for leap in leaps:
        data[rows[int(np.searchsorted(events.out, leap.t))], LEAP_VAR] = (leap.x**2 + leap.y**2) / 2
    return dataclasses.replace(events, data=data)


def _both_ways(p: Problem, events: Events) -> tuple[Walk, Walk, Array]:
    """Forward and smoothed walk, and the shock (M, 3) at each row."""
    from core.estimation.fusion._smoother_numba import walk_back

    out, state, end = tracks(events), p.begin.copy(), len(events.t)
    cuts = list(range(0, end, STRETCH))
    saved = []
    for cut in cuts:
        saved.append(state.copy())
        p.step(events, cut, min(cut + STRETCH, end), state, out)
    forward = _walked(out._replace(rows=out.rows.copy(), covariance=out.covariance.copy()), state)
    lam, L, work, gyro = np.zeros(N), np.zeros(N * N), np.zeros(4 * N), bool(p.constants[HAS_GYRO])
    shock = np.zeros((len(events.out), 3))
    recs = (records(STRETCH, STRETCH), records(STRETCH, STRETCH))
    rows = [begun.row for begun in saved] + [len(events.out)]
    with ThreadPoolExecutor(1) as ahead:  # the stretch before is recorded while this one is walked back

        def recorded(k: int) -> Future[None]:
            cut = cuts[k]
            return ahead.submit(p.step, events, cut, min(cut + STRETCH, end), saved[k], out, recs[k % 2])

        ready = recorded(len(cuts) - 1) if cuts else None
        for k in range(len(cuts) - 1, -1, -1):
            assert ready is not None
            ready.result()
            ready = recorded(k - 1) if k else None
            cut, last = cuts[k], min(cuts[k] + STRETCH, end)
            walk_back(
                cut, last, rows[k + 1], rows[k], events.kind, lam, L, p.n, gyro, events.first_offset, recs[k % 2], out,
                shock, work,
            )  # fmt: skip
    return forward, _walked(out, state), shock
