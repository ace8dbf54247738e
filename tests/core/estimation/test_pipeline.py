"""The table of methods: what each needs, what is refused and how, and that each does what every method must."""

from __future__ import annotations

import dataclasses
import subprocess
import sys

import numpy as np
import pytest

from core.errors import MissingStreamError, ParameterError
from core.estimation import METHODS, available, estimate
from core.run import Run
from core.sensors import ImuLog

from .world import Sensors, simulate

WORLD = simulate(0, 20.0)


@pytest.mark.parametrize("name", list(METHODS))
def test_a_method_says_what_it_is(name: str) -> None:
    method = METHODS[name]
    assert method.name == name
    assert all((method.label, method.needs, method.source, method.summary))


@pytest.mark.parametrize("name", list(METHODS))
def test_every_method_estimates_a_full_run(name: str) -> None:
    found = estimate(WORLD.run, name)
    assert found.method == name
    assert np.isfinite(found.trajectory.pose).all()
    assert found.trajectory.covariance is not None
    assert np.all(np.abs(np.diff(found.trajectory.theta)) < 1.0)  # unwrapped


@pytest.mark.parametrize("name", list(METHODS))
def test_nothing_runs_on_an_empty_run_and_it_is_said_why(name: str) -> None:
    reason = available(Run())[name]
    assert reason
    with pytest.raises(MissingStreamError, match="cannot run"):
        estimate(Run(), name)


def test_reasons_name_what_is_missing() -> None:
    run = WORLD.run
    bare = dataclasses.replace(run, beacon=None)
    assert available(bare)["beacon"] == "the run has neither beacon fixes nor ranges"
    assert "imu" in (available(dataclasses.replace(run, imu=None))["encoders+gyro"] or "")
    robot = dataclasses.replace(run.meta.robot, wheel_radius=None)
    lost = available(dataclasses.replace(run, meta=dataclasses.replace(run.meta, robot=robot)))
    assert "wheel_radius" in (lost["encoders"] or "") and "wheel_radius" in (lost["fused"] or "")
    robot = dataclasses.replace(run.meta.robot, track_width=None)
    narrow = available(dataclasses.replace(run, meta=dataclasses.replace(run.meta, robot=robot)))
    assert "track_width" in (narrow["encoders"] or "") and narrow["fused"] is None
    short = dataclasses.replace(run, imu=ImuLog(np.zeros(1), np.zeros(1)))
    assert "1 rows" in (available(short)["encoders+gyro"] or "")


def test_ranges_from_beacons_on_a_line_give_no_position() -> None:
    run = simulate(0, 10.0, sensors=Sensors(fixes=0, ranges=10)).run
    meta = dataclasses.replace(run.meta, beacons={f"B{i}": (float(i), 2.0 * i, 2.5) for i in range(1, 5)})
    assert "one line" in (available(dataclasses.replace(run, meta=meta))["beacon"] or "")
    meta = dataclasses.replace(run.meta, beacons={"B1": (0.0, 0.0, 2.0)})
    assert "1 surveyed" in (available(dataclasses.replace(run, meta=meta))["beacon"] or "")


def test_unknown_methods_and_options_are_refused_by_name() -> None:
    with pytest.raises(ParameterError, match="teleport"):
        estimate(WORLD.run, "teleport")
    with pytest.raises(ParameterError, match="slipp"):
        estimate(WORLD.run, "fused", {"slipp": 0.1})
    for bad in (-1.0, float("nan"), float("inf"), "much", True):
        with pytest.raises(ParameterError, match="slip"):
            estimate(WORLD.run, "fused", {"slip": bad})


def test_options_change_the_claim() -> None:
    narrow = estimate(WORLD.run, "encoders", {"slip": 0.001}).trajectory.sd
    wide = estimate(WORLD.run, "encoders", {"slip": 0.1}).trajectory.sd
    assert narrow is not None and wide is not None
    assert (wide[-1] > 2 * narrow[-1]).all()


def test_assumed_noise_is_said() -> None:
    meta = dataclasses.replace(WORLD.run.meta, noise=dataclasses.replace(WORLD.run.meta.noise, gyro_density=None))
    notes = estimate(dataclasses.replace(WORLD.run, meta=meta), "fused").notes
    assert any("gyro noise density" in note for note in notes)
    assert not any("gyro noise density" in note for note in estimate(WORLD.run, "fused").notes)


def test_importing_the_room_does_not_import_the_compiler() -> None:
    code = "import sys, core.estimation, core.metrics; sys.exit('numba' in sys.modules or 'scipy.stats' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
