"""Estimates and paths over HTTP: what the automatic job stored, series, map, asking again."""

from __future__ import annotations

import io
import time
from typing import Any

import numpy as np
import polars as pl
import pytest
from fastapi.testclient import TestClient

API = "/api/v1"


def finished(server: TestClient, run_id: str) -> list[dict[str, Any]]:
    """The jobs of a run once none is at work."""
    end = time.monotonic() + 120
    while server.get(f"{API}/jobs", params={"run": run_id, "state": "active"}).json()["items"]:
        assert time.monotonic() < end
        time.sleep(0.05)
    items: list[dict[str, Any]] = server.get(f"{API}/jobs", params={"run": run_id}).json()["items"]
    return items


@pytest.fixture
def estimates(server: TestClient, run_id: str) -> dict[str, dict[str, Any]]:
    """The run's estimates by method."""
    finished(server, run_id)
    return {e["method"]: e for e in server.get(f"{API}/runs/{run_id}/estimates").json()["items"]}


def test_every_method_that_can_run_has_run(
    server: TestClient, run_id: str, estimates: dict[str, dict[str, Any]]
) -> None:
    run = server.get(f"{API}/runs/{run_id}").json()
    assert {m for m, reason in run["methods"].items() if reason is None} == set(estimates)
    assert "encoders" in estimates
    assert run["best"]["method"] in estimates
    assert 0 < len(run["sparkline"]) <= 64


def test_an_estimate_says_what_makes_it_again(
    server: TestClient, run_id: str, estimates: dict[str, dict[str, Any]]
) -> None:
    for estimate in estimates.values():
        assert server.get(f"{API}/estimates/{estimate['id']}").json() == estimate
        assert estimate["run_sha256"][:16] == run_id == estimate["run_id"]
        assert "+core." in estimate["code_version"]
        assert (estimate["config"], estimate["seed"]) == ({}, 0)
        assert set(estimate["final"]) == {"x", "y", "theta"}
        assert estimate["metrics"]["distance_m"]["unit"] == "m"


def test_asking_again_replaces_and_keeps_the_id(
    server: TestClient, run_id: str, estimates: dict[str, dict[str, Any]]
) -> None:
    asked = server.post(f"{API}/runs/{run_id}/estimates", json={"methods": ["encoders"]})
    assert asked.status_code == 202
    jobs = {job["id"]: job for job in finished(server, run_id)}
    done = jobs[asked.json()["id"]]
    assert (done["state"], done["result"]["estimates"]) == ("done", [estimates["encoders"]["id"]])
    again = {e["method"]: e for e in server.get(f"{API}/runs/{run_id}/estimates").json()["items"]}
    assert set(again) == set(estimates)
    assert again["encoders"]["created_at"] > estimates["encoders"]["created_at"]
    assert again["encoders"]["metrics"] == estimates["encoders"]["metrics"]


@pytest.mark.parametrize(
    ("methods", "code"), [(["teleport"], "parameter"), ([], "parameter"), (["beacon", "teleport"], None)]
)
def test_methods_that_cannot_run_are_refused_at_once(
    server: TestClient, run_id: str, methods: list[str], code: str | None
) -> None:
    refused = server.post(f"{API}/runs/{run_id}/estimates", json={"methods": methods})
    assert refused.status_code == 422
    assert code is None or refused.json()["code"] == code


@pytest.mark.parametrize("config", [{"luck": 1}, {"gate": -1}, {"gate": "wide"}])
def test_an_option_that_no_method_takes_is_refused_at_once(
    server: TestClient, run_id: str, config: dict[str, Any]
) -> None:
    refused = server.post(f"{API}/runs/{run_id}/estimates", json={"methods": ["encoders"], "config": config})
    assert (refused.status_code, refused.json()["code"]) == (422, "parameter")
    assert next(iter(config)) in refused.json()["detail"]


def test_series_are_thinned_and_windowed(server: TestClient, estimates: dict[str, dict[str, Any]]) -> None:
    url = f"{API}/estimates/{estimates['encoders']['id']}/series"
    whole = server.get(url, params={"columns": "x,theta", "points": 10}).json()
    assert [s["column"] for s in whole["series"]] == ["x", "theta"]
    assert [s["unit"] for s in whole["series"]] == ["m", "rad"]
    assert all(s["shown"] == len(s["t"]) == len(s["y"]) <= 10 <= s["total"] for s in whole["series"])
    t0, t1 = whole["series"][0]["t"][2], whole["series"][0]["t"][5]
    part = server.get(url, params={"columns": "x", "t0": t0, "t1": t1, "points": 5000}).json()["series"][0]
    inside = [t for t in part["t"] if t0 <= t <= t1]
    assert len(inside) >= len(part["t"]) - 2 > 0  # one more at each end, for lines that reach the edge
    assert part["total"] < whole["series"][0]["total"]


def test_series_as_arrow_are_those_of_json(server: TestClient, estimates: dict[str, dict[str, Any]]) -> None:
    url = f"{API}/estimates/{estimates['encoders']['id']}/series"
    arrow = pl.read_ipc_stream(
        io.BytesIO(server.get(url, params={"columns": "x,y", "points": 20, "format": "arrow"}).content)
    )
    for series in server.get(url, params={"columns": "x,y", "points": 20}).json()["series"]:
        rows = arrow.filter(pl.col("column") == series["column"])
        np.testing.assert_allclose(rows["t"].to_numpy(), series["t"])
        np.testing.assert_allclose(rows["y"].to_numpy(), series["y"])


def test_unknown_columns_and_estimates_are_refused(server: TestClient, estimates: dict[str, dict[str, Any]]) -> None:
    url = f"{API}/estimates/{estimates['encoders']['id']}/series"
    refused = server.get(url, params={"columns": "x,luck"})
    assert refused.status_code == 422
    assert refused.json()["where"]["found"] == ["luck"]
    assert server.get(f"{API}/estimates/nope/series").status_code == 404


def test_the_map_has_all_methods_in_one_frame(
    server: TestClient, run_id: str, estimates: dict[str, dict[str, Any]]
) -> None:
    figure = server.get(f"{API}/runs/{run_id}/path", params={"points": 12}).json()
    lines = {line["method"]: line for line in figure["paths"]}
    assert figure["frame"] == "map"
    assert set(estimates) <= set(lines)
    for line in lines.values():
        assert line["shown"] == len(line["t"]) == len(line["x"]) == len(line["y"]) <= 12
        assert line["t"] == sorted(line["t"])
    path = lines["encoders"]
    assert path["estimate"] == estimates["encoders"]["id"]
    final = estimates["encoders"]["final"]
    assert (path["x"][-1], path["y"][-1]) == pytest.approx((final["x"], final["y"]), abs=1e-5)


def test_the_map_shows_what_is_asked_for(server: TestClient, run_id: str, estimates: dict[str, dict[str, Any]]) -> None:
    figure = server.get(f"{API}/runs/{run_id}/path", params={"methods": "encoders", "points": 5000}).json()
    assert [line["method"] for line in figure["paths"]] == ["encoders"]
    assert figure["paths"][0]["shown"] == figure["paths"][0]["total"] == estimates["encoders"]["rows"]
    assert server.get(f"{API}/runs/nope/path").status_code == 404
