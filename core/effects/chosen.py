"""Which effects a JSON document asks for: a plain effect set, a diagnosis, or the description of a run."""

from __future__ import annotations

from collections.abc import Mapping

from core.effects import check_effects
from core.errors import FormatError
from core.robot import EffectSet

JOINT_PROBABILITY = 0.5
"""Causes of a diagnosis above this are its joint explanation (schema gap/1)."""


def effects_of(data: object, *, file: str = "", immaterial: bool = False) -> EffectSet:
    """The effects in `{"effects": {...}}`, in a diagnosis (`gap/1`: its joint explanation) or in a `run.json`.

    A diagnosis gives each parameter as value and standard deviation; the value is taken. A diagnosis that explains
    nothing is an empty set. immaterial: of a diagnosis also what is real but below its tolerance. Raises FormatError
    (no such document), ParameterError (effect, parameter or value).
    """
    if not isinstance(data, Mapping):
        raise FormatError(_told(file, f"expected an object, found {type(data).__name__}"), file=file)
    if data.get("schema") == "gap/1":
        effects = _of_diagnosis(data, file, immaterial)
    elif "simulator" in data and "effects" not in data:
        effects = _objects(_object(data["simulator"], "simulator", file).get("effects", {}), "simulator.effects", file)
    elif "effects" in data:
        effects = _objects(data["effects"], "effects", file)
    else:
        raise FormatError(
            _told(file, 'neither an effect set {"effects": {...}} nor a diagnosis nor a run.json'),
            file=file,
            expected=["effects", "schema gap/1", "simulator"],
            found=sorted(map(str, data))[:20],
        )
    check_effects(effects)
    return effects


def _of_diagnosis(data: Mapping[str, object], file: str, immaterial: bool) -> EffectSet:
    effects = {}
    for part in ("immaterial", "causes") if immaterial else ("causes",):
        listed = data.get(part, [])
        if not isinstance(listed, list):
            raise FormatError(_told(file, f"{part} must be a list"), file=file, key=part)
        for i, entry in enumerate(listed):
            where = f"{part}[{i}]"
            told = _object(entry, where, file)
            probability = told.get("probability", 0.0)
            joint = isinstance(probability, int | float) and probability > JOINT_PROBABILITY
            if joint or part == "immaterial":
                effects[str(told.get("effect"))] = _values(
                    _object(told.get("parameters", {}), f"{where}.parameters", file)
                )
    return effects  # type: ignore[return-value]  # check_effects looks at every value


def _values(parameters: Mapping[str, object]) -> dict[str, object]:
    return {
        name: told["value"] if isinstance(told, Mapping) and "value" in told else told
        for name, told in parameters.items()
    }


def _objects(data: object, where: str, file: str) -> EffectSet:
    return {
        effect: _object(values, f"{where}.{effect}", file)  # type: ignore[misc]  # check_effects looks at every value
        for effect, values in _object(data, where, file).items()
    }


def _object(data: object, where: str, file: str) -> Mapping[str, object]:
    if not isinstance(data, Mapping):
        raise FormatError(_told(file, f"{where} must be an object, found {type(data).__name__}"), file=file, key=where)
    return data


def _told(file: str, message: str) -> str:
    return f"{file}: {message}" if file else message
