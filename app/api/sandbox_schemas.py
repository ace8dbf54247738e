"""The sandbox on the wire: effects and their ranges, sources, one move and what came of it. SI units."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from app.api.schemas import Wire, example

Values = dict[str, dict[str, float | str | None]]
RunIdText = Annotated[str, Field(max_length=64)]
Name = Annotated[str, Field(max_length=100)]
Seconds = Annotated[float, Field(allow_inf_nan=False)]
EFFECTS = {"track_width": {"scale": 1.021}}


class EffectParameter(Wire):
    """One number of an effect (or, for `text`, a name). Null stands for no limit."""

    name: str
    unit: str
    neutral: float | str | None = Field(description="switches the effect off; null: infinite")
    low: float | None
    high: float | None
    small: float | None = Field(description="a deviation below which the effect is immaterial")
    text: bool


class Effect(Wire):
    """One physical cause that a simulator can lack."""

    id: str
    family: str = Field(description="the link of the chain that it sits in")
    label: str
    equation: str
    parameters: list[EffectParameter]
    streams: list[str] = Field(description="all that it can move")
    switch: list[str] = Field(description="parameters that switch it on")
    noise_only: bool


class EffectTable(Wire):
    """Every effect, in the order of the chain."""

    items: list[Effect]


class Scenario(Wire):
    """A drive of the library."""

    name: str
    label: str
    duration_s: float


class SandboxSources(Wire):
    """What can be driven without a recording, and by which simulators."""

    scenarios: list[Scenario]
    simulators: list[str] = Field(description="`nominal` is our own; others are registered by whoever runs the server")


class ExportTarget(Wire):
    """A language that effects can leave in."""

    name: str
    label: str
    what: str


class SandboxSource(Wire):
    """A run or a scenario, one of both."""

    run: RunIdText | None = Field(None, description="a stored run's id")
    scenario: Name | None = Field(None, description="a drive of the library")


class SandboxMove(SandboxSource):
    """One move: what is driven, by which simulator, with which effects, and what of it is to be drawn."""

    model_config = example({"scenario": "square-ccw", "effects": EFFECTS, "points": 400})
    simulator: Name | None = None
    effects: Values = Field(default_factory=dict, description="null leaves a parameter neutral")
    seed: int = Field(0, ge=0, le=2**53)
    noise: bool = Field(False, description="with noise and rounded encoders; else expected readings")
    start: Seconds | None = Field(None, description="the stretch that is simulated [s]; default: from the run's start")
    end: Seconds | None = Field(None, description="its end [s]; default: 20 min after its start")
    t0: Seconds | None = Field(None, description="first second to draw")
    t1: Seconds | None = Field(None, description="last second to draw")
    points: int = Field(600, ge=30, le=20_000, description="at most about so many readings per column")
    path_points: int = Field(1500, ge=10, le=50_000)
    streams: list[Name] | None = Field(None, max_length=40, description="columns to draw; default: all")
    lines: bool = Field(True, description="false: neither paths nor columns, the gap alone")
    gap: bool = Field(True, description="false: no gap number, which takes as long as all else")


class SandboxPath(Wire):
    """One line of the map: `real`, `nominal`, `patched`, or `recorded`, the simulated run that was stored with it."""

    method: str
    label: str
    total: int
    shown: int
    t: list[float]
    x: list[float | None]
    y: list[float | None]
    theta: list[float | None] | None = None


class SandboxColumn(Wire):
    """One column at the run's own stamps. A scenario has no `real` and no residuals."""

    column: str
    unit: str
    label: str
    total: int
    shown: int
    t: list[float]
    nominal: list[float | None]
    patched: list[float | None]
    real: list[float | None] | None = None
    recorded: list[float | None] | None = Field(None, description="of the simulated run that was stored with it")
    residual_nominal: list[float | None] | None = Field(None, description="real - nominal, angles wrapped")
    residual_patched: list[float | None] | None = Field(None, description="real - patched, angles wrapped")


class GapFigures(Wire):
    """Root mean square of a residual in units of the stated noise: nominal, with the effects, by noise alone."""

    before: float
    now: float
    floor: float


class SandboxGap(GapFigures):
    """Over all columns. shrink: share of what is above the floor that the effects take away; null: nothing is."""

    shrink: float | None
    streams: dict[str, GapFigures]


class SandboxStretch(Wire):
    """What was simulated. idle: effects that this source cannot show, and why."""

    name: str
    start: float
    end: float
    full: tuple[float, float]
    recorded: bool
    reference: str | None = Field(description="whose path `real` is: truth, or a method of estimation")
    placed: bool = Field(description="set down where the robot was, for the run does not say where it starts")
    simulated: bool = Field(description="a simulated run was stored with it: the simulator `sim`, the lines `recorded`")
    channels: list[str]
    beacons: list[dict[str, Any]]
    modelled: Values = Field(description="effects that the run's simulator already has")
    idle: dict[str, str]


class SandboxAnswer(Wire):
    """What one move gives."""

    source: SandboxStretch
    paths: list[SandboxPath]
    streams: list[SandboxColumn]
    gap: SandboxGap | None = Field(description="null too where it was not asked for")
    no_gap: str | None = Field(description="why there is no gap number")
    runtime_ms: float


class ExportRequest(SandboxSource):
    """Effects to be written for another program, with the robot of a run or a scenario."""

    model_config = example({"scenario": "straight", "effects": EFFECTS})
    effects: Values = Field(default_factory=dict)
    form: Literal["file", "json"] = Field("file", description="the file itself, or text and lists as JSON")


class EffectFile(Wire):
    """An export, and what its target can say of each effect."""

    file_name: str
    media_type: str
    text: str
    expressed: list[str]
    nearest: dict[str, str] = Field(description="modelled roughly, and how")
    missing: dict[str, str] = Field(description="not to be expressed there, and what to do instead")
