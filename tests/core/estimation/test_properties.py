"""Whatever a log holds - gaps, jumps, lies, hardly any readings - a method answers with finite numbers or a reason."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from core.errors import DriftscopeError
from core.estimation import METHODS, available, estimate
from core.run import Run
from core.sensors import BeaconLog, ImuLog, Log, RangeLog, WheelLog

from .world import BEACONS, ROBOT, Sensors, simulate

BASE = simulate(0, 12.0, sensors=Sensors(fixes=10, ranges=10), rest=1.0).run
MODEST = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])

absurd = st.sampled_from([1e3, -1e6, 1e12, 1e300, np.nan, 0.0])
spots = st.lists(st.integers(0, 10_000), min_size=0, max_size=6)


TARGETS = [
    ("wheels", "left"),
    ("wheels", "right"),
    ("imu", "gz"),
    ("beacon", "x"),
    ("beacon", "theta"),
    ("ranges", "range"),
]


def check(run: Run) -> None:
    """Every method that says it can, does: poses and covariances are finite, stamps increase, variances are >= 0."""
    for method, reason in available(run).items():
        if reason is not None:
            continue
        try:
            found = estimate(run, method)
        except DriftscopeError:
            continue  # said why
        path = found.trajectory
        assert np.all(np.diff(path.t) > 0)
        columns = (path.x, path.y) if method == "beacon" else (path.x, path.y, path.theta)
        assert all(np.isfinite(c).all() for c in columns), method
        assert path.covariance is not None
        P = path.covariance if method != "beacon" else path.covariance[:, :2, :2]
        assert np.isfinite(P).all(), method
        assert (np.einsum("nii->ni", P) >= 0).all(), method
        if found.gyro_bias is not None and found.gyro_bias.sd is not None:
            assert np.isfinite(found.gyro_bias.value).all() and np.isfinite(found.gyro_bias.sd).all()


def gapped(log: Any, at: float, length: float, late: float) -> Any:
    """The log without the readings of a stretch, and with every stamp after it later by a leap of the clock."""
    kept = (log.t < at) | (log.t > at + length)
    cut = dataclasses.replace(log, **{k: v[kept] for k, v in log.columns().items()})
    return dataclasses.replace(cut, t=np.where(cut.t > at, cut.t + late, cut.t))


@MODEST
@given(
    stream=st.sampled_from(["wheels", "imu", "beacon", "ranges"]),
    at=st.floats(-1, 12),
    length=st.floats(0, 13),
    late=st.sampled_from([0.0, 0.5, 60.0, 1e4, 1e7]),
)
def test_gaps_of_any_stream(stream: str, at: float, length: float, late: float) -> None:
    log = gapped(getattr(BASE, stream), at, length, late)
    check(dataclasses.replace(BASE, **{stream: log if len(log) else None}))


@MODEST
@given(late=st.sampled_from([60.0, 1e4, 1e7]), at=st.floats(0, 12), known=st.booleans())
def test_leaps_of_every_clock_at_once(late: float, at: float, known: bool) -> None:
    logs: dict[str, Any] = {name: gapped(log, at, 0.0, late) for name, log in BASE.logs().items()}
    meta = BASE.meta if known else dataclasses.replace(BASE.meta, start=None)
    check(dataclasses.replace(BASE, meta=meta, **logs))


@MODEST
@given(
    target=st.sampled_from(TARGETS),
    rows=spots,
    value=absurd,
    lasting=st.booleans(),
    known=st.booleans(),
)
def test_absurd_readings(target: tuple[str, str], rows: list[int], value: float, lasting: bool, known: bool) -> None:
    stream, column = target
    log: Log = getattr(BASE, stream)
    values = np.array(log.columns()[column], np.float64)
    for row in rows:
        k = row % len(values)
        values[k : (len(values) if lasting else k + 1)] = value
    meta = BASE.meta if known else dataclasses.replace(BASE.meta, start=None)
    check(dataclasses.replace(BASE, meta=meta, **{stream: dataclasses.replace(log, **{column: values})}))


def stamps(count: int) -> st.SearchStrategy[np.ndarray]:
    steps = st.lists(st.sampled_from([1e-9, 1e-3, 0.01, 0.3, 7.0, 1e3]), min_size=count, max_size=count)
    return steps.map(lambda s: np.cumsum(np.array(s)))


def column(count: int, size: float) -> st.SearchStrategy[np.ndarray]:
    return st.lists(st.floats(-size, size), min_size=count, max_size=count).map(np.array)


@st.composite
def scraps(draw: st.DrawFn) -> Run:
    """A handful of readings of each sensor, at stamps that have nothing to do with each other."""

    def log(make: Any, *sizes: float) -> Any:
        n = draw(st.integers(1, 8))
        return make(draw(stamps(n)), *(draw(column(n, size)) for size in sizes))

    parts: dict[str, Any] = {"wheels": log(WheelLog, 50.0, 50.0)}
    if draw(st.booleans()):
        parts["imu"] = log(ImuLog, 5.0)
    if draw(st.booleans()):
        parts["beacon"] = log(BeaconLog, 20.0, 20.0, 7.0) if draw(st.booleans()) else log(BeaconLog, 20.0, 20.0)
    if draw(st.booleans()):
        n = draw(st.integers(1, 8))
        which = np.array(draw(st.lists(st.integers(0, 4), min_size=n, max_size=n)), np.int16)
        parts["ranges"] = RangeLog(draw(stamps(n)), which, draw(column(n, 30.0)), (*BEACONS, "stranger"))
    start = BASE.meta.start if draw(st.booleans()) else None
    robot = dataclasses.replace(ROBOT, track_width=draw(st.sampled_from([0.32, None])))
    return Run(dataclasses.replace(BASE.meta, start=start, robot=robot), **parts)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(scraps())
def test_scraps_of_data(run: Run) -> None:
    check(run)


@pytest.mark.parametrize("method", list(METHODS))
def test_a_rerun_is_equal_to_the_last_bit(method: str) -> None:
    a, b = estimate(BASE, method), estimate(BASE, method)
    np.testing.assert_array_equal(a.trajectory.pose, b.trajectory.pose)
