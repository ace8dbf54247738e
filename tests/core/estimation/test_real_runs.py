"""Every recorded run beside the project, by every method that it allows; and the figures that they must reach."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from core.estimation import available, estimate
from core.formats import read_run
from core.metrics import evaluate, nees
from core.run import Run

pytestmark = pytest.mark.shared


def every_run(folder: Path) -> list[Run]:
    return [read_run(path.parent) for path in sorted(folder.rglob("run.json"))]


def test_all_runs_estimate_by_all_methods_without_nan(shared_data: Path) -> None:
    runs = every_run(shared_data / "real")
    assert len(runs) >= 40
    done = 0
    for run in runs:
        for method, reason in available(run).items():
            assert (reason is None) or run.wheels is None or method not in ("fused", "smoothed")
            if reason is not None:
                continue
            path = estimate(run, method).trajectory
            columns = (path.x, path.y) if method == "beacon" else (path.x, path.y, path.theta)
            assert all(np.isfinite(c).all() for c in columns), (run.meta.name, method)
            done += 1
    assert done >= 80


@pytest.mark.parametrize(("encoding", "bound"), [("odometry", 0.5), ("distance-gyro", 0.35)])
def test_ranges_hold_the_mower_on_its_lawn(shared_data: Path, encoding: str, bound: float) -> None:
    """CMU Plaza 1, 1.86 km: dead reckoning 1.9 m; filters of its authors and after 0.3 to 0.5 m with these ranges."""
    run = read_run(shared_data / "real" / "plaza1" / encoding)
    assert run.truth is not None
    found = estimate(run, "fused")
    errors = evaluate(found.trajectory, run.truth)
    assert errors.ate_rmse_m is not None and errors.ate_rmse_m < bound
    scale = found.parameters["range_scale"]
    assert scale.value == pytest.approx(0.0694, abs=0.004)  # of these radios, by least squares against the truth


def test_a_circle_by_wheels_is_within_what_is_claimed(shared_data: Path) -> None:
    inside = []
    for run in every_run(shared_data / "real" / "optiodom-circle-a") + every_run(
        shared_data / "real" / "optiodom-square-a"
    ):
        assert run.truth is not None
        found = nees(estimate(run, "fused").trajectory, run.truth, truth_sd=(0.002, 0.002, 0.005))
        assert found is not None
        inside.append(found.inside)
    assert np.mean(inside) > 0.9
