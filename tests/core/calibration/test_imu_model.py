"""`calibration/1`: what is written is read again, what is wrong is refused by its key."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from core.calibration.imu import ImuCalibration, SensorModel, SensorPair
from core.errors import FormatError

number = st.one_of(st.just(float("nan")), st.floats(-1e6, 1e6))
positive = st.one_of(st.just(float("nan")), st.floats(1e-3, 1e6))


def vectors(of: st.SearchStrategy[float]) -> st.SearchStrategy[list[float]]:
    return st.lists(of, min_size=3, max_size=3)


@st.composite
def models(draw: st.DrawFn) -> SensorModel:
    matrix = np.eye(3) + np.array(draw(st.lists(vectors(st.floats(-0.2, 0.2)), min_size=3, max_size=3)))
    matrix[0, draw(st.integers(0, 2))] = draw(st.sampled_from([np.nan, 0.1]))
    return SensorModel(
        np.array(draw(vectors(number))),
        np.array(draw(vectors(number))),
        np.array(draw(vectors(positive))),
        matrix,
        np.array([1e-3, *draw(vectors(positive))[1:]]),
    )


@given(models(), models(), models())
def test_round_trip_keeps_every_bit(gyro: SensorModel, accel: SensorModel, sd: SensorModel) -> None:
    sd = SensorModel(*(np.abs(getattr(sd, name)) for name in SensorModel.__dataclass_fields__))
    made = ImuCalibration(gyro, accel, SensorPair(sd, sd))
    text = json.dumps(made.to_json(), allow_nan=False)
    again = ImuCalibration.from_json(text)
    assert again.to_json() == made.to_json()
    np.testing.assert_array_equal(again.gyro.static_bias, gyro.static_bias)
    np.testing.assert_array_equal(again.sd.accel.matrix, sd.matrix)


def test_json_has_the_published_shape(report: Any) -> None:
    data = report.calibration.to_json()
    assert list(data) == ["schema", "gyro", "accel", "sd"]
    for block in (data["gyro"], data["accel"], data["sd"]["gyro"], data["sd"]["accel"]):
        assert list(block) == ["static_bias", "drift_amplitude", "drift_tau", "matrix", "noise_sd"]
        assert [len(row) for row in block["matrix"]] == [3, 3, 3]
        assert all(len(block[key]) == 3 for key in block)


GOOD = ImuCalibration(SensorModel(static_bias=np.ones(3))).to_json()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"schema": "gap/1"}, "schema: expected 'calibration/1'; found gap/1"),
        ({"gyro": [1]}, "gyro: expected an object"),
        ({"gyro": None, "accel": None}, "at least one number"),
        ({"gyro": {"static_bias": [1, 2]}}, "gyro.static_bias: expected a list of 3"),
        ({"gyro": {"static_bias": [1, "x", 2]}}, "gyro.static_bias[1]: expected a finite number or null; found x"),
        ({"gyro": {"static_bias": [1, True, 2]}}, "gyro.static_bias[1]"),
        ({"accel": {"drift_tau": [1, 0, 2]}}, "accel.drift_tau: expected numbers over 0"),
        ({"accel": {"noise_sd": [1, -1, 2]}}, "accel.noise_sd: expected no number below 0"),
        (
            {"accel": {"matrix": [[1, 0, 0], [1, 0, 0], [0, 0, 1]]}},
            "accel.matrix: expected a matrix that can be solved",
        ),
        ({"accel": {"matrix": [[1, 0, 0], [0, 1], [0, 0, 1]]}}, "accel.matrix[1]: expected a list of 3"),
        ({"sd": {"gyro": {"static_bias": [-1, 0, 0]}}}, "sd.gyro.static_bias"),
    ],
)
def test_bad_json_is_refused_by_its_key(change: dict[str, Any], told: str) -> None:
    with pytest.raises(FormatError, match="calibration") as error:
        ImuCalibration.from_json(GOOD | change)
    assert told in error.value.message


@pytest.mark.parametrize("text", ["", "{", "[]", "3", '"x"', "null", "[" * 100_000])
def test_what_is_no_calibration_is_refused(text: str) -> None:
    with pytest.raises(FormatError):
        ImuCalibration.from_json(text)


def test_bias_follows_the_equation_and_leaves_out_what_is_unknown() -> None:
    model = SensorModel(
        static_bias=np.array([1.0, np.nan, 3.0]),
        drift_amplitude=np.array([2.0, 2.0, 2.0]),
        drift_tau=np.array([10.0, 10.0, np.nan]),
    )
    expected = 2 * (1 - np.exp(-0.5))
    np.testing.assert_allclose(model.bias([0.0, 5.0]), [[1, 0, 3], [1 + expected, expected, 3]])
    with pytest.raises(FormatError, match="static_bias"):
        SensorModel(static_bias=np.zeros(2))
