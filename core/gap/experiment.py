"""What to drive next: the scenario on which two rivals predict most apart, once both are refitted to it.

The first rival makes the readings at its fitted size; the second is fitted to them, with every other fitted effect free
beside it. What it cannot imitate, d in units of the noise, gives the chance: the drop of deviance between the two would
be d² with a standard deviation of 2d (Vuong 1989), and has to be more than what odds of 19 to 1 ask for.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import stats

from core.effects import EFFECTS
from core.errors import DriftscopeError
from core.gap.candidates import BANDS, SEARCHED, SHARES, STEPS, TAUS, Reach, bounds, free_of
from core.gap.evidence import Drive, Rivalry
from core.gap.floor import Floor
from core.gap.judge import odds
from core.gap.selection import Found
from core.gap.types import Cause, NextExperiment
from core.gap.world import WHEELS
from core.robot import EffectSet
from core.run import Run
from core.simulation import simulate_many
from core.simulation._batch_numba import Outputs
from core.simulation.scenarios import SCENARIOS

Array = npt.NDArray[np.float64]

CLOSE = 0.02
"""Rivals with less probability are not worth a drive."""
SURE = 5.9
"""Difference of deviance at which odds are 19 to 1."""
TEMPER = 2e-4
"""Share of an effect's own drop by which no model is exact (see `judge`)."""
PAIRS = 3
"""At most so many pairs are weighed."""
WINDOW = 2.0
"""The pose is set anew this often [s]: no drive is judged by where an integrated error ends."""
RATE = 20.0
"""Commands per second of the drive that is handed out."""
ROUNDS = 3
FIELDS = {
    "wheels.left": "left", "wheels.right": "right", "imu.gz": "gz", "imu.ax": "ax", "imu.ay": "ay",
    "beacon.x": "beacon_x", "beacon.y": "beacon_y", "beacon.theta": "beacon_theta", "ranges.range": "range",
    "truth.x": "x", "truth.y": "y", "truth.theta": "theta",
}  # fmt: skip


@dataclass(frozen=True)
class Rivals:
    """Two effects that these runs hardly tell apart: what the first brings over the second now, in deviance."""

    first: str
    second: str
    lead: float


def rivals_of(links: Sequence[Found], causes: Sequence[Cause]) -> list[Rivals]:
    """Pairs worth a drive, closest first."""
    out = []
    chances = {one.effect: one.probability for one in causes}
    for link in links:
        for name, weights in odds(link).items():
            step = next(s for s in link.steps if s.action == f"add {name}")
            gains = dict(step.gains)
            for rival in weights:
                near = min(chances.get(name, 0.0), chances.get(rival, 0.0))
                if near > CLOSE and name in link.fit.model and not {name, rival} & set(SEARCHED):
                    out.append((near, Rivals(name, rival, max(gains[name] - gains[rival], 0.0))))
    out.sort(key=lambda pair: -pair[0])
    return [pair for _, pair in out[:PAIRS]]


def next_experiment(
    run: Run, model: EffectSet, links: Sequence[Found], causes: Sequence[Cause], floor: Floor, reach: Reach
) -> tuple[NextExperiment, Drive] | None:
    """The best drive to tell the likeliest rivals apart; None where there is nothing to tell."""
    pairs = rivals_of(links, causes)
    if not pairs:
        return None
    best: tuple[float, str, list[float]] | None = None
    for name in SCENARIOS:
        try:
            far = [separation(run, name, model, pair, floor, reach) for pair in pairs]
        except DriftscopeError:
            continue  # a scenario that this robot cannot be simulated on
        least = min(chance(d**2) for d in far)
        score = least + 1e-6 * min(far)
        if best is None or score > best[0]:
            best = score, name, far
    if best is None or min(best[2]) <= 0.0:
        return None
    drive = SCENARIOS[best[1]]
    commands = drive.commands(RATE)
    after = [chance(d**2) for d in best[2]]
    told = " and ".join(f"{pair.first} from {pair.second}" for pair in pairs)
    reason = f"{drive.label} would tell {told}: refitted, they still differ by {min(best[2]):.1f} standard deviations"
    path = simulate_many(_scene(run, best[1]), [model])
    rivalries = tuple(
        Rivalry((pair.first, pair.second), chance(pair.lead), p) for pair, p in zip(pairs, after, strict=True)
    )
    profile = best[1].replace("-", "_")
    shown = Drive(
        profile,
        float(commands.t[-1]) / 60.0,
        _wide(commands.t),
        _wide(commands.v),
        _wide(commands.w),
        path.x[0],
        path.y[0],
        rivalries,
        reason,
    )
    separates = tuple((pair.first, pair.second) for pair in pairs)
    return NextExperiment(profile, separates, reason, min(after)), shown


def _wide(values: npt.NDArray[np.floating]) -> Array:
    return np.asarray(values, dtype=np.float64)


def chance(deviance: float) -> float:
    """That a right effect is told from its rival at odds of 19 to 1, where it leads by this much on average."""
    heat = 1.0 + TEMPER * deviance
    return float(stats.norm.cdf((deviance - SURE * heat) / (2.0 * np.sqrt(max(deviance, 1e-6)))))


def _scene(run: Run, scenario: str) -> Run:
    """The scenario with this robot, and with the streams that its runs have."""
    made = SCENARIOS[scenario].run(robot=run.meta.robot, beacons=dict(run.meta.beacons), noise=run.meta.noise)
    absent = {name: None for name in ("wheels", "imu", "beacon", "ranges") if getattr(run, name) is None}
    meta = dataclasses.replace(made.meta, effects=run.meta.effects)
    return dataclasses.replace(made, meta=meta, **absent)


def separation(run: Run, scenario: str, model: EffectSet, pair: Rivals, floor: Floor, reach: Reach) -> float:
    """What the first rival does there that the second, refitted beside the rest of the model, cannot, in sigma."""
    scene = _scene(run, scenario)
    path = simulate_many(scene, [model])
    t = scene.truth.t if scene.truth is not None else np.empty(0)
    first = np.searchsorted(t, np.arange(0.0, float(t[-1]) if len(t) else 0.0, WINDOW))
    restarts = np.column_stack((t[first], path.x[0, first], path.y[0, first], path.theta[0, first]))
    rest = {name: dict(values) for name, values in model.items() if name not in (pair.first, pair.second)}
    first_on = {**rest, pair.first: model[pair.first]}
    second = _start(pair.second, reach, run)
    best = np.inf
    for _ in range(ROUNDS):
        around = {**rest, pair.second: second}
        keys, sets = _derivatives(around)
        out = simulate_many(scene, [first_on, around, *sets], restarts=restarts)
        rows = _stack(out, run, floor)
        target = rows[0] - rows[1]
        columns = (rows[2:] - rows[1]).T / np.array([step for _, _, step in keys])
        size = np.maximum(np.linalg.norm(columns, axis=0), 1e-9)
        moved = np.linalg.lstsq(columns / size, target, rcond=1e-9)[0] / size
        best = min(best, float(np.linalg.norm(target - columns @ moved)))
        second = dict(second)
        for (effect, name, _), change in zip(keys, moved, strict=True):
            if effect == pair.second:
                low, high = bounds(effect, name)
                edge = STEPS[f"{effect}.{name}"]
                second[name] = float(np.clip(float(second[name]) + change, low + edge, high - edge))
    return best


def _start(effect: str, reach: Reach, run: Run) -> dict[str, float | str]:
    """Parameters near which an effect does something."""
    values = dict(EFFECTS[effect].neutral)
    if effect == "gyro_drift":
        values["tau"] = TAUS[1]
    if effect == "anchor_moved":
        values["beacon"] = next(iter(run.meta.beacons), "")
    if effect == "deadband":
        values["width"] = BANDS[1]
    tops = {"speed_limit": ("v_max", reach.speed), "accel_limit": ("a_max", reach.acceleration)}
    tops["gyro_clip"] = ("limit", reach.turn)
    if effect in tops:
        name, top = tops[effect]
        values[name] = SHARES[2] * max(top, 0.1)
    return values


def _derivatives(model: EffectSet) -> tuple[list[tuple[str, str, float]], list[EffectSet]]:
    """(effect, parameter, step) of every free number, and the model moved by each step."""
    keys: list[tuple[str, str, float]] = []
    sets: list[EffectSet] = []
    for effect, values in model.items():
        for name in free_of(effect, values) if not EFFECTS[effect].noise_only else ():
            step = STEPS[f"{effect}.{name}"]
            if float(values[name]) + step > bounds(effect, name)[1]:
                step = -step
            keys.append((effect, name, step))
            sets.append({**model, effect: {**values, name: float(values[name]) + step}})
    return keys, sets


def _stack(out: Outputs, run: Run, floor: Floor) -> Array:
    """(B, N) readings of every channel that the run has, in its own noise, end to end; angles less their mean."""
    names = [name for name in FIELDS if name in floor.sigma and _has(run, name)]
    parts = []
    for name in names:
        rows: Array = getattr(out, FIELDS[name]) / floor.sigma[name]
        parts.append(rows - rows.mean(axis=1, keepdims=True) if name in WHEELS else rows)
    return np.nan_to_num(np.concatenate(parts, axis=1))


def _has(run: Run, name: str) -> bool:
    log = getattr(run, name.split(".")[0])
    return log is not None and getattr(log, name.split(".")[1]) is not None
