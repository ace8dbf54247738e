"""`estimate(run, method)`: where the robot was, by one method. The story, one screen.

Given: a run with what the method needs. Done: the method's needs are checked, what is plainly wrong with the run is put
right (`sanity`, the same for all methods), its numbers are taken from the run (else assumed, and said so in the notes),
the path is estimated with its uncertainty. Truth is never looked at.
To add a method: a file with its function, a row in METHODS.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from core.errors import MissingStreamError, ParameterError
from core.estimation import needs
from core.estimation.assumptions import Config, assume
from core.estimation.beacon import beacon
from core.estimation.fusion.fused import fused, fused_and_smoothed, smoothed
from core.estimation.odometry import encoders, encoders_gyro
from core.estimation.published import missing as missing_for_published
from core.estimation.published import published
from core.estimation.result import Estimate
from core.estimation.sanity import sound
from core.run import Run


@dataclass(frozen=True)
class Method:
    """One way to a path: what it is called, what it needs, whether a pose uses only readings up to its stamp."""

    name: str
    label: str
    needs: str
    causal: bool
    source: str
    summary: str
    missing: Callable[[Run], str | None]
    run: Callable[[Run, Config | None], Estimate]


METHODS: dict[str, Method] = {
    m.name: m
    for m in (
        Method(
            name="encoders",
            label="Encoders",
            needs="wheels, wheel radius, track width",
            causal=True,
            source="Borenstein, Everett, Feng 1996",
            summary="Dead reckoning: both wheels' angles, exact arcs.",
            missing=needs.for_encoders,
            run=encoders,
        ),
        Method(
            name="beacon",
            label="Beacon",
            needs="beacon fixes, or ranges to three surveyed beacons",
            causal=True,
            source="Foy 1976 (ranges)",
            summary="The fixes alone; where there are only ranges, a position from each round of them.",
            missing=needs.for_beacon,
            run=beacon,
        ),
        Method(
            name="encoders+gyro",
            label="Encoders + gyro",
            needs="wheels, wheel radius, imu",
            causal=True,
            source="Chung, Ojeda, Borenstein 2001",
            summary="Distance by the wheels, heading by the gyro, its bias learnt wherever the robot rests.",
            missing=needs.for_encoders_gyro,
            run=encoders_gyro,
        ),
        Method(
            name="published",
            label="Published",
            needs="wheels, wheel radius, track width; imu with ax, ay; beacon fixes or ranges",
            causal=True,
            source="Lee, Shin, Cho 2009",
            summary="The system of a paper, for comparison: IMU data replace encoder data, the beacon the position.",
            missing=missing_for_published,
            run=published,
        ),
        Method(
            name="fused",
            label="Fused",
            needs="wheels, wheel radius, and imu or track width; fixes and ranges where there are any",
            causal=True,
            source="Bar-Shalom, Li, Kirubarajan 2001; Solà 2017",
            summary="Error-state Kalman filter of all sensors, with gyro bias and scales.",
            missing=needs.for_fused,
            run=fused,
        ),
        Method(
            name="smoothed",
            label="Smoothed",
            needs="as fused",
            causal=False,
            source="Bierman 1973; Rauch, Tung, Striebel 1965",
            summary="The fused filter walked back from its end: each pose by the whole run.",
            missing=needs.for_fused,
            run=smoothed,
        ),
    )
}


PAIR = ("fused", "smoothed")


def available(run: Run) -> dict[str, str | None]:
    """Each method's name with None, or with the reason why it cannot run on this run."""
    return {name: method.missing(run) for name, method in METHODS.items()}


def estimate(run: Run, method: str, config: Config | None = None) -> Estimate:
    """The path by one method of METHODS.

    Rows: per IMU stamp, per wheel stamp where there is no IMU; `beacon`: per fix. `config` sets any number of
    `core.estimation.assumptions.Assumptions` by name. Raises ParameterError (unknown method or option) and
    MissingStreamError (the run lacks what the method needs).
    """
    return Estimates(run, (method,), config).by(method)


class Estimates:
    """Paths of one run by several methods: what two of them share is done once, when the first is asked for.

    `by(method)` gives what `estimate` gives, and raises what it raises; `seconds` how long each took, `fused` and
    `smoothed` together where both are wanted.
    """

    def __init__(self, run: Run, methods: Sequence[str], config: Config | None = None) -> None:
        self._run, self._methods, self._config = run, tuple(methods), config
        self._made: dict[str, Estimate] = {}
        self._sound: tuple[Run, tuple[str, ...]] | None = None
        self.seconds: dict[str, float] = {}

    def by(self, method: str) -> Estimate:
        """The path by one method."""
        if method not in self._made:
            _check(self._run, method)
            began = time.perf_counter()
            run, wrong = self._sound = self._sound or sound(self._run, assume(self._run, self._config)[0])
            _check(run, method, wrong)
            if method in PAIR and all(one in self._methods for one in PAIR):
                made = dict(zip(PAIR, fused_and_smoothed(run, self._config), strict=True))
            else:
                made = {method: METHODS[method].run(run, self._config)}
            self._made |= {name: _with(wrong, one) for name, one in made.items()}
            self.seconds |= dict.fromkeys(made, time.perf_counter() - began)
        return self._made[method]


def _with(wrong: tuple[str, ...], made: Estimate) -> Estimate:
    """What was wrong with the run is said first, and once."""
    return replace(made, notes=(*wrong, *(note for note in made.notes if note not in wrong)))


def _check(run: Run, method: str, wrong: tuple[str, ...] = ()) -> None:
    if method not in METHODS:
        raise ParameterError(f"unknown method {method!r}", parameter="method", expected=tuple(METHODS), found=method)
    reason = METHODS[method].missing(run)
    if reason is not None:
        told = "".join(f". {note}" for note in wrong)
        raise MissingStreamError(f"{method} cannot run: {reason}{told}", method=method, missing=reason)
