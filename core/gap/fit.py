"""Exact refit of a model's parameters: Levenberg-Marquardt with bounds on white residuals, relinearised each step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.effects import EFFECTS
from core.gap.candidates import STEPS, bounds, free_of
from core.gap.linear import LOCAL, Model, Normal, Problem, linearise
from core.robot import EffectSet

Array = npt.NDArray[np.float64]

ITERATIONS = 8
SPREAD = 16.0
"""How much wider than `STEPS` the first look at an edge is."""
GAINED = 0.3
"""A step that lowers the cost by less than this ends the fit: a third of what noise does to one parameter."""
MARGIN = 1e-3
"""Parameters stay this share of a step inside their bounds."""


@dataclass(frozen=True)
class Fit:
    """A model at its best parameters in one scope: cost = -2 log likelihood up to a constant, and its equations."""

    model: Model
    cost: float
    normal: Normal
    scope: str

    @property
    def parameters(self) -> tuple[tuple[str, str], ...]:
        """(effect, parameter) of each column."""
        return parameters_of(self.model)


def parameters_of(model: EffectSet) -> tuple[tuple[str, str], ...]:
    """(effect, parameter) of every free number, in the order of the columns."""
    return tuple((effect, name) for effect, values in model.items() for name in free_of(effect, values))


def cost_of(normal: Normal) -> float:
    """-2 log likelihood up to a constant."""
    return float(normal.c.sum()) + normal.logs


def refit(problem: Problem, model: EffectSet, scope: str, iterations: int = ITERATIONS) -> Fit:
    """The model's parameters in this scope at their best; those of effects outside the scope stay."""
    inside = {name: values for name, values in problem.overlay(model, scope).items() if name not in problem.held}
    wide = any(f"{effect}.{name}" in LOCAL for effect, name in parameters_of(inside))
    spreads = [SPREAD / 2.0**k for k in range(5)] if wide else [1.0]
    normal = linearise(problem, inside, (), scope, spreads[0])
    best = Fit(inside, cost_of(normal), normal, scope)
    if not best.parameters:
        return best
    damping = 1e-4
    for k in range(iterations + len(spreads) - 1):
        spread = spreads[min(k + 1, len(spreads) - 1)]
        moved = _step(best, damping)
        if moved is None:
            break
        normal = linearise(problem, moved, (), scope, spread)
        cost = cost_of(normal)
        if not np.isfinite(cost) or cost > best.cost:
            damping *= 30.0
            if damping > 1e4:
                break
            if k + 1 < len(spreads):  # look again from where we are, less wide
                best = Fit(best.model, best.cost, linearise(problem, best.model, (), scope, spread), scope)
            continue
        gained = best.cost - cost
        best = Fit(moved, cost, normal, scope)
        damping = max(damping / 10.0, 1e-6)
        if gained < GAINED and k + 1 >= len(spreads):
            break
    return best


def _step(fit: Fit, damping: float) -> Model | None:
    """Parameters after one damped step, inside their bounds."""
    _, g, a = fit.normal.total
    scale = np.sqrt(np.maximum(np.diag(a), 1e-12))
    step = np.linalg.lstsq(a / np.outer(scale, scale) + damping * np.eye(len(g)), g / scale, rcond=1e-12)[0] / scale
    if not np.isfinite(step).all():
        return None
    moved: Model = {name: dict(values) for name, values in fit.model.items()}
    changed = False
    for (effect, name), change in zip(fit.parameters, step, strict=True):
        low, high = bounds(effect, name)
        inside = MARGIN * STEPS[f"{effect}.{name}"]
        old = float(moved[effect][name])
        new = float(
            np.clip(
                old + _bounded(effect, name, change),
                low if EFFECTS[effect].parameter(name).neutral == low else low + inside,
                high - inside,
            )
        )
        changed |= new != old
        moved[effect][name] = new
    return moved if changed else None


LEAP = {
    "slip_patch.x": 0.3,
    "slip_patch.y": 0.3,
    "slip_patch.radius": 0.3,
    "bump.time": 0.1,
    "gyro_drift.tau": 60.0,
    "command_delay.delay": 0.1,
    "motor_lag.tau": 0.1,
    "beacon_delay.delay": 0.3,
    "imu_clock.offset": 0.05,
    "deadband.width": 0.02,
}
"""Longest step of parameters whose response bends."""


def _bounded(effect: str, name: str, change: float) -> float:
    longest = LEAP.get(f"{effect}.{name}", np.inf)
    return float(np.clip(change, -longest, longest))
