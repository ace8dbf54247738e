"""What an effect is: one physical cause that a simulator can lack, with its parameters, equation and streams."""

from __future__ import annotations

import math
from dataclasses import dataclass

from core.errors import ParameterError

DRIVE_STREAMS = (
    "wheels.left", "wheels.right", "imu.gz", "imu.ax", "imu.ay",
    "beacon.x", "beacon.y", "beacon.theta", "ranges.range", "truth.x", "truth.y", "truth.theta",
)  # fmt: skip
BODY_STREAMS = DRIVE_STREAMS[2:]
FIX_STREAMS = ("beacon.x", "beacon.y", "beacon.theta", "ranges.range")


@dataclass(frozen=True)
class Parameter:
    """One number of an effect (or, for `text`, a name).

    unit: SI, "" where dimensionless. neutral: switches the effect off. low, high: what is physically plausible; values
    outside are refused. small: a deviation from neutral below which the effect is immaterial (None: judged by another
    parameter); `small_of_reach`: that figure is a share of what the run reaches. For an (x, y) pair it is of its size.
    """

    name: str
    unit: str
    neutral: float | str
    low: float = -math.inf
    high: float = math.inf
    small: float | None = None
    small_of_reach: bool = False

    @property
    def text(self) -> bool:
        """Whether the parameter is a name, not a number."""
        return isinstance(self.neutral, str)


@dataclass(frozen=True)
class Effect:
    """One effect. `equation` is plain text in the symbols of `core`; `streams` are all that it can move.

    switch: the parameters that switch it on: with all of them neutral it does nothing whatever the others are.
    noise_only: it only adds noise, so that no residual can shrink by it. smooth: least squares from neutral can
    find it; else it wants a scan of start values.
    """

    id: str
    family: str
    label: str
    equation: str
    parameters: tuple[Parameter, ...]
    streams: tuple[str, ...]
    switch: tuple[str, ...]
    noise_only: bool = False
    smooth: bool = True

    def parameter(self, name: str) -> Parameter:
        """The parameter of that name. Raises ParameterError."""
        for p in self.parameters:
            if p.name == name:
                return p
        names = [p.name for p in self.parameters]
        raise ParameterError(
            f"effect {self.id} has no parameter {name!r}; it has {', '.join(names)}",
            parameter=f"{self.id}.{name}",
            expected=names,
            found=name,
        )

    @property
    def neutral(self) -> dict[str, float | str]:
        """Every parameter at its neutral value."""
        return {p.name: p.neutral for p in self.parameters}

    def active(self, values: dict[str, float | str]) -> bool:
        """Whether these (complete) values do anything."""
        return any(values[name] != self.parameter(name).neutral for name in self.switch)
