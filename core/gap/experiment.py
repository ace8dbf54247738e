"""What to drive next: the scenario on which two rivals' predictions, each refitted, differ most."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import stats

from core.errors import DriftscopeError
from core.gap.candidates import STEPS
from core.gap.floor import stated
from core.gap.types import Cause, NextExperiment
from core.robot import EffectSet
from core.run import Run
from core.simulation import simulate_many
from core.simulation._batch_numba import Outputs
from core.simulation.scenarios import NOISE, SCENARIOS

SEPARATED = 5.0
"""Standardised distance at which rivals count as told apart."""
DOUBT = 0.9
"""Causes surer than this need no experiment."""
CLOSE = 0.02
"""Rivals with less probability are not worth a drive."""


def next_experiment(run: Run, model: EffectSet, causes: Sequence[Cause]) -> NextExperiment | None:
    """The best drive to tell the two likeliest rivals apart; None where there is nothing to tell."""
    rivals = [one for one in causes if one.probability > CLOSE]
    if len(rivals) < 2 or rivals[0].probability > DOUBT:
        return None
    first, second = rivals[0].effect, rivals[1].effect
    best: tuple[float, str] | None = None
    for name in SCENARIOS:
        try:
            far = separation(run, name, first, second)
        except DriftscopeError:
            continue
        if best is None or far > best[0]:
            best = (far, name)
    if best is None or best[0] <= 0.0:
        return None
    chance = float(stats.norm.cdf(best[0] - SEPARATED))
    return NextExperiment(
        best[1].replace("-", "_"),
        ((first, second),),
        f"{first} and {second} predict what differs by {best[0]:.1f} sigma there, after each is refitted",
        chance,
    )


def separation(run: Run, scenario: str, first: str, second: str) -> float:
    """What one rival of a step's size predicts that the other cannot imitate, in sigma, over all streams."""
    drive = SCENARIOS[scenario]
    made = drive.run(robot=run.meta.robot, beacons=dict(run.meta.beacons), noise=run.meta.noise)
    meta = dataclasses.replace(made.meta, effects=run.meta.effects)
    made = dataclasses.replace(made, meta=meta)
    keys = [key for key in STEPS if key.split(".")[0] in (first, second)]
    sets = []
    for key in keys:
        effect, name = key.split(".")
        sets.append({effect: {name: _moved(run, effect, name)}})
    out = simulate_many(made, [{}, *sets])
    columns = _stack(out, made)
    mine = [i for i, key in enumerate(keys) if key.startswith(first + ".")]
    theirs = [i for i, key in enumerate(keys) if key.startswith(second + ".")]
    if not mine or not theirs:
        return 0.0
    a, b = columns[mine].sum(axis=0), columns[theirs].T
    left = a - b @ np.linalg.lstsq(b, a, rcond=1e-9)[0]
    return float(np.linalg.norm(left))


def _moved(run: Run, effect: str, name: str) -> float:
    from core.effects import EFFECTS

    parameter = EFFECTS[effect].parameter(name)
    neutral = float(parameter.neutral)
    if np.isinf(neutral):
        return 0.3
    return neutral + STEPS[f"{effect}.{name}"]


def _stack(out: Outputs, run: Run) -> np.ndarray:
    """(B - 1, N) differences from the first set, in sigma, every stream end to end."""
    sheet = {
        "imu.gz": 2e-3,
        "imu.ax": 0.03,
        "imu.ay": 0.03,
        **stated(dataclasses.replace(run, meta=dataclasses.replace(run.meta, noise=run.meta.noise or NOISE))),
    }
    fields = {
        "left": "wheels.left",
        "right": "wheels.right",
        "gz": "imu.gz",
        "ax": "imu.ax",
        "ay": "imu.ay",
        "x": "truth.x",
        "y": "truth.y",
        "theta": "truth.theta",
    }
    parts = [
        (getattr(out, field)[1:] - getattr(out, field)[:1]) / (10.0 * sheet.get(name, 0.01))
        for field, name in fields.items()
    ]
    return np.nan_to_num(np.concatenate(parts, axis=1))
