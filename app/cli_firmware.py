"""The firmware room's command: `driftscope firmware`."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from app.cli_common import OK

if TYPE_CHECKING:
    from core.calibration.imu import ImuCalibration
    from core.firmware import Noise


def add_commands(commands: Any) -> None:
    """The room's command and its options."""
    made = commands.add_parser("firmware", help="IMU correction and bias tracker as C for a microcontroller")
    made.add_argument("--calibration", required=True, type=Path, metavar="F", help="what `calibrate --json` wrote")
    made.add_argument("--bias", required=True, metavar="M", help="the tracker: best or C")
    made.add_argument("--out", required=True, type=Path, metavar="DIR", help="folder for the C files")
    made.add_argument("--rate", type=float, default=100.0, metavar="HZ", help="of the IMU (default 100)")
    made.add_argument("--noise", type=Path, metavar="F", help="what `allan --axis gz --json` wrote of a log at rest")
    made.set_defaults(run=_firmware)


def _firmware(options: argparse.Namespace) -> int:
    from core.firmware import firmware

    calibration = _calibration(options.calibration)
    noise = _noise(options.noise) if options.noise else None
    made = firmware(calibration, rate_hz=options.rate, bias=options.bias, noise=noise)
    options.out.mkdir(parents=True, exist_ok=True)
    for name, text in made.files.items():
        (options.out / name).write_text(text, encoding="utf-8")
    for note in made.notes:
        sys.stderr.write(f"driftscope: note: {note}\n")
    return OK


def _calibration(path: Path) -> ImuCalibration:
    from core.calibration.imu import ImuCalibration
    from core.errors import FormatError

    try:
        return ImuCalibration.from_json(_bytes(path))
    except FormatError as error:
        raise FormatError(f"{path}: {error.message}", **{"file": str(path), **error.where}) from None


def _noise(path: Path) -> Noise:
    from core.errors import FormatError
    from core.firmware import noise_of_allan

    try:
        data = json.loads(_bytes(path))
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{path}: this is no JSON: {error}", file=str(path)) from None
    try:
        return noise_of_allan(data)
    except FormatError as error:
        raise FormatError(f"{path}: {error.message}", **{"file": str(path), **error.where}) from None


def _bytes(path: Path) -> bytes:
    from core.errors import FormatError

    if not path.is_file():
        raise FormatError(f"{path}: no such file", file=str(path))
    return path.read_bytes()
