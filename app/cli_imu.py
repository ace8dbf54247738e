"""The commands of the IMU room: `driftscope bias` and `driftscope allan`."""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from app.cli_common import OK, run_of, write_json

if TYPE_CHECKING:
    from core.imu.allan import AllanCurve
    from core.imu.bias import BiasEstimate
    from core.imu.noise import NoiseFit, Term
    from core.run import Run

AXES = ("gx", "gy", "gz", "ax", "ay", "az")


def add_commands(commands: Any, run_help: str) -> None:
    """The room's commands and their options."""
    bias = commands.add_parser("bias", help="gyro bias and heading by one method")
    bias.add_argument("source", metavar="RUN", help=run_help)
    bias.add_argument("--method", required=True, metavar="M", help="A, B, C, best or smoothed")
    bias.add_argument("--out", required=True, type=Path, metavar="FILE.csv", help="t,theta,bias,accepted at 10 Hz")
    bias.add_argument("--json", metavar="FILE", help="the result as JSON (- for standard output)")
    bias.add_argument("--data", type=Path, help="data folder of stored runs (default data)")
    bias.set_defaults(run=_bias)

    allan = commands.add_parser("allan", help="Allan deviation of one IMU axis with fitted N, B, K")
    allan.add_argument("source", metavar="RUN", help=run_help)
    allan.add_argument("--axis", default="gz", metavar="AXIS", help=f"{', '.join(AXES)} (default gz)")
    allan.add_argument("--json", metavar="FILE", help="the result as JSON (- for standard output)")
    allan.add_argument("--data", type=Path, help="data folder of stored runs (default data)")
    allan.set_defaults(run=_allan)


def imu_run_of(source: str, data: Path | None) -> Run:
    """The run that RUN names. IMU stamps that go back in time, which no stored run has, are told and left out."""
    from dataclasses import replace

    from core.formats import Limits, read_run
    from core.imu.stamps import in_order

    if not Path(source).exists():
        return run_of(source, data)
    run = read_run(Path(source), limits=Limits(unordered=frozenset({"imu"})))
    if run.imu is None:
        return run
    imu, notes = in_order(run.imu)
    _tell(tuple(f"{source}: {note}" for note in notes))
    return replace(run, imu=imu)


def _bias(options: argparse.Namespace) -> int:
    import time

    from core.imu.bias import track_bias

    run = imu_run_of(options.source, options.data)
    began = time.perf_counter()
    made = track_bias(run, options.method)
    runtime = time.perf_counter() - began
    write_bias(made, options.out)
    _tell(made.notes)
    if options.json:
        write_json(options.json, bias_json(run, made, runtime))
    return OK


def write_bias(made: BiasEstimate, out: Path) -> None:
    """t [s], theta [rad], bias [rad/s], accepted (1 or 0)."""
    import polars as pl

    table = pl.DataFrame({"t": made.t, "theta": made.theta, "bias": made.bias, "accepted": made.accepted})
    text = table.with_columns(pl.col("accepted").cast(pl.Int8)).fill_nan(None).write_csv()
    out.write_text(text, encoding="utf-8")


def bias_json(run: Run, made: BiasEstimate, runtime: float) -> dict[str, Any]:
    """The result in schema bias/1. `deg_per_hour` is the net error over the time."""
    from core.imu.bias import heading_errors
    from core.imu.bias.result import ACCEPTED

    errors = heading_errors(made, run.truth)
    return {
        "schema": "bias/1",
        "method": made.method,
        "max_deg": None if errors is None else math.degrees(errors.max_rad),
        "deg_per_hour": None if errors is None else abs(math.degrees(errors.net_rate)) * 3600,
        "accepted": int((made.segments.verdict == ACCEPTED).sum()),
        "segments": len(made.segments.t),
        "runtime_s": runtime,
    }


def _allan(options: argparse.Namespace) -> int:
    from core.errors import MissingStreamError, NotEnoughDataError, ParameterError
    from core.imu.allan import allan
    from core.imu.noise import fit_noise
    from core.imu.units import degrees

    axis = options.axis.removeprefix("imu.")
    if axis not in AXES:
        raise ParameterError(f"there is no IMU axis {options.axis!r}; expected one of {', '.join(AXES)}", axis=axis)
    run = imu_run_of(options.source, options.data)
    values = None if run.imu is None else getattr(run.imu, axis)
    if run.imu is None or values is None:
        raise MissingStreamError(f"the run has no imu.{axis}", missing=f"imu.{axis}")
    curve = allan(run.imu.t, values)
    notes, fit = curve.notes, None
    notes += _about(axis, values)
    if axis.startswith("g"):
        notes += degrees(run.imu.t, values, rested=True)
    try:
        fit = fit_noise(curve)
        notes += fit.notes
    except NotEnoughDataError as error:
        notes += (error.message,)
    _tell(notes)
    if options.json != "-":
        sys.stdout.write(_table(curve))
    if options.json:
        write_json(options.json, allan_json(f"imu.{axis}", curve, fit, notes))
    return OK


def _about(axis: str, values: Any) -> tuple[str, ...]:
    """What the readings say against themselves."""
    import numpy as np

    from core.imu.oddities import RESTLESS, saturated, wander

    times = wander(float(np.nanstd(values)), values)
    moved = (
        f"The readings wander by {times:.3g} times their own noise: the record is not at rest, and the curve shows "
        "that movement. The IMU page takes the readings at rest alone.",
    )
    return saturated(values, axis) + (moved if times > RESTLESS else ())


def allan_json(axis: str, curve: AllanCurve, fit: NoiseFit | None, notes: tuple[str, ...]) -> dict[str, Any]:
    """The result in schema allan/1: SI of the axis' unit; None where the record does not show a figure. `chi2`, `dof`:
    of the fit; `notes`: what speaks against the figures."""
    out: dict[str, Any] = {
        "schema": "allan/1",
        "axis": axis,
        "tau": curve.tau.tolist(),
        "adev": curve.deviation.tolist(),
        "lo": curve.lo.tolist(),
        "hi": curve.hi.tolist(),
        "n": curve.pairs.tolist(),
    }
    for name in ("N", "B", "K"):
        term: Term | None = None if fit is None else getattr(fit, name)
        out[name] = _finite(None if term is None else term.value)
        out[f"{name}_sd"] = _finite(None if term is None else term.sd)
    out |= {"chi2": None if fit is None else _finite(fit.chi2), "dof": None if fit is None else fit.dof}
    return {**out, "notes": list(notes)}


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _table(curve: AllanCurve) -> str:
    rows = zip(curve.tau, curve.deviation, curve.lo, curve.hi, curve.pairs, strict=True)
    lines = [f"{tau:12.6g} {dev:12.5e} {lo:12.5e} {hi:12.5e} {pairs:10d}\n" for tau, dev, lo, hi, pairs in rows]
    return f"{'tau [s]':>12} {'adev':>12} {'lo':>12} {'hi':>12} {'n':>10}\n" + "".join(lines)


def _tell(notes: tuple[str, ...]) -> None:
    """What a user should know about the result, a line each on standard error."""
    for note in notes:
        sys.stderr.write(f"driftscope: note: {note}\n")
