"""The compiled filter against filterpy on the same problem, and the rules of its own that filterpy does not know."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from core.estimation.fusion._filter_numba import ACCEPTED, FIX, OUT, RANGE, REJECTED, WHEEL, Constants, run_filter

X, Y, TH, S, PHI, V, B, KG, KD, KE, KB, KR, BR = range(13)
N = 13

BASE = Constants(
    has_gyro=1.0, inverse_track=1 / 0.32, tag_x=0.1, tag_y=0.05, tag_z=0.4, tau=2.0, q_speed=1.0, q_turn=4.0,
    q_gyro=1e-5, q_bias=1e-8, q_scale=1e-9, q_slip=1e-4, q_side=2.5e-5, r_distance=1e-6, r_turn=1e-5, r_rate=4e-5,
    r_still=1e-6, r_fix=1.6e-3, r_fix_theta=9e-4, r_range=2.5e-3, top_speed=10.0, gate1=1e9, gate2=1e9, gate3=1e9,
    patience=5.0, patience_rest=50.0,
)  # fmt: skip
PRIOR = np.diag([1e-2, 1e-2, 1e-2, 0.0, 0.0, 0.25, 1e-4, 2.5e-5, 1e-4, 1e-5, 1e-3, 1e-3, 4e-2])


def events(seed: int, count: int = 120, *, kinds: tuple[int, ...] = (OUT, WHEEL, FIX, RANGE)) -> dict[str, Any]:
    """A sound log: a robot on a wide curve, read by everything."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.002, 0.02, count))
    kind = rng.choice(kinds, count)
    kind[0] = WHEEL
    v, w, noise = 0.5, 0.3, rng.standard_normal((count, 4))
    theta = w * t
    x, y = v / w * np.sin(theta), v / w * (1 - np.cos(theta))
    tag_x, tag_y = x + 0.1 * np.cos(theta) - 0.05 * np.sin(theta), y + 0.1 * np.sin(theta) + 0.05 * np.cos(theta)
    data = np.zeros((count, 4))
    wheel_t = 0.0
    for e in range(count):
        if kind[e] == WHEEL:
            data[e] = (v * t[e] + 1e-3 * noise[e, 0], w * t[e] + 3e-3 * noise[e, 1], t[e] - wheel_t, 0)
            wheel_t = t[e]
        elif kind[e] == FIX:
            heading = theta[e] + 0.03 * noise[e, 2] if e % 2 else np.nan
            data[e] = (tag_x[e] + 0.04 * noise[e, 0], tag_y[e] + 0.04 * noise[e, 1], heading, 0)
        elif kind[e] == RANGE:
            beacon = np.array([(3.0, -2.0, 2.5), (-2.0, 4.0, 2.3)][e % 2])
            far = np.linalg.norm(np.array((tag_x[e], tag_y[e], 0.4)) - beacon)
            data[e] = (*beacon, far + 0.05 * noise[e, 0])
        else:
            data[e, 0] = w
    return {
        "dt": np.diff(t, prepend=t[0]),
        "kind": kind.astype(np.int64),
        "data": data,
        "raw": np.diff(theta, prepend=theta[0]),
        "q_extra": np.zeros(count),
        "flags": np.zeros((count, 3), bool),
    }


def walk(
    log: dict[str, Any], c: Constants = BASE, P0: np.ndarray = PRIOR, x0: np.ndarray | None = None
) -> dict[str, Any]:
    x = np.zeros(N) if x0 is None else x0.copy()
    x[V] = 0.5
    P, count, rows = P0.copy(), len(log["dt"]), int(np.sum(log["kind"] == OUT))
    nis, status = np.full((count, 2), np.nan), np.zeros((count, 2), np.int8)
    pose, covariance, bias, bias_var = np.empty((rows, 3)), np.empty((rows, 3, 3)), np.empty(rows), np.empty(rows)
    run_filter(
        log["dt"], log["kind"], log["data"], log["raw"], log["q_extra"], log["flags"], x, P, c,
        nis, status, pose, covariance, bias, bias_var,
    )  # fmt: skip
    return {"x": x, "P": P, "nis": nis, "status": status, "pose": pose, "covariance": covariance}


def motion(x: np.ndarray, dt: float, raw: float, c: Constants) -> np.ndarray:
    """The process model, written again; complex numbers go through it, so its Jacobian is exact to rounding."""
    out = x.copy()
    rate_turn = raw - x[B] * dt if c.has_gyro else -x[B] * dt
    w = rate_turn * (1 - x[KG])
    d = x[V] * dt
    chord = d * np.sin(w / 2) / (w / 2) if abs(w) > 1e-12 else d
    out[X] += chord * np.cos(x[TH] + w / 2)
    out[Y] += chord * np.sin(x[TH] + w / 2)
    out[TH] += w
    out[S] += d * (1 - x[KD])
    out[PHI] += w * (1 + x[KB]) - x[KE] * c.inverse_track * d
    return out


def jacobian(f: Any, x: np.ndarray) -> np.ndarray:
    h = 1e-30
    columns = [np.imag(f(x + 1j * h * np.eye(len(x))[i])) / h for i in range(len(x))]
    return np.column_stack(columns)


def process_noise(x: np.ndarray, dt: float, w: float, c: Constants) -> np.ndarray:
    """Speed as a random walk, gyro noise shared by heading and wheel turn, slip along, across and in turning."""
    d = x[V] * dt
    middle = x[TH] - w / 2  # x is already propagated
    u = np.array((np.cos(middle), np.sin(middle))) * (np.sin(w / 2) / (w / 2) if abs(w) > 1e-12 else 1.0)
    moves, across, along = np.zeros(N), np.zeros(N), np.zeros(N)
    moves[[X, Y, S]] = u[0], u[1], 1.0
    across[[X, Y]] = -u[1], u[0]
    along[[X, Y]] = u
    speed = np.zeros(N)
    speed[V] = 1.0
    turn = np.zeros(N)
    turn[[TH, PHI]] = 1.0, 1.0 + x[KB]
    Q = c.q_speed * (
        dt * np.outer(speed, speed)
        + dt**2 / 2 * (np.outer(moves, speed) + np.outer(speed, moves))
        + dt**3 / 3 * np.outer(moves, moves)
    )
    Q += c.q_side * abs(d) * np.outer(across, across) + c.q_slip / 2 * abs(d) * np.outer(along, along)
    Q += c.q_gyro * dt * np.outer(turn, turn)
    Q[B, B] += c.q_bias * dt
    Q[PHI, PHI] += 2 * c.q_slip * c.inverse_track * (abs(d) * c.inverse_track + abs(w) / 2)
    for i in (KG, KD, KE, KB, KR, BR):
        Q[i, i] += c.q_scale * dt
    return Q


def tag(x: np.ndarray, c: Constants) -> tuple[Any, Any]:
    cos, sin = np.cos(x[TH]), np.sin(x[TH])
    return x[X] + cos * c.tag_x - sin * c.tag_y, x[Y] + sin * c.tag_x + cos * c.tag_y


def expected(kind: int, a: np.ndarray, x: np.ndarray, c: Constants) -> np.ndarray:
    """What the sensor should read."""
    if kind == FIX:
        whole = (*tag(x, c), x[TH])
        return np.array(whole if np.isfinite(a[2]) else whole[:2])
    tx, ty = tag(x, c)
    far = np.sqrt((tx - a[0]) ** 2 + (ty - a[1]) ** 2 + (c.tag_z - a[2]) ** 2)
    return np.array([(1 + x[KR]) * far + x[BR]])


def with_filterpy(log: dict[str, Any], c: Constants) -> KalmanFilter:
    """The same walk by filterpy's textbook predict and update; the wheels' distance by Joseph's form, written out."""
    kf = KalmanFilter(dim_x=N, dim_z=1)
    kf.x, kf.P = np.zeros(N), PRIOR.copy()
    kf.x[V] = 0.5
    for e in range(len(log["dt"])):
        dt, kind, a = log["dt"][e], log["kind"][e], log["data"][e]
        if dt > 0:
            before, raw = kf.x.copy(), log["raw"][e]
            kf.F = jacobian(lambda x: motion(x, dt, raw, c), before.astype(complex))  # noqa: B023
            after = motion(before, dt, raw, c)
            kf.Q = process_noise(after, dt, after[TH] - before[TH], c)
            kf.predict()
            kf.x = after
        if kind == WHEEL and e == 0:
            kf.x[S], kf.x[PHI] = a[0], a[1]
            kf.P[S, S], kf.P[PHI, PHI] = c.r_distance, c.r_turn
        if kind == WHEEL:
            turn = kf.x[PHI]
            distance_alone(kf, a[0], c)
            H = np.zeros((1, N))
            H[0, PHI] = 1
            kf.update(a[1] - turn + turn, R=np.array([[c.r_turn]]), H=H)
        elif kind in (FIX, RANGE):
            H = jacobian(lambda x: expected(kind, a, x, c), kf.x.astype(complex))  # noqa: B023
            z = (a[: len(H)] if kind == FIX else a[3:4]) - expected(kind, a, kf.x, c) + H @ kf.x
            R = np.diag([c.r_fix, c.r_fix, c.r_fix_theta][: len(H)]) if kind == FIX else np.array([[c.r_range]])
            kf.dim_z = len(H)
            kf.update(z, R=R, H=H)
            kf.dim_z = 1
    return kf


def distance_alone(kf: KalmanFilter, z: float, c: Constants) -> None:
    """Schmidt's update: the motion along is corrected, with the gain for a known distance scale."""
    P, h = kf.P, np.eye(N)[S]
    known = P - np.outer(P[:, KD], P[KD]) / P[KD, KD]
    K = known @ h / (h @ known @ h + c.r_distance)
    K[[i for i in range(N) if i not in (X, Y, V, S)]] = 0.0
    kf.x = kf.x + K * (z - kf.x[S])
    A = np.eye(N) - np.outer(K, h)
    kf.P = A @ P @ A.T + c.r_distance * np.outer(K, K)


@pytest.mark.parametrize("seed", range(4))
def test_equal_to_filterpy_on_every_kind_of_reading(seed: int) -> None:
    log = events(seed)
    ours, theirs = walk(log), with_filterpy(log, BASE)
    assert np.all(np.linalg.eigvalsh(ours["P"]) > -1e-12)
    np.testing.assert_allclose(ours["x"], theirs.x, atol=1e-9, rtol=0)
    np.testing.assert_allclose(ours["P"], theirs.P, atol=1e-9, rtol=0)


def test_equal_to_filterpy_over_a_long_log_without_ranges() -> None:
    log = events(9, 1500, kinds=(OUT, WHEEL, FIX))
    ours, theirs = walk(log), with_filterpy(log, BASE)
    np.testing.assert_allclose(ours["x"], theirs.x, atol=1e-9, rtol=0)
    np.testing.assert_allclose(ours["P"], theirs.P, atol=1e-9, rtol=0)


def test_a_frozen_parameter_never_moves() -> None:
    P0 = PRIOR.copy()
    P0[KB, KB] = P0[KG, KG] = 0.0
    ours = walk(events(2), P0=P0)
    assert ours["x"][KB] == 0.0 and ours["x"][KG] == 0.0
    assert not ours["P"][KB].any() and not ours["P"][KG].any()


def test_covariance_stays_symmetric_and_positive() -> None:
    P = walk(events(3, 5000))["P"]
    np.testing.assert_allclose(P, P.T, rtol=1e-12, atol=1e-18)
    assert np.linalg.eigvalsh(P).min() > 0


def gated(log: dict[str, Any], **changes: float) -> dict[str, Any]:
    return walk(log, BASE._replace(gate1=10.83, gate2=13.82, gate3=16.27, **changes))


def test_one_wild_fix_is_refused_and_leaves_no_trace() -> None:
    log = events(5, 400, kinds=(OUT, WHEEL, FIX))
    last = int(np.flatnonzero(log["kind"] == FIX)[-1])
    wild, without = {k: v.copy() for k, v in log.items()}, {k: v.copy() for k, v in log.items()}
    wild["data"][last, :2] += 1.5
    without["data"][last] = 0.0
    without["kind"][last] = RANGE  # to a beacon at an impossible distance, refused as well
    without["data"][last] = (0.0, 0.0, 0.0, 900.0)
    a, b = gated(wild), gated(without)
    assert a["status"][last, 0] == REJECTED
    np.testing.assert_array_equal(a["x"], b["x"])
    np.testing.assert_array_equal(a["P"], b["P"])


def test_a_lasting_contradiction_is_believed_in_the_end() -> None:
    log = events(6, 600, kinds=(OUT, WHEEL, FIX))
    log["data"][:, 2] = np.where(log["kind"] == FIX, np.nan, log["data"][:, 2])
    late = (np.arange(600) > 300) & (log["kind"] == FIX)
    log["data"][late, 0] += 2.0
    found = gated(log)
    states = found["status"][late, 0]
    assert (states[:5] == REJECTED).all()
    assert np.mean(states[10:] == ACCEPTED) > 0.95
    honest = gated(events(6, 600, kinds=(OUT, WHEEL, FIX)))
    assert found["x"][X] - honest["x"][X] == pytest.approx(2.0, abs=0.15)


def test_headings_that_differ_by_whole_turns_are_the_same() -> None:
    log = events(7, 200, kinds=(OUT, WHEEL, FIX))
    turned = {k: v.copy() for k, v in log.items()}
    turned["data"][turned["kind"] == FIX, 2] += 6 * np.pi
    np.testing.assert_allclose(gated(log)["x"], gated(turned)["x"], atol=1e-9)


def test_a_jump_of_the_counter_is_not_motion() -> None:
    log = events(8, 300, kinds=(OUT, WHEEL))
    jumped = {k: v.copy() for k, v in log.items()}
    wheels = np.flatnonzero(log["kind"] == WHEEL)
    after = wheels[len(wheels) // 2 :]
    jumped["data"][after, 0] += 400.0
    jumped["flags"][after[0], 1] = True
    a, b = gated(log), gated(jumped)
    np.testing.assert_allclose(a["x"][[X, Y, TH]], b["x"][[X, Y, TH]], atol=0.02)
    assert b["status"][after[0], 0] == REJECTED


def test_wheels_alone_leave_every_scale_as_it_was() -> None:
    ours = walk(events(4, 400, kinds=(OUT, WHEEL)), BASE._replace(has_gyro=0.0))
    np.testing.assert_array_equal(ours["x"][[KD, KE, KB, KR, BR]], 0.0)
