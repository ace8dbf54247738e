"""The table of effects: every physical cause that a simulator can lack, by id. One file per family beside this one.

To add an effect: declare it in its family's file and list it in that file's EFFECTS; if its physics is new, add a slot
in `core.simulation.params` and the line that uses it in a kernel.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from core.effects import accelerometer, beacons, drive, encoders, ground, gyroscope, kinematics, timing
from core.effects.base import Effect, Parameter
from core.errors import ParameterError
from core.robot import EffectSet

FAMILIES = (drive, kinematics, ground, gyroscope, accelerometer, encoders, beacons, timing)
EFFECTS: dict[str, Effect] = {e.id: e for family in FAMILIES for e in family.EFFECTS}

__all__ = ["EFFECTS", "Effect", "Parameter", "active", "check_effects", "complete"]


def check_effects(effects: EffectSet) -> None:
    """Refuse an unknown effect or parameter, a value that is no number, NaN, or outside its plausible range.

    A neutral value is always allowed where the effect is off. Raises ParameterError naming effect and parameter.
    """
    for effect_id, values in effects.items():
        effect = EFFECTS.get(effect_id)
        if effect is None:
            raise ParameterError(
                f"there is no effect {effect_id!r}", parameter=effect_id, expected=sorted(EFFECTS), found=effect_id
            )
        if not isinstance(values, Mapping):
            raise ParameterError(
                f"effect {effect_id} needs its parameters by name, found {type(values).__name__}",
                parameter=effect_id,
                expected=[p.name for p in effect.parameters],
                found=type(values).__name__,
            )
        for name, value in values.items():
            _check_type(effect, effect.parameter(name), value)
        full = {**effect.neutral, **values}
        if effect.active(full):
            for parameter in effect.parameters:
                _check_range(effect, parameter, full[parameter.name])
        else:
            for name, value in values.items():
                if value != effect.parameter(name).neutral:
                    _check_range(effect, effect.parameter(name), value)


def complete(effects: EffectSet) -> dict[str, dict[str, float | str]]:
    """All effects with all parameters: those given, the rest neutral. `effects` must have passed `check_effects`."""
    return {e.id: {**e.neutral, **effects.get(e.id, {})} for e in EFFECTS.values()}


def active(effects: EffectSet) -> tuple[str, ...]:
    """Ids of the effects that do something at these values, in the table's order."""
    return tuple(name for name, values in complete(effects).items() if EFFECTS[name].active(values))


def _check_type(effect: Effect, parameter: Parameter, value: object) -> None:
    expected = "a name" if parameter.text else "a number"
    kind_fits = isinstance(value, str) if parameter.text else isinstance(value, int | float)
    if not kind_fits or isinstance(value, bool) or (isinstance(value, float) and math.isnan(value)):
        raise ParameterError(
            f"effect {effect.id}: {parameter.name} must be {expected}, found {value!r}",
            parameter=f"{effect.id}.{parameter.name}",
            expected=expected,
            found=repr(value),
        )


def _check_range(effect: Effect, parameter: Parameter, value: float | str) -> None:
    if isinstance(value, str) or parameter.low <= value <= parameter.high:
        return
    unit = f" {parameter.unit}" if parameter.unit else ""
    raise ParameterError(
        f"effect {effect.id}: {parameter.name} is {value:g}{unit}; expected {parameter.low:g} to {parameter.high:g}",
        parameter=f"{effect.id}.{parameter.name}",
        expected=[parameter.low, parameter.high],
        found=value,
    )
