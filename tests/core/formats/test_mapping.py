"""Foreign tables: columns, units and signs are what the mapping says."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from core.errors import FormatError, NeedsMappingError, ParameterError
from core.formats import UNITS, ColumnMap, ColumnSource, open_table, read_run, suggest_mapping
from core.sensors import STREAMS

LOG = 'ms,gyro,left,note\n1000,90,0,a\n1010,180,10,\n1020,,20,"x,y"\n1030,-90,,b\n'


def write(tmp_path: Path, text: str = LOG) -> Path:
    path = tmp_path / "log.csv"
    path.write_text(text)
    return path


def mapping(**streams: dict[str, dict[str, Any]]) -> dict[str, Any]:
    return {"streams": streams}


GYRO = {"t": {"column": "ms", "unit": "ms"}, "gz": {"column": "gyro", "unit": "deg/s"}}


def test_every_unit_has_a_known_value() -> None:
    known = {
        ("s", "ms"): 1e-3, ("s", "us"): 1e-6, ("s", "ns"): 1e-9, ("s", "min"): 60, ("s", "h"): 3600,
        ("m", "cm"): 0.01, ("m", "mm"): 1e-3, ("m", "km"): 1e3, ("m", "in"): 0.0254, ("m", "ft"): 0.3048,
        ("m/s", "cm/s"): 0.01, ("m/s", "mm/s"): 1e-3, ("m/s", "km/h"): 1 / 3.6,
        ("rad", "deg"): math.pi / 180, ("rad", "rev"): 2 * math.pi, ("rad", "ticks"): 2 * math.pi, ("rad", "m"): 1,
        ("rad/s", "mrad/s"): 1e-3, ("rad/s", "deg/s"): math.pi / 180, ("rad/s", "deg/h"): math.pi / 180 / 3600,
        ("rad/s", "rpm"): 2 * math.pi / 60,
        ("m/s²", "g"): 9.80665, ("m/s²", "mg"): 9.80665e-3, ("m/s²", "cm/s²"): 0.01,
        ("°C", "K"): 1, ("°C", "°F"): 5 / 9,
    }  # fmt: skip
    for si, units in UNITS.items():
        assert next(iter(units)) == si
        for name, unit in units.items():
            assert unit.factor / unit.divisor == pytest.approx(known.get((si, name), 1.0), rel=1e-15)
    kelvin, fahrenheit = UNITS["°C"]["K"], UNITS["°C"]["°F"]
    assert 273.15 + kelvin.offset == 0.0
    assert 212 * fahrenheit.factor / fahrenheit.divisor + fahrenheit.offset == pytest.approx(100.0, rel=1e-14)
    assert {c.unit for s in STREAMS.values() for c in s.columns} <= set(UNITS)


def test_units_signs_and_the_start_of_time(tmp_path: Path) -> None:
    flipped = GYRO | {"gz": {"column": "gyro", "unit": "deg/s", "sign": -1}}
    imu = read_run(write(tmp_path), mapping=mapping(imu=flipped)).imu
    assert imu is not None
    np.testing.assert_allclose(imu.t, [0.0, 0.01, 0.03], rtol=0, atol=1e-15)  # rows without a reading belong to others
    np.testing.assert_allclose(imu.gz, [-math.pi / 2, -math.pi, math.pi / 2], rtol=1e-15)
    absolute = read_run(write(tmp_path), mapping=mapping(imu=GYRO) | {"t0": "zero"}).imu
    assert absolute is not None and absolute.t.tolist() == [1.0, 1.01, 1.03]


def test_ticks_need_the_wheel_and_take_it_from_the_mapping(tmp_path: Path) -> None:
    wheels = {
        "t": {"column": "ms", "unit": "ms"},
        "left": {"column": "left", "unit": "ticks"},
        "right": {"column": "left", "unit": "m", "sign": -1},
    }
    with pytest.raises(ParameterError, match="ticks_per_rev"):
        read_run(write(tmp_path), mapping=mapping(wheels=wheels))
    whole = mapping(wheels=wheels) | {"robot": {"ticks_per_rev": 20, "wheel_radius": 0.5}, "name": "lap"}
    run = read_run(write(tmp_path), mapping=whole)
    assert run.wheels is not None and run.meta.name == "lap" and run.meta.robot.ticks_per_rev == 20.0
    np.testing.assert_allclose(run.wheels.left, [0.0, math.pi, 2 * math.pi], rtol=1e-15)
    np.testing.assert_allclose(run.wheels.right, [0.0, -20.0, -40.0], rtol=1e-15)


def test_two_streams_share_one_start(tmp_path: Path) -> None:
    path = write(tmp_path, "a,gz,b,v,w\n5,1,,,\n6,2,4500,0.5,0.1\n7,3,5500,0.6,0.2\n")
    both = mapping(
        imu={"t": {"column": "a"}, "gz": {"column": "gz"}},
        commands={"t": {"column": "b", "unit": "ms"}, "v": {"column": "v"}, "w": {"column": "w"}},
    )
    run = read_run(path, mapping=both)
    assert run.imu is not None and run.commands is not None
    np.testing.assert_allclose(run.imu.t, [0.5, 1.5, 2.5], atol=1e-12)
    np.testing.assert_allclose(run.commands.t, [0.0, 1.0], atol=1e-12)


def test_epoch_nanoseconds_keep_every_nanosecond(tmp_path: Path) -> None:
    stamps = np.arange(5) * 1_000_001 + 1_700_000_000_000_000_123
    pl.DataFrame({"stamp": stamps, "w": np.arange(5, dtype=np.float32)}).write_parquet(tmp_path / "log.parquet")
    imu = read_run(
        tmp_path / "log.parquet",
        mapping=mapping(imu={"t": {"column": "stamp", "unit": "ns"}, "gz": {"column": "w"}}),
    ).imu
    assert imu is not None and imu.gz.dtype == np.float32
    assert np.rint(imu.t * 1e9).tolist() == [i * 1_000_001 for i in range(5)]


def test_float32_stays_float32_through_units(tmp_path: Path) -> None:
    pl.DataFrame({"t": [0.0, 1.0], "w": np.array([90, 45], np.float32)}).write_parquet(tmp_path / "a.parquet")
    source = {"t": {"column": "t"}, "gz": {"column": "w", "unit": "deg/s"}}
    imu = read_run(tmp_path / "a.parquet", mapping=mapping(imu=source)).imu
    assert imu is not None and imu.gz.dtype == np.float32
    assert imu.gz.tolist() == np.deg2rad([90.0, 45.0]).astype(np.float32).tolist()


@pytest.mark.parametrize(
    ("change", "parameter"),
    [
        ({"streams": {}}, "streams"),
        ({"streams": {"lidar": {}}}, "streams"),
        ({"t0": "noon"}, "t0"),
        ({"foo": 1}, "foo"),
        ({"robot": {"wheel_radius": -1}}, None),
        ({"streams": {"imu": {"t": {"column": "ms"}}}}, "streams.imu.gz"),
        ({"streams": {"imu": GYRO | {"gy0": {"column": "gyro"}}}}, "streams.imu"),
        ({"streams": {"imu": GYRO | {"gz": {"column": "gyro", "unit": "V"}}}}, "streams.imu.gz.unit"),
        ({"streams": {"imu": GYRO | {"gz": {"column": "gyro", "sign": 2}}}}, "streams.imu.gz.sign"),
        ({"streams": {"imu": GYRO | {"gz": {"column": "gyro", "scale": 2}}}}, "streams.imu.gz.scale"),
        ({"streams": {"imu": GYRO | {"gz": {"column": ""}}}}, "streams.imu.gz.column"),
        ({"streams": {"imu": GYRO | {"t": {"column": "ms", "sign": -1}}}}, "streams.imu.t.sign"),
        ({"streams": {"truth": {"t": {"column": "ms"}}}}, "streams.truth"),
        ({"streams": {"beacon": {n: {"column": "ms"} for n in "txy"} | {"theta": {"column": "a", "unit": "ticks"}}}},
         "streams.beacon.theta.unit"),
    ],
)  # fmt: skip
def test_a_wrong_mapping_names_its_key(change: dict[str, Any], parameter: str | None, tmp_path: Path) -> None:
    with pytest.raises((ParameterError, FormatError)) as caught:
        ColumnMap.from_json(mapping(imu=GYRO) | change)
    assert parameter is None or caught.value.where["parameter"] == parameter


def test_faults_of_the_table_name_its_own_column_and_row(tmp_path: Path) -> None:
    lost = GYRO | {"gz": {"column": "nope"}}
    with pytest.raises(FormatError, match="no such column") as caught:
        read_run(write(tmp_path), mapping=mapping(imu=lost))
    assert caught.value.where["column"] == "nope"
    for text, row, column, found in (
        ("ms,gyro\n1,1\n2,x\n", 2, "gyro", "'x'"),
        ("ms,gyro,a\n1,,5\n2,1,5\n2,1,5\n", 3, "ms", None),
        ("ms,gyro,a\n1,1,5\n,1,5\n", 2, "ms", "an empty cell"),
        ("ms,gyro,a\n1,1,5\n2,1,5,6\n", 2, None, "4 fields: '2,1,5,6'"),
    ):
        with pytest.raises(FormatError) as caught:
            read_run(write(tmp_path, text), mapping=mapping(imu=GYRO))
        where = caught.value.where
        assert (where["row"], where.get("column")) == (row, column)
        assert found is None or where["found"] == found


def test_json_form_is_stable() -> None:
    built = ColumnMap({"imu": {"t": ColumnSource("ms", "ms"), "gz": ColumnSource("gyro", "deg/s", -1)}})
    plain = built.to_json()
    assert plain["streams"]["imu"]["gz"] == {"column": "gyro", "unit": "deg/s", "sign": -1}
    assert ColumnMap.from_json(plain) == built


@pytest.mark.parametrize(
    ("column", "stream", "target", "unit"),
    [
        ("gyro_z", "imu", "gz", "rad/s"),
        ("GyroZ [deg/s]", "imu", "gz", "deg/s"),
        ("gz_dps", "imu", "gz", "deg/s"),
        ("angular_velocity.z", "imu", "gz", "rad/s"),
        ("yaw_rate", "imu", "gz", "rad/s"),
        ("acc_x (g)", "imu", "ax", "g"),
        ("linear_acceleration.y", "imu", "ay", "m/s²"),
        ("temp", "imu", "temperature", "°C"),
        ("left_ticks", "wheels", "left", "ticks"),
        ("encoder_right", "wheels", "right", "rad"),
        ("left_deg", "wheels", "left", "deg"),
        ("cmd_vel.linear.x", "commands", "v", "m/s"),
        ("tag_x_mm", "beacon", "x", "mm"),
        ("gt_y", "truth", "y", "m"),
        ("yaw_deg", "truth", "theta", "deg"),
        ("anchor", "ranges", "beacon", ""),
        ("distance_mm", "ranges", "range", "mm"),
    ],
)
def test_common_names_are_guessed(column: str, stream: str, target: str, unit: str) -> None:
    found = suggest_mapping(["id", "timestamp_us", column, "battery"]).streams
    assert list(found) == [stream]
    assert found[stream][target] == ColumnSource(column, unit)
    assert found[stream]["t"] == ColumnSource("timestamp_us", "us")


def test_a_table_can_be_looked_into(tmp_path: Path) -> None:
    table = open_table(write(tmp_path))
    assert table.names == ("ms", "gyro", "left", "note")
    assert [t.is_numeric() for t in table.dtypes().values()] == [True, True, True, False]
    assert table.head(3)[2] == ("1020", None, "20", "x,y")
    with pytest.raises(NeedsMappingError):
        read_run(write(tmp_path))
