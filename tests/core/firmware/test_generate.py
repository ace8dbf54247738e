"""What the generator makes and refuses: the header, the decisions it states, and the replay program for a PC."""

from __future__ import annotations

import json
import math
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

from core.calibration.imu import ImuCalibration
from core.errors import FormatError, ParameterError
from core.firmware import TRACKERS, Noise, firmware, generate, noise_of_allan
from core.imu.bias import BiasNoise
from tests.core.firmware.board import STRICT, build, records, run, sources, write
from tests.core.firmware.logs import driving_log, random_calibration


def silent() -> ImuCalibration:
    """A calibration that shows one number."""
    gyro = {"noise_sd": [None, None, 0.003]}
    return ImuCalibration.from_json({"schema": "calibration/1", "gyro": gyro, "accel": {}})


def defined(header: str, name: str) -> str:
    found = re.search(rf"^#define {name} ((?:.*\\\n)*.*)$", header, re.M)
    assert found, name
    return found[1]


@pytest.mark.parametrize("bias", TRACKERS)
def test_every_constant_is_used_and_says_what_it_is(bias: str) -> None:
    files = generate(random_calibration(np.random.default_rng(0)), bias=bias)
    header = files["ds_constants.h"]
    names = re.findall(r"^#define (DS_\w+) .", header, re.M)
    code = "".join(text for name, text in files.items() if name.endswith((".c", ".h")) and name != "ds_constants.h")
    assert [name for name in names if not re.search(rf"\b{name}\b", code)] == []
    lines = header.splitlines()
    assert all(lines[lines.index(line) - 1].endswith("*/") for line in lines if line.startswith("#define DS_")
               and "CONSTANTS" not in line)  # fmt: skip
    assert not re.search(r"\b(malloc|free|double|printf)\b", files["driftscope.c"] + files["ds_bias.c"])


def test_constants_are_those_of_the_calibration() -> None:
    calibration = random_calibration(np.random.default_rng(1))
    header = generate(calibration, bias="C", noise=Noise(sd=0.0025))["ds_constants.h"]
    static = [float(v) for v in re.findall(r"\(?(-?[\d.e-]+)f\)?,", defined(header, "DS_STATIC_BIAS"))]
    np.testing.assert_array_equal(
        np.float32(static), np.float32(np.concatenate([calibration.accel.static_bias, calibration.gyro.static_bias]))
    )
    inverse = re.findall(r"\(?(-?[\d.e-]+)f\)?[,}]", defined(header, "DS_GYRO_INVERSE"))
    product = np.array(inverse, float).reshape(3, 3) @ calibration.gyro.matrix
    np.testing.assert_allclose(product, np.eye(3), atol=1e-6)
    assert float(defined(header, "DS_C_SIGMA").rstrip("f")) == pytest.approx(0.0025)
    assert float(defined(header, "DS_C_RANGE").rstrip("f")) == pytest.approx(0.0175)


def test_what_the_calibration_does_not_show_is_nothing_and_is_said(tmp_path: Path) -> None:
    made = firmware(silent(), bias="C")
    header = made.files["ds_constants.h"]
    assert header.count("NOT SHOWN by the calibration: 0") == 18
    assert header.count("NOT SHOWN by the calibration: identity") == 6
    joined = " ".join(header.split()).replace("* ", "")
    assert made.notes
    assert all(note in joined for note in made.notes)
    t = np.arange(500) / 100.0
    readings = np.tile(np.float32([0.5, -0.25, 9.75, 0.125, 0.25, -0.5]), (500, 1))
    replayed = run(build(write(made.files, tmp_path), "host"), records(t, readings))
    for j, axis in enumerate(("ax", "ay", "az", "gx", "gy", "gz")):
        np.testing.assert_array_equal(replayed.values[axis], readings[:, j])
    assert replayed.values["heading"][200] == pytest.approx(-0.5 * t[200], abs=1e-6)


def test_noise_comes_from_what_is_given_then_the_calibration_then_a_usual_gyro() -> None:
    def sigma(calibration: ImuCalibration, noise: Noise | None = None) -> tuple[float, tuple[str, ...]]:
        made = firmware(calibration, rate_hz=400.0, bias="C", noise=noise)
        return float(defined(made.files["ds_constants.h"], "DS_C_SIGMA").rstrip("f")), made.notes

    assert sigma(silent(), Noise(sd=0.004))[0] == pytest.approx(0.004)
    assert sigma(silent())[0] == pytest.approx(0.003)
    given = {"schema": "calibration/1", "gyro": {"static_bias": [0, 0, 0]}, "accel": {}}
    unknown = ImuCalibration.from_json(given)
    assert sigma(unknown, Noise(drift=BiasNoise(1e-4, 0.0, 0.0)))[0] == pytest.approx(1e-4 * 20)
    value, notes = sigma(unknown)
    assert value == pytest.approx(math.radians(0.011) * 20)
    assert any("NOT KNOWN" in note for note in notes)


def test_noise_of_allan_takes_what_the_record_shows() -> None:
    shown = {"schema": "allan/1", "axis": "imu.gz", "N": 1e-4, "B": 2e-5, "K": None}
    drift = noise_of_allan(shown).drift
    assert drift is not None
    assert (drift.N, drift.sd) == (1e-4, 2e-5)
    assert pytest.approx(1e-7) == drift.K
    for broken in ({**shown, "N": None}, {**shown, "axis": "imu.gx"}, {**shown, "K": "1"}, {"schema": "bias/1"}, []):
        with pytest.raises(FormatError):
            noise_of_allan(broken)


def test_refusals_name_what_is_wrong() -> None:
    whole = random_calibration(np.random.default_rng(2))
    for rate in (0.0, -5.0, 5.0, 2e4, math.nan, math.inf):
        with pytest.raises(ParameterError, match="rate is"):
            generate(whole, rate_hz=rate, bias="C")
    with pytest.raises(ParameterError, match="no bias tracker 'D'"):
        generate(whole, bias="D")
    for sd in (0.0, -1.0, math.nan, 3.0):
        with pytest.raises(ParameterError, match="noise"):
            Noise(sd=sd)
    data = whole.to_json()
    flat = json.loads(json.dumps(data))
    flat["gyro"]["matrix"][2] = [1e-5 * v for v in flat["gyro"]["matrix"][2]]
    flat["gyro"]["matrix"][1] = [v * 30 for v in flat["gyro"]["matrix"][1]]
    with pytest.raises(ParameterError, match="singular"):
        generate(ImuCalibration.from_json(flat), bias="C")
    data["gyro"]["static_bias"][2] = 300.0
    with pytest.raises(ParameterError, match="static_bias of gz"):
        generate(ImuCalibration.from_json(data), bias="C")


def test_replay_on_a_pc_gives_the_same(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    calibration = random_calibration(rng)
    t, readings = driving_log(rng, calibration, 30.0, 100.0)
    folder = write(generate(calibration, bias="C"), tmp_path)
    files = [str(path) for path in [*sources(folder), folder / "replay.c"]]
    subprocess.run(["gcc", *STRICT, *files, "-lm", "-o", str(folder / "replay")], check=True)
    rows = [f"{round(s * 1e6)}," + ",".join(f"{v:.9g}" for v in row) for s, row in zip(t, readings, strict=True)]
    text = "t_us,ax,ay,az,gx,gy,gz\n" + "\n".join(rows) + "\n"
    done = subprocess.run([str(folder / "replay")], input=text, capture_output=True, text=True, check=True)
    lines = done.stdout.splitlines()
    table = np.array([line.split(",") for line in lines[1:]], np.float64)
    expected = run(build(folder, "host"), records(t, readings))
    names = lines[0].split(",")
    for name, values in expected.values.items():
        np.testing.assert_array_equal(np.float32(table[:, names.index(name)]), values)
    broken = subprocess.run([str(folder / "replay")], input="t_us,ax\n1,2\n", capture_output=True, text=True)
    assert broken.returncode == 1
    assert broken.stderr == "replay: line 2 has 2 numbers, expected 7 to 9\n"
