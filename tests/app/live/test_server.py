"""Robots and viewers at a server: rows go to disk, estimates and commands come back, what is wrong is told."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from app.jobs import kinds
from app.live import run as live_run
from app.main import create_app
from app.settings import Settings
from core.live import LiveEstimator
from core.live.pieces import pieces
from core.run import Run
from core.simulation import simulate
from core.simulation.scenarios import SCENARIOS

from .robots import API, batch, hang_up, heard, hello, join, stored

RUN = simulate(SCENARIOS["straight"].run(), {}, 1).crop(0.0, 8.0)
PARTS = list(pieces(RUN, 0.1))


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    """One server for all; stored runs are not estimated again."""
    data = tmp_path_factory.mktemp("live") / "data"
    app = create_app(Settings(data=data, workers=1, allowed_hosts=("testserver",)))
    with pytest.MonkeyPatch.context() as patch, TestClient(app, raise_server_exceptions=False) as client:
        patch.setattr(kinds.jobs, "first_jobs", lambda session, run_id: [])
        yield client


@pytest.fixture(autouse=True)
def lines() -> Iterator[None]:
    """No robot outlives its test."""
    yield
    hang_up()


def test_a_run_is_stored_as_it_was_sent_and_estimated_as_it_came(client: TestClient) -> None:
    with client.websocket_connect(f"{API}/mill/watch") as viewer:
        assert heard(viewer, "snapshot")["state"] == "waiting"
        robot = join(client, "mill", hello(RUN))
        welcome = heard(robot, "welcome")
        live_id = welcome["run_id"]
        assert welcome["next"] == 0
        assert heard(viewer, "snapshot")["run_id"] == live_id
        for n, piece in enumerate(PARTS):
            robot.send_text(json.dumps(batch(n, piece)))
        heard(robot, "ack", n=len(PARTS) - 1)
        listed = {r["robot"]: r for r in client.get(API).json()["items"]}
        assert listed["mill"]["rows"]["imu"] == 800
        assert client.get("/api/v1/runs").json()["items"][0]["is_live"]
        fused: dict[str, Any] = {}
        while not fused or fused["t"] < 7.9:
            update = heard(viewer, "update")
            fused = update["poses"].get("fused", fused)
        assert RUN.truth is not None and RUN.truth.x is not None
        at = float(np.interp(fused["t"], RUN.truth.t, RUN.truth.x))
        assert abs(fused["x"] - at) < 5 * fused["sd_x"] + 0.01
        with client.websocket_connect(f"{API}/mill/watch") as late:
            whole = heard(late, "snapshot")
            path = whole["paths"]["fused"]
            assert path["t"][0] < 0.1 and path["t"][-1] > 7.8 and len(path["t"]) > 100
            assert max(v for v in whole["signals"]["commands.v"]["y"]) == pytest.approx(0.5)
            assert set(whole["ranges"]) == set(RUN.meta.beacons)
            assert {m["method"]: m["reason"] for m in whole["methods"]}["fused"] is None
        robot.send_text(json.dumps({"type": "end"}))
        assert heard(robot, "ended") == {"type": "ended", "run_id": live_id, "n": len(PARTS)}
        heard(viewer, "gone", stored_as=None)
        final = heard(viewer, "gone")["stored_as"]
    found = stored(client, live_id)
    assert found["id"] == final != live_id
    series = client.get(f"/api/v1/runs/{live_id}/streams/imu?columns=gz&points=5000").json()["series"][0]
    assert RUN.imu is not None
    np.testing.assert_array_equal(series["y"], RUN.imu.gz)
    np.testing.assert_array_equal(series["t"], RUN.imu.t)
    assert {s["name"]: s["rows"] for s in found["streams"]} == {n: len(log) for n, log in RUN.logs().items()}


def test_a_growing_run_is_read_like_any_other(client: TestClient) -> None:
    robot = join(client, "grows", hello(RUN))
    live_id = heard(robot, "welcome")["run_id"]
    for n, piece in enumerate(PARTS[:20]):
        robot.send_text(json.dumps(batch(n, piece)))
    heard(robot, "ack", n=19)
    detail: dict[str, Any] = {"streams": []}
    end = time.monotonic() + 30
    while {"imu": 200} not in [{s["name"]: s["rows"]} for s in detail["streams"]] and time.monotonic() < end:
        time.sleep(0.05)
        detail = client.get(f"/api/v1/runs/{live_id}").json()
    assert detail["is_live"] and {s["name"] for s in detail["streams"]} == set(RUN.logs())
    assert client.get(f"/api/v1/runs/{live_id}/streams/wheels?columns=left").json()["total"] > 50
    assert client.get(f"/api/v1/runs/{live_id}/files/run-csv.zip").status_code == 200
    assert client.get(f"/runs/{live_id}", headers={"accept": "text/html"}).status_code == 200
    assert client.post(f"{API}/grows/end").status_code == 202
    heard(robot, "ended")
    stored(client, live_id)


def test_a_robot_that_comes_back_goes_on_and_what_it_repeats_is_ignored(client: TestClient) -> None:
    robot = join(client, "back", hello(RUN, "x"))
    live_id = heard(robot, "welcome")["run_id"]
    for n in (0, 1, 2):
        robot.send_text(json.dumps(batch(n, PARTS[n])))
    heard(robot, "ack", n=2)
    robot.close()
    robot = join(client, "back", hello(RUN, "x"))
    welcome = heard(robot, "welcome")
    assert (welcome["run_id"], welcome["next"]) == (live_id, 3)
    for n in (1, 2, 5, 3, 4, 5):  # known, known, too early, and on
        robot.send_text(json.dumps(batch(n, PARTS[n])))
    gap = heard(robot, "throttle")
    assert gap["code"] == "gap" and gap["next"] == 3
    heard(robot, "ack", n=5)
    row = next(r for r in client.get(API).json()["items"] if r["robot"] == "back")
    assert row["rows"]["imu"] == 60 and row["quality"]["late_rows"] == 0
    late = batch(6, PARTS[6])
    late["streams"]["imu"] = {"t": [0.55, 0.65], "gz": [0.0, 0.0]}
    robot.send_text(json.dumps(late))
    heard(robot, "ack", n=6)
    row = next(r for r in client.get(API).json()["items"] if r["robot"] == "back")
    assert row["rows"]["imu"] == 61 and row["quality"]["late_rows"] == 1
    robot.send_text(json.dumps({"type": "end"}))
    heard(robot, "ended")
    assert stored(client, live_id)["duration_s"] > 0.5


def refused(client: TestClient, name: str, *messages: Any) -> dict[str, Any]:
    """The error that a robot is told, and that the connection is closed after it."""
    with client.websocket_connect(f"{API}/{name}") as socket:
        for message in messages:
            socket.send_text(message if isinstance(message, str) else json.dumps(message))
        error = heard(socket, "error")
        with pytest.raises(WebSocketDisconnect):
            socket.receive_text()
    return error


def jumped(n: int, by: float) -> dict[str, Any]:
    message = batch(n, PARTS[n])
    for columns in message["streams"].values():
        columns["t"] = [t + by for t in columns["t"]]
    return message


@pytest.mark.parametrize(
    ("messages", "code"),
    [
        (["no json"], "schema"),
        ([{"type": "hello", "protocol": "mqtt"}], "protocol"),
        ([hello(RUN), {"type": "batch", "n": 0, "sent": 0.0, "streams": {"imu": {"t": [0.0]}}}], "schema"),
        ([hello(RUN), {"type": "dance"}], "schema"),
        ([hello(RUN), batch(0, PARTS[0]), jumped(1, 5000.0)], "clock"),
        ([hello(RUN), batch(0, PARTS[0]), batch(1, PARTS[50]), jumped(2, -3.0)], "clock"),
    ],
)
def test_bad_input_is_refused_with_a_reason_and_others_go_on(
    client: TestClient, messages: list[Any], code: str
) -> None:
    other = join(client, "other", hello(RUN, f"o-{code}-{len(messages)}"))
    heard(other, "welcome")
    other.send_text(json.dumps(batch(0, PARTS[0])))
    error = refused(client, "bad", *messages)
    assert error["code"] == code and error["detail"]
    other.send_text(json.dumps(batch(1, PARTS[1])))
    heard(other, "ack", n=1)
    for name in ("other", "bad"):
        client.post(f"{API}/{name}/end")


def test_two_robots_with_one_name_are_not_mixed_up(client: TestClient) -> None:
    robot = join(client, "twin", hello(RUN, "first"))
    heard(robot, "welcome")
    error = refused(client, "twin", hello(RUN, "second"))
    assert error["code"] == "name_taken" and "twin" in error["detail"]
    again = join(client, "twin", hello(RUN, "first"))
    heard(again, "welcome")
    assert heard(robot, "error")["code"] == "replaced"
    client.post(f"{API}/twin/end")


def test_who_sends_too_fast_waits_and_who_does_not_listen_is_cut_off(
    client: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(live_run.LIMITS, "batches_per_s", 1e-3)  # twenty at once, then hardly any more
    monkeypatch.setattr(live_run, "BURST", 20e3)
    monkeypatch.setattr(live_run, "FLOOD", 30)
    robot = join(client, "hasty", hello(RUN))
    heard(robot, "welcome")
    for n in range(21):
        robot.send_text(json.dumps(batch(n, PARTS[n])))
    slow = heard(robot, "throttle")
    assert slow["code"] == "rate" and slow["next"] == 20 and slow["wait_s"] > 0
    for n in range(20, 55):
        robot.send_text(json.dumps(batch(n, PARTS[n])))
    assert heard(robot, "error")["code"] == "flood"
    client.post(f"{API}/hasty/end")


def test_rows_come_by_http_too(client: TestClient) -> None:
    def post(*messages: dict[str, Any]) -> Any:
        return client.post(f"{API}/posts/rows", content="\n".join(json.dumps(m) for m in messages))

    first = post(hello(RUN), batch(0, PARTS[0]), batch(1, PARTS[1])).json()
    assert first["next"] == 2 and not first["ended"]
    again = post(hello(RUN), batch(1, PARTS[1]), batch(2, PARTS[2])).json()
    assert again == {**first, "next": 3}
    assert post(hello(RUN), batch(9, PARTS[9])).status_code == 409
    wrong = post(hello(RUN), {"type": "batch", "n": 3, "sent": 0.0, "streams": {"imu": {"t": [9.0], "gz": ["x"]}}})
    assert wrong.status_code == 422 and wrong.json()["where"]["column"] == "gz"
    assert post(batch(3, PARTS[3])).status_code == 422
    assert post(hello(RUN), {"type": "end"}).json()["ended"]
    assert stored(client, first["run_id"])["duration_s"] > 0.2


def test_one_drives_at_a_time_and_what_was_asked_is_recorded(client: TestClient) -> None:
    said = hello(RUN, drive=True, virtual=True, limits={"v": 0.5, "w": 1.0})
    robot = join(client, "driven", said)
    live_id = heard(robot, "welcome")["run_id"]
    piece = Run(RUN.meta, wheels=RUN.wheels, imu=RUN.imu).crop(0.0, 0.5)
    robot.send_text(json.dumps(batch(0, piece)))
    heard(robot, "ack", n=0)
    with client.websocket_connect(f"{API}/driven/watch") as one, client.websocket_connect(f"{API}/driven/watch") as two:
        assert heard(one, "snapshot")["driver"] == {
            "who": None, "you": False, "allowed": True, "reason": None, "limits": {"v": 0.5, "w": 1.0}
        }  # fmt: skip
        one.send_text(json.dumps({"type": "drive", "v": 0.1, "w": 0.0}))
        assert heard(one, "refused")["code"] == "not_driver"
        one.send_text(json.dumps({"type": "drive_request", "name": "Ann"}))
        assert heard(one, "driver", you=True)["who"] == "Ann"
        assert heard(two, "driver", who="Ann")["you"] is False
        one.send_text(json.dumps({"type": "drive", "v": 9.0, "w": -0.2}))
        command = heard(robot, "command")
        assert (command["v"], command["w"]) == (0.5, -0.2) and 0 < command["valid_s"] <= 1
        two.send_text(json.dumps({"type": "drive_request", "name": "Bo"}))
        assert heard(two, "refused")["code"] == "driving"
        two.send_text(json.dumps({"type": "drive_request", "name": "Bo", "take_over": True}))
        assert heard(one, "driver", who="Bo")["you"] is False
        assert heard(robot, "stop")["seq"] > command["seq"]
        one.send_text(json.dumps({"type": "stop"}))  # who drove does not drive on
        heard(robot, "stop")
        assert heard(two, "driver", who=None)["you"] is False
        two.send_text(json.dumps({"type": "drive", "v": 0.2, "w": 0.0}))
        assert heard(two, "refused")["code"] == "not_driver"
        two.send_text(json.dumps({"type": "drive_request", "name": "Bo"}))
        assert heard(two, "driver", you=True)["who"] == "Bo"
        two.send_text(json.dumps({"type": "drive", "v": 0.2, "w": 0.0}))
        assert heard(robot, "command")["v"] == 0.2
        heard(robot, "stop")  # nobody held the stick any more: dead man
        two.send_text(json.dumps({"type": "drive", "v": 0.2, "w": 0.0}))
        heard(robot, "command")
        two.close()
        heard(robot, "stop")  # the driver's browser has gone
        assert heard(one, "driver", who=None)
        one.send_text("{}")
        assert heard(one, "refused")["code"] == "schema"
    robot.send_text(json.dumps({"type": "end"}))
    heard(robot, "ended")
    stored(client, live_id)
    rows = client.get(f"/api/v1/runs/{live_id}/streams/commands?columns=v").json()["series"][0]["y"]
    assert rows[:2] == [0.5, 0.0] and 0.2 in rows and rows[-1] == 0.0


def test_a_real_robot_is_not_driven_unless_the_server_was_told_so(client: TestClient) -> None:
    join(client, "real", hello(RUN, drive=True))
    with client.websocket_connect(f"{API}/real/watch") as viewer:
        while not heard(viewer, "snapshot")["run_id"]:
            pass
        viewer.send_text(json.dumps({"type": "drive_request"}))
        no = heard(viewer, "refused")
        assert no["code"] == "drive_off" and "--drive" in no["detail"]
        while heard(viewer, "update")["quality"]["silent_s"] < 0.5:  # told though the robot says nothing at all
            pass
    client.post(f"{API}/real/end")


def test_a_viewer_that_does_not_read_misses_updates_and_holds_nobody_up() -> None:
    from app.live.feed import QUEUE, Viewer

    slow = Viewer("slow", binary=False)
    assert [slow.post("x") for _ in range(QUEUE + 5)] == [True] * QUEUE + [False] * 5
    slow.tell({"type": "gone"})
    assert slow.missed == 6 and slow.queue.qsize() == QUEUE


def test_pages_elsewhere_and_those_without_the_token_get_no_connection(tmp_path: Path) -> None:
    settings = Settings(data=tmp_path, workers=1, host="0.0.0.0", token="secret", allowed_hosts=("testserver",))
    with TestClient(create_app(settings)) as client:
        bad: list[dict[str, str]] = [{}, {"authorization": "Bearer wrong"}]
        good = {"authorization": "Bearer secret"}
        for headers in (*bad, {**good, "origin": "http://evil.example"}):
            for path in (f"{API}/mill", f"{API}/mill/watch"):
                with pytest.raises(WebSocketDisconnect), client.websocket_connect(path, headers=headers):
                    pass
        with client.websocket_connect(f"{API}/mill/watch", headers=good) as viewer:
            assert heard(viewer, "snapshot")["state"] == "waiting"


def test_several_robots_at_once_lose_nothing_and_are_estimated_as_each_alone(client: TestClient) -> None:
    with client.websocket_connect(f"{API}/fleet2/watch") as viewer:
        fleet = {f"fleet{k}": join(client, f"fleet{k}", hello(RUN, f"f{k}")) for k in range(4)}
        for n, piece in enumerate(PARTS[:40]):
            for socket in fleet.values():
                socket.send_text(json.dumps(batch(n, piece)))
        for socket in fleet.values():
            heard(socket, "ack", n=39)
        pose: dict[str, Any] = {}
        while pose.get("t", 0.0) < 3.99:
            pose = heard(viewer, "update")["poses"].get("fused", pose)
    alone = LiveEstimator(RUN.meta)
    path = [made.paths["fused"] for piece in PARTS[:40] if "fused" in (made := alone.feed(piece)).paths][-1]
    assert path.covariance is not None
    expected = {"t": path.t, "x": path.x, "y": path.y, "theta": path.theta, "sd_x": np.sqrt(path.covariance[:, 0, 0])}
    assert {k: pose[k] for k in expected} == pytest.approx({k: float(v[-1]) for k, v in expected.items()}, abs=1e-9)
    rows = {r["robot"]: r for r in client.get(API).json()["items"]}
    for name in fleet:
        assert rows[name]["rows"]["imu"] == 400 and rows[name]["quality"]["loss"] == 0.0
        client.post(f"{API}/{name}/end")
