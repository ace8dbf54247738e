"""On the product's own simulator, with ordinary flaws that nobody told the filter: errors are as large as claimed.

Twelve runs like the fifty of `tests/bench/bench_consistency.py`; nothing is set by hand, unstated noise is learnt.
"""

from __future__ import annotations

import numpy as np
import pytest

from core.estimation.fusion.fused import fused_and_smoothed
from core.metrics import chi2_band, nees
from tests.bench.bench_consistency import simulated


@pytest.fixture(scope="module")
def claims() -> dict[str, list[tuple[float, float]]]:
    """NEES at the end and the share of stamps inside the 95 % ellipse, per run of both methods."""
    found: dict[str, list[tuple[float, float]]] = {"fused": [], "smoothed": []}
    for name in ("square-ccw", "slalom", "stop-go"):
        for seed in range(4):
            run = simulated(name, seed, True)
            assert run.truth is not None
            for estimate in fused_and_smoothed(run):
                claim = nees(estimate.trajectory, run.truth)
                assert claim is not None and claim.dof == 3
                found[estimate.method].append((float(claim.nees[-1]), claim.inside))
    return found


@pytest.mark.parametrize("method", ["fused", "smoothed"])
def test_errors_on_flawed_robots_are_as_large_as_claimed(
    claims: dict[str, list[tuple[float, float]]], method: str
) -> None:
    last, inside = np.array(claims[method]).T
    low, high = chi2_band(3, len(last))
    assert low < np.mean(last) < high
    assert 0.90 < np.mean(inside) <= 0.99
