"""`Estimate`: what a method says about a run. Every member carries its uncertainty where the method has one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from core.trajectory import Trajectory

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Event:
    """Something that happened: its kind (slip, collision, beacon_loss, ...), t0, t1 [s], and why we say so."""

    kind: str
    t0: float
    t1: float
    evidence: str = ""
    replaced: str = ""


@dataclass(frozen=True)
class Curve:
    """A quantity over time with its standard deviation: t, value, sd (N,), unit as in the name of the field."""

    t: Array
    value: Array
    sd: Array | None = None


@dataclass(frozen=True)
class Value:
    """A parameter with its standard deviation."""

    value: float
    sd: float | None = None
    unit: str = ""


@dataclass(frozen=True)
class Innovations:
    """Normalised innovation squared of one sensor: t, nis (M,), degrees of freedom, accepted (M,) by the gate.

    score (M, k): signed innovations, each over its own standard deviation, where the method keeps them.
    """

    t: Array
    nis: Array
    dof: int
    accepted: npt.NDArray[np.bool_]
    score: Array | None = None


@dataclass(frozen=True)
class Estimate:
    """The path by one method and all that the method learnt on the way.

    `notes` are plain sentences a user should read (what was assumed, what is unobservable, what was frozen).
    """

    method: str
    trajectory: Trajectory
    gyro_bias: Curve | None = None  # rad/s
    parameters: Mapping[str, Value] = field(default_factory=dict)
    events: tuple[Event, ...] = ()
    innovations: Mapping[str, Innovations] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
