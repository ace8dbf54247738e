"""Estimators stepped over pieces of a run give what they give over the whole of it."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator

import numpy as np
import pytest

from core.estimation import odometry
from core.estimation.events import Disturbances
from core.estimation.events.disturbances import Disturbance
from core.estimation.fusion.events import merge
from core.estimation.fusion.layout import R_FIX
from core.estimation.fusion.walk import Walk, flagged, problem, walk
from core.estimation.pipeline import estimate
from core.estimation.published import signals
from core.estimation.rest import Rest, at_rest
from core.imu.bias import track_bias
from core.live import LiveEstimator, Step
from core.live.pieces import pieces
from core.live.recent import joined
from core.live.virtual import META, VirtualRobot
from core.run import Run
from core.simulation import simulate
from core.simulation.scenarios import SCENARIOS
from core.trajectory import Trajectory

SECONDS = 16.0


@functools.cache
def recorded(effect: str = "", size: float = 0.0) -> Run:
    """A drive with rests, turns and straights, of which the start is known."""
    effects = {effect: {"scale": size}} if effect else {}
    return simulate(SCENARIOS["square-ccw"].run(), effects, 1).crop(0.0, SECONDS)


def uneven(run: Run) -> Iterator[Run]:
    """Pieces of very different lengths."""
    rng = np.random.default_rng(4)
    at, end = 0.0, run.span[1]
    while at <= end:
        until = at + float(rng.choice((0.013, 0.05, 0.21, 1.7)))
        logs = {n: log.crop(at, float(np.nextafter(until, 0))) for n, log in run.logs().items()}
        yield Run(run.meta, **{n: log for n, log in logs.items() if len(log)})  # type: ignore[arg-type]
        at = until


def stepped(run: Run, parts: Iterator[Run]) -> tuple[LiveEstimator, list[Step]]:
    estimator = LiveEstimator(run.meta)
    return estimator, [estimator.feed(piece) for piece in parts]


def path(steps: list[Step], method: str) -> Trajectory:
    rows = [s.paths[method] for s in steps if method in s.paths]
    t, x, y, theta, P = (np.concatenate([getattr(r, k) for r in rows]) for k in ("t", "x", "y", "theta", "covariance"))
    return Trajectory(t, x, y, theta, P)


def assert_same(live: Trajectory, whole: Trajectory, atol: float = 1e-9) -> None:
    n = len(live)
    np.testing.assert_array_equal(live.t, whole.t[:n])
    for name in ("x", "y", "theta", "covariance"):
        np.testing.assert_allclose(getattr(live, name), getattr(whole, name)[:n], atol=atol, rtol=0)


@pytest.fixture(scope="module")
def both() -> list[tuple[LiveEstimator, list[Step]]]:
    return [stepped(recorded(), parts) for parts in (pieces(recorded(), 0.1), uneven(recorded()))]


@pytest.mark.parametrize("method", ["encoders", "beacon"])
def test_wheels_and_fixes_alone_are_what_they_are_offline(
    both: list[tuple[LiveEstimator, list[Step]]], method: str
) -> None:
    whole = estimate(recorded(), method).trajectory
    for _, steps in both:
        live = path(steps, method)
        assert len(live) == len(whole)
        assert_same(live, whole)


def test_encoders_and_gyro_are_what_they_are_offline_at_the_same_rest_noise(
    both: list[tuple[LiveEstimator, list[Step]]], monkeypatch: pytest.MonkeyPatch
) -> None:
    for estimator, steps in both:
        assert estimator.rhythm is not None
        sd = estimator.rhythm.gyro_sd  # offline it is learnt from the whole run
        monkeypatch.setattr(odometry, "at_rest", lambda run, numbers, sd=sd: at_rest(run, numbers, sd))
        live = path(steps, "encoders+gyro")
        assert live.t[-1] > SECONDS - 1.0
        assert_same(live, estimate(recorded(), "encoders+gyro").trajectory)


def test_the_published_system_is_what_it_is_offline_at_the_same_rest_noise(
    both: list[tuple[LiveEstimator, list[Step]]], monkeypatch: pytest.MonkeyPatch
) -> None:
    for estimator, steps in both:
        assert estimator.rhythm is not None
        sd = estimator.rhythm.gyro_sd
        monkeypatch.setattr(signals, "at_rest", lambda run, numbers, sd=sd: at_rest(run, numbers, sd))
        live = path(steps, "published")
        assert live.t[-1] > SECONDS - 1.0
        assert_same(live, estimate(recorded(), "published").trajectory)


def test_the_published_system_sets_out_from_headed_fixes_and_is_set_right_by_them_after_a_blow(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run = recorded()
    assert run.imu is not None and run.imu.ax is not None
    ax = np.array(run.imu.ax)
    ax[800:804], ax[804:808] = -9.0, 9.0
    blow = dataclasses.replace(run, imu=dataclasses.replace(run.imu, ax=ax))
    lost = dataclasses.replace(blow, meta=dataclasses.replace(run.meta, start=None), ranges=None)
    estimator, steps = stepped(lost, pieces(lost, 0.25))
    assert estimator.rhythm is not None and steps[-1].reasons["published"] is None
    sd = estimator.rhythm.gyro_sd
    monkeypatch.setattr(signals, "at_rest", lambda run, numbers: at_rest(run, numbers, sd))
    found = estimate(lost, "published")
    assert "replacement" in [event.kind for event in found.events]
    live, whole = path(steps, "published"), found.trajectory
    rows = np.searchsorted(whole.t, live.t)
    assert rows[0] < 200
    np.testing.assert_allclose(live.pose, whole.pose[rows], atol=1e-9, rtol=0)
    assert run.beacon is not None
    headless = dataclasses.replace(lost, beacon=dataclasses.replace(run.beacon, theta=None)).crop(0.0, 4.0)
    _, steps = stepped(headless, pieces(headless, 0.25))
    assert "headings" in str(steps[-1].reasons["published"])


def offline(run: Run, live: LiveEstimator, known: Disturbances | None = None) -> tuple[np.ndarray, Walk]:
    """The filter over the whole run, on the numbers and from the start that the stepped one has."""
    start, sd = live.fused.start, live.rhythm.gyro_sd if live.rhythm else 1.0
    assert start is not None
    rest: Rest = at_rest(run, live.numbers, sd)
    events = start.without_used(merge(run, live.numbers, rest))
    if known is not None:
        events = flagged(events, known.dated(events.t))
    return events.out, walk(problem(run, events, start, live.numbers, rest), events)


def test_fused_is_what_it_is_offline_on_the_same_numbers(both: list[tuple[LiveEstimator, list[Step]]]) -> None:
    for estimator, steps in both:
        out, whole = offline(recorded(), estimator)
        live = path(steps, "fused")
        np.testing.assert_array_equal(live.t, out)
        np.testing.assert_allclose(live.pose, whole.pose, atol=1e-9, rtol=0)
        np.testing.assert_allclose(live.covariance, whole.covariance, atol=1e-9, rtol=0)
        assert estimator.fused.replay is not None
        np.testing.assert_allclose(estimator.fused.replay.state.x, whole.x, atol=1e-9, rtol=0)
        np.testing.assert_allclose(estimator.fused.replay.state.P, whole.P, atol=1e-9, rtol=0)


def test_a_disturbance_told_afterwards_is_as_if_it_had_been_known(
    both: list[tuple[LiveEstimator, list[Step]]],
) -> None:
    estimator, _ = stepped(recorded(), pieces(recorded(), 0.1))
    slip = Disturbance("slip", SECONDS - 1.0, SECONDS - 0.6, SECONDS - 0.7, SECONDS - 0.5, left=True, right=True)
    told = Disturbances((slip,))
    estimator.fused.tell(told)
    _, whole = offline(recorded(), estimator, told)
    _, plain = offline(recorded(), estimator)
    assert estimator.fused.replay is not None
    np.testing.assert_allclose(estimator.fused.replay.state.x, whole.x, atol=1e-9, rtol=0)
    assert np.abs(whole.P - plain.P).max() > 1e-9


def test_the_bias_is_what_best_says_at_the_end_of_each_block(both: list[tuple[LiveEstimator, list[Step]]]) -> None:
    whole = track_bias(recorded(), "best")
    for _, steps in both:
        curves = [s.bias for s in steps if s.bias is not None]
        t = np.concatenate([c.t for c in curves])
        assert len(t) > 5 * (SECONDS - 2)
        rows = np.searchsorted(whole.t, t - 1e-6)
        np.testing.assert_allclose(np.concatenate([c.value for c in curves]), whole.bias[rows], atol=1e-12, rtol=0)
        np.testing.assert_allclose(np.concatenate([c.sd for c in curves]), whole.sd[rows], atol=1e-12, rtol=0)


def test_links_of_a_robot_as_simulated_stay_in_their_noise_and_a_wide_track_leaves_it(
    both: list[tuple[LiveEstimator, list[Step]]],
) -> None:
    links = {s.link: s for s in [step.links for step in both[0][1] if step.links][-1]}
    assert {"commands to wheels", "wheels to gyro", "wheels to accelerometer", "body to beacon"} <= set(links)
    assert not any(link.warn for link in links.values())
    found = {name: link.excess for name, link in links.items()}
    assert all(excess is not None and 0.3 < excess < links[name].level for name, excess in found.items()), found
    wide = recorded("track_width", 1.06)
    _, steps = stepped(wide, pieces(wide, 0.25))
    warned = {link.link for step in steps for link in step.links or () if link.warn}
    assert warned == {"wheels to gyro"}


def test_without_a_start_pose_the_filter_waits_until_fixes_and_a_drive_have_shown_it() -> None:
    run = recorded()
    headless = dataclasses.replace(run.beacon, theta=None) if run.beacon else None
    lost = dataclasses.replace(run, meta=dataclasses.replace(run.meta, start=None), beacon=headless, ranges=None)
    estimator, steps = stepped(lost, pieces(lost, 0.25))
    assert "heading" in str(steps[12].reasons["fused"])
    assert estimator.fused.reason is None
    live = path(steps, "fused")
    out, whole = offline(lost, estimator)
    rows = np.searchsorted(out, live.t)
    np.testing.assert_allclose(live.pose, whole.pose[rows], atol=1e-9, rtol=0)
    assert run.truth is not None
    truth = np.interp(live.t[-1], run.truth.t, run.truth.x), np.interp(live.t[-1], run.truth.t, run.truth.y)
    assert np.hypot(live.x[-1] - truth[0], live.y[-1] - truth[1]) < 0.1


def test_a_gyro_that_begins_after_the_wheels_is_used_from_then_on() -> None:
    run = recorded()
    assert run.imu is not None and run.truth is not None and run.truth.theta is not None
    late = dataclasses.replace(run, imu=run.imu.crop(5.0, SECONDS), beacon=None, ranges=None)
    estimator, steps = stepped(late, pieces(late, 0.25))
    live = path(steps, "fused")
    assert estimator.rhythm is not None and estimator.rhythm.imu
    assert (np.diff(live.t) > 0).all() and np.median(np.diff(live.t[live.t > 8])) == pytest.approx(0.01)
    assert abs(live.theta[-1] - np.interp(live.t[-1], run.truth.t, run.truth.theta)) < 0.02
    assert all(reason is None or "beacon" in reason for reason in estimator.reasons().values())


def test_a_robot_of_unknown_track_width_is_estimated_as_offline(monkeypatch: pytest.MonkeyPatch) -> None:
    run = recorded().crop(0.0, 8.0)
    run = dataclasses.replace(
        run, meta=dataclasses.replace(run.meta, robot=dataclasses.replace(run.meta.robot, track_width=None))
    )
    estimator, steps = stepped(run, pieces(run, 0.1))
    assert estimator.rhythm is not None
    sd = estimator.rhythm.gyro_sd
    monkeypatch.setattr(odometry, "at_rest", lambda run, numbers: at_rest(run, numbers, sd))
    assert_same(path(steps, "encoders+gyro"), estimate(run, "encoders+gyro").trajectory)
    _, whole = offline(run, estimator)
    np.testing.assert_allclose(path(steps, "fused").pose, whole.pose, atol=1e-9, rtol=0)
    reasons = estimator.reasons()
    assert {m for m in reasons if "track_width" in str(reasons[m])} == {"encoders", "published"}


def test_noise_of_fixes_that_nobody_stated_is_learnt_as_it_goes() -> None:
    run = recorded()
    true = run.meta.noise.beacon_xy
    assert true is not None and run.beacon is not None
    loud = np.random.default_rng(3).normal(0.0, 4 * true, (2, len(run.beacon)))
    fixes = dataclasses.replace(run.beacon, x=run.beacon.x + loud[0], y=run.beacon.y + loud[1], theta=None)
    noise = dataclasses.replace(run.meta.noise, beacon_xy=None)
    silent = dataclasses.replace(run, meta=dataclasses.replace(run.meta, noise=noise), beacon=fixes, ranges=None)
    estimator, _ = stepped(silent, pieces(silent, 0.25))
    assert estimator.fused.replay is not None
    assumed, found = estimator.numbers.fix_xy, float(np.sqrt(estimator.fused.replay.constants[R_FIX]))
    assert abs(np.log(found / (true * np.sqrt(17)))) < min(0.4, abs(np.log(assumed / (true * np.sqrt(17)))))


def test_what_is_kept_does_not_grow_with_the_run(both: list[tuple[LiveEstimator, list[Step]]]) -> None:
    estimator = both[0][0]
    assert all(len(log) < 700 for log in estimator._recent.run.logs().values())
    assert estimator.fused.replay is not None
    assert len(estimator.fused.replay.path()[0]) < 400


def test_the_virtual_robot_is_the_simulator_a_tick_at_a_time() -> None:
    effects = {"motor_lag": {"tau": 0.1}, "unequal_wheels": {"ratio": 1.01}}
    robot = VirtualRobot(META, effects, 3)
    asked = [(0.0, 0.0)] * 10 + [(0.4, 0.0)] * 50 + [(0.3, 0.6)] * 50 + [(0.0, 0.0)] * 20
    parts = [robot.step((k + 1) * 0.05, v, w) for k, (v, w) in enumerate(asked)]
    made = Run(META, **{n: functools.reduce(joined, (p.logs()[n] for p in parts if n in p.logs()))
                        for n in ("commands", "wheels", "imu", "beacon", "truth")})  # fmt: skip
    whole = simulate(made, effects, 0, noise=False)
    for ours, theirs in ((made.truth, whole.truth), (made.wheels, whole.wheels)):
        assert ours is not None and theirs is not None
    assert made.truth is not None and whole.truth is not None and made.wheels is not None and whole.wheels is not None
    assert made.imu is not None and whole.imu is not None
    np.testing.assert_allclose(made.truth.x, whole.truth.x, atol=1e-8)
    np.testing.assert_allclose(made.truth.theta, whole.truth.theta, atol=1e-8)
    step = 2 * np.pi / 2048
    assert np.all(np.abs(made.wheels.left - whole.wheels.left) < step * 1.001)
    assert np.ptp(np.diff(made.wheels.t)) < 1e-9
    noise = made.imu.gz[100:] - whole.imu.gz[100:]
    assert 0.7 < noise.std() / (1.9e-4 * np.sqrt(50)) < 1.6  # white, and half a sample of what the next tick asks
