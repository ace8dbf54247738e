"""Simulators registered by whoever runs the server: a callable, a program, an address; what they do wrong is named."""

from __future__ import annotations

import json
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.cli import main
from app.simulators import SimulatorError, chosen, registered
from core.errors import DriftscopeError, FormatError, ParameterError
from core.formats import read_run, write_run
from core.run import Run
from core.simulation import simulate
from core.simulation.foreign import around
from core.simulation.scenarios import SCENARIOS

CODE = """
import os, time
from core.simulation import simulate

def good(run, effects, seed):
    print("chatter")
    os.write(1, b"more of it")
    return simulate(run, effects, seed)
"""
BAD = """
import os, time

def bad(run, effects, seed):
    if seed == 0:
        raise RuntimeError("no such floor")
    if seed == 1:
        return 7
    if seed == 2:
        time.sleep(600)
    os._exit(3)
"""
PROGRAM = """
import json, sys
from pathlib import Path
mode = sys.argv[-1]
if mode == "fail":
    sys.exit("the world is flat")
if mode == "nothing":
    sys.exit(0)
from core.formats import read_run, write_run
from core.simulation import simulate
run, out, effects, seed, mode = sys.argv[1:]
effects = json.loads(Path(effects).read_text())["effects"]
write_run(simulate(read_run(Path(run)), effects, int(seed)), Path(out), "folder-csv")
"""
WORDS = ["{run}", "{out}", "{effects}", "{seed}"]


@pytest.fixture(scope="module")
def run() -> Run:
    return SCENARIOS["straight"].run()


@pytest.fixture
def settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Registers entries; the file's path."""
    (tmp_path / "their_simulators.py").write_text(CODE)
    (tmp_path / "bad_simulators.py").write_text(BAD)
    (tmp_path / "program.py").write_text(PROGRAM)
    root = str(Path(__file__).resolve().parents[2])
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{root}")

    def write(entries: object) -> Path:
        path = tmp_path / "simulators.json"
        path.write_text(json.dumps(entries))
        return path

    write.folder = tmp_path  # type: ignore[attr-defined]
    return write


def same(found: Run, expected: Run) -> None:
    assert found.imu is not None and expected.imu is not None
    np.testing.assert_array_equal(found.imu.gz, expected.imu.gz)
    np.testing.assert_array_equal(found.wheels.left, expected.wheels.left)  # type: ignore[union-attr]


def test_a_callable_lives_in_a_process_of_its_own(settings: Any, run: Run) -> None:
    path = settings({"mine": {"python": "their_simulators:good", "effects": ["motor_lag"]}})
    mine = registered(path)["mine"]
    lag = {"motor_lag": {"tau": 0.1}}
    for seed in (3, 4):
        same(around(mine, run, lag, seed), simulate(run, lag, seed))
    assert "their_simulators" not in sys.modules


def test_a_callable_that_fails_hangs_or_dies_is_named_and_ended(settings: Any, run: Run) -> None:
    mine = registered(settings({"mine": {"python": "bad_simulators:bad", "timeout_s": 5}}))["mine"]
    for seed, named in enumerate(
        ("RuntimeError: no such floor", "gave int, expected a Run", "longer than 5 s", "ended before it answered")
    ):
        with pytest.raises(SimulatorError, match=named) as caught:
            mine.simulate(run, {}, seed)
        assert "'mine'" in caught.value.message


def test_a_program_takes_and_gives_folders(settings: Any, run: Run, tmp_path: Path) -> None:
    words = [sys.executable, str(settings.folder / "program.py"), *WORDS]
    entries = {mode: {"command": [*words, mode]} for mode in ("work", "fail", "nothing")}
    entries["hang"] = {"command": ["sleep", "600"], "timeout_s": 0.3}
    entries["absent"] = {"command": ["no-such-program"]}
    simulators = registered(settings(entries))
    same(
        simulators["work"].simulate(run, {"gyro_bias": {"bias": 0.01}}, 5),
        simulate(run, {"gyro_bias": {"bias": 0.01}}, 5),
    )
    for name, named in (
        ("fail", "status 1: the world is flat"),
        ("nothing", "gave no run"),
        ("hang", "longer than 0.3 s"),
        ("absent", "did not start"),
    ):
        with pytest.raises(SimulatorError, match=named):
            simulators[name].simulate(run, {}, 0)


class Service(BaseHTTPRequestHandler):
    """A simulator behind an address."""

    def do_POST(self) -> None:
        import io
        import tempfile
        import zipfile

        body = self.rfile.read(int(self.headers["Content-Length"]))
        if self.path.startswith("/broken"):
            self.send_error(500, "out of order")
            return
        if self.path.startswith("/slow"):
            threading.Event().wait(1.5)
            return
        with tempfile.TemporaryDirectory() as folder:
            zipfile.ZipFile(io.BytesIO(body)).extractall(folder)
            effects = json.loads((Path(folder) / "effects.json").read_text())["effects"]
            (Path(folder) / "effects.json").unlink()
            seed = int(self.path.split("seed=")[1])
            write_run(simulate(read_run(Path(folder)), effects, seed), Path(folder) / "out.zip", "zip-csv")
            reply = (Path(folder) / "out.zip").read_bytes()
        self.send_response(200)
        self.send_header("Content-Length", str(len(reply)))
        self.end_headers()
        self.wfile.write(reply)

    def log_request(self, *told: Any) -> None:
        return


@pytest.fixture
def service() -> Iterator[str]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), Service)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()
    thread.join()


def test_an_address_takes_and_gives_zips(settings: Any, run: Run, service: str) -> None:
    entries = {name: {"url": f"{service}/{name}", "timeout_s": 20} for name in ("good", "broken")}
    entries["slow"] = {"url": f"{service}/slow", "timeout_s": 0.5}
    simulators = registered(settings(entries))
    same(simulators["good"].simulate(run, {}, 6), simulate(run, {}, 6))
    with pytest.raises(SimulatorError, match="answered 500"):
        simulators["broken"].simulate(run, {}, 0)
    with pytest.raises(SimulatorError, match=r"longer than 0\.5 s"):
        simulators["slow"].simulate(run, {}, 0)


@pytest.mark.parametrize(
    ("entries", "named"),
    [
        ([], "an object of simulators"),
        ({"a": {}}, "expected one of python, command, url"),
        ({"a": {"python": "m:f", "url": "http://x"}}, "expected one of"),
        ({"nominal": {"python": "m:f"}}, "a name other than"),
        ({"a": {"python": "no-colon"}}, "module:function"),
        ({"a": {"command": "rm -r"}}, "a list of words"),
        ({"a": {"python": "m:f", "timeout_s": 0}}, "timeout_s"),
        ({"a": {"python": "m:f", "effects": ["luck"]}}, "no effect 'luck'"),
    ],
)
def test_wrong_settings_are_named(settings: Any, entries: object, named: str) -> None:
    with pytest.raises(ParameterError, match=named):
        registered(settings(entries))


def test_a_simulator_is_chosen_by_name(settings: Any, run: Run) -> None:
    path = settings({"mine": {"url": "http://127.0.0.1:1/"}})
    assert chosen(None, path) is None and chosen("nominal", path) is None
    assert chosen("mine", path).name == "mine"  # type: ignore[union-attr]
    with pytest.raises(ParameterError, match="nominal, sim, mine"):
        chosen("yours", path)
    with pytest.raises(FormatError, match="there is no folder sim/"):
        chosen("sim", path)


def test_the_command_line_uses_a_recorded_simulation(run: Run, tmp_path: Path, capsys: Any) -> None:
    write_run(run_with_readings := simulate(run, {}, 1), tmp_path / "real", "folder-csv")
    write_run(simulate(run, {}, 2), tmp_path / "real" / "sim", "folder-csv")
    (tmp_path / "e.json").write_text('{"effects": {"gyro_bias": {"bias": 0.01}}}')
    words = ["simulate", str(tmp_path / "real"), "--simulator", "sim", "--effects", str(tmp_path / "e.json")]
    assert main([*words, "--out", str(tmp_path / "out")]) == 0
    found, theirs = read_run(tmp_path / "out"), read_run(tmp_path / "real" / "sim")
    assert found.imu is not None and theirs.imu is not None and run_with_readings.imu is not None
    np.testing.assert_allclose(found.imu.gz, theirs.imu.gz + 0.01, atol=1e-12)
    (tmp_path / "e.json").write_text('{"effects": {"motor_lag": {"tau": 0.1}}}')
    assert main([*words, "--out", str(tmp_path / "no")]) == 2
    assert "motor_lag cannot be put around" in capsys.readouterr().err
    assert not (tmp_path / "no").exists()


def test_errors_are_of_the_family() -> None:
    assert issubclass(SimulatorError, DriftscopeError)
