"""The simulator's kernels, compiled before somebody waits for them."""

from __future__ import annotations

from core.simulation.links import body_from_commands, imu_from_path
from core.simulation.scenarios import SCENARIOS
from core.simulation.simulate import simulate, simulate_many


def warm() -> None:
    """Compile the kernels (or load them from numba's cache)."""
    run = SCENARIOS["straight"].run()
    simulate_many(run, [{}, {}])
    simulate(run, {}, 0)
    imu_from_path(body_from_commands(run, {}), run, {})
