"""`driftscope simulate`: the nominal simulator on a run's commands, with effects added."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from app.cli_common import OK, run_of, simulated_beside, write_json

if TYPE_CHECKING:
    from core.robot import EffectSet
    from core.run import Run
    from core.simulation.foreign import Foreign

SCENARIO = "scenario:"


def add_commands(commands: Any, run_help: str) -> None:
    """The command and its options."""
    simulate = commands.add_parser("simulate", help="the nominal simulator on a run's commands, with effects added")
    simulate.add_argument("source", metavar="RUN", help=f"{run_help}; or {SCENARIO}NAME, one of the scenario library")
    simulate.add_argument(
        "--effects", type=Path, metavar="F", help='JSON: {"effects": {...}}, a diagnosis, or a run.json'
    )
    simulate.add_argument("--seed", type=_seed, default=0, metavar="N", help="seed of all noise (default 0)")
    simulate.add_argument("--no-noise", action="store_true", help="expected readings: no noise, encoders not rounded")
    simulate.add_argument(
        "--start", type=float, metavar="S", help="from here on only [s], set down where the robot was"
    )
    simulate.add_argument("--end", type=float, metavar="S", help="up to here only [s]")
    simulate.add_argument("--simulator", metavar="NAME", help="one registered in DRIFTSCOPE_SIMULATORS, or sim/ of RUN")
    simulate.add_argument("--out", required=True, type=Path, metavar="DIR", help="a run folder, made anew")
    simulate.add_argument(
        "--json", metavar="FILE", help="what was made, and the gap to a recorded run, as JSON (- for standard output)"
    )
    simulate.add_argument("--data", type=Path, help="data folder of stored runs (default data)")
    simulate.set_defaults(run=_simulate)


def _simulate(options: argparse.Namespace) -> int:
    import dataclasses
    from functools import partial

    from app.settings import Settings
    from app.simulators import chosen
    from core.errors import ParameterError
    from core.formats import write_run
    from core.simulation import simulate
    from core.simulation.foreign import around

    foreign = chosen(
        options.simulator,
        Settings.from_env().simulators,
        partial(_beside, options),
        options.source,
    )
    if foreign is not None and options.no_noise:
        raise ParameterError("--no-noise is of our own simulator only", parameter="no_noise")
    run = _driven(options.source, options.data)
    inputs = None
    if options.start is not None or options.end is not None:
        from app.sandbox.prepared import stretch

        run, inputs = stretch(run, options.start, options.end)
    effects = {} if options.effects is None else read_effects(options.effects)
    if foreign is None:
        made = simulate(run, effects, options.seed, noise=not options.no_noise, inputs=inputs)
    else:
        made = around(foreign, run, effects, options.seed)
    origin = {"effects": effects, "seed": options.seed, "simulator": options.simulator or "nominal"}
    extra = {**run.meta.extra, "simulated": origin}  # beside what its simulator models, which stays as it was
    meta = dataclasses.replace(made.meta, name=f"{run.meta.name or 'run'} (simulated)", extra=extra)
    write_run(dataclasses.replace(made, meta=meta), options.out, "folder-csv")
    if options.json:
        gap = (
            (None, DRIVEN_BY_NOBODY)
            if _is_scenario(options.source)
            else _gap(run, made, effects, foreign, options.seed)
        )
        told = {"schema": "simulate/1", **origin, "noise": not options.no_noise, "gap": gap[0], "no_gap": gap[1]}
        write_json(options.json, told)
    return OK


def _beside(options: argparse.Namespace) -> Run | None:
    """The simulated run beside the real one, of the same stretch."""

    made = simulated_beside(options.source, options.data)
    if made is None or (options.start is None and options.end is None):
        return made
    first, last = made.span
    return made.crop(first if options.start is None else options.start, last if options.end is None else options.end)


DRIVEN_BY_NOBODY = "a scenario was driven by nobody: there is nothing to hold it against"


def _gap(
    run: Run, made: Run, effects: EffectSet, foreign: Foreign | None, seed: int
) -> tuple[dict[str, Any] | None, str | None]:
    """How far real and simulated are apart, as the sandbox has it; or why there is no number."""
    from app.sandbox.prepared import make_prepared
    from core.errors import MissingStreamError

    try:
        one = make_prepared(run, run.span, recorded=True, best=None)
        gap = one.gap(effects, seed, foreign, made)
    except MissingStreamError as error:  # a robot at rest needs no wheels, its gap does
        return None, error.message
    if gap is None:
        return None, one.no_gap
    by = {name: {"before": f.before, "after": f.after, "floor": f.floor} for name, f in gap.by_stream.items()}
    total = {"before": gap.total.before, "after": gap.total.after, "floor": gap.total.floor, "shrink": gap.shrink}
    return {**total, "by_stream": by}, None


def read_effects(path: Path) -> EffectSet:
    """The effects that a JSON file asks for."""
    from core.effects.chosen import effects_of
    from core.errors import FormatError

    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise FormatError(f"{path}: no JSON: {error}", file=str(path)) from None
    return effects_of(data, file=str(path))


def _driven(source: str, data: Path | None) -> Run:

    if not _is_scenario(source):
        return run_of(source, data)
    from core.errors import ParameterError
    from core.simulation.scenarios import SCENARIOS

    name = source.removeprefix(SCENARIO)
    if name not in SCENARIOS:
        raise ParameterError(f"there is no scenario {name!r}; expected one of {', '.join(SCENARIOS)}", scenario=name)
    return SCENARIOS[name].run()


def _is_scenario(source: str) -> bool:
    return source.startswith(SCENARIO) and not Path(source).exists()


def _seed(text: str) -> int:
    if not text.isdecimal() or int(text) > sys.maxsize:
        raise argparse.ArgumentTypeError(f"{text!r} is no seed, expected a whole number from 0")
    return int(text)
