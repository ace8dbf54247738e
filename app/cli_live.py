"""`driftscope stream` and `driftscope robot`: a recorded run, or a virtual robot, as a live one."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import os
import secrets
import signal
import sys
import time
from collections.abc import Coroutine
from pathlib import Path
from typing import TYPE_CHECKING, Any

from app.cli_common import run_of

if TYPE_CHECKING:
    from app.live.client import Client
    from core.run import Run

TICK = 0.05  # s between two batches
REST_TICK = 0.1  # and of a robot that stands
SPEED_UP, TURN_UP = 1.0, 3.0  # m/s^2, rad/s^2: how fast the virtual robot's set-points follow the stick
SLOW_DOWN = 2.0  # times as fast when it stops
V_MAX, W_MAX = 0.8, 1.5


def add_commands(commands: Any, run_help: str) -> None:
    """Both commands with their options."""
    stream = commands.add_parser("stream", help="replay a run as a live robot")
    stream.add_argument("source", metavar="RUN", help=run_help)
    stream.add_argument("--speed", type=_positive, default=1.0, help="times real time (default 1)")
    stream.add_argument("--data", type=Path, help="data folder of stored runs (default data)")
    _common(stream, "the run's name")
    stream.set_defaults(run=_stream)

    robot = commands.add_parser("robot", help="a virtual robot, driven from the dashboard")
    robot.add_argument("--effects", metavar="FILE", help='effects it has: a diagnosis, or {"effects": {...}}')
    robot.add_argument("--scenario", metavar="S", help="drive by itself: the name of a scenario, again and again")
    robot.add_argument("--seed", type=int, default=0, help="of its noise (default 0)")
    robot.add_argument("--seconds", type=_positive, help="end the run after so long")
    _common(robot, "virtual")
    robot.set_defaults(run=_robot)


def _common(command: argparse.ArgumentParser, name: str) -> None:
    command.add_argument("--to", required=True, metavar="URL", help="the dashboard, such as http://127.0.0.1:8000")
    command.add_argument("--name", help=f"the robot's name (default: {name})")


def _positive(text: str) -> float:
    value = float(text)
    if not 0 < value < 1e6:
        raise argparse.ArgumentTypeError(f"{text!r} is no number over 0")
    return value


def _client(options: argparse.Namespace, name: str, run: dict[str, Any], **more: Any) -> Client:
    from app.live.client import Client, address

    hello = {"session": secrets.token_hex(8), "run": run, **more}
    client = Client(options.to, name, hello, token=os.environ.get("DRIFTSCOPE_TOKEN"), on_state=_say)
    address(client.url, name)  # a wrong URL is told at once
    return client


def _say(state: str) -> None:
    sys.stderr.write(f"driftscope: {state}\n")
    sys.stderr.flush()


def robot_name(text: str) -> str:
    """A text as a robot's name: what may not stand in one becomes a dash."""
    kept = "".join(c if c.isascii() and (c.isalnum() or c in "._-") else "-" for c in text.strip())[:64]
    return kept.strip("-") or "robot"


def _stream(options: argparse.Namespace) -> int:
    from core.formats.run_json import meta_to_json

    run = run_of(options.source, options.data)
    name = options.name or robot_name(run.meta.name or Path(options.source).stem)
    client = _client(options, name, meta_to_json(run.meta))
    return asyncio.run(_until_ended(client, _replay(client, run, options.speed)))


async def _replay(client: Client, run: Run, speed: float) -> None:
    """The run's pieces when they are due."""
    from app.live.client import wire
    from core.live.pieces import pieces

    began, t0 = time.monotonic(), run.span[0]
    for k, piece in enumerate(pieces(run, TICK * max(speed, 1.0))):
        due = began + (k + 1) * TICK * max(speed, 1.0) / speed
        await asyncio.sleep(max(due - time.monotonic(), 0.0))
        while client.waiting > 400:  # the server is behind: no row is dropped here
            await asyncio.sleep(TICK)
        if piece.logs():
            client.send(wire(piece))
    _say(f"all of {run.span[1] - t0:.6g} s is sent")


def _robot(options: argparse.Namespace) -> int:
    from app.live.client import wire
    from core.effects.chosen import effects_of
    from core.formats.run_json import meta_to_json
    from core.live.virtual import META, VirtualRobot

    effects: Any = {}
    if options.effects:
        import json

        effects = effects_of(json.loads(Path(options.effects).read_text(encoding="utf-8")), file=options.effects)
    robot = VirtualRobot(META, effects, options.seed)
    robot.step(TICK, 0.0, 0.0)  # what is wrong with the effects is told now
    robot = VirtualRobot(META, effects, options.seed)
    stick = Stick(_scenario(options.scenario) if options.scenario else None)
    limits = {"v": V_MAX, "w": W_MAX}
    client = _client(options, options.name or "virtual", meta_to_json(META), drive=True, virtual=True, limits=limits)
    client.on_command = stick.take

    async def drive() -> None:
        began = time.monotonic()
        while options.seconds is None or robot.t < options.seconds:
            tick = REST_TICK if stick.stands else TICK
            until = robot.t + tick
            await asyncio.sleep(max(began + until - time.monotonic(), 0.0))
            if time.monotonic() - began - until > 2.0:  # the machine slept
                began = time.monotonic() - until
            client.send(wire(robot.step(until, *stick.at(until, tick))))

    return asyncio.run(_until_ended(client, drive()))


class Stick:
    """Where the robot's set-points stand: they follow the driver's, else the scenario's, at steady rates; without a
    newer command than `valid_s` old the robot stops by itself."""

    def __init__(self, scenario: Any = None) -> None:
        self._scenario = scenario
        self._asked, self._until = (0.0, 0.0), 0.0
        self._driven = False
        self._v = self._w = 0.0

    def take(self, command: tuple[float, float, float] | None) -> None:
        """A command, or None to stop."""
        now = time.monotonic()
        self._driven = self._driven or command is not None
        self._asked, self._until = ((command[0], command[1]), now + command[2]) if command else ((0.0, 0.0), now)

    @property
    def stands(self) -> bool:
        """Whether nothing is asked for and nothing moves."""
        follows = self._scenario is None or self._driven
        return follows and self._asked == (0.0, 0.0) and self._v == self._w == 0.0

    def at(self, t: float, tick: float) -> tuple[float, float]:
        """Set-points at the end of the next tick."""
        if self._scenario is not None and not self._driven:
            self._v, self._w = self._scenario(t)
            return self._v, self._w
        v, w = self._asked if time.monotonic() < self._until else (0.0, 0.0)
        self._v, self._w = _towards(self._v, v, SPEED_UP * tick), _towards(self._w, w, TURN_UP * tick)
        return self._v, self._w


def _towards(now: float, asked: float, most: float) -> float:
    if abs(asked) < abs(now) or asked * now < 0:
        most *= SLOW_DOWN
    return max(now - most, min(now + most, asked))


def _scenario(name: str) -> Any:
    import numpy as np

    from core.errors import ParameterError
    from core.simulation.scenarios import SCENARIOS

    if name not in SCENARIOS:
        expected = ", ".join(SCENARIOS)
        raise ParameterError(f"there is no scenario {name!r}; expected one of {expected}", parameter="scenario")
    asked = SCENARIOS[name].commands()
    end = float(asked.t[-1])
    return lambda t: tuple(float(np.interp(t % end, asked.t, column)) for column in (asked.v, asked.w))


async def _until_ended(client: Client, work: Coroutine[Any, Any, None]) -> int:
    """Stream until the work is done or somebody interrupts; then end the run."""
    stopped = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stopped.set)
    serving, working = asyncio.create_task(client.run()), asyncio.create_task(work)
    waiting = asyncio.create_task(stopped.wait())
    try:
        await asyncio.wait((serving, working, waiting), return_when=asyncio.FIRST_COMPLETED)
        if not serving.done():
            if working.done():
                await working
            client.end()
            await asyncio.wait((serving,), timeout=None if not stopped.is_set() else 3.0)
        if serving.done():
            await serving
    finally:
        for task in (working, waiting, serving):
            task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.gather(working, waiting, serving, return_exceptions=True)
    return 0
