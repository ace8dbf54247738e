"""The sandbox: a run or scenario with effects, now; the table of effects; effects in other programs' languages."""

from __future__ import annotations

import dataclasses
import json
import math
import time
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Path, Query, Request, Response
from pydantic_core import to_json

from app.api import sandbox_schemas as wire
from app.exports.effects import TARGETS, export_effects
from app.sandbox.cache import Sandbox
from app.sandbox.figure import View, figure
from app.sandbox.packed import MEDIA, listed, pack
from app.sandbox.prepared import Prepared
from app.simulators import OURS
from core.effects import EFFECTS, check_effects
from core.effects.base import Effect
from core.effects.chosen import effects_of
from core.errors import ParameterError
from core.robot import EffectSet
from core.simulation.scenarios import SCENARIOS

router = APIRouter(tags=["sandbox"])

FILE: dict[int | str, dict[str, Any]] = {
    200: {
        "model": wire.EffectFile,
        "description": "the file; or, with form=json, its text and what the target cannot say",
        "content": {kind: {"schema": {"type": "string"}} for kind in ("application/xml", "application/yaml")},
    }
}
ANSWER: dict[int | str, dict[str, Any]] = {
    200: {
        "model": wire.SandboxAnswer,
        "description": f"the move as JSON; with `Accept: {MEDIA}` packed, as `app/sandbox/packed.py` says",
        "content": {MEDIA: {"schema": {"type": "string", "format": "binary"}}},
    }
}
Target = Annotated[str, Path(description=f"one of {', '.join(TARGETS)}", examples=["sdf"], max_length=40)]


@router.get("/effects", summary="Every effect with its ranges")
def list_effects() -> wire.EffectTable:
    """Parameters with unit, neutral value, plausible range and the size below which they are immaterial."""
    return wire.EffectTable(items=[_effect(one) for one in EFFECTS.values()])


@router.get("/scenarios", summary="Drives and simulators of the sandbox")
def list_scenarios(request: Request) -> wire.SandboxSources:
    """The scenario library, and the simulators that may be asked for by name."""
    drives = [
        wire.Scenario(name=s.name, label=s.label, duration_s=float(s.commands().t[-1])) for s in SCENARIOS.values()
    ]
    return wire.SandboxSources(scenarios=drives, simulators=[OURS, *_sandbox(request).simulators()])


@router.post("/sandbox/simulate", summary="Simulate with effects, now", responses=ANSWER)
def sandbox_simulate(request: Request, move: wire.SandboxMove) -> Response:
    """Paths, columns with residuals, and the gap against its floor; nothing is stored.

    A long run is simulated in a stretch (20 min unless `start` and `end` say otherwise). The gap is that of a
    diagnosis: window by window of 2 s from the reference pose, in units of the stated noise.
    """
    sandbox = _sandbox(request)
    effects = clean(move.effects)
    check_effects(effects)
    one = sandbox.prepared(move.run, move.scenario, move.start, move.end)
    foreign = sandbox.foreign(move.simulator, one)
    began = time.perf_counter()
    view = View(move.t0, move.t1, move.points, move.path_points, move.streams, move.lines, move.gap)
    made = figure(one, effects, seed=move.seed, noise=move.noise, foreign=foreign, view=view)
    took = round(1000.0 * (time.perf_counter() - began), 2)
    body = {"source": _source(one), **made, "runtime_ms": took}
    if request.headers.get("accept") == MEDIA:
        return Response(pack(body), media_type=MEDIA)
    return Response(to_json(listed(body)), media_type="application/json")


@router.get("/exports/effects", summary="Languages that effects can leave in")
def list_effect_targets() -> list[wire.ExportTarget]:
    """Each with what its file is."""
    return [wire.ExportTarget(name=n, label=t.label, what=t.what) for n, t in TARGETS.items()]


@router.get("/exports/effects/{target}", summary="Effects as a file for another program", responses=FILE)
def get_effect_export(
    request: Request,
    target: Target,
    run: Annotated[str | None, Query(max_length=64, description="a stored run, whose robot it is")] = None,
    scenario: Annotated[str | None, Query(max_length=100, description="or a scenario of the library")] = None,
    effects: Annotated[str, Query(max_length=20_000, description='{"effect": {"parameter": value}} as JSON')] = "{}",
    form: Literal["file", "json"] = "file",
) -> Response:
    """The effects with the robot of a run or scenario. As for POST, in an address."""
    try:
        given = json.loads(effects)
    except ValueError as error:
        raise ParameterError(f"effects: no JSON: {error}", parameter="effects") from None
    if not isinstance(given, Mapping) or not all(isinstance(v, Mapping) for v in given.values()):
        raise ParameterError("effects: expected an object of objects", parameter="effects")
    return _exported(request, target, run, scenario, clean(given), form)


@router.post("/exports/effects/{target}", summary="Effects as a file for another program", responses=FILE)
def create_effect_export(request: Request, target: Target, wanted: wire.ExportRequest) -> Response:
    """The effects with the robot of a run or scenario, as a file or, with `form` json, with what it cannot say."""
    return _exported(request, target, wanted.run, wanted.scenario, clean(wanted.effects), wanted.form)


def clean(values: Mapping[str, Mapping[str, Any]]) -> EffectSet:
    """Without the parameters that are null. Raises ParameterError for a value that no effect could have."""
    out = {effect: {k: v for k, v in given.items() if v is not None} for effect, given in values.items()}
    return effects_of({"effects": {effect: given for effect, given in out.items() if given or effect not in EFFECTS}})


def _exported(
    request: Request, target: str, run: str | None, scenario: str | None, effects: EffectSet, form: str
) -> Response:
    meta = _sandbox(request).meta(run, scenario)
    made = export_effects(target, meta, effects)
    if form == "json":
        return Response(to_json(dataclasses.asdict(made)), media_type="application/json")
    headers = {"Content-Disposition": f'attachment; filename="{made.file_name}"'}
    return Response(made.text, media_type=made.media_type, headers=headers)


def _sandbox(request: Request) -> Sandbox:
    found: Sandbox = request.app.state.sandbox
    return found


def _source(one: Prepared) -> dict[str, Any]:
    meta = one.run.meta
    start, end = one.run.span
    return {
        "name": meta.name,
        "start": start,
        "end": end,
        "full": one.full,
        "recorded": one.recorded,
        "reference": one.real[0] if one.real else None,
        "placed": one.placed,
        "simulated": one.beside is not None,
        "channels": one.channels,
        "beacons": [{"name": name, "x": p[0], "y": p[1], "z": p[2]} for name, p in meta.beacons.items()],
        "modelled": {effect: dict(values) for effect, values in meta.effects.items()},
        "idle": one.idle(),
    }


def _effect(one: Effect) -> wire.Effect:
    parameters = [
        wire.EffectParameter(
            name=p.name,
            unit=p.unit,
            neutral=_finite(p.neutral),
            low=None if p.text else _number(p.low),
            high=None if p.text else _number(p.high),
            small=p.small,
            text=p.text,
        )
        for p in one.parameters
    ]
    return wire.Effect(
        id=one.id, family=one.family, label=one.label, equation=one.equation, parameters=parameters,
        streams=list(one.streams), switch=list(one.switch), noise_only=one.noise_only,
    )  # fmt: skip


def _finite(value: float | str) -> float | str | None:
    return value if isinstance(value, str) else _number(value)


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
