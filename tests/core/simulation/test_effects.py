"""The table of effects: complete, consistent, and refusing what makes no sense."""

from __future__ import annotations

import math

import pytest

from core.effects import EFFECTS, Effect, active, check_effects, complete
from core.errors import ParameterError
from core.sensors import STREAMS

from .values import TELLING

FAMILIES = {
    "drive": 7, "kinematics": 3, "ground": 5, "gyroscope": 8,
    "accelerometer": 5, "encoders": 1, "beacons": 10, "timing": 2,
}  # fmt: skip
NEUTRAL_ONE = {"drive_gain", "wheel_radius", "unequal_wheels", "track_width", "gyro_scale", "gyro_noise", "accel_scale"}
NEUTRAL_ONE |= {"beacon_scale", "beacon_noise"}
NEUTRAL_INF = {"speed_limit", "accel_limit", "gyro_clip"}


def test_there_are_forty_one_by_family() -> None:
    assert len(EFFECTS) == 41
    assert {f: sum(e.family == f for e in EFFECTS.values()) for f in FAMILIES} == FAMILIES
    assert set(TELLING) == set(EFFECTS)
    assert all({p.name for p in EFFECTS[name].parameters} == set(values) for name, values in TELLING.items())


@pytest.mark.parametrize("effect", EFFECTS.values(), ids=EFFECTS)
def test_declaration_is_sound(effect: Effect) -> None:
    known = {f"{s.name}.{c.name}" for s in STREAMS.values() for c in s.columns}
    assert effect.streams and set(effect.streams) <= known
    assert effect.switch and all(effect.parameter(name) for name in effect.switch)
    assert effect.equation and effect.label
    expected = 1.0 if effect.id in NEUTRAL_ONE else math.inf if effect.id in NEUTRAL_INF else 0.0
    for p in effect.parameters:
        if not p.text:
            assert p.neutral == expected
            assert p.low < p.high
            assert p.small is None or p.small > 0.0
    assert any(p.small is not None for p in effect.parameters)


@pytest.mark.parametrize("name", EFFECTS)
def test_neutral_and_telling_values_pass(name: str) -> None:
    check_effects({name: EFFECTS[name].neutral})
    check_effects({name: TELLING[name]})
    check_effects({name: {}})
    assert active({name: EFFECTS[name].neutral}) == ()
    assert active({name: TELLING[name]}) == (name,)
    assert complete({name: TELLING[name]})[name] == TELLING[name]


@pytest.mark.parametrize(
    ("effects", "parameter"),
    [
        ({"warp_drive": {"factor": 9.0}}, "warp_drive"),
        ({"motor_lag": {"time": 0.1}}, "motor_lag.time"),
        ({"motor_lag": {"tau": math.nan}}, "motor_lag.tau"),
        ({"motor_lag": {"tau": -0.1}}, "motor_lag.tau"),
        ({"motor_lag": {"tau": "0.1"}}, "motor_lag.tau"),
        ({"motor_lag": {"tau": True}}, "motor_lag.tau"),
        ({"motor_lag": [0.1]}, "motor_lag"),
        ({"wheel_radius": {"scale": math.inf}}, "wheel_radius.scale"),
        ({"slip_patch": {"slip": 1.5}}, "slip_patch.slip"),
        ({"slip_patch": {"radius": -1.0}}, "slip_patch.radius"),
        ({"anchor_moved": {"beacon": 3, "x": 0.1}}, "anchor_moved.beacon"),
        ({"gyro_drift": {"amplitude": 0.01, "tau": 5.0}}, "gyro_drift.tau"),
        ({"gyro_drift": {"amplitude": 0.01}}, "gyro_drift.tau"),
    ],
)
def test_nonsense_is_refused_by_name(effects: dict[str, dict[str, float]], parameter: str) -> None:
    with pytest.raises(ParameterError) as error:
        check_effects(effects)
    assert error.value.where["parameter"] == parameter
    assert parameter.split(".")[0] in error.value.message
