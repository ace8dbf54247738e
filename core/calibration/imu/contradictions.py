"""Segments whose data contradict what they declare: named with what the data say, and left out.

Two looks. Gross ones (not moving, wrong sign, wrong axis, degrees for radians) are seen from a segment alone, since no
sensor is that bad. Finer ones (a wrong rate) are seen against all other segments: a triad under a weak belief in
matrices near the identity is fitted to the segments' levels, and a segment is dropped while that mends the fit.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from core.calibration.imu.algorithm1 import AXES
from core.calibration.imu.stretches import LeftOut, Stretch

Floats = npt.NDArray[np.float64]

GROSS = 0.2  # of the declared size
GYRO_BIAS = 0.35  # rad/s, 20 deg/s: the worst MEMS gyros
KNOWN_BIAS = 0.035  # rad/s, how far a gyro's bias is from what most segments say
ACCEL_BIAS = 2.0  # m/s^2
GRAVITY = 9.80665
DEGREES = 180 / np.pi
BELIEF = 0.03  # sd of a matrix element about the identity's
FINE = 0.01  # of the declared size that a finer contradiction reaches at least
GYRO_LEVEL, ACCEL_LEVEL = 0.006, 0.06  # rad/s, m/s^2: drift and noise of a segment's level
MENDS = 16.0  # chi-square that dropping a segment must save
STUCK = 0.02  # of the usual variance, below which a reading does not move
WORDS = ("x", "y", "z")


def contradictions(found: Sequence[Stretch], sensor: str) -> tuple[list[Stretch], list[LeftOut], list[str]]:
    """The stretches that `sensor` ("gyro" or "accel") can be fitted to, those left out, and notes on units."""
    gyro = sensor == "gyro"
    usable = [s for s in found if gyro or s.still]
    axes = _present(usable, gyro)
    if not axes:
        return [], [], []
    left: list[LeftOut] = []
    notes = _units(usable, gyro, axes)
    bias = _provisional_bias(usable, axes) if gyro else np.zeros(len(axes))
    usual = np.median([s.noise for s in usable], axis=0)
    coarse = np.max([s.quantum for s in usable], axis=0) > 2 * np.sqrt(usual)
    kept = []
    for s in usable:
        stuck = [j for j in axes if s.noise[j] < STUCK * usual[j] and not coarse[j]]
        reason = _stuck(s, stuck) if stuck else _gross(s, gyro, axes, bias)
        if reason:
            left.append(_out(s, sensor, reason))
        else:
            kept.append(s)
    fine, dropped = _fine(kept, gyro, axes)
    return fine, left + [_out(s, sensor, reason) for s, reason in dropped], notes


def _out(s: Stretch, sensor: str, reason: str) -> LeftOut:
    return LeftOut(s.run, s.index, float(s.lo[0]), float(s.hi[-1]), reason, sensor)


def _stuck(s: Stretch, stuck: list[int]) -> str:
    values = ", ".join(f"{AXES[j]} at {s.level[j]:.4g}" for j in stuck)
    return f"saturated or stuck: hardly any noise about {values}"


def _present(found: Sequence[Stretch], gyro: bool) -> list[int]:
    offset = 3 if gyro else 0
    return [j for j in range(offset, offset + 3) if any(np.isfinite(s.mean[:, j]).all() for s in found)]


def dead_axes(found: Sequence[Stretch]) -> list[int]:
    """Axes (of AXES) whose readings never change."""
    return [
        j
        for j in range(6)
        if all(s.noise[j] == 0 for s in found) and np.ptp(np.concatenate([s.mean[:, j] for s in found])) == 0
    ]


def declared(s: Stretch, gyro: bool) -> Floats | None:
    """(3,) what the segment declares of the sensor's true value."""
    return s.rate if gyro else s.force


def _provisional_bias(found: Sequence[Stretch], axes: list[int]) -> Floats:
    """A bias that most segments agree with: a level at rest, or the middle of what is read beyond the declared."""
    known = [s for s in found if np.isfinite(s.level[axes]).all()]
    if not known:
        return np.zeros(len(axes))
    beyond = np.array([s.level[axes] - s.rate[[j % 3 for j in axes]] for s in known])
    size = np.array([np.linalg.norm(s.rate) for s in known])
    candidates = np.vstack([beyond[[s.still for s in known]], np.median(beyond, axis=0)])
    reach = GROSS * size + KNOWN_BIAS
    votes = [np.minimum(np.linalg.norm(beyond - c, axis=1) / reach, 1.0).sum() for c in candidates]
    return np.asarray(candidates[int(np.argmin(votes))])


def _units(found: Sequence[Stretch], gyro: bool, axes: list[int]) -> list[str]:
    """Units that the sizes give away: degrees for radians, g for m/s^2."""
    known = [(s, u) for s in found if (u := declared(s, gyro)) is not None and np.isfinite(s.level[axes]).all()]
    local = [j % 3 for j in axes]
    ratios = [
        float(np.linalg.norm(s.level[axes]) / np.linalg.norm(u[local]))
        for s, u in known
        if np.linalg.norm(u[local]) > 0
    ]
    ratio = float(np.median(ratios)) if ratios else 1.0
    notes = []
    if gyro:
        if abs(ratio / DEGREES - 1) < GROSS:
            notes.append("gyro readings are 57 times the declared rates: they look like deg/s; wanted are rad/s")
        elif abs(ratio * DEGREES - 1) < GROSS:
            notes.append("declared rates are 57 times the gyro's readings: they look like deg/s; wanted are rad/s")
        noise = np.array([np.sqrt(np.nanmedian([s.noise[j] for s in found])) for j in axes])
        bias = np.abs(_provisional_bias(found, axes))
        if not notes and ((noise > 0.1).any() or (bias > GYRO_BIAS).any()):
            notes.append(
                f"gyro at rest reads up to {bias.max():.3g} rad/s with noise up to {noise.max():.3g}: "
                "are the readings in deg/s? Wanted are rad/s, 57.3 times less"
            )
    elif abs(ratio * GRAVITY - 1) < GROSS:
        notes.append("accelerometer readings are 9.8 times less than the declared gravity: they look like g, not m/s²")
    return notes


def _gross(s: Stretch, gyro: bool, axes: list[int], bias: Floats) -> str:
    """Why a segment cannot be what it declares; empty where it can."""
    u = declared(s, gyro)
    if u is None or not np.isfinite(s.level[axes]).all():
        return ""
    local = [j % 3 for j in axes]
    true, m = u[local], s.level[axes] - bias
    size, found = float(np.linalg.norm(true)), float(np.linalg.norm(m))
    limit = _saturated(s, axes)
    allowance = KNOWN_BIAS if gyro else ACCEL_BIAS
    if float(np.linalg.norm(m - true)) <= GROSS * size + allowance:
        return limit
    if limit:
        return limit
    unit = "rad/s" if gyro else "m/s²"
    read = _spread(m, local)
    told = f"declared {_vector(u)} {unit}, read (bias taken off) {_vector(read)}"
    if size <= allowance and gyro:
        return f"it is declared at rest but turns: {told}"
    along = float(m @ true) / (size * found) if size * found > 0 else 0.0
    if gyro and abs(found / size / DEGREES - 1) < GROSS:
        return f"degrees taken for radians: {told}"
    if gyro and abs(found / size * DEGREES - 1) < GROSS:
        return f"the declared rate looks like deg/s, wanted are rad/s: {told}"
    if found < GROSS * size + (0 if not gyro else KNOWN_BIAS):
        return f"{'the table does not move' if gyro else 'no gravity is felt'}: {told}"
    if along < -0.8:
        return f"{'the table turns the other way' if gyro else 'the other side is up'} (wrong sign): {told}"
    if along > 0.9:
        flat = np.ptp(s.mean[:, axes], axis=0)[int(np.argmax(np.abs(true)))] == 0
        return f"{'saturated' if flat else 'wrong ' + ('rate' if gyro else 'size')}: {told}"
    axis = WORDS[local[int(np.argmax(np.abs(m)))]]
    return f"wrong axis, the data say {axis}: {told}"


def _saturated(s: Stretch, axes: list[int]) -> str:
    """Which axes sit at a limit for a part of the readings."""
    hit = [f"{AXES[j]} ({s.limit[j]:.0%} of the readings)" for j in axes if s.limit[j] > 0]
    return f"saturated: {', '.join(hit)}" if hit else ""


def _spread(m: Floats, local: list[int]) -> Floats:
    out = np.full(3, np.nan)
    out[local] = m
    return out


def _vector(v: Floats) -> str:
    return "(" + ", ".join("-" if np.isnan(x) else f"{x:.4g}" for x in v) + ")"


def _fine(found: list[Stretch], gyro: bool, axes: list[int]) -> tuple[list[Stretch], list[tuple[Stretch, str]]]:
    """Drop segments one by one while that mends the common fit by far."""
    known = [s for s in found if declared(s, gyro) is not None and np.isfinite(s.level[axes]).all()]
    dropped: list[tuple[Stretch, str]] = []
    while len(known) > 2 and len(dropped) < len(found) // 2:
        costs = [_misfit(known[:k] + known[k + 1 :], gyro, axes)[0] for k in range(len(known))]
        worst = int(np.argmin(costs))
        whole = _misfit(known, gyro, axes)[0]
        rest = known[:worst] + known[worst + 1 :]
        s = known[worst]
        model = _misfit(rest, gyro, axes)[1]
        u = declared(s, gyro)
        assert u is not None
        left = s.level[axes] - np.append(u, 1.0) @ model
        tolerance = FINE * float(np.linalg.norm(u)) + (GYRO_LEVEL if gyro else ACCEL_LEVEL)
        if whole - costs[worst] < MENDS or float(np.linalg.norm(left)) < tolerance:
            break
        dropped.append((s, _finer(u, gyro, float(np.linalg.norm(left)))))
        known = rest
    gone = {id(s) for s, _ in dropped}
    return [s for s in found if id(s) not in gone], dropped


def _finer(u: Floats, gyro: bool, left: float) -> str:
    unit = "rad/s" if gyro else "m/s²"
    what = f"wrong {'rate' if gyro else 'position'}" if u.any() else "it is declared at rest but turns"
    return f"{what}: declared {_vector(u)} {unit}, and by the other segments {left:.3g} {unit} of it stay unexplained"


def _misfit(known: list[Stretch], gyro: bool, axes: list[int]) -> tuple[float, Floats]:
    """Cost and model (4, axes) of a triad under the belief in a matrix near the identity."""
    local = [j % 3 for j in axes]
    u = np.array([declared(s, gyro) for s in known])
    y = np.array([s.level[axes] for s in known])
    level = GYRO_LEVEL if gyro else ACCEL_LEVEL
    weight = 1 / (level + 0.003 * np.linalg.norm(u, axis=1))
    x = np.column_stack([u, np.ones(len(u))]) * weight[:, None]
    prior = np.diag([1 / BELIEF] * 3 + [1e-3])
    target = np.vstack([np.eye(3)[:, local], np.zeros((1, len(axes)))])
    model, *_ = np.linalg.lstsq(np.vstack([x, prior]), np.vstack([y * weight[:, None], prior @ target]), rcond=None)
    cost = float(((x @ model - y * weight[:, None]) ** 2).sum() + ((prior @ (model - target)) ** 2).sum())
    return cost, model
