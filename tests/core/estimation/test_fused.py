"""The fused path in a closed loop: errors against what the filter claims, over seeds, starts, losses and lies."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from core.estimation import Estimate, estimate
from core.estimation.assumptions import Assumptions
from core.metrics import chi2_band, evaluate, nees
from core.run import Run
from core.sensors import BeaconLog, ImuLog

from .world import BEACONS, Flaws, Sensors, World, simulate

SEEDS, SLOW_SEEDS = 50, 12  # the start from ranges alone is a large search
LENGTHS = 36.0, 48.0  # s
SURE = {
    "slip": Assumptions().slip,
    "bias_walk": Assumptions().bias_walk,
    "start_xy": 1e-4,
    "start_theta": 1e-4,
}  # what the worlds do


def drawn_flaws(seed: int) -> Flaws:
    """A robot as likely as the filter assumes it to be."""
    rng, a = np.random.default_rng(1000 + seed), Assumptions()
    return Flaws(
        bias=a.bias_sd * rng.standard_normal(),
        bias_walk=a.bias_walk,
        gyro_scale=a.gyro_scale_sd * rng.standard_normal(),
        distance_scale=a.distance_scale_sd * rng.standard_normal(),
        inequality=a.inequality_sd * rng.standard_normal(),
        track_scale=a.track_scale_sd * rng.standard_normal(),
        slip=a.slip,
        side_slip=a.side_slip,
    )


CASES = {
    "fixes with heading": (Sensors(), True),
    "fixes without heading, start unknown": (Sensors(fix_theta=None), False),
    "no gyro": (Sensors(imu=0), True),
    "ranges": (Sensors(fixes=0, ranges=20), True),
    "ranges, start unknown": (Sensors(fixes=0, ranges=20), False),
    "wheels and gyro alone": (Sensors(fixes=0), True),
}


@pytest.mark.parametrize("case", CASES)
def test_errors_are_as_large_as_claimed(case: str) -> None:
    sensors, known = CASES[case]
    seeds = SLOW_SEEDS if case == "ranges, start unknown" else SEEDS
    last, inside = [], []
    for seed in range(seeds):
        world = simulate(seed, LENGTHS[seed % 2], drawn_flaws(seed), sensors, start_known=known)
        found = nees(estimate(world.run, "fused", SURE).trajectory, world.run.truth)
        assert found is not None
        last.append(found.nees[-1])
        inside.append(found.inside)
    low, high = chi2_band(3, seeds, 1 - 0.05 / len(CASES))  # 95 % of all cases together
    assert low < np.mean(last) < high
    assert 0.90 < np.mean(inside) < 0.99


def fused(world: World) -> Estimate:
    return estimate(world.run, "fused")


def test_far_better_than_dead_reckoning_and_than_the_fixes() -> None:
    world = simulate(1, flaws=drawn_flaws(1))
    ate = {m: evaluate(estimate(world.run, m).trajectory, world.run.truth).ate_rmse_m for m in ("encoders", "beacon")}
    found = evaluate(fused(world).trajectory, world.run.truth).ate_rmse_m
    assert found is not None and ate["encoders"] and ate["beacon"]
    assert found < ate["encoders"] / 5
    assert found < ate["beacon"] / 3


def test_the_gyro_bias_and_the_scales_are_found_with_their_deviation() -> None:
    flaws = Flaws(bias=0.006, distance_scale=0.012, track_scale=0.03, gyro_scale=-0.004)
    found = estimate(simulate(3, 120.0, flaws).run, "fused", {"slip": 0.001})
    assert found.gyro_bias is not None and found.gyro_bias.sd is not None
    assert abs(found.gyro_bias.value[-1] - 0.006) < 4 * found.gyro_bias.sd[-1]
    for name, true in (("distance_scale", 0.012), ("track_scale", 0.03), ("gyro_scale", -0.004)):
        value = found.parameters[name]
        assert value.sd is not None and abs(value.value - true) < 4 * value.sd, name
        assert value.sd < 0.003, name


def test_a_scale_of_all_ranges_is_found() -> None:
    world = simulate(2, 120.0, sensors=Sensors(fixes=0, ranges=20))
    assert world.run.ranges is not None
    long = dataclasses.replace(world.run.ranges, range=world.run.ranges.range * 1.02)
    found = estimate(dataclasses.replace(world.run, ranges=long), "fused").parameters["range_scale"]
    assert found.sd is not None and abs(found.value - 0.02) < 4 * found.sd < 0.02


def test_one_pose_per_imu_stamp_else_per_wheel_stamp() -> None:
    world = simulate(1, 20.0)
    assert world.run.imu is not None and world.run.wheels is not None
    np.testing.assert_array_equal(fused(world).trajectory.t, world.run.imu.t)
    bare = estimate(dataclasses.replace(world.run, imu=None), "fused")
    np.testing.assert_array_equal(bare.trajectory.t, world.run.wheels.t)
    assert bare.gyro_bias is None


def test_the_path_is_causal() -> None:
    """What comes later changes nothing of what was said before."""
    world = simulate(5, 40.0, drawn_flaws(5))
    given = {"slip": 0.01}
    whole = estimate(world.run, "fused", given).trajectory
    cut = estimate(world.run.crop(0.0, 25.0), "fused", given).trajectory
    np.testing.assert_allclose(whole.pose[: len(cut)], cut.pose, atol=1e-12)


def test_wild_fixes_are_refused() -> None:
    world = simulate(4, flaws=drawn_flaws(4))
    fixes = world.run.beacon
    assert fixes is not None
    wild = np.random.default_rng(0).random(len(fixes)) < 0.05
    lying = dataclasses.replace(fixes, x=fixes.x + 0.8 * wild, y=fixes.y - 0.8 * wild)
    honest = evaluate(fused(world).trajectory, world.run.truth)
    found = estimate(dataclasses.replace(world.run, beacon=lying), "fused")
    assert not found.innovations["beacon"].accepted[wild].any()
    errors = evaluate(found.trajectory, world.run.truth)
    assert errors.ate_rmse_m is not None and honest.ate_rmse_m is not None
    assert errors.ate_rmse_m < 1.3 * honest.ate_rmse_m + 0.002
    assert any("outside their gate" in note for note in found.notes)


def test_a_pause_of_the_fixes_is_an_event_and_no_leap() -> None:
    world = simulate(6, flaws=drawn_flaws(6))
    fixes = world.run.beacon
    assert fixes is not None
    kept = (fixes.t < 25) | (fixes.t > 37)
    assert fixes.theta is not None
    paused = BeaconLog(fixes.t[kept], fixes.x[kept], fixes.y[kept], fixes.theta[kept])
    found = estimate(dataclasses.replace(world.run, beacon=paused), "fused")
    assert [e.kind for e in found.events] == ["beacon_loss"]
    assert found.events[0].t0 == pytest.approx(25, abs=0.2) and found.events[0].t1 == pytest.approx(37, abs=0.2)
    errors = evaluate(found.trajectory, world.run.truth)
    assert errors.max_m is not None and errors.max_m < 0.15


def test_a_pause_of_the_gyro_is_carried_by_the_wheels() -> None:
    world = simulate(7, sensors=Sensors(fixes=0))
    imu = world.run.imu
    assert imu is not None
    kept = (imu.t < 20) | (imu.t > 26)
    found = estimate(dataclasses.replace(world.run, imu=ImuLog(imu.t[kept], imu.gz[kept])), "fused")
    errors, claimed = evaluate(found.trajectory, world.run.truth), nees(found.trajectory, world.run.truth)
    turned = np.ptp(world.truth[(imu.t[-1] * np.linspace(0, 1, len(world.truth)) > 20), 2][:120])
    assert turned > 1.0
    assert errors.heading_max_rad is not None and errors.heading_max_rad < 0.05
    assert claimed is not None and claimed.inside > 0.9


def test_an_unknown_beacon_is_ignored_and_named() -> None:
    world = simulate(8, 30.0, sensors=Sensors(fixes=0, ranges=20))
    meta = dataclasses.replace(world.run.meta, beacons={k: v for k, v in BEACONS.items() if k != "B4"})
    found = estimate(dataclasses.replace(world.run, meta=meta), "fused")
    assert any("B4" in note for note in found.notes)
    errors = evaluate(found.trajectory, world.run.truth)
    assert errors.max_m is not None and errors.max_m < 0.15


def test_a_heading_that_nothing_shows_is_said_to_be_unknown() -> None:
    world = simulate(9, 20.0, sensors=Sensors(fix_theta=None), start_known=False, rest=10.0)  # never moves
    found = fused(world)
    assert found.trajectory.sd is not None and found.trajectory.sd[-1, 2] > 1.0
    assert any("eading not observable" in note for note in found.notes)
    errors = evaluate(found.trajectory, world.run.truth)
    assert errors.max_m is not None and errors.max_m < 0.3  # the tag is found, its arm may point anywhere


def test_the_start_is_found_among_wild_first_fixes() -> None:
    world = simulate(10, start_known=False)
    fixes = world.run.beacon
    assert fixes is not None
    x = np.array(fixes.x)
    x[0] += 3.0
    found = estimate(dataclasses.replace(world.run, beacon=dataclasses.replace(fixes, x=x)), "fused")
    errors = evaluate(found.trajectory, world.run.truth)
    assert errors.max_m is not None and errors.max_m < 0.12


@pytest.mark.parametrize("true_sd", [0.01, 0.2])
def test_a_noise_that_nobody_stated_is_learnt(true_sd: float) -> None:
    world = simulate(11, sensors=Sensors(fix_xy=true_sd, fix_theta=None))
    meta = dataclasses.replace(world.run.meta, noise=dataclasses.replace(world.run.meta.noise, beacon_xy=None))
    found = estimate(dataclasses.replace(world.run, meta=meta), "fused")
    innovations = found.innovations["beacon.position"]
    assert np.median(innovations.nis) == pytest.approx(1.386, rel=0.25)
    assert any("Noise of fixes learnt" in note for note in found.notes)


def test_slip_is_learnt_where_the_floor_is_slippery() -> None:
    flaws = Flaws(slip=0.06, side_slip=0.03)
    world = simulate(12, 120.0, flaws, Sensors(imu=0, fix_theta=None))
    learnt = estimate(world.run, "fused")
    assert any("Slip learnt" in note for note in learnt.notes)
    stubborn = estimate(world.run, "fused", {"slip": 0.003, "side_slip": 0.001})
    ate = [evaluate(e.trajectory, world.run.truth).ate_rmse_m or np.inf for e in (learnt, stubborn)]
    assert ate[0] < ate[1]


@pytest.mark.parametrize("wide", [0.3, 0.8, -0.4])
def test_a_track_width_that_cannot_be_right_is_found_by_the_gyro(wide: float) -> None:
    """As of a skid-steered robot, whose effective track is far from the distance between its wheels."""
    world = simulate(16, flaws=Flaws(track_scale=wide), sensors=Sensors(fixes=0))
    found = fused(world)
    assert any("track width" in note for note in found.notes)
    scale, consistency = found.parameters["track_scale"], nees(found.trajectory, world.run.truth)
    assert scale.sd is not None and abs(scale.value - wide) < 4 * scale.sd + 0.02
    assert consistency is not None and consistency.inside > 0.9


def test_wheels_that_keep_contradicting_the_gyro_are_left_out() -> None:
    """Both wheels read a turn that is not there. The heading follows the gyro."""
    world = simulate(16, sensors=Sensors(fixes=0))
    wheels = world.run.wheels
    assert wheels is not None
    drunk = np.cumsum(
        0.02 * np.random.default_rng(0).standard_normal(len(wheels)) * (np.diff(wheels.left, prepend=0) != 0)
    )
    broken = dataclasses.replace(wheels, left=wheels.left - drunk, right=wheels.right + drunk)
    found = estimate(dataclasses.replace(world.run, wheels=broken), "fused")
    assert any("disagree about turning" in note for note in found.notes)
    assert "wheels.turn" not in found.innovations
    errors = evaluate(found.trajectory, world.run.truth)
    assert errors.heading_max_rad is not None and errors.heading_max_rad < 0.05


def test_hindsight_finds_where_the_wheels_spun_and_nothing_felt_it() -> None:
    """No accelerometer, no turn: only later fixes show it; the smoothed path leaps there instead of bending."""
    world = simulate(17, sensors=Sensors(fixes=2, fix_xy=0.15, fix_theta=None))
    run, span = world.run, (30.0, 30.4)
    assert run.wheels is not None and run.imu is not None
    spun = 5.0 * np.clip((run.wheels.t - span[0]) / (span[1] - span[0]), 0, 1)  # rad, both wheels
    wheels = dataclasses.replace(run.wheels, left=run.wheels.left + spun, right=run.wheels.right + spun)
    run = dataclasses.replace(run, wheels=wheels, imu=ImuLog(run.imu.t, run.imu.gz))
    found = estimate(run, "smoothed")
    (leap,) = [e for e in found.events if e.kind == "slip"]
    assert leap.t0 == pytest.approx(span[0], abs=1.0) and "hindsight" in leap.evidence
    errors, claim = evaluate(found.trajectory, run.truth), nees(found.trajectory, run.truth)
    assert errors.ate_rmse_m is not None and errors.ate_rmse_m < 0.06
    assert claim is not None and claim.inside > 0.9
    assert not any("hindsight" in e.evidence for e in estimate(world.run, "smoothed").events)


def test_slip_and_the_walk_of_the_bias_are_learnt_without_a_beacon() -> None:
    """From the wheels' turn against the gyro, and from the gyro's means at rest."""
    worlds = [simulate(18, 240.0, Flaws(slip=s), Sensors(fixes=0), rest=40.0) for s in (2e-4, 0.012)]
    smooth, rough = (next(n for n in fused(w).notes if n.startswith("Slip learnt")) for w in worlds)
    assert float(smooth.split(": ")[1].split()[0]) < 1e-3
    assert float(rough.split(": ")[1].split()[0]) == pytest.approx(0.012, rel=0.5)
    warm = simulate(19, 240.0, Flaws(bias_walk=3e-4, slip=0.004), Sensors(fixes=0), rest=40.0)
    note = next(n for n in fused(warm).notes if n.startswith("Walk of the gyro's bias"))
    assert float(note.split(": ")[1].split()[0]) == pytest.approx(3e-4, rel=0.7)


def test_truth_is_never_looked_at() -> None:
    world = simulate(13, 20.0)
    with_truth, without = fused(world), estimate(dataclasses.replace(world.run, truth=None), "fused")
    np.testing.assert_array_equal(with_truth.trajectory.pose, without.trajectory.pose)


def test_nis_is_given_for_every_sensor() -> None:
    world = simulate(14, 30.0, sensors=Sensors(ranges=8))
    found = fused(world)
    assert {"wheels.distance", "wheels.turn", "beacon", "ranges"} <= set(found.innovations)
    beacon = found.innovations["beacon"]
    assert beacon.dof == 3 and 2.0 < beacon.nis.mean() < 4.0


def test_runs_are_not_changed() -> None:
    world = simulate(15, 10.0, sensors=Sensors(ranges=8))
    before = {name: {k: v.copy() for k, v in log.columns().items()} for name, log in world.run.logs().items()}
    for log in world.run.logs().values():
        for column in log.columns().values():
            column.setflags(write=False)
    assert isinstance(world.run, Run)
    for method in ("encoders", "encoders+gyro", "beacon", "fused"):
        estimate(world.run, method)
    for name, log in world.run.logs().items():
        for k, v in log.columns().items():
            np.testing.assert_array_equal(v, before[name][k])
