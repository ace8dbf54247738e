"""What stands behind a diagnosis: the figures of the report page. Plain frozen data, SI and radians.

`evidence_json.py` writes it as gap-evidence/1. Arrays are thinned for plotting; gaps are in units of the stated noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class NoiseLevel:
    """A channel's noise as its readings show it, beside what run.json states; ratio_sd: of their ratio."""

    stream: str
    sigma: float
    unit: str
    stated: float | None
    ratio: float | None
    ratio_sd: float | None


@dataclass(frozen=True)
class LinkGap:
    """One link of the chain: root mean square over its channels, each predicted from the recorded stream before it."""

    link: str
    streams: tuple[str, ...]
    before: float
    after: float
    floor: float
    p_value: float


@dataclass(frozen=True)
class Cell:
    """A cell of the heat map: a stream while the robot does something. significant: after one false-discovery rule."""

    stream: str
    regime: str
    rows: int
    before: float
    after: float
    floor: float
    p_value: float
    significant: bool


@dataclass(frozen=True)
class PathTrace:
    """(N,) a run's path, and how far the simulator was off there, in units of the noise."""

    t: Array
    x: Array
    y: Array
    theta: Array
    gap: Array


@dataclass(frozen=True)
class Timeline:
    """(N,) middles of blocks of time, and each stream's gap there before and after."""

    t: Array
    before: Mapping[str, Array]
    after: Mapping[str, Array]


@dataclass(frozen=True)
class Poses:
    """(N,) x, y [m] and theta [rad]."""

    x: Array
    y: Array
    theta: Array


@dataclass(frozen=True)
class FreeRun:
    """The whole chain from the commands, the pose never set anew: one path per share of the fitted effects."""

    t: Array
    real: Poses
    shares: tuple[float, ...]
    paths: tuple[Poses, ...]


@dataclass(frozen=True)
class RunEvidence:
    """One run's curves. held_out: it, or none of what is scored of it, took part in the fit."""

    run: int
    name: str
    held_out: bool
    path: PathTrace | None
    timeline: Timeline
    free_run: FreeRun | None


@dataclass(frozen=True)
class Signature:
    """An effect in the data: the residual without it, by the regressor that it follows; with its fit, and after."""

    stream: str
    regressor: str
    unit: str
    x: Array
    residual: Array
    sd: Array
    fitted: Array
    after: Array


@dataclass(frozen=True)
class Considered:
    """An effect explained away. drop: of deviance, refitted beside the others; takes: share of the best one's."""

    effect: str
    probability: float
    drop: float
    takes: float
    reason: str


@dataclass(frozen=True)
class CannotSee:
    """A parameter that these runs do not show at its tolerance; visible_from: at which deviation from neutral they
    would (None: at none).
    """

    effect: str
    parameter: str
    unit: str
    visible_from: float | None


@dataclass(frozen=True)
class ShapeCurve:
    """(N,) what is left by one regressor, with a 90 % band; share: of the stream's rest that the curve takes."""

    regressor: str
    unit: str
    x: Array
    y: Array
    lo: Array
    hi: Array
    share: float


@dataclass(frozen=True)
class Period:
    """What is left repeats after this much of a regressor."""

    regressor: str
    value: float
    unit: str


@dataclass(frozen=True)
class Onset:
    """What is left begins here [s]."""

    t: float
    sd: float


@dataclass(frozen=True)
class Nearest:
    """A listed effect close to what is left; takes: share of the shape's drop that it takes."""

    effect: str
    takes: float
    reason: str


@dataclass(frozen=True)
class Leftover:
    """What no listed effect explains, described."""

    stream: str
    shapes: tuple[ShapeCurve, ...]
    period: Period | None
    onset: Onset | None
    place: tuple[float, float, float] | None
    nearest: tuple[Nearest, ...]


@dataclass(frozen=True)
class Rivalry:
    """Two rivals: the chance that they can be told apart now, and after the next experiment."""

    pair: tuple[str, str]
    chance_now: float
    chance_after: float


@dataclass(frozen=True)
class Drive:
    """What to drive next: commands (t [s], v [m/s], w [rad/s]), the nominal path, what it would separate."""

    profile: str
    minutes: float
    t: Array
    v: Array
    w: Array
    x: Array
    y: Array
    rivals: tuple[Rivalry, ...]
    reason: str


@dataclass(frozen=True)
class Evidence:
    """All of it; what is not known is empty."""

    noise_floor: tuple[NoiseLevel, ...] = ()
    links: tuple[LinkGap, ...] = ()
    cells: tuple[Cell, ...] = ()
    runs: tuple[RunEvidence, ...] = ()
    signatures: Mapping[str, Signature] = field(default_factory=dict)
    sets: tuple[tuple[str, ...], ...] = ()
    considered: tuple[Considered, ...] = ()
    cannot_see: tuple[CannotSee, ...] = ()
    unexplained: Leftover | None = None
    next: Drive | None = None
