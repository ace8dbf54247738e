"""The sandbox over REST: what it gives is what the simulator gives, the gap falls with the true effect, files leave."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from app.cli import main
from app.errors import NotFoundError
from core.effects import EFFECTS
from core.effects.chosen import effects_of
from core.formats import read_run, write_run
from core.simulation import simulate
from core.simulation.scenarios import SCENARIOS, Rates

MOVE = "/api/v1/sandbox/simulate"
TRUE = {"track_width": {"scale": 1.04}}
DRIVE = SCENARIOS["in-place"]


def moved(server: TestClient, **move: Any) -> dict[str, Any]:
    answer = server.post(MOVE, json=move)
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


@pytest.fixture(scope="module")
def driven(server: TestClient, tmp_path_factory: pytest.TempPathFactory) -> str:
    """A run of a robot whose track is 4 % wider than its simulator thinks."""
    path = tmp_path_factory.mktemp("sandbox") / "real.zip"
    run = DRIVE.run(Rates(commands=20, wheels=20, imu=50, beacon=5, ranges=0, truth=20))
    write_run(simulate(run, TRUE, 7), path, "zip-parquet")
    answer = server.post("/api/v1/runs", params={"filename": "real.zip"}, content=path.read_bytes())
    assert answer.status_code in (200, 201), answer.text
    found: str = answer.json()["id"]
    return found


def test_a_scenario_gives_what_the_simulator_gives(server: TestClient) -> None:
    found = moved(server, scenario="in-place", effects=TRUE, points=20_000, path_points=50_000)
    core = simulate(DRIVE.run(), TRUE, 0, noise=False)
    assert core.imu is not None and core.truth is not None and core.truth.x is not None
    gz = next(s for s in found["streams"] if s["column"] == "imu.gz")
    assert gz["shown"] == gz["total"] == len(core.imu)
    assert np.allclose(gz["patched"], core.imu.gz, atol=1e-6) and not np.allclose(gz["nominal"], core.imu.gz, atol=1e-3)
    patched = next(p for p in found["paths"] if p["method"] == "patched")
    assert np.allclose(patched["x"], core.truth.x, atol=1e-4)
    assert found["gap"] is None and "scenario" in found["no_gap"]
    assert "real" not in gz and "residual_patched" not in gz


def test_the_true_effect_takes_the_gap_to_the_floor(server: TestClient, driven: str) -> None:
    nominal, patched = moved(server, run=driven, effects={}), moved(server, run=driven, effects=TRUE)
    before, gap = nominal["gap"], patched["gap"]
    assert before["now"] == pytest.approx(before["before"]) and before["shrink"] == pytest.approx(0.0)
    assert gap["before"] == pytest.approx(before["before"])
    assert gap["before"] > 2.0 * gap["now"] and gap["now"] < 1.5 * gap["floor"]
    assert gap["shrink"] > 0.85
    gz = next(s for s in patched["streams"] if s["column"] == "imu.gz")
    rest, left = (np.std(gz[key]) for key in ("residual_nominal", "residual_patched"))
    assert left < 0.5 * rest
    assert {p["method"] for p in patched["paths"]} == {"real", "nominal", "patched"}


def test_noise_effects_are_told_by_their_level(server: TestClient, driven: str) -> None:
    gap = moved(server, run=driven, effects={**TRUE, "gyro_noise": {"factor": 2.0}})["gap"]
    assert gap["streams"]["imu.gz"]["now"] == pytest.approx(1.0)


def test_packed_says_the_same_as_json(server: TestClient, driven: str) -> None:
    move = {"run": driven, "effects": {**TRUE, "beacon_shadow": {"x": 4.5, "y": 3.5, "radius": 0.1}}, "gap": False}
    plain = moved(server, **move)
    body = server.post(MOVE, json=move, headers={"Accept": "application/octet-stream"}).content
    size = int.from_bytes(body[:4], "little")
    head, rows = json.loads(body[4 : 4 + size]), np.frombuffer(body, "<f8", offset=4 + size)
    assert plain["gap"] is None and (4 + size) % 8 == 0 and len(head["streams"]) == len(plain["streams"])
    holes = 0
    for packed, told in zip((*head["paths"], *head["streams"]), (*plain["paths"], *plain["streams"]), strict=True):
        for key in packed.keys() & {"t", "x", "y", "theta", "real", "nominal", "patched", "residual_patched"}:
            first, count, holed = packed[key]["$"]
            values = np.array(told[key], np.float64)
            np.testing.assert_allclose(rows[first : first + count], values, atol=6e-8)
            assert holed == np.isnan(values).any()
            holes += holed
    assert holes > 0
    only = moved(server, **{**move, "gap": True, "lines": False})
    assert only["gap"]["now"] > 0.0 and only["paths"] == only["streams"] == []


def test_a_stretch_and_its_columns_can_be_chosen(server: TestClient, driven: str) -> None:
    found = moved(server, run=driven, start=5.0, end=15.0, t0=7.0, t1=8.0, streams=["imu.gz"], points=30)
    assert (found["source"]["start"], found["source"]["end"]) == pytest.approx((5.0, 15.0), abs=0.1)
    (gz,) = found["streams"]
    assert gz["t"][0] > 6.9 and gz["t"][-1] < 8.1 and gz["shown"] < gz["total"] <= 55
    real, nominal = found["paths"][0], found["paths"][1]
    assert np.hypot(real["x"][0] - nominal["x"][0], real["y"][0] - nominal["y"][0]) < 0.1


@pytest.mark.parametrize("stretch", [{}, {"start": 5.0, "end": 15.0}])
def test_the_command_line_makes_what_is_seen(
    server: TestClient, driven: str, stretch: dict[str, float], tmp_path: Path
) -> None:
    """What the page copies as a command: effects as JSON, seed, noise and stretch give the same readings."""
    seen = moved(server, run=driven, effects=TRUE, seed=3, noise=True, points=20_000, **stretch)
    real = server.get(f"/api/v1/runs/{driven}/files/run-parquet.zip").content
    (tmp_path / "real.zip").write_bytes(real)
    file = server.get("/api/v1/exports/effects/json", params={"run": driven, "effects": json.dumps(TRUE)})
    (tmp_path / "effects.json").write_bytes(file.content)
    words = ["simulate", str(tmp_path / "real.zip"), "--effects", str(tmp_path / "effects.json"), "--seed", "3"]
    words += [word for name, value in stretch.items() for word in (f"--{name}", str(value))]
    assert main([*words, "--out", str(tmp_path / "out")]) == 0
    made = read_run(tmp_path / "out")
    assert seen["source"]["placed"] == bool(stretch) and seen["source"]["reference"] == "truth"
    for column in seen["streams"]:
        stream, name = column["column"].split(".")
        log = getattr(made, stream)
        assert column["shown"] == column["total"] == len(log)
        np.testing.assert_allclose(column["patched"], getattr(log, name), atol=6e-8)


def test_a_stretch_outside_the_run_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words, named in (
        (["--start", "9", "--end", "2"], "from 9 to 2 s"),
        (["--start", "nan"], "within the run's 0 to"),
    ):
        out = str(tmp_path / "out")
        assert main(["simulate", "scenario:straight", *words, "--out", out]) == 2
        assert named in capsys.readouterr().err and not Path(out).exists()


def test_a_scenario_has_a_scene(server: TestClient) -> None:
    scenes = server.app.state.scenes  # type: ignore[attr-defined]  # Starlette's type of `app` has no state
    data = scenes.data("scenario-in-place")
    core = simulate(DRIVE.run(), {}, 0, noise=False).truth
    assert (
        core is not None
        and [p.method for p in data.paths] == ["truth"]
        and set(data.beacons) == {"B1", "B2", "B3", "B4"}
    )
    np.testing.assert_array_equal(data.paths[0].theta, core.theta)
    with pytest.raises(NotFoundError):
        scenes.data("scenario-nowhere")


def test_a_run_without_commands_says_what_it_cannot_show(server: TestClient, run_id: str) -> None:
    found = moved(server, run=run_id, effects={"track_width": {"scale": 1.1}})
    assert "commands" in found["source"]["idle"]["motor_lag"]
    assert "track_width" not in found["source"]["idle"]
    assert found["gap"]["now"] > found["gap"]["before"]


@pytest.mark.parametrize(
    ("move", "status", "parameter"),
    [
        ({"scenario": "straight", "effects": {"track_width": {"scale": 9.0}}}, 422, "track_width.scale"),
        ({"scenario": "straight", "effects": {"track_width": {"scole": 1.0}}}, 422, "track_width.scole"),
        ({"scenario": "straight", "effects": {"no_such": {"x": 1.0}}}, 422, "no_such"),
        ({"scenario": "nowhere"}, 422, "scenario"),
        ({"scenario": "straight", "simulator": "nobody"}, 422, "simulator"),
        ({"scenario": "straight", "streams": ["imu.az"]}, 422, "streams"),
        ({"scenario": "straight", "start": 9.0, "end": 2.0}, 422, "end"),
        ({}, 422, "run"),
        ({"run": "0000000000000000"}, 404, None),
    ],
)
def test_what_is_wrong_is_named(server: TestClient, move: dict[str, Any], status: int, parameter: str | None) -> None:
    answer = server.post(MOVE, json=move)
    assert answer.status_code == status and answer.headers["content-type"] == "application/problem+json"
    assert answer.json()["where"].get("parameter") == parameter


def test_the_table_and_the_scenarios_are_whole(server: TestClient) -> None:
    table = {e["id"]: e for e in server.get("/api/v1/effects").json()["items"]}
    assert list(table) == list(EFFECTS)
    limit = table["speed_limit"]["parameters"][0]
    assert limit["neutral"] is None and limit["high"] is None and limit["unit"] == "m/s"
    drives = server.get("/api/v1/scenarios").json()
    assert [s["name"] for s in drives["scenarios"]] == list(SCENARIOS)
    assert drives["simulators"] == ["nominal"]


def test_effects_leave_as_files(server: TestClient, driven: str) -> None:
    effects = {**TRUE, "bump": {"time": 3.0, "turn": 0.1}}
    told = server.post("/api/v1/exports/effects/sdf", json={"run": driven, "effects": effects, "form": "json"}).json()
    assert "track_width" in told["expressed"] and "bump" in told["missing"]
    params = {"run": driven, "effects": json.dumps(effects)}
    file = server.get("/api/v1/exports/effects/sdf", params=params)
    assert file.text == told["text"] and told["file_name"] in file.headers["content-disposition"]
    plain = server.get("/api/v1/exports/effects/json", params=params)
    assert effects_of(plain.json())["track_width"] == TRUE["track_width"]
    assert {t["name"] for t in server.get("/api/v1/exports/effects").json()} >= {"json", "sdf", "ros2_control", "mjcf"}
    wrong = server.get("/api/v1/exports/effects/sdf", params={"run": driven, "effects": "[1]"})
    assert wrong.status_code == 422 and wrong.json()["where"]["parameter"] == "effects"
    assert server.get("/api/v1/exports/effects/word", params=params).status_code == 422


def test_few_stretches_are_kept(server: TestClient, driven: str, tmp_path: Path) -> None:
    kept = server.app.state.sandbox._kept  # type: ignore[attr-defined]  # how much memory it may take
    for k in range(10):
        moved(server, run=driven, end=8.0 + 0.5 * k, streams=[])
    assert len(kept) == 8
