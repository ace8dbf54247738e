"""The command of the gap: `driftscope diagnose`."""

from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path
from typing import Any

from app.cli_common import OK, progress_on_terminal, run_of, simulated_beside, write_json


def add_commands(commands: Any, run_help: str) -> None:
    """The command and its options."""
    diagnose = commands.add_parser("diagnose", help="the sim-to-real gap: where, which effect, how far it shrinks")
    diagnose.add_argument("sources", nargs="+", metavar="RUN", help=run_help)
    diagnose.add_argument("--held-out", nargs="+", default=[], metavar="RUN", help="runs that only judge the result")
    diagnose.add_argument("--json", metavar="FILE", help="the diagnosis as JSON (- for standard output)")
    diagnose.add_argument("--evidence", metavar="FILE", help="what stands behind it, for a report, as JSON")
    diagnose.add_argument(
        "--simulator",
        metavar="NAME",
        help="one registered in DRIFTSCOPE_SIMULATORS, or sim/ of every RUN (default nominal)",
    )
    diagnose.add_argument(
        "--tolerance",
        nargs="+",
        action="extend",
        default=[],
        metavar="EFFECT.PARAMETER=SIZE",
        help="what is smaller is immaterial, in place of the table's size, as track_width.scale=0.01",
    )
    diagnose.add_argument("--seed", type=_seed, default=0, metavar="N", help="of every random draw (default 0)")
    diagnose.add_argument("--data", type=Path, help="data folder of stored runs (default data)")
    diagnose.set_defaults(run=_diagnose)


def _diagnose(options: argparse.Namespace) -> int:
    from app.settings import Settings
    from app.simulators import chosen
    from core.gap import Config, as_json, diagnose, evidence_json
    from core.gap.checks import check_tolerances

    config = Config(tolerances=_sizes(options.tolerance), seed=options.seed)
    check_tolerances(config.tolerances, "--tolerance")
    progress = progress_on_terminal("diagnose")
    runs = [run_of(source, options.data) for source in options.sources]
    held_out = [run_of(source, options.data) for source in options.held_out]
    path = Settings.from_env().simulators
    every = [*options.sources, *options.held_out]
    asked = [
        chosen(options.simulator, path, partial(simulated_beside, source, options.data), source) for source in every
    ]
    foreign = [one for one in asked if one is not None]
    diagnosis = diagnose(runs, foreign or None, held_out, config, progress)
    found = as_json(diagnosis)
    progress(1.0, "done")
    if options.evidence:
        write_json(options.evidence, evidence_json(diagnosis))
    if options.json:
        write_json(options.json, found)
    if options.json != "-":
        sys.stdout.write(told(found))
    return OK


def _seed(text: str) -> int:
    """A seed for numpy's generators."""
    if not text.isdecimal():
        raise argparse.ArgumentTypeError(f"expected a whole number of 0 or more, found {text!r}")
    return int(text)


def _sizes(given: list[str]) -> dict[str, float]:
    """`EFFECT.PARAMETER=SIZE` by key. Raises ParameterError."""
    from core.errors import ParameterError

    out = {}
    for text in given:
        key, _, size = text.partition("=")
        try:
            out[key] = float(size)
        except ValueError:
            raise ParameterError(
                f"--tolerance {text}: expected EFFECT.PARAMETER=SIZE, as track_width.scale=0.01", parameter="tolerance"
            ) from None
    return out


def told(found: dict[str, Any]) -> str:
    """The diagnosis in a few lines."""
    gap = found["gap"]
    lines = [f"verdict: {found['verdict'].replace('_', ' ')}"]
    for cause in found["causes"]:
        sizes = ", ".join(f"{name} {_size(value)}" for name, value in cause["parameters"].items())
        lines.append(f"  {cause['probability']:5.2f}  {cause['effect']}  {sizes}  share {cause['share']:.2f}")
    spots = found["where"][:5]
    lines += [f"where: {spot['stream']}, {spot['regime']}: {spot['share']:.0%} of the gap" for spot in spots]
    basis = "held out" if gap["held_out"] else "same runs"
    shrink = "" if gap["shrink"] is None else f", shrinks by {gap['shrink']:.0%}"
    lines.append(f"gap ({basis}): {gap['before']:.2f} -> {gap['after']:.2f}, floor {gap['floor']:.2f}{shrink}")
    if found["unexplained"]:
        lines.append(f"unexplained: {found['unexplained']['description']}")
    if found["next_experiment"]:
        lines.append(f"drive next: {found['next_experiment']['profile']}: {found['next_experiment']['reason']}")
    lines += [f"note: {note}" for note in found["notes"]]
    return "\n".join(lines) + "\n"


def _size(value: dict[str, Any]) -> str:
    if isinstance(value["value"], str):
        return value["value"]
    sd = "" if value["std"] is None else f" ± {value['std']:.2g}"
    return f"{value['value']:.6g}{sd}"
