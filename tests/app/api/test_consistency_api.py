"""Consistency of estimates and decisions on events over HTTP."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from typing import Any

import pytest
from fastapi.testclient import TestClient

from app.db.session import writing
from app.db.tables import Estimate
from tests.app.api.test_estimates_api import finished

API = "/api/v1"
SLIP = {"kind": "slip", "t0": 1.2004, "t1": 1.6, "evidence": "turn, 9 sigma", "replaced": "encoder heading by gyro"}
LATER = {**SLIP, "t0": 1.35}
HIT = {"kind": "collision", "t0": 1.21, "t1": 1.3, "evidence": "0.3 m/s, =1+1", "replaced": ""}


@pytest.fixture
def fused(server: TestClient, run_id: str) -> dict[str, Any]:
    finished(server, run_id)
    found = server.get(f"{API}/runs/{run_id}/estimates").json()["items"]
    return next(e for e in found if e["method"] == "fused")


def happened(server: TestClient, estimate: dict[str, Any], events: Sequence[dict[str, Any]]) -> None:
    """The estimate found these events."""
    with writing(server.app.state.engine) as session:  # type: ignore[attr-defined]  # Starlette's `app` has no state
        row = session.get(Estimate, estimate["id"])
        assert row is not None
        row.events = list(events)


def decisions(server: TestClient, run_id: str) -> dict[str, str | None]:
    listed = server.get(f"{API}/runs/{run_id}/events", params={"method": "fused"}).json()["items"]
    return {e["id"]: e["decision"] for e in listed}


def test_every_sensor_is_judged_with_bands_and_advice(server: TestClient, fused: dict[str, Any]) -> None:
    answer = server.get(f"{API}/estimates/{fused['id']}/consistency")
    found = answer.json()
    assert answer.status_code == 200 and found["sentence"].endswith(".")
    assert found["method"] == "fused" and found["sensors"]
    for sensor in found["sensors"]:
        running = sensor["running"]
        assert 0 <= sensor["rejected"] <= sensor["readings"] == running["readings"]
        assert len(running["t"]) == len(running["mean"]) and running["t"] == sorted(running["t"])
        assert running["band"][0] < sensor["dof"] < running["band"][1]
        assert (sensor["whiteness"] is None) == (sensor["advice"] is None) == (sensor["readings"] < 30)
    assert found["nees"]["dof"] in (2, 3) and 0 <= found["nees"]["inside"] <= 1
    assert found["nees"]["shown"] == len(found["nees"]["t"]) == len(found["nees"]["y"])


def test_a_range_gets_windows_of_its_own(server: TestClient, fused: dict[str, Any]) -> None:
    url = f"{API}/estimates/{fused['id']}/consistency"
    whole = server.get(url).json()
    t0, t1 = whole["nees"]["t"][0], whole["nees"]["t"][len(whole["nees"]["t"]) // 2]
    part = server.get(url, params={"t0": t0, "t1": t1}).json()
    for a, b in zip(whole["sensors"], part["sensors"], strict=True):
        assert {k: a[k] for k in a if k != "running"} == {k: b[k] for k in b if k != "running"}
        assert b["running"]["readings"] < a["running"]["readings"]
    assert part["nees"]["total"] < whole["nees"]["total"]
    assert server.get(f"{API}/estimates/nope/consistency").status_code == 404


def test_a_method_without_innovations_says_so(server: TestClient, run_id: str, fused: dict[str, Any]) -> None:
    found = server.get(f"{API}/runs/{run_id}/estimates").json()["items"]
    plain = next(e for e in found if e["method"] == "encoders")
    assert server.get(f"{API}/estimates/{plain['id']}/consistency").json()["sensors"] == []


def test_a_decision_stays_when_the_event_is_found_again(server: TestClient, run_id: str, fused: dict[str, Any]) -> None:
    happened(server, fused, [SLIP, HIT])
    url = f"{API}/runs/{run_id}/events/fused"
    put = server.put(f"{url}/slip-1200", json={"decision": "dismissed"})
    assert (put.status_code, put.json()["decision"]) == (200, "dismissed")
    assert decisions(server, run_id) == {"slip-1200": "dismissed", "collision-1210": None}
    happened(server, fused, [HIT, LATER])
    assert decisions(server, run_id) == {"collision-1210": None, "slip-1350": "dismissed"}
    server.put(f"{url}/slip-1350", json={"decision": "confirmed"})
    assert decisions(server, run_id)["slip-1350"] == "confirmed"
    happened(server, fused, [SLIP, LATER])  # two of a kind: the word belongs to the nearer one alone
    assert decisions(server, run_id) == {"slip-1200": None, "slip-1350": "confirmed"}
    assert server.delete(f"{url}/slip-1350").json()["decision"] is None
    assert decisions(server, run_id) == {"slip-1200": None, "slip-1350": None}


def test_dismissed_events_leave_the_sentence(server: TestClient, run_id: str, fused: dict[str, Any]) -> None:
    happened(server, fused, [SLIP, HIT])
    assert "1 collision, 1 slip." in server.get(f"/runs/{run_id}.json").json()["sentence"]
    server.put(f"{API}/runs/{run_id}/events/fused/slip-1200", json={"decision": "dismissed"})
    page = server.get(f"/runs/{run_id}.json").json()
    assert "1 collision." in page["sentence"] and "slip" not in page["sentence"]
    shown = next(e for e in page["estimates"] if e["method"] == "fused")["events"]
    assert [e["decision"] for e in shown] == ["dismissed", None]
    server.delete(f"{API}/runs/{run_id}/events/fused/slip-1200")


def test_events_leave_as_csv(server: TestClient, run_id: str, fused: dict[str, Any]) -> None:
    happened(server, fused, [SLIP, HIT])
    answer = server.get(f"{API}/runs/{run_id}/events", params={"method": "fused", "format": "csv"})
    assert answer.headers["content-type"].startswith("text/csv")
    rows = list(csv.DictReader(io.StringIO(answer.text)))
    assert [r["kind"] for r in rows] == ["slip", "collision"]
    assert float(rows[0]["t0 [s]"]) == SLIP["t0"] and rows[1]["evidence"] == HIT["evidence"]


@pytest.mark.parametrize(
    ("method", "event", "decision", "status"),
    [("fused", "slip-99", "confirmed", 404), ("luck", "slip-1200", "confirmed", 404), ("fused", "x", "maybe", 422)],
)
def test_what_does_not_exist_is_not_decided(
    server: TestClient, run_id: str, fused: dict[str, Any], method: str, event: str, decision: str, status: int
) -> None:
    refused = server.put(f"{API}/runs/{run_id}/events/{method}/{event}", json={"decision": decision})
    assert refused.status_code == status
