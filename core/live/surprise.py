"""Noise of fixes and ranges that nobody stated, learnt while it goes: by how much the filter is surprised by them.

As offline (`estimation.fusion.noise`): the sd is scaled until the median innovation is what it claims to be. Offline it
is scaled before the filter sets out; here whenever ENOUGH new readings have shown that it is wrong.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from core.estimation.fusion.layout import FIX, R_FIX, R_FIX_THETA, R_RANGE, RANGE
from core.estimation.fusion.noise import ENOUGH, MEDIAN_CHI2
from core.run import RunMeta

Array = npt.NDArray[np.float64]

CLOSE = 0.1  # relative: the sd is right within it
ONCE, EVER = 2.0, 10.0  # factors by which it is changed at once, and in all
OF = {FIX: (R_FIX, R_FIX_THETA), RANGE: (R_RANGE,)}


class Surprise:
    """Innovations of readings whose noise is not known, and the filter's numbers that are set by them."""

    def __init__(self, meta: RunMeta, given: frozenset[str]) -> None:
        stated = {FIX: meta.noise.beacon_xy or "fix_xy" in given, RANGE: meta.noise.range or "range" in given}
        self._seen: dict[int, list[float]] = {kind: [] for kind, known in stated.items() if not known}
        self._scaled = dict.fromkeys(self._seen, 1.0)

    def take(self, kind: npt.NDArray[np.int64], headed: npt.NDArray[np.bool_], nis: Array, constants: Array) -> None:
        """New readings: their kind, whether with a heading, normalised innovations squared; `constants` are changed."""
        for which, seen in self._seen.items():
            rows = kind == which
            if not rows.any():
                continue
            typical = np.where(headed[rows], MEDIAN_CHI2[3], MEDIAN_CHI2[2 if which == FIX else 1])
            seen += (nis[rows] / typical).tolist()
            if len(seen) >= ENOUGH:
                factor = float(np.clip(np.sqrt(np.median(seen)), 1 / ONCE, ONCE))
                factor = float(np.clip(self._scaled[which] * factor, 1 / EVER, EVER)) / self._scaled[which]
                seen.clear()
                if abs(factor - 1.0) > CLOSE:
                    self._scaled[which] *= factor
                    constants[list(OF[which])] *= factor**2
