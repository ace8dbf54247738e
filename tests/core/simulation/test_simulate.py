"""`simulate`: the nominal simulator's known answers, effects that move only what they touch, their order, the noise."""

from __future__ import annotations

import dataclasses
import threading

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.effects import EFFECTS
from core.errors import MissingStreamError, ParameterError
from core.robot import EffectSet, Noise, Pose, Procedure, RobotParams
from core.run import Run, RunMeta
from core.sensors import CommandLog, ImuLog, RangeLog, WheelLog
from core.simulation import simulate, simulate_many

from .values import TELLING

Array = npt.NDArray[np.float64]
TAU = 2.0 * np.pi


def columns(run: Run) -> dict[str, Array]:
    """Every column by stream.column."""
    return {f"{s}.{c}": v for s, log in run.logs().items() for c, v in log.columns().items()}


def same(a: Run, b: Run, names: set[str] | None = None) -> set[str]:
    """Names of the columns whose bytes differ, out of `names` or all."""
    left, right = columns(a), columns(b)
    assert left.keys() == right.keys()
    return {k for k in left if (names is None or k in names) and left[k].tobytes() != right[k].tobytes()}


# --- the nominal simulator ---------------------------------------------------------------------------------------


def test_stamps_columns_and_description_are_the_runs(wild: Run) -> None:
    out = simulate(wild, {}, 1)
    assert out.meta == wild.meta
    assert columns(out).keys() == columns(wild).keys()
    assert all(np.array_equal(out.logs()[s].t, log.t) for s, log in wild.logs().items())
    assert all(np.isfinite(v).all() for v in columns(out).values())
    assert out.imu is not None and wild.imu is not None and out.imu.temperature is wild.imu.temperature


def test_ramp_and_arc_have_their_textbook_answers() -> None:
    """0.5 m/s after 1 s of steady acceleration, then a circle of radius 0.5 m at 1 rad/s."""
    commands = CommandLog(
        t=np.array([0.0, 1.0, 3.0, 4.0, 4.0 + TAU]), v=np.full(5, 0.5) * [0, 1, 1, 1, 1], w=np.array([0.0, 0, 0, 1, 1])
    )
    t = np.arange(0.0, 10.0, 0.01)
    robot = RobotParams(wheel_radius=0.1, track_width=0.4, ticks_per_rev=1000)
    nan = np.full(t.shape, np.nan)
    run = Run(
        meta=RunMeta(robot=robot, start=Pose(1.0, 2.0, 0.0)),
        commands=commands,
        wheels=WheelLog(t=t, left=nan, right=nan),
        imu=ImuLog(t=t, gz=nan, ax=nan, ay=nan, az=nan, gx=nan, gy=nan),
    )
    out = simulate(run, {}, 0, noise=False)
    assert out.wheels is not None and out.imu is not None and out.imu.ax is not None and out.imu.ay is not None
    ramp, line, circle = t < 0.99, (t > 1.01) & (t < 2.99), t > 4.01
    np.testing.assert_allclose(out.wheels.left[ramp], 0.25 * t[ramp] ** 2 / 0.1, atol=1e-12)
    np.testing.assert_allclose(out.wheels.right[line], (0.25 + 0.5 * (t[line] - 1.0)) / 0.1, atol=1e-12)
    np.testing.assert_allclose(np.diff(out.wheels.right[circle]) / 0.01, (0.5 + 0.2) / 0.1, atol=1e-9)
    np.testing.assert_allclose(np.diff(out.wheels.left[circle]) / 0.01, (0.5 - 0.2) / 0.1, atol=1e-9)
    np.testing.assert_allclose(out.imu.ax[1:99], 0.5, atol=1e-9)
    np.testing.assert_allclose(out.imu.gz[circle], 1.0, atol=1e-9)
    np.testing.assert_allclose(out.imu.ay[circle], 0.5, atol=1e-9)
    assert out.imu.az is not None and out.imu.gx is not None
    assert (out.imu.az == 9.80665).all() and (out.imu.gx == 0.0).all()


def test_accelerometer_off_centre_reads_the_mean_of_its_own_point(wild: Run) -> None:
    """Mean specific force = change of the IMU point's map velocity, turned by its yaw; at 1 kHz, for accuracy."""
    assert wild.commands is not None
    t = np.arange(5.0, 6.0, 1e-3)
    nan = np.full(t.shape, np.nan)
    smooth = CommandLog(t=np.array([0.0, 10.0]), v=np.array([0.0, 0.8]), w=np.array([0.0, 1.5]))
    run = dataclasses.replace(
        wild,
        commands=smooth,
        wheels=None,
        beacon=None,
        ranges=None,
        truth=None,
        imu=ImuLog(t=t, gz=nan, ax=nan, ay=nan),
    )
    out = simulate(run, {}, 0, noise=False).imu
    assert out is not None and out.ax is not None and out.ay is not None
    v, w, dv, dw = 0.08 * t, 0.15 * t, 0.08, 0.15
    x, y = 0.08, -0.03
    fx, fy = dv - dw * y - w * w * x, v * w + dw * x - w * w * y
    c, s = np.cos(0.4), np.sin(0.4)
    np.testing.assert_allclose(out.ax, c * fx + s * fy, atol=1e-6)
    np.testing.assert_allclose(out.ay, c * fy - s * fx, atol=1e-6)
    np.testing.assert_allclose(out.gz, w, atol=1e-9)


def test_tag_ranges_and_fixes_are_of_the_tag(wild: Run) -> None:
    still = dataclasses.replace(wild, commands=CommandLog(t=np.zeros(1), v=np.zeros(1), w=np.zeros(1)))
    out = simulate(still, {}, 0, noise=False)
    x = 4.5 + 0.1 * np.cos(0.3) - 0.05 * np.sin(0.3)
    y = 3.5 + 0.1 * np.sin(0.3) + 0.05 * np.cos(0.3)
    assert out.beacon is not None and out.ranges is not None and out.beacon.theta is not None
    np.testing.assert_allclose(out.beacon.x, x, atol=1e-12)
    np.testing.assert_allclose(out.beacon.y, y, atol=1e-12)
    np.testing.assert_allclose(out.beacon.theta, 0.3, atol=1e-12)
    to_b2 = out.ranges.range[out.ranges.beacon == 1]
    np.testing.assert_allclose(to_b2, np.sqrt((9.0 - x) ** 2 + y**2 + 1.8**2), atol=1e-12)


def test_commands_are_held_past_their_ends_and_nothing_moves_before_the_start(wild: Run) -> None:
    commands = CommandLog(t=np.array([10.0, 20.0]), v=np.array([0.2, 0.4]), w=np.zeros(2))
    out = simulate(dataclasses.replace(wild, commands=commands), {}, 0, noise=False)
    assert out.truth is not None and out.truth.x is not None and out.truth.y is not None
    way = np.hypot(out.truth.x - 4.5, out.truth.y - 3.5)
    np.testing.assert_allclose(way[-1], 10 * 0.2 + 10 * 0.3 + 40 * 0.4, atol=1e-9)
    np.testing.assert_allclose(way[out.truth.t == 5.0], 1.0, atol=1e-9)


# --- effects move what they touch, and nothing else --------------------------------------------------------------


@pytest.mark.parametrize("noise", [False, True])
@pytest.mark.parametrize("name", EFFECTS)
def test_neutral_changes_no_bit(name: str, noise: bool, wild: Run) -> None:
    assert (
        same(simulate(wild, {}, 5, noise=noise), simulate(wild, {name: EFFECTS[name].neutral}, 5, noise=noise)) == set()
    )


@pytest.mark.parametrize("name", sorted(set(EFFECTS) - {"beacon_shadow"}))
def test_effect_moves_its_streams_only(name: str, wild: Run) -> None:
    moved = same(simulate(wild, {}, 5), simulate(wild, {name: TELLING[name]}, 5))
    assert moved == set(EFFECTS[name].streams)


def test_shadow_leaves_out_fixes_and_ranges_and_no_more(wild: Run) -> None:
    a, b = simulate(wild, {}, 5), simulate(wild, {"beacon_shadow": TELLING["beacon_shadow"]}, 5)
    assert a.beacon is not None and b.beacon is not None and a.ranges is not None and b.ranges is not None
    assert 0 < len(b.beacon) < len(a.beacon) and 0 < len(b.ranges) < len(a.ranges)
    kept = np.isin(a.beacon.t, b.beacon.t)
    assert np.array_equal(a.beacon.x[kept], b.beacon.x) and np.array_equal(a.beacon.y[kept], b.beacon.y)
    true = simulate(wild, {}, 5, noise=False).beacon
    assert true is not None
    inside = np.hypot(true.x - 4.6, true.y - 3.6) < 0.6
    assert np.array_equal(kept, ~inside)


@given(names=st.lists(st.sampled_from(sorted(EFFECTS)), unique=True, min_size=2, max_size=8), rnd=st.randoms())
@settings(max_examples=25, deadline=None)
def test_order_of_naming_is_no_order_of_acting(names: list[str], rnd: np.random.Generator, wild: Run) -> None:
    shuffled = list(names)
    rnd.shuffle(shuffled)
    first = simulate(wild, {name: TELLING[name] for name in names}, 2)
    assert same(first, simulate(wild, {name: TELLING[name] for name in shuffled}, 2)) == set()


@given(
    scale=st.floats(0.9, 1.1), bias=st.floats(-0.1, 0.1), slope=st.floats(-0.01, 0.01), k=st.floats(-0.02, 0.02),
    limit=st.floats(0.3, 2.0), amplitude=st.floats(-0.05, 0.05),
)  # fmt: skip
@settings(max_examples=20, deadline=None)
def test_gyro_order(
    scale: float, bias: float, slope: float, k: float, limit: float, amplitude: float, wild: Run
) -> None:
    """True rate times scale, then offsets (of the true ay, whatever the accelerometer says), then the clip."""
    plain = simulate(wild, {"imu_yaw": {"angle": 0.1}}, 0, noise=False).imu
    effects: EffectSet = {
        "gyro_scale": {"scale": scale}, "gyro_bias": {"bias": bias}, "gyro_temperature": {"slope": slope},
        "gyro_g_sensitivity": {"k": k}, "gyro_clip": {"limit": limit}, "imu_yaw": {"angle": 0.1},
        "gyro_drift": {"amplitude": amplitude, "tau": 30.0},
        "accel_scale": {"x": 1.2, "y": 1.3}, "accel_bias": {"x": 0.3, "y": 0.4},
    }  # fmt: skip
    out = simulate(wild, effects, 0, noise=False).imu
    assert plain is not None and out is not None and plain.temperature is not None
    assert plain.ax is not None and plain.ay is not None and out.ax is not None and out.ay is not None
    warmth = plain.temperature - plain.temperature[0]
    offset = bias + slope * warmth + k * plain.ay + amplitude * (1.0 - np.exp(-plain.t / 30.0))
    np.testing.assert_allclose(out.gz, np.clip(scale * plain.gz + offset, -limit, limit), atol=1e-12)
    np.testing.assert_allclose(out.ax, 1.2 * plain.ax + 0.3, atol=1e-12)
    np.testing.assert_allclose(out.ay, 1.3 * plain.ay + 0.4, atol=1e-12)


@given(
    angle=st.floats(-0.3, 0.3), scale=st.floats(0.9, 1.1), x=st.floats(-1, 1), y=st.floats(-1, 1), bias=st.floats(-1, 1)
)
@settings(max_examples=20, deadline=None)
def test_beacon_order(angle: float, scale: float, x: float, y: float, bias: float, wild: Run) -> None:
    """Rotated, then scaled, then shifted; ranges scaled, then biased."""
    plain = simulate(wild, {"beacon_delay": {"delay": 0.1}}, 0, noise=False)
    effects: EffectSet = {
        "beacon_shift": {"x": x, "y": y}, "beacon_scale": {"scale": scale}, "beacon_rotation": {"angle": angle},
        "range_bias": {"bias": bias}, "beacon_delay": {"delay": 0.1},
    }  # fmt: skip
    out = simulate(wild, effects, 0, noise=False)
    assert plain.beacon is not None and out.beacon is not None and plain.ranges is not None and out.ranges is not None
    c, s = np.cos(angle), np.sin(angle)
    np.testing.assert_allclose(out.beacon.x, scale * (c * plain.beacon.x - s * plain.beacon.y) + x, atol=1e-12)
    np.testing.assert_allclose(out.beacon.y, scale * (s * plain.beacon.x + c * plain.beacon.y) + y, atol=1e-12)
    assert out.beacon.theta is not None and plain.beacon.theta is not None
    np.testing.assert_allclose(out.beacon.theta, plain.beacon.theta + angle, atol=1e-12)
    np.testing.assert_allclose(out.ranges.range, scale * plain.ranges.range + bias, atol=1e-12)


def test_imu_clock_makes_stamps_late(wild: Run) -> None:
    """stamp = t*(1 + skew) + offset: what is stamped s happened at (s - offset)/(1 + skew)."""
    late = simulate(wild, {"imu_clock": {"offset": 0.05}, "clock_drift": {"skew": 1e-3}}, 0, noise=False).imu
    assert late is not None and wild.imu is not None
    happened = (wild.imu.t - 0.05) / 1.001
    half = 0.005 / 1.001
    fine = np.sort(np.concatenate((happened - half, happened + half)))
    truth = dataclasses.replace(wild.truth, t=np.maximum(fine, 0.0), x=fine, y=fine, theta=fine)  # type: ignore[type-var]
    theta = simulate(dataclasses.replace(wild, truth=truth), {}, 0, noise=False).truth
    assert theta is not None and theta.theta is not None
    rate = np.diff(theta.theta)[::2] / (2 * half)
    np.testing.assert_allclose(late.gz[10:-10], rate[10:-10], atol=2e-6)


@given(seed=st.integers(0, 10**6), names=st.sets(st.sampled_from(sorted(EFFECTS)), min_size=1, max_size=12))
@settings(max_examples=25, deadline=None)
def test_any_effects_together_stay_finite(seed: int, names: set[str], wild: Run) -> None:
    """Strong values of many effects at once: no lost piece, no endless one, no NaN."""
    out = simulate(wild, {name: TELLING[name] for name in names}, seed)
    assert all(np.isfinite(v).all() for v in columns(out).values())
    assert out.truth is not None and out.truth.x is not None
    assert np.max(np.abs(np.diff(out.truth.x))) < 0.2


# --- noise -------------------------------------------------------------------------------------------------------


def test_one_seed_one_noise(wild: Run) -> None:
    assert same(simulate(wild, {}, 7), simulate(wild, {}, 7)) == set()
    noisy = {"imu.gz", "imu.ax", "imu.ay", "imu.az", "imu.gx", "imu.gy"}
    noisy |= {"beacon.x", "beacon.y", "beacon.theta", "ranges.range"}
    assert same(simulate(wild, {}, 7), simulate(wild, {}, 8)) == noisy


def test_noise_is_the_data_sheets(wild: Run) -> None:
    clean, noisy = columns(simulate(wild, {}, 3, noise=False)), columns(simulate(wild, {}, 3))
    sheet, band = wild.meta.noise, np.sqrt(100.0 / 2.0)
    assert sheet.gyro_density and sheet.accel_density and sheet.beacon_xy and sheet.beacon_theta and sheet.range
    expected = {
        "imu.gz": sheet.gyro_density * band, "imu.ax": sheet.accel_density * band, "imu.ay": sheet.accel_density * band,
        "imu.az": sheet.accel_density * band, "imu.gx": sheet.gyro_density * band, "beacon.x": sheet.beacon_xy,
        "beacon.y": sheet.beacon_xy, "beacon.theta": sheet.beacon_theta, "ranges.range": sheet.range,
    }  # fmt: skip
    for name, sd in expected.items():
        error = noisy[name] - clean[name]
        assert np.std(error) == pytest.approx(sd, rel=4.0 / np.sqrt(2 * len(error))), name
        assert abs(np.mean(error)) < 4.0 * sd / np.sqrt(len(error)), name
    assert np.array_equal(noisy["truth.x"], clean["truth.x"])


def test_encoders_are_rounded_down_to_ticks(wild: Run) -> None:
    clean, noisy = simulate(wild, {}, 3, noise=False).wheels, simulate(wild, {}, 3).wheels
    assert clean is not None and noisy is not None
    tick = TAU / 2048
    short = (clean.left - noisy.left) / tick
    assert short.min() >= -1e-9 and short.max() < 1.0
    np.testing.assert_allclose(noisy.left / tick, np.round(noisy.left / tick), atol=1e-9)


def test_unknown_noise_is_none(wild: Run) -> None:
    quiet = dataclasses.replace(wild, meta=dataclasses.replace(wild.meta, noise=Noise()))
    rounded = {"wheels.left", "wheels.right"}
    assert same(simulate(quiet, {}, 1), simulate(quiet, {}, 1, noise=False)) == rounded


# --- what the simulator already models, many at once, bad input --------------------------------------------------


def test_known_effects_act_unless_replaced(wild: Run) -> None:
    known: EffectSet = {"motor_lag": {"tau": 0.15}}
    run = dataclasses.replace(wild, meta=dataclasses.replace(wild.meta, effects=known))
    assert same(simulate(run, {}, 0), simulate(wild, known, 0)) == set()
    assert same(simulate(run, {"motor_lag": {"tau": 0.0}}, 0), simulate(wild, {}, 0)) == set()


def test_many_at_once_are_the_same_as_one_by_one(wild: Run) -> None:
    sets: list[EffectSet] = [{}, *({name: TELLING[name]} for name in sorted(set(EFFECTS) - {"beacon_shadow"}))]
    many = simulate_many(wild, sets)
    for row, effects in enumerate(sets):
        one = columns(simulate(wild, effects, 0, noise=False))
        for ours, theirs in (("gz", "imu.gz"), ("ay", "imu.ay"), ("left", "wheels.left"), ("range", "ranges.range")):
            assert np.array_equal(getattr(many, ours)[row], one[theirs]), (effects, theirs)
        assert np.array_equal(many.x[row], one["truth.x"]) and np.array_equal(
            many.beacon_theta[row], one["beacon.theta"]
        )
    shadow = simulate_many(wild, [{"beacon_shadow": TELLING["beacon_shadow"]}])
    assert np.isnan(shadow.beacon_x).any() and np.isnan(shadow.range).any()


def test_restarts_set_the_pose_and_let_the_wheels_run_on(wild: Run) -> None:
    restarts = np.array([[10.0, 1.0, 2.0, 0.5], [20.0, -3.0, 4.0, -1.0]])
    lag: EffectSet = {"motor_lag": {"tau": 0.3}}
    a, b = simulate_many(wild, [lag]), simulate_many(wild, [lag], restarts=restarts)
    assert np.allclose(a.left, b.left, atol=1e-12) and np.allclose(a.gz, b.gz, atol=1e-9)
    assert wild.truth is not None
    i, j = np.searchsorted(wild.truth.t, [10.0 - 1e-9, 20.0 - 1e-9])
    np.testing.assert_allclose([b.x[0, i], b.y[0, i], b.theta[0, i]], [1.0, 2.0, 0.5], atol=1e-9)
    np.testing.assert_allclose([b.x[0, j], b.y[0, j], b.theta[0, j]], [-3.0, 4.0, -1.0], atol=1e-9)
    way = np.hypot(np.diff(a.x[0, i:j]), np.diff(a.y[0, i:j]))
    np.testing.assert_allclose(np.hypot(np.diff(b.x[0, i:j]), np.diff(b.y[0, i:j])), way, atol=1e-9)


def test_batches_from_two_threads_do_not_disturb_each_other(wild: Run) -> None:
    sets: list[EffectSet] = [{"drive_gain": {"gain": 0.9 + 0.01 * i}} for i in range(8)]
    expected, found = simulate_many(wild, sets).x, []
    threads = [threading.Thread(target=lambda: found.append(simulate_many(wild, sets).x)) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 3 and all(np.array_equal(expected, x) for x in found)


def test_no_sets_no_rows(wild: Run) -> None:
    assert simulate_many(wild, []).gz.shape == (0, 6000)


def test_a_run_without_commands_is_driven_by_its_wheels(wild: Run) -> None:
    driven = simulate(wild, {}, 0, noise=False)
    out = simulate(dataclasses.replace(driven, commands=None), {}, 0, noise=False)
    assert driven.truth is not None and out.truth is not None
    assert (
        driven.truth.x is not None
        and driven.truth.y is not None
        and out.truth.x is not None
        and out.truth.y is not None
    )
    assert np.max(np.hypot(driven.truth.x - out.truth.x, driven.truth.y - out.truth.y)) < 0.01
    with pytest.raises(MissingStreamError, match="commands"):
        simulate(dataclasses.replace(driven, commands=None), {"motor_lag": {"tau": 0.1}}, 0)


def test_a_rest_needs_no_robot(wild: Run) -> None:
    assert wild.imu is not None
    run = Run(meta=RunMeta(procedure=Procedure(kind="rest")), imu=wild.imu)
    out = simulate(run, {"gyro_bias": {"bias": 0.02}}, 0, noise=False).imu
    assert out is not None and out.ax is not None
    assert (out.gz == 0.02).all() and (out.ax == 0.0).all()


@pytest.mark.parametrize(
    ("change", "effects", "missing"),
    [
        ({"commands": None, "wheels": None}, {}, "commands"),
        ({"meta": RunMeta()}, {}, "robot.wheel_radius"),
        ({"meta": RunMeta(robot=RobotParams(wheel_radius=0.1, track_width=0.3))}, {}, "beacons.B1"),
        ({"imu": ImuLog(t=np.arange(3.0), gz=np.zeros(3))}, {"gyro_temperature": {"slope": 1e-3}}, "imu.temperature"),
    ],
)
def test_what_is_missing_is_named(change: dict[str, object], effects: EffectSet, missing: str, wild: Run) -> None:
    with pytest.raises(MissingStreamError) as error:
        simulate(dataclasses.replace(wild, **change), effects, 0)  # type: ignore[arg-type]
    assert missing in error.value.where["missing"]  # type: ignore[operator]


def test_an_unknown_anchor_is_named(wild: Run) -> None:
    with pytest.raises(ParameterError, match="B9") as error:
        simulate(wild, {"anchor_moved": {"beacon": "B9", "x": 0.1}}, 0)
    assert error.value.where["expected"] == ["B1", "B2", "B3", "B4"]


def test_bad_effects_are_refused_wherever_they_stand(wild: Run) -> None:
    with pytest.raises(ParameterError, match="warp"):
        simulate(wild, {"warp": {}}, 0)
    with pytest.raises(ParameterError, match="warp"):
        simulate(dataclasses.replace(wild, meta=dataclasses.replace(wild.meta, effects={"warp": {}})), {}, 0)


def test_gaps_jitter_and_short_streams_are_taken_as_they_are(wild: Run) -> None:
    rng = np.random.default_rng(0)
    t = np.sort(rng.uniform(0.0, 60.0, 3000))
    t = t[(t < 20.0) | (t > 31.0)]
    nan = np.full(t.shape, np.nan)
    one = RangeLog(t=np.array([5.0]), beacon=np.zeros(1, np.int16), range=np.zeros(1), names=("B1",))
    ragged = dataclasses.replace(
        wild, imu=ImuLog(t=t, gz=nan), ranges=one, wheels=WheelLog(t=t[:1], left=nan[:1], right=nan[:1])
    )
    out = simulate(ragged, TELLING_SMOOTH, 0, noise=False)
    assert out.imu is not None and np.isfinite(out.imu.gz).all() and out.imu.ax is None
    assert out.truth is not None and out.truth.x is not None
    plain = simulate(wild, TELLING_SMOOTH, 0, noise=False).truth
    assert plain is not None and plain.x is not None
    np.testing.assert_allclose(out.truth.x, plain.x, atol=1e-7)


TELLING_SMOOTH: EffectSet = {name: TELLING[name] for name in ("motor_lag", "track_width", "wheel_slip")}
