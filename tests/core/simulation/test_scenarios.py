"""The drives: they start and end at rest, do what their names say, and simulate as they stand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from core.errors import ParameterError
from core.simulation import simulate, warm
from core.simulation.scenarios import SCENARIOS, Rates


@pytest.mark.parametrize("name", SCENARIOS)
def test_scenario_simulates_from_rest_to_rest(name: str) -> None:
    run = SCENARIOS[name].run()
    assert run.commands is not None
    assert all(run.commands.v[[0, -1]] == 0.0) and all(np.abs(run.commands.w[[0, -1]]) < 1e-12)
    out = simulate(run, {}, 1)
    assert out.logs().keys() == {"commands", "wheels", "imu", "beacon", "ranges", "truth"}
    for log in out.logs().values():
        assert all(np.isfinite(column).all() for column in log.columns().values())
    for stream, rate in vars(Rates()).items():
        assert out.logs()[stream].rate == pytest.approx(rate, rel=1e-6)


ENDS = {  # x, y, theta relative to the start, in its frame
    "straight": (6.0, 0.0, 0.0),
    "square-ccw": (0.0, 0.0, math.tau),
    "square-cw": (0.0, 0.0, -math.tau),
    "figure-eight": (0.0, 0.0, 0.0),
    "in-place": (0.0, 0.0, 0.0),
    "corridor": (0.0, 0.0, 0.0),
    "mission": (0.0, 0.0, 2 * math.tau),
    "standstill": (0.0, 0.0, 0.0),
}


@pytest.mark.parametrize("name", ENDS)
def test_nominal_drive_ends_where_it_should(name: str) -> None:
    run = SCENARIOS[name].run()
    truth = simulate(run, {}, 0, noise=False).truth
    start = run.meta.start
    assert truth is not None and truth.x is not None and truth.y is not None and truth.theta is not None
    assert start is not None
    end = (truth.x[-1] - start.x, truth.y[-1] - start.y, truth.theta[-1] - start.theta)
    np.testing.assert_allclose(end, ENDS[name], atol=5e-3)


def test_rates_leave_streams_out_and_are_checked() -> None:
    run = SCENARIOS["straight"].run(Rates(commands=20, wheels=0, imu=200, beacon=0, ranges=0, truth=5))
    assert run.logs().keys() == {"commands", "imu", "truth"}
    assert run.imu is not None and run.imu.rate == pytest.approx(200.0)
    for bad in (Rates(imu=-1.0), Rates(truth=math.nan), Rates(commands=0.0), Rates(wheels=math.inf)):
        with pytest.raises(ParameterError, match="rate"):
            SCENARIOS["straight"].run(bad)


def test_warm_start_works() -> None:
    warm()
