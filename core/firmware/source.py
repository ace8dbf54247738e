"""From constants to the files of a firmware: the header is made, the algorithms are the C files in `c/`."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import resources

from core.calibration.imu import ImuCalibration
from core.errors import ParameterError
from core.firmware import best
from core.firmware.constants import Constant, Noise, algorithm1, check_rate, common, method_c, white
from core.imu.bias import FilterConfig, SegmentConfig

WIDTH = 118


@dataclass(frozen=True)
class Firmware:
    """files: name to text. notes: what was decided where the calibration or the noise figures are silent."""

    files: dict[str, str]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Tracker:
    """A bias tracker in C: its files, by the name of what stands for them in `c/`, and its part of the header
    (constants, notes) for a calibration."""

    label: str
    files: Mapping[str, str]
    constants: Callable[[ImuCalibration, float, Noise], tuple[list[Constant], tuple[str, ...]]]


def _c(calibration: ImuCalibration, rate_hz: float, noise: Noise) -> tuple[list[Constant], tuple[str, ...]]:
    made, _ = algorithm1(calibration)
    sigma, origin = white(made, calibration, rate_hz, noise)
    notes = (f"noise of the gyro: {origin}",) if "NOT KNOWN" in origin else ()
    return method_c(sigma, origin, rate_hz, SegmentConfig()), notes


def _best(calibration: ImuCalibration, rate_hz: float, noise: Noise) -> tuple[list[Constant], tuple[str, ...]]:
    return best.constants(rate_hz, noise.drift, FilterConfig()), ()


TRACKERS: dict[str, Tracker] = {
    "best": Tracker(
        "our causal filter of heading and bias",
        {
            "ds_bias.h": "best.h",
            "ds_bias.c": "best.c",
            "ds_filter.c": "best_filter.c",
            "ds_judge.c": "best_judge.c",
            "ds_learn.c": "best_learn.c",
        },
        _best,
    ),
    "C": Tracker(
        "method C of Cechowicz 2017: range test and band", {"ds_bias.h": "bias_c.h", "ds_bias.c": "bias_c.c"}, _c
    ),
}

FIXED = ("driftscope.h", "driftscope.c", "ds_sum.h", "ds_track.h", "replay.c", "README.md")


def generate(
    calibration: ImuCalibration, *, rate_hz: float = 100.0, bias: str = "best", noise: Noise | None = None
) -> dict[str, str]:
    """Files of the firmware, name to text. As `firmware`, without its notes."""
    return firmware(calibration, rate_hz=rate_hz, bias=bias, noise=noise).files


def firmware(
    calibration: ImuCalibration, *, rate_hz: float = 100.0, bias: str = "best", noise: Noise | None = None
) -> Firmware:
    """Algorithm 1 with this calibration and the tracker `bias` (one of TRACKERS), for an IMU read at rate_hz.

    Raises ParameterError for an unknown tracker, a rate that no IMU has, or a calibration that cannot be undone.
    """
    if bias not in TRACKERS:
        raise ParameterError(
            f"there is no bias tracker {bias!r} for firmware; expected one of {', '.join(TRACKERS)}",
            parameter="bias",
            found=bias,
            expected=list(TRACKERS),
        )
    tracker = TRACKERS[bias]
    check_rate(rate_hz)
    made, own = algorithm1(calibration)
    tracked, notes = tracker.constants(calibration, rate_hz, noise or Noise())
    notes = made.notes + notes
    files = {name: _text(name) for name in FIXED}
    files |= {name: _text(stored) for name, stored in tracker.files.items()}
    files["ds_constants.h"] = header(common() + own + tracked, tracker.label, rate_hz, notes)
    return Firmware(dict(sorted(files.items())), notes)


def header(rows: list[Constant], label: str, rate_hz: float, notes: tuple[str, ...]) -> str:
    """The text of ds_constants.h."""
    lines = [
        "/* Driftscope firmware: every constant, with its unit and where it came from. Made for one IMU; make it anew",
        f" * after each calibration. For an IMU read at {rate_hz:g} Hz; axes ax, ay, az, gx, gy, gz.",
        f" * Bias tracker: {label}.",
    ]
    if notes:
        lines.append(" * Decided here, because neither calibration nor noise figures say:")
        for note in notes:
            lines += textwrap.wrap(note, WIDTH, initial_indent=" *   - ", subsequent_indent=" *     ")
    lines += [" */", "#ifndef DS_CONSTANTS_H", "#define DS_CONSTANTS_H", ""]
    for row in rows:
        remark = f"[{row.unit}] {row.note}" if row.unit else row.note
        lines += textwrap.wrap(f"/* {remark} */", WIDTH, subsequent_indent=" * ")
        lines += [*_define(row), ""]
    return "\n".join([*lines, "#endif", ""])


def _define(row: Constant) -> list[str]:
    if isinstance(row.text, str):
        return [f"#define {row.name} {row.text}"]
    width = max(len(text) for text in row.text) + 1
    rows = [f"{text + ',':{width}} /* {origin} */ \\" for text, origin in zip(row.text, row.origins, strict=True)]
    return [f"#define {row.name} {{ \\", *(f"    {text}" for text in rows), "}"]


def _text(name: str) -> str:
    return resources.files("core.firmware").joinpath("c", name).read_text(encoding="utf-8")
