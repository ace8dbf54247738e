"""The commands of the calibration room: `driftscope calibrate` and `driftscope correct`."""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from app.cli_common import OK, progress_on_terminal, write_json
from app.cli_imu import imu_run_of

if TYPE_CHECKING:
    from core.calibration.imu import CalibrationReport, ImuCalibration, SensorModel


def add_commands(commands: Any, run_help: str) -> None:
    """The room's commands and their options."""
    calibrate = commands.add_parser("calibrate", help="IMU error model from rest, six-position and rate-table runs")
    calibrate.add_argument("sources", nargs="+", metavar="RUN", help=run_help)
    calibrate.add_argument("--json", metavar="FILE", help="the calibration as JSON (- for standard output)")
    calibrate.add_argument("--data", type=Path, help="data folder of stored runs (default data)")
    calibrate.set_defaults(run=_calibrate)

    correct = commands.add_parser("correct", help="a run with its IMU corrected by Algorithm 1 (Kolhoff & Kemper)")
    correct.add_argument("source", metavar="RUN", help=run_help)
    correct.add_argument("--calibration", required=True, type=Path, metavar="F", help="what `calibrate --json` wrote")
    correct.add_argument("--out", required=True, type=Path, metavar="DIR", help="a new run folder")
    correct.add_argument("--offline", action="store_true", help="with hindsight: two-sided average, no delay")
    correct.add_argument("--json", metavar="FILE", help="how good it is at rest, as JSON (- for standard output)")
    correct.add_argument("--data", type=Path, help="data folder of stored runs (default data)")
    correct.set_defaults(run=_correct)


def _calibrate(options: argparse.Namespace) -> int:
    from core.calibration.imu import calibrate

    runs = [imu_run_of(source, options.data) for source in options.sources]
    report = calibrate(runs, progress_on_terminal("calibrate"))
    _tell([str(item) for item in report.left_out], "left out: ")
    _tell(report.notes, "note: ")
    if options.json != "-":
        sys.stdout.write(table(report))
    if options.json:
        write_json(options.json, report.calibration.to_json())
    return OK


def table(report: CalibrationReport) -> str:
    """The calibration for people: a line per axis and number, with its deviation, SI."""
    lines = [f"{'':7}{'static bias':>24}{'drift':>24}{'drift tau [s]':>20}{'noise sd':>12}  matrix row\n"]
    for sensor, axes in (("gyro", ("gx", "gy", "gz")), ("accel", ("ax", "ay", "az"))):
        model: SensorModel = getattr(report.calibration, sensor)
        sd: SensorModel = getattr(report.calibration.sd, sensor)
        for k, axis in enumerate(axes):
            row = "  ".join(_known(v, s, 7) for v, s in zip(model.matrix[k], sd.matrix[k], strict=True))
            lines.append(
                f"{axis:7}{_known(model.static_bias[k], sd.static_bias[k], 5):>24}"
                f"{_known(model.drift_amplitude[k], sd.drift_amplitude[k], 5):>24}"
                f"{_known(model.drift_tau[k], sd.drift_tau[k], 4):>20}{_known(model.noise_sd[k]):>12}  {row}\n"
            )
    return "".join(lines)


def _known(value: float, sd: float = math.nan, digits: int = 4) -> str:
    if not math.isfinite(value):
        return "-"
    return f"{value:.{digits}g}" + (f" ± {sd:.1g}" if math.isfinite(sd) else "")


def _correct(options: argparse.Namespace) -> int:
    from core.calibration.imu import correct, correction_notes
    from core.errors import ParameterError
    from core.formats import write_run

    calibration = read_calibration(options.calibration)
    if options.out.exists() and (not options.out.is_dir() or any(options.out.iterdir())):
        raise ParameterError(f"{options.out} is there already; name a new folder", parameter="out")
    run = imu_run_of(options.source, options.data)
    made = correct(run, calibration, online=not options.offline)
    _tell(correction_notes(run, calibration), "note: ")
    write_run(made, options.out, "folder-csv")
    if options.json:
        write_json(options.json, judged(run, calibration))
    return OK


def judged(run: Any, calibration: ImuCalibration) -> dict[str, Any]:
    """The correction's report in schema correction/1: lists in the order of `axes`, SI, null where not known."""
    from core.calibration.imu import AXES, judge_correction

    report = judge_correction(run, calibration)
    out: dict[str, Any] = {"schema": "correction/1", "axes": list(AXES), "t0": report.t0, "t1": report.t1}
    for state in ("raw", "online", "offline"):
        one = getattr(report, state)
        out[state] = {key: _nulls(getattr(one, key)) for key in ("start", "asymptote", "mean", "sd")}
    for key in ("noise_factor", "mean_left", "correlation", "correlation_all"):
        out[key] = _nulls(getattr(report, key))
    return out


def _nulls(values: Any) -> list[float | None]:
    return [float(v) if math.isfinite(v) else None for v in values]


def read_calibration(path: Path) -> ImuCalibration:
    """A calibration file. Raises FormatError naming file and key."""
    from core.calibration.imu import ImuCalibration
    from core.errors import FormatError

    try:
        text = path.read_text(encoding="utf-8")
    except (FileNotFoundError, IsADirectoryError):
        raise FormatError(f"{path}: no such file", file=str(path)) from None
    except UnicodeDecodeError:
        raise FormatError(f"{path}: this is no JSON text", file=str(path)) from None
    try:
        return ImuCalibration.from_json(text)
    except FormatError as error:
        raise FormatError(f"{path}: {error.message}", **{**error.where, "file": str(path)}) from None


def _tell(notes: Any, what: str) -> None:
    """What a user should know about the result, a line each on standard error."""
    for note in notes:
        sys.stderr.write(f"driftscope: {what}{note}\n")
