"""What a diagnosis says. Plain frozen data, SI and radians; `as_json.py` writes it as gap/1."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from core.gap.evidence import Evidence
from core.robot import EffectSet


@dataclass(frozen=True)
class Config:
    """What the user may set. tolerances: a size below which "effect.parameter" is immaterial, in place of the table's.

    window: the pose is set anew this often [s]. seed: of every random draw.
    """

    tolerances: Mapping[str, float] = field(default_factory=dict)
    window: float = 2.0
    seed: int = 0


@dataclass(frozen=True)
class Value:
    """A parameter and its standard deviation; `text` for a name."""

    value: float | str
    std: float | None = None


@dataclass(frozen=True)
class Place:
    """A disc in the map [m]."""

    x: float
    y: float
    radius: float


@dataclass(frozen=True)
class Where:
    """Where the gap lies: a stream, what the robot does there, its share of all excess, p-value.

    intervals: of the first run [s]; by_run: of every run.
    """

    stream: str
    regime: str
    share: float
    p_value: float
    intervals: tuple[tuple[float, float], ...] = ()
    place: Place | None = None
    by_run: tuple[tuple[tuple[float, float], ...], ...] = ()


@dataclass(frozen=True)
class Cause:
    """One effect: its probability, the share of the explained gap that leaving it out would bring back, its size."""

    effect: str
    probability: float
    share: float
    parameters: Mapping[str, Value]
    confusable_with: tuple[str, ...] = ()


@dataclass(frozen=True)
class Immaterial:
    """Real, but below its tolerance."""

    effect: str
    parameters: Mapping[str, Value]


@dataclass(frozen=True)
class Figures:
    """Gap in units of the stated noise: before, after, at the noise floor."""

    before: float
    after: float
    floor: float


@dataclass(frozen=True)
class Gap:
    """How far: in total with the shrinkage and its 90 % interval, and per stream.

    held_out: on runs, or stretches, that took no part in choice or fit. without: the gap after, but for one cause.
    """

    total: Figures
    shrink: float | None
    shrink_ci: tuple[float, float] | None
    held_out: bool
    by_stream: Mapping[str, Figures]
    without: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Unexplained:
    """What no listed effect explains: stream, regressors, words; the shape's share of its stream's excess."""

    stream: str
    depends_on: tuple[str, ...]
    description: str
    share: float = 0.0


@dataclass(frozen=True)
class NextExperiment:
    """What to drive next: a scenario's name, which pairs it separates, why, the chance that it does."""

    profile: str
    separates: tuple[tuple[str, str], ...]
    reason: str
    chance: float


@dataclass(frozen=True)
class Rejected:
    """An effect that was considered, and why it is not a cause."""

    effect: str
    reason: str


@dataclass(frozen=True)
class Unseen:
    """A parameter that these runs cannot show, and the size from which on they could (None: at no size)."""

    effect: str
    parameter: str
    visible_from: float | None


@dataclass(frozen=True)
class Diagnosis:
    """The whole answer. `model`: every effect that was fitted, for patching the simulator; `evidence`: for a report."""

    verdict: str
    where: tuple[Where, ...]
    causes: tuple[Cause, ...]
    gap: Gap
    immaterial: tuple[Immaterial, ...]
    unexplained: Unexplained | None
    next_experiment: NextExperiment | None
    rejected: tuple[Rejected, ...]
    unseen: tuple[Unseen, ...]
    probabilities: Mapping[str, float]
    model: EffectSet
    noise: Mapping[str, float]
    notes: tuple[str, ...]
    link: str | None
    runtime_s: float
    evidence: Evidence = field(default_factory=Evidence)
