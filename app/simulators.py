"""Simulators that whoever runs the server has registered by name, never through the web.

`DRIFTSCOPE_SIMULATORS` names a JSON file: `{"mine": {"python": "module:function", "effects": ["motor_lag"]}}`, or
`"command": ["prog", "{run}", "{out}", "{effects}", "{seed}"]`, or `"url": "http://..."`; `timeout_s` (default 60).
"""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from core.effects import EFFECTS
from core.errors import DriftscopeError, FormatError, ParameterError
from core.formats import read_run, write_run
from core.robot import EffectSet
from core.run import Run
from core.simulation.foreign import Foreign, Simulate, recorded

OURS, RECORDED = "nominal", "sim"
TIMEOUT_S = 60.0
MAX_REPLY = 2 << 30  # bytes


class SimulatorError(DriftscopeError):
    """A simulator that is not ours failed, hung or answered with something else."""

    code = "simulator"


def registered(path: Path | None) -> dict[str, Foreign]:
    """The simulators in the settings' file by name; none without a file. Raises ParameterError naming the entry."""
    if path is None:
        return {}
    try:
        entries = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ParameterError(f"DRIFTSCOPE_SIMULATORS: {path}: {error}", parameter="simulators") from None
    if not isinstance(entries, dict):
        raise ParameterError(f"{path}: expected an object of simulators by name", parameter="simulators")
    return {name: _entry(name, entry) for name, entry in entries.items()}


def chosen(
    name: str | None, path: Path | None, beside: Callable[[], Run | None] = lambda: None, label: str = "the run"
) -> Foreign | None:
    """The simulator of that name in the settings' file `path`, or for `sim` the recorded run beside the real one.

    beside: reads the simulated run of the real one called `label`. None for our own (`nominal`, or no name). Raises
    ParameterError (no such name) and FormatError (no `sim/`).
    """
    if name is None or name == OURS:
        return None
    if name == RECORDED:
        made = beside()
        if made is None:
            raise FormatError(f"{label}: there is no folder {RECORDED}/ with a simulated run beside the streams")
        return recorded(f"{label}/{RECORDED}", made)
    simulators = registered(path)
    if name not in simulators:
        known = ", ".join([OURS, RECORDED, *simulators])
        raise ParameterError(f"there is no simulator {name!r}; expected one of {known}", parameter="simulator")
    return simulators[name]


def _entry(name: str, entry: object) -> Foreign:
    kinds = set(KINDS) & set(entry) if isinstance(entry, Mapping) else set()
    if not isinstance(entry, Mapping) or len(kinds) != 1 or name in (OURS, RECORDED):
        raise ParameterError(
            f"simulator {name!r}: expected one of {', '.join(KINDS)}, and a name other than {OURS} and {RECORDED}",
            parameter=f"simulators.{name}",
        )
    kind = kinds.pop()
    timeout = entry.get("timeout_s", TIMEOUT_S)
    if not isinstance(timeout, int | float) or not timeout > 0:
        raise ParameterError(f"simulator {name!r}: timeout_s must be a positive number of seconds", parameter=name)
    effects = frozenset(entry.get("effects", ()))
    if unknown := effects - set(EFFECTS):
        raise ParameterError(f"simulator {name!r}: there is no effect {sorted(unknown)[0]!r}", parameter=name)
    return Foreign(name, KINDS[kind](name, entry[kind], float(timeout)), effects)


class _Host:
    """A process that holds a Python callable; started when first asked, and again after it was ended."""

    def __init__(self, name: str, target: str, timeout: float) -> None:
        self._name, self._target, self._timeout = name, target, timeout
        self._process: subprocess.Popen[str] | None = None
        self._lock = threading.Lock()

    def __call__(self, run: Run, effects: EffectSet, seed: int) -> Run:
        with self._lock, tempfile.TemporaryDirectory(prefix="driftscope-") as folder:
            write_run(run, Path(folder) / "run", "folder-parquet")
            asked = {"run": f"{folder}/run", "out": f"{folder}/out", "effects": effects, "seed": seed}
            reply = self._ask(json.dumps(asked) + "\n")
            if "error" in reply:
                raise SimulatorError(f"the simulator {self._name!r} failed: {reply['error']}", simulator=self._name)
            return _read(self._name, Path(folder) / "out")

    def _ask(self, line: str) -> dict[str, str]:
        process = self._alive()
        assert process.stdin is not None and process.stdout is not None
        late = threading.Event()

        def give_up() -> None:
            late.set()
            process.kill()

        timer = threading.Timer(self._timeout, give_up)
        timer.start()
        try:
            process.stdin.write(line)
            process.stdin.flush()
            told = process.stdout.readline()
        except BrokenPipeError:
            told = ""
        finally:
            timer.cancel()
        if told:
            answer: dict[str, str] = json.loads(told)
            return answer
        self.close()
        why = f"took longer than {self._timeout:g} s" if late.is_set() else "ended before it answered"
        raise SimulatorError(f"the simulator {self._name!r} {why}", simulator=self._name)

    def _alive(self) -> subprocess.Popen[str]:
        if self._process is None or self._process.poll() is not None:
            words = [sys.executable, "-m", "app.simulator_host", self._target]
            self._process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        return self._process

    def close(self) -> None:
        """End the process."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.communicate()

    def __del__(self) -> None:
        self.close()


def _python(name: str, target: Any, timeout: float) -> Simulate:
    """A callable `module:function`, held in a process of its own. Its module is only imported there."""
    module, _, attribute = str(target).partition(":")
    if not module or not attribute:
        raise ParameterError(
            f"simulator {name!r}: expected module:function, found {target!r}", parameter=f"simulators.{name}"
        )
    return _Host(name, str(target), timeout)


def _command(name: str, words: Any, timeout: float) -> Simulate:
    """A program: the run's folder in, a run folder out. `{run}`, `{out}`, `{effects}` (a JSON file), `{seed}`."""
    if not isinstance(words, list) or not all(isinstance(w, str) for w in words) or not words:
        raise ParameterError(f"simulator {name!r}: command must be a list of words", parameter=f"simulators.{name}")

    def simulate(run: Run, effects: EffectSet, seed: int) -> Run:
        with tempfile.TemporaryDirectory(prefix="driftscope-") as folder:
            places = {"run": f"{folder}/run", "out": f"{folder}/out", "effects": f"{folder}/effects.json"}
            write_run(run, Path(places["run"]), "folder-csv")
            Path(places["effects"]).write_text(json.dumps({"effects": effects}), encoding="utf-8")
            filled = [_filled(word, {**places, "seed": str(seed)}) for word in words]
            _run_to_end(name, filled, timeout)
            return _read(name, Path(places["out"]))

    return simulate


def _filled(word: str, values: Mapping[str, str]) -> str:
    for key, value in values.items():
        word = word.replace(f"{{{key}}}", value)
    return word


def _run_to_end(name: str, words: list[str], timeout: float) -> None:
    """Run the program and all that it starts, no longer than `timeout` seconds."""
    try:
        process = subprocess.Popen(
            words, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True
        )
    except OSError as error:
        raise SimulatorError(f"the simulator {name!r} did not start: {error}", simulator=name) from None
    try:
        _, told = process.communicate(timeout=timeout)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        raise SimulatorError(f"the simulator {name!r} took longer than {timeout:g} s", simulator=name) from None
    if process.returncode:
        last = told.decode(errors="replace").strip().splitlines()[-1:] or ["no message"]
        raise SimulatorError(
            f"the simulator {name!r} ended with status {process.returncode}: {last[0][:500]}", simulator=name
        )


def _url(name: str, address: Any, timeout: float) -> Simulate:
    """An HTTP endpoint: POST a zip of the run folder with `?seed=N`, effects in `effects.json` beside; a zip back."""
    import httpx

    def simulate(run: Run, effects: EffectSet, seed: int) -> Run:
        with tempfile.TemporaryDirectory(prefix="driftscope-") as folder:
            write_run(run, Path(folder) / "run", "folder-csv")
            body = io.BytesIO()
            with zipfile.ZipFile(body, "w", zipfile.ZIP_DEFLATED) as archive:
                for path in sorted((Path(folder) / "run").iterdir()):
                    archive.write(path, path.name)
                archive.writestr("effects.json", json.dumps({"effects": effects}))
            reply = Path(folder) / "reply.zip"
            try:
                with httpx.stream(
                    "POST", str(address), params={"seed": seed}, content=body.getvalue(), timeout=timeout,
                    headers={"Content-Type": "application/zip"},
                ) as answer:  # fmt: skip
                    _keep(name, answer, reply, timeout)
            except httpx.TimeoutException:
                raise SimulatorError(f"the simulator {name!r} took longer than {timeout:g} s", simulator=name) from None
            except httpx.HTTPError as error:
                raise SimulatorError(f"the simulator {name!r} did not answer: {error}", simulator=name) from None
            return _read(name, reply)

    return simulate


def _keep(name: str, answer: Any, reply: Path, timeout: float) -> None:
    """The reply's body on disk; refused where it is an error, too large or too slow as a whole."""
    import time

    if answer.status_code != 200:
        answer.read()
        raise SimulatorError(
            f"the simulator {name!r} answered {answer.status_code}: {answer.text[:300]}", simulator=name
        )
    end, size = time.monotonic() + timeout, 0
    with reply.open("wb") as file:
        for chunk in answer.iter_bytes():
            size += len(chunk)
            if size > MAX_REPLY or time.monotonic() > end:
                raise SimulatorError(
                    f"the simulator {name!r} sent more than {MAX_REPLY >> 30} GiB or took longer than {timeout:g} s",
                    simulator=name,
                )
            file.write(chunk)


def _read(name: str, path: Path) -> Run:
    try:
        made = read_run(path)
    except (FormatError, OSError) as error:
        raise SimulatorError(f"the simulator {name!r} gave no run: {error}", simulator=name) from None
    return made


KINDS: dict[str, Callable[[str, Any, float], Simulate]] = {"python": _python, "command": _command, "url": _url}
