"""What is plainly wrong with a run before anything is estimated: counters, units, signs, mirrored maps, beacons' names.

`sound(run, numbers)` is asked once, before whichever method (`core.estimation.pipeline`). What is found is named, and
put right where there is no doubt how; else the sensor is left out. To add a check: a function in a file of this folder,
a place in CHECKS; each sees the run as those before it have left it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from core.estimation.assumptions import Assumptions
from core.estimation.sanity.beacons import beacons, one_line, unsurveyed
from core.estimation.sanity.counters import counters
from core.estimation.sanity.mirrored import mirrored
from core.estimation.sanity.units import dimensions, fixes, gravity, place_units, range_units, turning
from core.run import Run

Check = Callable[[Run, Assumptions], tuple[Run, tuple[str, ...]]]


def sound(run: Run, numbers: Assumptions, checks: Sequence[Check] | None = None) -> tuple[Run, tuple[str, ...]]:
    """The run with what is plainly wrong put right or left out, and a sentence on each. checks: all where None."""
    notes: tuple[str, ...] = ()
    for check in CHECKS if checks is None else checks:
        run, more = check(run, numbers)
        notes += more
    return run, notes


CHECKS: tuple[Check, ...] = (
    dimensions, counters, gravity, turning, fixes, mirrored, range_units, place_units, unsurveyed, one_line, beacons,
)  # fmt: skip
MENDING = tuple(check for check in CHECKS if check not in (unsurveyed, one_line))
"""Those that change a run; the others only say what it lacks."""
