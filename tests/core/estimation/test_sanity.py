"""Mistakes in units, signs and names are named, and the run is processed with what is sound."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from core.estimation import estimate
from core.estimation.assumptions import assume
from core.estimation.fusion.sanity import sound
from core.metrics import evaluate
from core.run import Run

from .world import Sensors, simulate

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


MISTAKES: dict[str, tuple[Callable[[Run], Run], str, float]] = {
    "gyro in degrees": (imu(gz=180 / np.pi), "degrees", 0.15),
    "IMU upside down": (imu(gz=-1.0), "upside down", 0.15),
    "wheels exchanged": (wheels_exchanged, "exchanged", 0.15),
    "wheels in degrees": (wheels_in_degrees, "wheels read degrees", 0.15),
    "wheels in degrees, no gyro": (wheels_in_degrees_without_a_gyro, "wheels read degrees", 0.15),
    "fixes in millimetres": (fixes_in_millimetres, "millimetres", 0.15),
    "fix headings in degrees": (fix_headings_in_degrees, "headings read degrees", 0.15),
    "mirrored map": (mirrored, "mirrored", 1.5),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_named_and_put_right(name: str) -> None:
    make, words, bound = MISTAKES[name]
    found = estimate(make(WORLD.run), "fused")
    assert any(words in note for note in found.notes), found.notes
    errors = evaluate(found.trajectory, WORLD.run.truth)
    assert errors.max_m is not None and errors.max_m < bound


def test_an_accelerometer_in_g_is_converted() -> None:
    run = WORLD.run
    assert run.imu is not None
    flat = np.zeros(len(run.imu))
    in_g = dataclasses.replace(run.imu, ax=flat, ay=flat, az=flat + 1.0)
    found, notes = sound(dataclasses.replace(run, imu=in_g), assume(run)[0])
    assert found.imu is not None and found.imu.az is not None
    assert found.imu.az[0] == pytest.approx(9.80665) and "reads g" in notes[0]


def test_ranges_in_millimetres_are_converted() -> None:
    log = RANGED.run.ranges
    assert log is not None
    found = estimate(dataclasses.replace(RANGED.run, ranges=dataclasses.replace(log, range=log.range * 1e3)), "fused")
    assert any("ranges read millimetres" in note for note in found.notes)
    errors = evaluate(found.trajectory, RANGED.run.truth)
    assert errors.max_m is not None and errors.max_m < 0.15


@pytest.mark.parametrize("known", [True, False], ids=["known start", "unknown start"])
def test_two_beacons_exchanged_are_put_right(known: bool) -> None:
    places = dict(RANGED.run.meta.beacons)
    places["B1"], places["B3"] = places["B3"], places["B1"]
    meta = dataclasses.replace(RANGED.run.meta, beacons=places, start=RANGED.run.meta.start if known else None)
    run = dataclasses.replace(RANGED.run, meta=meta)
    found = estimate(run, "fused")
    assert any("B1 and B3 are exchanged" in note for note in found.notes)
    errors = evaluate(found.trajectory, RANGED.run.truth)
    assert errors.max_m is not None and errors.max_m < 0.15


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
