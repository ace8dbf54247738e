"""How a diagnosis takes runs as they come: begun in mid-drive, with a reference on another clock, with a large rest."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from core.errors import CancelledError, ParameterError
from core.formats import read_run
from core.gap import Config, Diagnosis, diagnose
from core.gap.aligned import aligned, reference_clock
from core.gap.checks import check_tolerances
from core.gap.faced import faced, facing
from core.gap.reference import restarts_of
from core.gap.rolling import first_speeds, rolling
from core.gap.scatter import DENSITIES, angle_costs
from core.gap.searched import searched
from core.gap.world import make_world
from core.run import Run
from core.simulation import simulate
from tests.plants.gap_plant import Effects, Plan, record

LAG: Effects = {"motor_lag": {"tau": 0.08}}


def made(seconds: float = 30.0, **options: object) -> Run:
    """One drive of the plant."""
    return record(Plan(11, seconds=seconds, sensors="none", **options))  # type: ignore[arg-type]


def likely(found: Diagnosis) -> list[str]:
    return [one.effect for one in found.causes if one.probability > 0.5]


def test_a_run_that_begins_in_mid_drive_is_predicted_from_its_first_reading_on() -> None:
    whole = made(effects=LAG)
    assert whole.wheels is not None and whole.commands is not None
    moving = whole.commands.t[np.flatnonzero(np.abs(whole.commands.v) > 0.3)[40]]
    cropped = whole.crop(float(moving), 30.0)
    speeds = first_speeds(cropped)
    assert speeds is not None and min(map(abs, speeds)) > 0.1
    world = make_world(cropped, restarts_of(cropped))
    first = world.times["wheels.left"] < moving + 2.0

    def far(one: object) -> float:
        missed = world.readings["wheels.left"] - one.wheels([LAG])["wheels.left"][0]  # type: ignore[attr-defined]
        return float(np.ptp(missed[first]))

    assert far(rolling(world)) < 0.1 * far(world)
    assert rolling(make_world(whole, restarts_of(whole))).body_inputs.begin == 0.0


def test_a_reference_on_another_clock_is_set_right_and_told() -> None:
    run = made(effects={"wheel_slip": {"k": 0.05}})
    assert run.truth is not None
    t = run.truth.t
    late = dataclasses.replace(run, truth=dataclasses.replace(run.truth, t=t - 0.03 + 0.07 * t / t[-1]))
    clock = reference_clock(late)
    assert clock is not None
    assert clock.values == pytest.approx([-0.03, 0.04], abs=4e-3)
    right, told = aligned([late])
    assert right[0].truth is not None
    assert np.abs(right[0].truth.t - t).max() < 4e-3
    assert "set right" in told[0] and "+40 ms at its end" in told[0]
    assert aligned([run]) == ([run], ())  # slip alone, however like a delay it looks, moves no stamp


def test_a_reference_that_faces_beside_the_way_driven_is_turned_and_told() -> None:
    run = made(effects={"side_slip": {"k": 0.03}})
    assert run.truth is not None
    askew = dataclasses.replace(run, truth=dataclasses.replace(run.truth, theta=run.truth.theta - 0.005))
    assert facing([askew]) == pytest.approx(0.005, abs=1e-3)
    assert "mrad to the right of the way driven" in faced([askew])[1][0]
    assert faced([run]) == ([run], ())  # sliding out of bends is no mounting


def test_a_walk_is_weighed_over_rests_that_are_far_apart_and_short() -> None:
    """Blocks of part of a second, then a gap: the covariance stays one, however lively the walk that is tried."""
    at = np.array([0.5, 1.5, 2.13, 3.91, 4.5, 15.57, 18.8, 19.07, 31.85, 32.5])
    costs = angle_costs(at, np.full(at.size, 1e-4), np.full(at.size, 3e-8), 4e-8, DENSITIES)
    assert np.isfinite(costs).all() and costs[0] == costs.min()


def test_readings_in_another_unit_are_the_files_fault_not_the_robots() -> None:
    run = made(20.0, effects={"track_width": {"scale": 1.05}})
    assert run.imu is not None and run.wheels is not None
    wrapped = dataclasses.replace(run.wheels, left=np.mod(run.wheels.left, 2 * np.pi))
    wrong = dataclasses.replace(run, imu=dataclasses.replace(run.imu, gz=np.degrees(run.imu.gz)), wheels=wrapped)
    found = diagnose([wrong])
    assert [cause.effect for cause in found.causes if cause.probability > 0.5] == ["track_width"]
    assert any("gyro reads degrees" in note for note in found.notes)
    assert any("left encoder wraps round" in note for note in found.notes)


def test_a_drive_that_cuts_off_what_is_asked_and_is_late_is_told_by_both() -> None:
    run = made(20.0, imu=False)
    assert run.commands is not None
    kept = dataclasses.replace(run.commands, w=np.clip(run.commands.w, -0.4, 0.4))
    late = {"motor_lag": {"tau": 0.2}, "command_delay": {"delay": 0.15}}
    drives = simulate(dataclasses.replace(run, commands=kept), late, 1)
    found = searched([dataclasses.replace(drives, commands=run.commands)], {}, 2.0).found.wheels
    assert found is not None and found.unknown is not None
    assert "0.40 rad/s of turning, which the drive does not follow" in found.unknown[0].text
    assert found.fit.model.keys() == late.keys()
    assert float(found.fit.model["motor_lag"]["tau"]) == pytest.approx(0.2, abs=0.02)
    assert float(found.fit.model["command_delay"]["delay"]) == pytest.approx(0.15, abs=0.02)


def test_a_large_rest_is_never_told_as_none() -> None:
    run = made(20.0, imu=False)
    assert run.truth is not None and run.truth.y is not None
    off = run.truth.y + 0.02 * np.sin(2.0 * np.pi * run.truth.t / 1.3)
    found = diagnose([dataclasses.replace(run, truth=dataclasses.replace(run.truth, y=off))])
    assert found.verdict in ("unknown", "partly_explained")
    assert found.unexplained is not None and found.unexplained.stream == "truth.y"
    assert found.probabilities["unknown"] > 0.8 and found.probabilities["none"] == 0.0
    assert found.where


def test_the_users_own_tolerances_decide_what_matters() -> None:
    run = made(effects={"track_width": {"scale": 1.0015}})
    assert likely(diagnose([run])) == []
    fine = diagnose([run], config=Config(tolerances={"track_width.scale": 8e-4}))
    assert likely(fine) == ["track_width"]
    assert "track_width" not in [one.effect for one in fine.immaterial]


@pytest.mark.parametrize(
    ("given", "words"),
    [({"track_width": 0.1}, "no 'track_width'"), ({"gyro_drift.tau": 5.0}, "set gyro_drift.amplitude"),
     ({"gyro_bias.bias": 0.0}, "above 0"), ({"gyro_bias.bias": float("nan")}, "above 0")],
)  # fmt: skip
def test_a_tolerance_that_means_nothing_is_named(given: dict[str, float], words: str) -> None:
    with pytest.raises(ParameterError, match=words):
        check_tolerances(given)


def test_progress_grows_inside_each_phase_and_each_can_be_stopped() -> None:
    run, told = made(12.0), []
    diagnose([run], progress=lambda share, message: told.append((share, message)))
    shares = [share for share, _ in told]
    assert shares == sorted(shares) and len(set(shares)) > 20
    phases = list(dict.fromkeys(message for _, message in told))
    for phase in phases:

        def stop(_: float, message: str, at: str = phase) -> None:
            if message == at:
                raise CancelledError("enough")

        with pytest.raises(CancelledError):
            diagnose([run], progress=stop)


@pytest.mark.shared
def test_the_track_of_a_recorded_robot_is_found_from_half_of_its_passes(shared_data: Path) -> None:
    passes = [read_run(path) for path in sorted((shared_data / "real" / "optiodom-square-a").glob("run-*"))]
    found = diagnose(passes[::2], held_out=passes[1::2])
    track = next(one for one in found.causes if one.effect == "track_width")
    assert track.probability > 0.5
    assert float(track.parameters["scale"].value) == pytest.approx(1.0075, abs=3e-3)  # calibrated: 1.005 to 1.011
    assert found.gap.total.after < found.gap.total.before
    assert any("set right" in note for note in found.notes)
