"""The compiled filter and smoother against filterpy and plain algebra on the same problem, and the rules of its own."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from core.estimation.fusion.events import Events
from core.estimation.fusion.layout import (
    ACCEPTED,
    BA,
    BR,
    DT,
    FIX,
    JUMP,
    KB,
    KD,
    KE,
    KG,
    KR,
    MEMORY,
    OUT,
    PAST,
    PHI,
    RANGE,
    REJECTED,
    RELOCATED,
    REST,
    SEEN,
    T_FIX,
    T_IMU,
    T_STRANGE,
    T_WHEEL,
    TH,
    WHEEL,
    B,
    Constants,
    N,
    S,
    V,
    X,
    Y,
)  # fmt: skip
from core.estimation.fusion.walk import Problem, State, Walk, smooth, tracks, walk

NEVER = 1e9
BASE = Constants(
    has_gyro=1.0, has_accel=1.0, inverse_track=1 / 0.32, tag_x=0.1, tag_y=0.05, tag_z=0.4, tau=2.0, silence=NEVER,
    hold=NEVER, q_pause=0.09, q_speed=1.0, q_accel=0.01, q_tilt=4e-4, q_turn=4.0, q_gyro=1e-5, q_bias=1e-8,
    q_scale=1e-9, q_slip=1e-4, q_side=2.5e-5, q_skid=0.0, q_slide=1.6e-3, q_carried=0.5, q_carried_turn=2.5e-3,
    r_distance=1e-6, r_turn=1e-5, r_rate=4e-5, r_still=1e-6, r_fix=1.6e-3, r_fix_theta=9e-4, r_range=2.5e-3,
    offset_var=0.0, offset_tau=10.0, first_offset=15.0, gate1=1e9, gate2=1e9, gate3=1e9, patience=5.0,
    patience_rest=50.0, stubborn=60.0, leap=3.0, coast=NEVER,
)  # fmt: skip
GATED = BASE._replace(gate1=10.83, gate2=13.82, gate3=16.27)
PRIOR = np.diag([1e-2, 1e-2, 1e-2, 0.25, 1e-4, 0, 0, 1e-4, 1e-5, 1e-3, 2.5e-5, 4e-2, 9e-4, 1e-3, 4e-2])
ALL = (OUT, WHEEL, FIX, RANGE)


def events(seed: int, count: int = 120, kinds: tuple[int, ...] = ALL) -> Events:
    """A sound log: a robot on a wide curve, read by everything."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.002, 0.02, count))
    kind = rng.choice(kinds, count).astype(np.int64)
    kind[0] = OUT
    v, w, noise = 0.5, 0.3, rng.standard_normal((count, 4))
    theta = w * t
    x, y = v / w * np.sin(theta), v / w * (1 - np.cos(theta))
    cos, sin = np.cos(theta), np.sin(theta)
    tag_x, tag_y = x + 0.1 * cos - 0.05 * sin, y + 0.1 * sin + 0.05 * cos
    beacon = np.array([(3.0, -2.0, 2.5), (-2.0, 4.0, 2.3)])[np.arange(count) % 2]
    far = np.sqrt((tag_x - beacon[:, 0]) ** 2 + (tag_y - beacon[:, 1]) ** 2 + (0.4 - beacon[:, 2]) ** 2)
    zero = np.zeros(count)
    heading = np.where(np.arange(count) % 2, theta + 0.03 * noise[:, 2], np.nan)
    of = {
        WHEEL: (v * t + 1e-3 * noise[:, 0], w * t + 3e-3 * noise[:, 1], zero, zero, zero),
        FIX: (tag_x + 0.04 * noise[:, 0], tag_y + 0.04 * noise[:, 1], heading, zero, zero),
        RANGE: (*beacon.T, far + 0.05 * noise[:, 0], zero),
        OUT: (w + 0.01 * noise[:, 0], 0.05 * noise[:, 1], zero, zero, zero),
    }
    data = np.zeros((count, 5))
    for k, columns in of.items():
        data[kind == k] = np.column_stack(columns)[kind == k]
    return Events(t, kind, data, np.zeros(count, np.int64), t[kind == OUT], first_offset=15)


def ready(c: Constants = BASE, P0: np.ndarray = PRIOR, n: int = 15, begin: float = 0.0) -> Problem:
    """The filter at rest in its prior, moving at 0.5 m/s."""
    x, P, mem = np.zeros(N), np.zeros((N, N)), np.zeros(MEMORY)
    x[V], P[:15, :15] = 0.5, P0
    mem[[T_IMU, T_WHEEL, T_FIX]], mem[T_STRANGE], mem[0] = -1.0, -1e9, begin
    return Problem(n, np.array(c, np.float64), State(x, P, mem, np.zeros((PAST, SEEN))))


def test_a_reading_at_the_imus_own_stamp_delays_nothing() -> None:
    """A gyro whose rate grows: half of its steps end at a wheel reading's stamp, which comes first."""
    t, alpha = np.arange(101) * 0.01, 0.8
    zero = np.zeros(101)
    imu = np.column_stack((alpha * t, zero, zero, zero, zero))
    wheel = np.column_stack((0.5 * t, zero + np.nan, zero, zero, zero))[::2]
    stamps, kind = np.concatenate((t[::2], t)), np.repeat((WHEEL, OUT), (51, 101))
    order = np.argsort(stamps, kind="stable")
    log = Events(stamps[order], kind[order], np.concatenate((wheel, imu))[order], np.zeros(152, np.int64), t)
    heading = walked(log).pose[:, 2]
    np.testing.assert_allclose(heading[1::2], alpha / 2 * t[1::2] ** 2, atol=1e-12)


def test_turning_before_the_first_tick_is_made_up_for() -> None:
    """Rest is told by counters that have not ticked: for 0.1 s the robot turns already, held to be at rest."""
    t = np.arange(201) * 0.01
    rate = np.where(t > 0.9, 0.1, 0.0)
    zero, resting = np.zeros(201), np.where(t < 1.0, REST, 0)
    prior = PRIOR.copy()
    prior[B, B] = 1e-12
    log = Events(t, np.full(201, OUT), np.column_stack((rate, zero, zero, zero, zero)), resting, t)
    heading = walked(log, P0=prior).pose[:, 2]
    assert heading[99] == 0.0
    assert heading[-1] == pytest.approx(0.1 * 1.095, abs=0.0015)


def walked(log: Events, c: Constants = BASE, P0: np.ndarray = PRIOR, n: int = 15) -> Walk:
    return walk(ready(c, P0, n, float(log.t[0])), log)


def motion(x: np.ndarray, dt: float, raw: float, dv: float, c: Constants) -> np.ndarray:
    """The process model, written again; complex numbers go through it, so its Jacobian is exact to rounding."""
    out = x.copy()
    change = dv - x[BA] * dt if c.has_accel else 0.0
    d = (x[V] + change / 2) * dt
    if c.has_gyro:
        w = (raw - x[B] * dt) * (1 - x[KG])
        phi = w * (1 + x[KB]) - x[KE] * c.inverse_track * d
    else:
        phi = -x[B] * dt
        w = (phi + x[KE] * c.inverse_track * d) * (1 - x[KB])
    half = w / 2
    chord = d * (1 + x[KD]) * (np.sin(half) / half if abs(half) > 1e-12 else 1.0)
    out[X] += chord * np.cos(x[TH] + half)
    out[Y] += chord * np.sin(x[TH] + half)
    out[TH] += w
    out[V] += change
    out[S] += d
    out[PHI] += phi
    return out


def jacobian(f: Any, x: np.ndarray) -> np.ndarray:
    h = 1e-30
    return np.column_stack([np.imag(f(x.astype(complex) + 1j * h * e)) / h for e in np.eye(len(x))])


def process_noise(x: np.ndarray, dt: float, w: float, d: float, c: Constants) -> np.ndarray:
    """Speed as a random walk, gyro noise shared by heading and wheel turn, slip along, across and in turning."""
    body, ib, Q = abs(d * (1 + x[KD])), c.inverse_track, np.zeros((15, 15))
    chord = np.sin(w / 2) / (w / 2) if abs(w) > 1e-12 else 1.0
    u = chord * np.array((np.cos(x[TH] + w / 2), np.sin(x[TH] + w / 2)))

    def direction(**parts: float) -> np.ndarray:
        return np.array([parts.get(name, 0.0) for name in ("x", "y", "th", "v", "b", "s", "phi")] + [0.0] * 8)

    def outer(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.outer(a, b) + np.outer(b, a)

    speed, moves = direction(v=1), direction(x=u[0], y=u[1], s=1)
    q = c.q_accel if c.has_accel else c.q_speed
    Q += q * (dt * outer(speed, speed) / 2 + dt**2 / 2 * outer(moves, speed) + dt**3 / 6 * outer(moves, moves))
    across, along = direction(x=-u[1], y=u[0]), direction(x=u[0], y=u[1])
    Q += body * (c.q_side * np.outer(across, across) + c.q_slip / 2 * np.outer(along, along))
    slip = 2 * c.q_slip * ib * (body * ib + abs(w) / 2)
    if c.has_gyro:
        turn, wheel = direction(th=1, phi=1 + x[KB]), direction(phi=1)
        Q += c.q_gyro * dt * np.outer(turn, turn) + slip * np.outer(wheel, wheel)
        Q[B, B] += c.q_bias * dt
    else:
        rate, turn, body_turn = direction(b=-1), direction(th=1 - x[KB], phi=1), direction(th=1)
        Q += c.q_turn * (dt * outer(rate, rate) / 2 + dt**2 / 2 * outer(turn, rate) + dt**3 / 6 * outer(turn, turn))
        Q += slip * np.outer(body_turn, body_turn)
    for i in (KD, KE, KB, KG, BA, DT, KR, BR):
        Q[i, i] += (c.q_tilt if i == BA else c.q_scale) * dt
    return Q


def expected(kind: int, a: np.ndarray, x: np.ndarray, rate: float, c: Constants) -> np.ndarray:
    """What the sensor should read, a while ago; `rate` is the gyro's last reading."""
    if kind == WHEEL:
        return np.array((x[S], x[PHI]))
    cos, sin = np.cos(x[TH]), np.sin(x[TH])
    arm = np.array((cos * c.tag_x - sin * c.tag_y, sin * c.tag_x + cos * c.tag_y))
    tag = x[:2] + arm - x[DT] * (x[V] * np.array((cos, sin)) + rate * np.array((-arm[1], arm[0])))
    if kind == FIX:
        whole = (*tag, x[TH] - x[DT] * rate)
        return np.array(whole if np.isfinite(a[2]) else whole[:2])
    far = np.sqrt((tag[0] - a[0]) ** 2 + (tag[1] - a[1]) ** 2 + (c.tag_z - a[2]) ** 2)
    return np.array([(1 + x[KR]) * far + x[BR]])


class Oracle:
    """The same walk by filterpy's textbook predict and update; keeps what a textbook smoother needs."""

    def __init__(self, log: Events, c: Constants, P0: np.ndarray = PRIOR) -> None:
        self.kf = KalmanFilter(dim_x=15, dim_z=1)
        self.kf.x, self.kf.P = np.zeros(15), P0.copy()
        self.kf.x[V] = 0.5
        self.before: list[Any] = []
        self.after: list[Any] = []
        self.F: list[np.ndarray] = []
        last, imu, used = log.t[0], None, np.zeros(2)
        started = False
        for t, kind, a in zip(log.t, log.kind, log.data, strict=True):
            total = np.zeros(2)
            if imu is not None:
                total = 0.5 * (imu[1] + a[:2]) * (t - imu[0]) if kind == OUT else imu[1] * (t - imu[0])
            raw, dv = (total - used) * c.has_gyro
            used = total
            if kind == OUT:
                imu, used = (t, a[:2].copy()), np.zeros(2)
            self.carry(t - last, raw, dv if imu is not None else 0.0, c if imu is not None else c._replace(has_accel=0))
            last = t
            if kind == WHEEL and not started:
                started = True
                self.anchor(a, c)
            if kind != OUT:
                self.measure(kind, a, imu[1][0] * c.has_gyro if imu is not None else 0.0, c)
            self.after.append((self.kf.x.copy(), self.kf.P.copy()))

    def carry(self, dt: float, raw: float, dv: float, c: Constants) -> None:
        kf, x = self.kf, self.kf.x.copy()
        F = np.eye(15)
        if dt > 0:
            F = jacobian(lambda z: motion(z, dt, raw, dv, c), x)
            after = motion(x, dt, raw, dv, c)
            kf.F, kf.Q = F, process_noise(x, dt, after[TH] - x[TH], after[S] - x[S], c)
            kf.predict()
            kf.x = after
        self.F.append(F)
        self.before.append((kf.x.copy(), kf.P.copy()))

    def anchor(self, a: np.ndarray, c: Constants) -> None:
        forget = np.eye(15)
        forget[S, S] = forget[PHI, PHI] = 0.0
        self.F[-1] = forget @ self.F[-1]
        self.kf.x[S], self.kf.x[PHI] = a[0], a[1]
        self.kf.P = forget @ self.kf.P @ forget
        self.kf.P[S, S], self.kf.P[PHI, PHI] = c.r_distance, c.r_turn
        self.before[-1] = (self.kf.x.copy(), self.kf.P.copy())

    def measure(self, kind: int, a: np.ndarray, rate: float, c: Constants) -> None:
        kf = self.kf
        h = expected(kind, a, kf.x, rate, c)
        H = jacobian(lambda z: expected(kind, a, z, rate, c), kf.x)
        z = a[3:4] if kind == RANGE else a[: len(h)]
        R = {WHEEL: (c.r_distance, c.r_turn), FIX: (c.r_fix, c.r_fix, c.r_fix_theta), RANGE: (c.r_range,)}[kind]
        kf.dim_z = len(h)
        kf.update(z - h + H @ kf.x, R=np.diag(R[: len(h)]), H=H)
        kf.dim_z = 1

    def smoothed(self) -> list[Any]:
        """Rauch, Tung, Striebel over the stored predictions."""
        found = [self.after[-1]]
        for k in range(len(self.after) - 2, -1, -1):
            (x, P), (xp, Pp), F = self.after[k], self.before[k + 1], self.F[k + 1]
            C = P @ F.T @ np.linalg.pinv(Pp, rcond=1e-14, hermitian=True)
            xs, Ps = found[-1]
            found.append((x + C @ (xs - xp), P + C @ (Ps - Pp) @ C.T))
        return found[::-1]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("gyro", [1.0, 0.0])
def test_equal_to_filterpy_on_every_kind_of_reading(seed: int, gyro: float) -> None:
    log, c = events(seed), BASE._replace(has_gyro=gyro, has_accel=gyro)
    P0 = PRIOR.copy()
    if not gyro:
        P0[KG, KG] = P0[BA, BA] = 0.0
        c = c._replace(q_tilt=0.0)
    ours, theirs = walked(log, c, P0), Oracle(log, c, P0).kf
    free = [i for i in range(15) if P0[i, i] > 0 or i in (S, PHI)]
    assert np.all(np.linalg.eigvalsh(ours.P) > -1e-12)
    np.testing.assert_allclose(ours.x[free], theirs.x[free], atol=1e-9, rtol=0)
    np.testing.assert_allclose(ours.P[np.ix_(free, free)], theirs.P[np.ix_(free, free)], atol=1e-9, rtol=0)


def test_equal_to_filterpy_over_a_long_log() -> None:
    log = events(9, 1500, (OUT, WHEEL, FIX))
    ours, theirs = walked(log), Oracle(log, BASE).kf
    np.testing.assert_allclose(ours.x[:15], theirs.x, atol=1e-9, rtol=0)
    np.testing.assert_allclose(ours.P[:15, :15], theirs.P, atol=1e-9, rtol=0)


def test_smoother_equal_to_the_textbook_one() -> None:
    """Bryson and Frazier's form against Rauch, Tung and Striebel's, on 400 steps of everything."""
    log = events(11, 400)
    oracle = Oracle(log, BASE)
    forward, back = smooth(ready(begin=float(log.t[0])), log)
    rows = np.flatnonzero(log.kind == OUT)
    theirs = oracle.smoothed()
    x = np.array([theirs[k][0][[X, Y, TH, B]] for k in rows])
    P = np.array([theirs[k][1][:3, :3] for k in rows])
    np.testing.assert_allclose(np.column_stack((back.pose, back.bias)), x, atol=1e-6, rtol=0)
    np.testing.assert_allclose(back.covariance, P, atol=1e-6, rtol=0)
    assert (back.covariance[:-1, 0, 0] <= forward.covariance[:-1, 0, 0] + 1e-12).all()
    np.testing.assert_array_equal(forward.pose, walked(log).pose)


@pytest.mark.parametrize("piece", [1, 7, 1000])
def test_pieces_give_what_one_walk_gives(piece: int) -> None:
    log, p = events(3, 1500), ready(GATED)
    whole, state, out = walk(p, log), p.begin.copy(), tracks(log)
    for begin in range(0, len(log.t), piece):
        p.step(log, begin, min(begin + piece, len(log.t)), state, out)
    np.testing.assert_array_equal(out.rows[:, :3], whole.pose)
    np.testing.assert_array_equal(out.status, whole.status)
    np.testing.assert_array_equal(state.P, whole.P)


def test_fewer_states_are_the_same_filter_with_the_others_known() -> None:
    """Five states, no wheels: equal to all states with the others' variance zero."""
    log = events(4, 600, (OUT, FIX))
    P0 = PRIOR.copy()
    P0[5:] = 0.0
    five, all_of_them = walked(log, BASE, P0, 5), walked(log, BASE._replace(q_scale=0.0), P0, 15)
    np.testing.assert_allclose(five.pose, all_of_them.pose, atol=1e-12)
    np.testing.assert_allclose(five.P[:5, :5], all_of_them.P[:5, :5], atol=1e-12)


def test_a_frozen_parameter_never_moves() -> None:
    P0 = PRIOR.copy()
    P0[KB, KB] = P0[KG, KG] = 0.0
    ours = walked(events(2), P0=P0)
    assert ours.x[KB] == 0.0 and ours.x[KG] == 0.0
    assert not ours.P[KB].any() and not ours.P[KG].any()


def test_covariance_stays_symmetric_and_positive() -> None:
    P = walked(events(3, 5000)).P[:15, :15]
    np.testing.assert_allclose(P, P.T, rtol=1e-9, atol=1e-15)
    assert np.linalg.eigvalsh(P).min() > 0


def last_fix(log: Events) -> int:
    return int(np.flatnonzero(log.kind == FIX)[-1])


def test_one_wild_fix_is_refused_and_leaves_no_trace() -> None:
    log = events(5, 400, (OUT, WHEEL, FIX))
    last = last_fix(log)
    wild = log.data.copy()
    wild[last, :2] += 1.5
    a = walked(dataclasses.replace(log, data=wild), GATED)
    without, kind = log.data.copy(), log.kind.copy()
    without[last], kind[last] = (0.0, 0.0, 0.0, 900.0, 0.0), RANGE  # to a beacon much too far away, refused as well
    b = walked(dataclasses.replace(log, data=without, kind=kind), GATED)
    assert a.status[last, 0] == b.status[last, 0] == REJECTED
    np.testing.assert_array_equal(a.x, b.x)
    np.testing.assert_array_equal(a.P, b.P)


def moved_fixes(by: float, *, gap: bool) -> Events:
    """The fixes of the second half lie elsewhere, after a pause of theirs or without one."""
    log = events(6, 1200, (OUT, WHEEL, FIX))
    late = log.t > log.t[600]
    log.data[late & (log.kind == FIX), 0] += by
    kept = (log.kind != FIX) | ~late | (log.t > log.t[600] + 1.5)
    return log.kept(kept) if gap else log


def test_a_lasting_contradiction_after_a_pause_is_believed_in_the_end() -> None:
    log = moved_fixes(2.0, gap=True)
    found = walked(log, GATED)
    states = found.status[log.kind == FIX, 0]
    first = int(np.flatnonzero(states == REJECTED)[0])
    assert (states[first : first + 4] == REJECTED).all() and states[first + 4] == RELOCATED
    assert np.mean(states[first + 5 :] == ACCEPTED) > 0.9
    honest = walked(events(6, 1200, (OUT, WHEEL, FIX)), GATED)
    assert found.pose[-1, 0] - honest.pose[-1, 0] == pytest.approx(2.0, abs=0.15)


def test_fixes_that_leap_while_nothing_shakes_the_robot_are_lies() -> None:
    log = moved_fixes(2.0, gap=False)
    found, honest = walked(log, GATED), walked(events(6, 1200, (OUT, WHEEL, FIX)), GATED)
    assert (found.status[(log.kind == FIX) & (log.t > log.t[600]), 0] == REJECTED).all()
    np.testing.assert_allclose(found.pose[-1], honest.pose[-1], atol=0.15)


def test_headings_that_differ_by_whole_turns_are_the_same() -> None:
    log = events(7, 200, (OUT, WHEEL, FIX))
    turned = log.data.copy()
    turned[log.kind == FIX, 2] += 6 * np.pi
    other = dataclasses.replace(log, data=turned)
    np.testing.assert_allclose(walked(log, GATED).x, walked(other, GATED).x, atol=1e-9)


def test_a_jump_of_the_counter_is_not_motion() -> None:
    log = events(8, 300, (OUT, WHEEL))
    wheels = np.flatnonzero(log.kind == WHEEL)
    after = wheels[len(wheels) // 2 :]
    jumped = dataclasses.replace(log, data=log.data.copy(), flags=log.flags.copy())
    jumped.data[after, 0] += 400.0
    jumped.flags[after[0]] = JUMP
    a, b = walked(log, GATED), walked(jumped, GATED)
    np.testing.assert_allclose(a.x[[X, Y, TH]], b.x[[X, Y, TH]], atol=0.02)
    assert b.status[after[0], 0] == REJECTED


def test_wheels_alone_leave_every_scale_as_it_was() -> None:
    ours = walked(events(4, 400, (OUT, WHEEL)), BASE._replace(has_gyro=0.0, has_accel=0.0))
    np.testing.assert_array_equal(ours.x[[KD, KE, KB, KR, BR]], 0.0)
