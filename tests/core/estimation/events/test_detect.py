"""Detectors on a robot to which things happen: each fault by its name, on time; nothing on a robot with plain flaws."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest

from core.estimation import estimate
from core.estimation.assumptions import assume
from core.estimation.events import KINDS, Detector, Disturbance, Disturbances, detect
from core.estimation.events.detector import gather, thresholds
from core.run import Run
from tests.plants.faults import FaultRun, Flaws, Label, fault_run

MARKED = {"slip": 0.03, "collision": 0.2, "bounce": 4.0, "pushed": 0.1, "stuck": 1.0, "dead_encoder": 0.5}


@cache
def world(seed: int, fault: str | None, seconds: float = 120.0) -> FaultRun:
    return fault_run(seed, seconds, (fault,) if fault else ())


def found_in(run: Run) -> Disturbances:
    return detect(run, assume(run)[0])


def labels(made: FaultRun) -> list[Label]:
    return [one for one in made.labels if one.size >= MARKED[one.kind]]


@pytest.mark.parametrize(
    "fault",
    ["spin_up", "brake_slide", "one_wheel", "turn_slip", "collision", "bounce", "pushed", "stuck", "dead_encoder"],
)
def test_a_fault_is_found_by_its_name_and_dated(fault: str) -> None:
    made = world(21, fault)
    marked = labels(made)
    assert len(marked) >= 3
    events = found_in(made.run).events
    for label in marked:
        offsets = [abs(e.t0 - label.t0) for e in events if e.kind == label.kind]
        assert min(offsets, default=np.inf) <= 0.2, label


@pytest.mark.parametrize("seed", [31, 32, 33])
def test_ordinary_flaws_are_no_events(seed: int) -> None:
    """Ten minutes at one false alarm an hour: none, or now and then one."""
    assert len(found_in(world(seed, None, 600.0).run).events) <= 1


def test_flaws_twice_as_large_are_no_events_either() -> None:
    twice = Flaws(tyre=0.006, gyro_bias=8e-3, accel_bias=0.08, mount=0.02)
    assert len(found_in(fault_run(34, 400.0, (), twice).run).events) <= 1


def test_a_piece_of_the_log_never_changes_what_came_before() -> None:
    """Causal: cut anywhere, and all that was known by then is the same."""
    made = world(21, "collision")
    whole = found_in(made.run).found
    for end in (40.0, 73.3, 101.7):
        cut = found_in(made.run.crop(0.0, end)).found
        known = [(d.kind, d.t0, d.alarm, d.t1) for d in whole if d.release < end - 1.0]
        assert known
        assert [(d.kind, d.t0, d.alarm, d.t1) for d in cut][: len(known)] == known


@pytest.mark.parametrize("step", [0.37, 5.0])
def test_a_log_in_pieces_gives_the_same_as_whole(step: float) -> None:
    made = world(22, "one_wheel")
    run, numbers = made.run, assume(made.run)[0]
    detector = Detector(run.meta, numbers, run)
    found: list[Disturbance] = []
    for begin in np.arange(0.0, run.span[1] + step, step):
        found += detector.feed(run.crop(begin, np.nextafter(begin + step, 0.0)))
    found += detector.finish()
    assert gather(tuple(found)).found == found_in(run).found


def test_more_false_alarms_allowed_means_lower_thresholds() -> None:
    rates = (1e-3, 1.0, 100.0)
    points, cusums = zip(*(thresholds(rate) for rate in rates), strict=True)
    assert sorted(points, reverse=True) == list(points)
    assert sorted(cusums, reverse=True) == list(cusums)


def test_a_dead_encoder_is_named_by_its_side() -> None:
    made = world(23, "dead_encoder")
    dead = [d for d in found_in(made.run).found if d.kind == "dead_encoder" and d.t1 - d.t0 > 0.3]
    rims = made.motion[:, 6:8]
    wheels = made.run.wheels
    assert dead and wheels is not None
    for d in dead:
        middle = np.searchsorted(wheels.t, [d.t0 + 0.1, d.t1 - 0.1])
        for flat, column in ((d.left, wheels.left), (d.right, wheels.right)):
            if flat:
                assert np.ptp(column[middle[0] : middle[1]]) == 0
        assert np.abs(rims[int(1000 * d.t0) : int(1000 * d.t1)]).max() > 0.05


def test_flags_live_begin_at_the_alarm_and_dated_at_the_onset() -> None:
    made = world(22, "one_wheel")
    found = found_in(made.run)
    one = next(d for d in found.found if d.left != d.right)
    assert made.run.wheels is not None
    t = made.run.wheels.t
    live, dated = found.live(t), found.dated(t)
    column, other = (live.left, dated.left) if one.left else (live.right, dated.right)
    assert not column[(t > one.t0) & (t < one.alarm)].any()
    assert column[(t > one.alarm) & (t < one.release)].all()
    assert other[(t > one.t0) & (t < one.t1)].all()


def test_what_is_missing_is_said_and_the_rest_still_works() -> None:
    made = world(21, "turn_slip")
    run = made.run
    assert run.imu is not None
    gyro_only = dataclasses.replace(run, imu=dataclasses.replace(run.imu, ax=None, ay=None, az=None, gx=None, gy=None))
    found = found_in(gyro_only)
    assert any("no accelerometer" in note for note in found.notes)
    for label in labels(made):
        assert min(abs(e.t0 - label.t0) for e in found.events if e.kind == "slip") <= 0.2
    stuck = world(21, "stuck")
    blind = found_in(dataclasses.replace(stuck.run, imu=None))
    assert any("no IMU" in note for note in blind.notes)
    assert {e.kind for e in blind.events} == {"stuck"}
    assert len(blind.events) >= len(labels(stuck))
    no_wheels = found_in(dataclasses.replace(world(21, "collision").run, wheels=None))
    assert any(e.kind == "collision" for e in no_wheels.events)
    assert found_in(Run(run.meta)).events == ()


def test_evidence_is_a_sentence_with_figures() -> None:
    for fault in ("one_wheel", "collision", "bounce"):
        for event in found_in(world(22 if fault == "one_wheel" else 21, fault).run).events:
            assert event.kind in KINDS
            assert "sigma" in event.evidence or "asked for" in event.evidence
            assert any(unit in event.evidence for unit in ("m/s", "rad/s"))


def test_encoders_and_gyro_carry_the_events() -> None:
    made = world(21, "turn_slip")
    assert any(event.kind == "slip" for event in estimate(made.run, "encoders+gyro").events)


def test_broken_readings_do_no_harm() -> None:
    """NaN, infinities and a jump of the counter: events perhaps, but none that lasts, and nothing raised."""
    made = world(31, None, 600.0)
    run = made.run
    assert run.imu is not None and run.wheels is not None
    gz, ax, left = run.imu.gz.copy(), np.asarray(run.imu.ax).copy(), run.wheels.left.copy()
    gz[5000:5010], ax[7000], left[9000:] = np.nan, np.inf, left[9000:] + 500.0
    left[12000] = np.nan
    broken = dataclasses.replace(
        run, imu=dataclasses.replace(run.imu, gz=gz, ax=ax), wheels=dataclasses.replace(run.wheels, left=left)
    )
    events = found_in(broken).events
    assert len(events) <= 3
    assert all(e.t1 - e.t0 < 3.0 for e in events)
