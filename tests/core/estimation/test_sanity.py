"""Mistakes in units, signs and names are named, and the run is processed with what is sound."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from core.estimation import estimate
from core.estimation.assumptions import assume
from core.estimation.pipeline import Estimates
from core.estimation.sanity import sound
from core.metrics import evaluate
from core.run import Run
from core.sensors import BeaconLog, WheelLog

from .world import Sensors, simulate

Place = tuple[float, float, float]

WORLD = simulate(31, 60.0)
RANGED = simulate(32, 60.0, sensors=Sensors(fixes=0, ranges=20))


def imu(**factors: float) -> Callable[[Run], Run]:
    def change(run: Run) -> Run:
        assert run.imu is not None
        scaled = {k: getattr(run.imu, k) * f for k, f in factors.items()}
        return dataclasses.replace(run, imu=dataclasses.replace(run.imu, **scaled))

    return change


def wheels_exchanged(run: Run) -> Run:
    assert run.wheels is not None and run.imu is not None
    wheels = dataclasses.replace(run.wheels, left=run.wheels.right, right=run.wheels.left)
    return dataclasses.replace(run, wheels=wheels, imu=dataclasses.replace(run.imu, az=np.full(len(run.imu), 9.81)))


def wheels_in_degrees(run: Run) -> Run:
    assert run.wheels is not None
    left, right = np.degrees(run.wheels.left), np.degrees(run.wheels.right)
    return dataclasses.replace(run, wheels=dataclasses.replace(run.wheels, left=left, right=right))


def wheels_in_degrees_without_a_gyro(run: Run) -> Run:
    return dataclasses.replace(wheels_in_degrees(run), imu=None)


def fixes_in_millimetres(run: Run) -> Run:
    assert run.beacon is not None
    return dataclasses.replace(run, beacon=dataclasses.replace(run.beacon, x=run.beacon.x * 1e3, y=run.beacon.y * 1e3))


def fix_headings_in_degrees(run: Run) -> Run:
    assert run.beacon is not None and run.beacon.theta is not None
    return dataclasses.replace(run, beacon=dataclasses.replace(run.beacon, theta=np.degrees(run.beacon.theta)))


def mirrored(run: Run) -> Run:
    assert run.beacon is not None
    fixes = dataclasses.replace(run.beacon, y=-run.beacon.y, theta=None)
    return dataclasses.replace(run, beacon=fixes)


def axes_exchanged(run: Run) -> Run:
    """As where x is north and y east, headings clockwise."""
    assert run.beacon is not None and run.beacon.theta is not None
    fixes = dataclasses.replace(run.beacon, x=run.beacon.y, y=run.beacon.x, theta=np.pi / 2 - run.beacon.theta)
    return dataclasses.replace(run, beacon=fixes)


def mirrored_and_no_start(run: Run) -> Run:
    """The path is then one in the mended map, which here is the true one."""
    return unknown_start(mirrored(run))


def unknown_start(run: Run) -> Run:
    return dataclasses.replace(run, meta=dataclasses.replace(run.meta, start=None))


def radius_in_millimetres(run: Run) -> Run:
    robot = dataclasses.replace(run.meta.robot, wheel_radius=75.0, track_width=32.0)
    return dataclasses.replace(run, meta=dataclasses.replace(run.meta, robot=robot))


def places(change: Callable[[dict[str, Place]], dict[str, Place]]) -> Callable[[Run], Run]:
    def made(run: Run) -> Run:
        return dataclasses.replace(run, meta=dataclasses.replace(run.meta, beacons=change(dict(run.meta.beacons))))

    return made


def ranges_in_millimetres(run: Run) -> Run:
    assert run.ranges is not None
    return dataclasses.replace(run, ranges=dataclasses.replace(run.ranges, range=run.ranges.range * 1e3))


MISTAKES: dict[str, tuple[Callable[[Run], Run], str, float]] = {
    "gyro in degrees": (imu(gz=180 / np.pi), "degrees", 0.15),
    "IMU upside down": (imu(gz=-1.0), "upside down", 0.15),
    "wheels exchanged": (wheels_exchanged, "exchanged", 0.15),
    "wheels in degrees": (wheels_in_degrees, "wheels read degrees", 0.15),
    "wheels in degrees, no gyro": (wheels_in_degrees_without_a_gyro, "wheels read degrees", 0.15),
    "fixes in millimetres": (fixes_in_millimetres, "millimetres", 0.15),
    "fix headings in degrees": (fix_headings_in_degrees, "headings read degrees", 0.15),
    "mirrored map": (mirrored, "sign of its y", 0.15),
    "mirrored map, unknown start": (mirrored_and_no_start, "nobody tells the axis", 0.15),
    "axes exchanged": (axes_exchanged, "x and y are exchanged", 0.15),
    "radius in millimetres, track in centimetres": (radius_in_millimetres, "32 m, is in centimetres", 0.15),
}
EXCHANGED = places(lambda p: {**p, "B1": p["B3"], "B3": p["B1"]})
MIRRORED = places(lambda p: {name: (x, -y, z) for name, (x, y, z) in p.items()})
RANGED_MISTAKES: dict[str, tuple[Callable[[Run], Run], str]] = {
    "ranges in millimetres": (ranges_in_millimetres, "ranges read millimetres"),
    "places in millimetres": (
        places(lambda p: {n: (1e3 * x, 1e3 * y, 1e3 * z) for n, (x, y, z) in p.items()}),
        "are in",
    ),
    "two exchanged": (EXCHANGED, "B1 and B3 are exchanged"),
    "two exchanged, unknown start": (lambda run: unknown_start(EXCHANGED(run)), "B1 and B3 are exchanged"),
    "three": (places(lambda p: {**p, "B1": p["B2"], "B2": p["B3"], "B3": p["B1"]}), "B1, B2 and B3 are exchanged"),
    "mirrored": (MIRRORED, "sign of its y"),
    "mirrored, unknown start": (lambda run: unknown_start(MIRRORED(run)), "nobody tells the axis"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_named_and_put_right(name: str) -> None:
    make, words, bound = MISTAKES[name]
    check(make(WORLD.run), WORLD.run, words, {"fused": bound, "beacon": 0.4})


def check(run: Run, true: Run, words: str, bounds: dict[str, float]) -> None:
    made = Estimates(run, tuple(bounds))
    for method, bound in bounds.items():
        found = made.by(method)
        assert any(words in note for note in found.notes), found.notes
        errors = evaluate(found.trajectory, true.truth)
        assert errors.max_m is not None and errors.max_m < bound


@pytest.mark.parametrize("name", RANGED_MISTAKES)
def test_a_mistake_in_ranges_or_their_beacons_is_put_right(name: str) -> None:
    make, words = RANGED_MISTAKES[name]
    check(make(RANGED.run), RANGED.run, words, {"fused": 0.15, "beacon": 0.4})


def test_an_accelerometer_in_g_is_converted() -> None:
    run = WORLD.run
    assert run.imu is not None
    flat = np.zeros(len(run.imu))
    in_g = dataclasses.replace(run.imu, ax=flat, ay=flat, az=flat + 1.0)
    found, notes = sound(dataclasses.replace(run, imu=in_g), assume(run)[0])
    assert found.imu is not None and found.imu.az is not None
    assert found.imu.az[0] == pytest.approx(9.80665) and "reads g" in notes[0]


def test_beacons_on_one_line_are_said_to_be() -> None:
    beacons = {f"B{i}": (float(2 * i), 1.0, 2.5) for i in range(1, 5)}
    run = dataclasses.replace(RANGED.run, meta=dataclasses.replace(RANGED.run.meta, beacons=beacons))
    assert any("one line" in note for note in sound(run, assume(run)[0])[1])


@pytest.mark.parametrize("seed", range(3))
def test_a_sound_run_is_left_alone(seed: int) -> None:
    for sensors in (Sensors(), Sensors(fix_theta=None), Sensors(fixes=0, ranges=20), Sensors(imu=0)):
        run = simulate(40 + seed, 40.0, sensors=sensors).run
        found, notes = sound(run, assume(run)[0])
        assert notes == ()
        assert all(a is b for a, b in zip(found.logs().values(), run.logs().values(), strict=True))


def test_a_robot_that_mostly_rests_is_left_alone() -> None:
    """At rest wheels tremble by next to nothing and fixes by their noise: their ratio is no unit."""
    rng = np.random.default_rng(3)
    t = np.arange(0.0, 150.0, 0.05)
    forth_and_back = np.interp(t, (90.0, 120.0, 150.0), (0.0, 12.0, 0.0))
    turned = forth_and_back / (WORLD.run.meta.robot.wheel_radius or np.nan) + 1e-5 * rng.standard_normal(t.size)
    x, y = (mean + 0.08 * rng.standard_normal(t[::2].size) for mean in (forth_and_back[::2], 0.0))
    fixes = BeaconLog(t[::2], x, y)
    resting = dataclasses.replace(
        WORLD.run, imu=None, truth=None, commands=None, ranges=None, wheels=WheelLog(t, turned, turned), beacon=fixes
    )
    assert sound(resting, assume(resting)[0])[1] == ()
    toggling = dataclasses.replace(resting, wheels=WheelLog(t, turned, np.where(np.abs(t - 50.0) < 2.0, 0.003, 0.0)))
    assert not any("encoder" in note for note in sound(toggling, assume(toggling)[0])[1])


@pytest.mark.parametrize(
    ("modulus", "says"), [(2 * np.pi, "wraps round at 6.28319"), (2**16 / 2048 * 2 * np.pi, "wraps round at 201.06")]
)
def test_a_counter_that_wraps_is_unrolled(modulus: float, says: str) -> None:
    run = WORLD.run
    assert run.wheels is not None
    offset = run.wheels.left + modulus - 3.0  # so that the wide one wraps as well
    wrapped = dataclasses.replace(run.wheels, left=np.mod(offset, modulus))
    for method in ("fused", "encoders", "encoders+gyro"):
        found = estimate(dataclasses.replace(run, wheels=wrapped), method)
        assert any("left encoder" in note and says in note for note in found.notes)
        np.testing.assert_allclose(found.trajectory.pose, estimate(run, method).trajectory.pose, atol=1e-9)


def test_a_counter_that_jumps_is_taken_out_and_named() -> None:
    run = WORLD.run
    assert run.wheels is not None
    right = run.wheels.right + np.where(run.wheels.t > 30.0, 40.0, 0.0)
    found = estimate(dataclasses.replace(run, wheels=dataclasses.replace(run.wheels, right=right)), "fused")
    (note,) = [n for n in found.notes if "encoder" in n]
    assert "right encoder jumps 1 times" in note and "at 30.02 s" in note
    honest, errors = (evaluate(e.trajectory, run.truth).max_m for e in (estimate(run, "fused"), found))
    assert honest is not None and errors is not None and errors < honest + 0.01


def test_clocks_that_are_apart_are_named() -> None:
    run = WORLD.run
    assert run.imu is not None
    late = dataclasses.replace(run, imu=dataclasses.replace(run.imu, t=run.imu.t + 0.04))
    (note,) = [n for n in estimate(late, "fused").notes if "stamps" in n]
    assert float(note.split("are ")[1].split()[0]) == pytest.approx(40, abs=6) and "late" in note
    assert not any("stamps are" in n for n in estimate(run, "fused").notes)
