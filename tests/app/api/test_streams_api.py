"""Series for plots: nothing that matters is thinned away, and what is left out is said."""

from __future__ import annotations

import io
from collections.abc import Callable

import numpy as np
import polars as pl
import pytest
from fastapi.testclient import TestClient
from hypothesis import given
from hypothesis import strategies as st

from app.figures.series import MAX_POINTS, plain, series, thin, window
from core.errors import ParameterError
from core.run import Run

API = "/api/v1"


def series_of(server: TestClient, run_id: str, stream: str, **params: object) -> dict:
    answer = server.get(f"{API}/runs/{run_id}/streams/{stream}", params=params)
    assert answer.status_code == 200, answer.text
    return answer.json()


def test_all_columns_with_units_and_counts(server: TestClient, run_id: str) -> None:
    body = series_of(server, run_id, "imu", points=100)
    assert [(s["column"], s["unit"]) for s in body["series"]] == [("gz", "rad/s"), ("ax", "m/s²")]
    assert body["total"] == 900 - 1 and 98 <= body["shown"] <= 100
    assert body["gaps"] == [[pytest.approx(7.98), pytest.approx(10.02)]]
    for one in body["series"]:
        assert one["label"] and len(one["t"]) == len(one["y"]) == one["shown"] <= 100
        assert one["t"] == sorted(one["t"])


def test_a_window_reaches_its_edges(server: TestClient, run_id: str, make_run: Callable[..., Run]) -> None:
    t = make_run().wheels.t
    one = series_of(server, run_id, "wheels", columns="left", t0=3.005, t1=4.0, points=2000)["series"][0]
    inside = t[(t >= 3.005) & (t <= 4.0)]
    assert one["t"][0] < 3.005 and one["t"][-1] > 4.0
    assert one["t"][1:-1] == inside.tolist()


def test_ranges_come_by_beacon(server: TestClient, run_id: str) -> None:
    body = series_of(server, run_id, "ranges")
    assert [s["column"] for s in body["series"]] == ["B1", "B2"]
    assert all(s["total"] == 50 and s["unit"] == "m" for s in body["series"])
    only = series_of(server, run_id, "ranges", columns="B2", t0=2, t1=3)["series"]
    assert [s["column"] for s in only] == ["B2"] and 4 <= only[0]["total"] <= 7


def test_arrow_says_the_same_as_json(server: TestClient, run_id: str) -> None:
    params = {"columns": "left,right", "points": 50}
    body = series_of(server, run_id, "wheels", **params)
    answer = server.get(f"{API}/runs/{run_id}/streams/wheels", params={**params, "format": "arrow"})
    assert answer.headers["x-total"] == "1000" and answer.headers["x-shown"] == str(body["shown"])
    frame = pl.read_ipc_stream(io.BytesIO(answer.content))
    for one in body["series"]:
        part = frame.filter(pl.col("column") == one["column"])
        assert part["t"].to_list() == one["t"] and part["y"].to_list() == one["y"]


@pytest.mark.parametrize(
    ("path", "code"),
    [
        ("odometry", "parameter"),
        ("commands", "missing_stream"),
        ("imu?columns=gz,qq", "parameter"),
        ("imu?t0=5&t1=4", "parameter"),
        ("imu?t0=nan", "parameter"),
        ("imu?t1=inf", "parameter"),
        ("imu?points=9", "parameter"),
        (f"imu?points={MAX_POINTS + 1}", "parameter"),
        ("imu?format=xml", "parameter"),
    ],
)
def test_impossible_series(server: TestClient, run_id: str, path: str, code: str) -> None:
    answer = server.get(f"{API}/runs/{run_id}/streams/{path}")
    assert answer.status_code == 422 and answer.json()["code"] == code


def test_a_window_beyond_the_run_is_empty_but_for_its_neighbour(server: TestClient, run_id: str) -> None:
    assert series_of(server, run_id, "wheels", t0=1e6)["series"][0]["total"] == 1


FLOATS = st.floats(-1e6, 1e6, width=32)


@given(values=st.lists(FLOATS, min_size=50, max_size=400), points=st.integers(10, 60), spike=st.integers(0, 10_000))
def test_thinning_keeps_order_and_extremes(values: list[float], points: int, spike: int) -> None:
    y = np.array(values, np.float32)
    y[spike % len(y)] = 2e6
    t = np.cumsum(np.linspace(0.01, 1.0, len(y)))
    thin_t, thin_y = thin(t, y, points)
    assert min(points, len(y)) - 2 <= len(thin_t) <= points or len(y) <= points
    assert np.all(np.diff(thin_t) > 0)
    assert np.isin(thin_t, t).all() and thin_y.max() == 2e6
    assert thin_t[0] == t[0] and thin_t[-1] == t[-1]


@given(st.integers(0, 500), st.integers(10, 40))
def test_missing_values_do_not_break_a_plot(seed: int, points: int) -> None:
    rng = np.random.default_rng(seed)
    y = rng.normal(size=300)
    y[rng.random(300) < 0.3] = np.nan
    t = np.arange(300.0)
    _, thin_y = thin(t, y, points)
    assert np.isfinite(thin_y).mean() > 0.5
    listed = plain(series("x", "m", "x", t, y, 1000))["y"]
    assert [v is None for v in listed] == np.isnan(y).tolist()


@given(
    t=st.lists(st.integers(0, 100), min_size=1, unique=True).map(sorted),
    t0=st.one_of(st.none(), st.integers(-10, 110)),
    length=st.one_of(st.none(), st.integers(0, 50)),
)
def test_windows(t: list[int], t0: int | None, length: int | None) -> None:
    stamps = np.array(t, float)
    t1 = None if length is None else (t0 or 0) + length
    rows = window(stamps, t0, t1)
    inside = [i for i, v in enumerate(t) if (t0 is None or v >= t0) and (t1 is None or v <= t1)]
    assert set(inside) <= set(range(rows.start, rows.stop))
    assert rows.stop - rows.start <= len(inside) + 2


def test_windows_that_are_none() -> None:
    for t0, t1 in ((2.0, 1.0), (float("nan"), None), (None, float("inf"))):
        with pytest.raises(ParameterError):
            window(np.arange(5.0), t0, t1)
