"""The noise floor of each channel, from the data themselves: high differences see noise, not motion.

A third difference of the residual leaves white noise (its variance times 20) and next to nothing of what an unmodelled
effect does, for that varies slowly against the sampling. Medians keep edges and outliers out.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from core.gap._pose_numba import SIDE
from core.gap.world import POSES, WHEELS, World
from core.run import Run

Array = npt.NDArray[np.float64]

NORMAL_MEDIAN = 0.67449
"""Median size of a standard normal number."""
NORMAL_HIGH, HEAVY = 1.95996 / NORMAL_MEDIAN, (1.2, 2.0)
"""Size that one normal number in twenty exceeds, over the median size; noise with so much more has tails; at most."""
THIRD = np.sqrt(20.0)
"""Standard deviation of a third difference of unit white noise."""
SATURATED = 5
"""A largest reading that comes more often is a sensor's limit."""
NOTHING = 1e-12
"""Variance of readings without any noise, in squares of their floor."""
COARSE, TRIM, TRIMMED = 0.3, 3.0, 0.9733
"""Rounding beyond this share of the noise is coarse; then the variance within so many sigma, and what share that is."""
EDGE, KEPT = 5e-4, 0.4
"""Where a signal moves by more than the noise in this time [s] its differences show timing; so much must be left."""
FEW = 30
"""Fewer third differences than this say nothing of the noise."""
FALLBACK = {"imu.gz": 2e-3, "imu.ax": 0.05, "imu.ay": 0.05, "ranges.range": 0.05, "beacon.theta": 0.05}
TRUTH_SHEET = 0.001
"""Of a truth that states no noise [m, rad]."""


@dataclass(frozen=True)
class Floor:
    """White noise per channel, one sigma per reading; `sd` is its own relative uncertainty; `sheet` what is stated.

    vibration: k of sd² = sigma² + (k*v)² for both accelerometer axes. walk: how the pose strays from the model, in rad
    of heading per root of m driven; side: in m of position per rad of that. gyro_walk: density of the gyro's bias walk,
    where one was found [rad/s/√s]. sway: of IMU axes, (sd, angular frequency [rad/s]) of what the smoothing of wheel
    angles leaves (`sway.py`).
    """

    sigma: Mapping[str, float]
    sd: Mapping[str, float]
    sheet: Mapping[str, float]
    vibration: float = 0.0
    vibration_sd: float = 0.0
    walk: float = 1e-5
    side: float = SIDE
    gyro_walk: float = 0.0
    sway: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def wrap(values: Array) -> Array:
    """Angles to -pi .. pi."""
    out: Array = (values + np.pi) % (2.0 * np.pi) - np.pi
    return out


def stated(run: Run) -> dict[str, float]:
    """The data sheet's sigma of each channel; what it does not state is left out (truth: 1 mm, 1 mrad)."""
    noise, robot = run.meta.noise, run.meta.robot
    out = {"truth.x": noise.truth_xy or TRUTH_SHEET, "truth.y": noise.truth_xy or TRUTH_SHEET}
    out["truth.theta"] = noise.truth_theta or TRUTH_SHEET
    if robot.ticks_per_rev:
        out |= dict.fromkeys(WHEELS, 2.0 * np.pi / robot.ticks_per_rev / np.sqrt(6.0))
    root = np.sqrt(run.imu.rate / 2.0) if run.imu is not None else 0.0
    if noise.gyro_density:
        out["imu.gz"] = noise.gyro_density * root
    if noise.accel_density:
        out |= dict.fromkeys(("imu.ax", "imu.ay"), noise.accel_density * root)
    if noise.beacon_xy:
        out |= dict.fromkeys(("beacon.x", "beacon.y"), noise.beacon_xy)
    for name, value in (("beacon.theta", noise.beacon_theta), ("ranges.range", noise.range)):
        if value:
            out[name] = value
    return {name: float(value) for name, value in out.items()}


def third_differences(world: World, name: str, residual: Array) -> Array:
    """Third differences in units of the noise; of ranges, each beacon's own; of a saturated gyro, the rest.

    Where smoothed wheels drive the body, the prediction is rougher than the motion: then of the IMU's readings alone.
    """
    if name in ("imu.ax", "imu.ay"):
        calm = _calm(world, name, residual)
        return np.diff(world.readings[name] if world.rough else residual, 3)[calm] / THIRD
    if world.rough and name == "imu.gz":
        residual = world.readings[name]
    if name == "imu.gz":
        size = np.abs(world.readings[name])
        stuck = size >= size.max(initial=0.0) * (1.0 - 1e-9)
        if stuck.sum() > SATURATED:
            free = ~(stuck[3:] | stuck[2:-1] | stuck[1:-2] | stuck[:-3])
            return np.diff(residual, 3)[free] / THIRD
    if name != "ranges.range" or world.run.ranges is None:
        return np.diff(residual, 3) / THIRD
    beacon = world.run.ranges.beacon[world.keep(name)]
    order = np.argsort(beacon, kind="stable")
    far = np.diff(residual[order], 3) / THIRD
    same = beacon[order][3:] == beacon[order][:-3]
    return far[same]


def _calm(world: World, name: str, residual: Array) -> npt.NDArray[np.bool_]:
    """(N - 3,) third differences that no edge of the signal touches."""
    predicted = world.readings[name] - residual
    slope = np.abs(np.diff(predicted)) / np.maximum(np.diff(world.times[name]), 1e-6)
    noise = float(np.median(np.abs(np.diff(residual, 3)))) / NORMAL_MEDIAN / THIRD
    still = EDGE * slope < 0.3 * noise
    calm: npt.NDArray[np.bool_] = still[2:] & still[1:-1] & still[:-2]
    return calm if calm.mean() > KEPT else np.ones(len(calm), dtype=bool)


def rounding_of(readings: Array) -> float:
    """The step that readings are rounded to; 0 where they lie on no grid."""
    levels = np.unique(readings[:5000])
    if len(levels) < 3 or len(levels) > 0.5 * min(len(readings), 5000):
        return 0.0
    step = float(np.diff(levels).min())
    off = (levels - levels[0]) / max(step, 1e-15)
    return step if float(np.abs(off - np.round(off)).max()) < 0.05 else 0.0


def measure(worlds: list[World], residuals: Sequence[Mapping[str, Array]], speeds: Sequence[Array | None]) -> Floor:
    """The floor that all runs share. residuals: per run and channel; speeds: forward speed at the IMU's stamps."""
    sheet = stated(worlds[0].run)
    for name in [n for n in sheet if n.startswith("imu")]:  # rounding comes on top of what is stated
        steps = [rounding_of(w.readings[name]) for w in worlds if name in w.readings]
        sheet[name] = float(np.hypot(sheet[name], min(steps, default=0.0) / np.sqrt(12.0)))
    sigma: dict[str, float] = {}
    sd: dict[str, float] = {}
    names = [name for name in (*WHEELS, "imu.gz", "imu.ax", "imu.ay", *POSES) if any(name in r for r in residuals)]
    for name in names:
        far = np.concatenate(
            [third_differences(w, name, r[name]) for w, r in zip(worlds, residuals, strict=True) if name in r]
        )
        coarse = max((rounding_of(w.readings[name]) for w in worlds if name in w.readings), default=0.0)
        if name in WHEELS:
            far = far[far != 0.0]  # a wheel at rest shows no rounding
        if len(far) < FEW:
            sigma[name], sd[name] = sheet.get(name, FALLBACK.get(name, 0.05)), 1.0
            continue
        sigma[name] = float(np.median(np.abs(far))) / NORMAL_MEDIAN
        if name.startswith("imu") and coarse > COARSE * sigma[name]:  # few levels: a median jumps from one to the next
            inside = far[np.abs(far) < TRIM * sigma[name]]
            sigma[name] = float(np.sqrt(np.mean(inside**2) / TRIMMED))
        if name.startswith("imu"):  # where rounding hides the noise most differences are 0: rounding is the noise
            sigma[name] = max(sigma[name], coarse / np.sqrt(12.0))
        if name.startswith("truth"):
            sigma[name] *= _tails(far)
        if name.startswith(("beacon", "ranges")):  # outliers sit in four differences each, but in one residual
            plain = np.concatenate([r[name] for r in residuals if name in r])
            direct = float(np.median(np.abs(plain - np.median(plain)))) / NORMAL_MEDIAN
            sigma[name] = direct if direct < 0.93 * sigma[name] else sigma[name]
        sd[name] = 1.5 / float(np.sqrt(len(far)))
        if name in WHEELS and name in sheet:  # rounding is no white noise: its differences say more than there is
            rounding = sheet[name] / np.sqrt(2.0)
            sigma[name] = rounding if sigma[name] < 2.0 * rounding else sigma[name]
        sigma[name] = max(sigma[name], 0.05 * sheet.get(name, 0.0), 1e-9)
    vibration = spread = 0.0
    if "imu.ax" in sigma and "imu.ay" in sigma:
        sigma, vibration, spread = _vibration(worlds, residuals, speeds, sigma)
    return Floor(sigma=sigma, sd=sd, sheet=sheet, vibration=vibration, vibration_sd=spread)


def _tails(far: Array) -> float:
    """By how much noise is wider than its median size says: a motion capture's markers swap, a lidar's scans slip."""
    ratio = float(np.quantile(np.abs(far), 0.95)) / NORMAL_HIGH / max(float(np.median(np.abs(far))), 1e-15)
    return 1.0 if ratio < HEAVY[0] else min(ratio, HEAVY[1])


def _level(far: Array) -> float:
    """Variance by the mean square of what lies near; a median of few levels jumps from one to the next."""
    size = float(np.median(np.abs(far))) / NORMAL_MEDIAN
    for _ in range(3):
        inside = far[np.abs(far) < TRIM * max(size, float(np.abs(far).mean()))]
        size = float(np.sqrt(np.mean(inside**2) / TRIMMED)) if len(inside) else size
    return size**2


CLEAR = 3.0
"""Deviations by which noise must grow with speed to be told as vibration."""
SCATTERED = 4.5
"""Variance of such a level over its square, times the readings: third differences repeat each other."""


def _vibration(
    worlds: list[World],
    residuals: Sequence[Mapping[str, Array]],
    speeds: Sequence[Array | None],
    sigma: dict[str, float],
) -> tuple[dict[str, float], float, float]:
    """Accelerometer noise that grows with speed: median squares of differences in classes of speed, a line through."""
    squares, speed = [], []
    for name in ("imu.ax", "imu.ay"):
        far, v = [], []
        for world, residual, fast in zip(worlds, residuals, speeds, strict=True):
            if name in residual and fast is not None:
                far.append(third_differences(world, name, residual[name]))
                v.append(np.abs(fast[world.keep(name)])[1:-2][_calm(world, name, residual[name])])
        if not far:
            return sigma, 0.0, 0.0
        squares.append(np.concatenate(far))
        speed.append(np.concatenate(v))
    top = max(float(v.max(initial=0.0)) for v in speed)
    if top < 0.05:
        return sigma, 0.0, 0.0
    edges = np.linspace(0.0, top, 9)
    design, target, weight = [], [], []
    for axis, (square, rates) in enumerate(zip(squares, speed, strict=True)):
        for a, b in itertools.pairwise(edges):
            inside = (rates >= a) & (rates <= b)
            n = int(inside.sum())
            if n >= FEW:
                level = max(_level(square[inside]), NOTHING)
                row = [0.0, 0.0, float(np.mean(rates[inside] ** 2))]
                row[axis] = 1.0
                design.append(row)
                target.append(level)
                weight.append(np.sqrt(n) / level)
    x, y, w = np.array(design), np.array(target), np.array(weight)
    if len(x) < 4 or np.linalg.matrix_rank(x) < 3:
        return sigma, 0.0, 0.0
    base_x, base_y, k2 = np.linalg.lstsq(x * w[:, None], y * w, rcond=None)[0]
    cov = np.linalg.inv((x * w[:, None]).T @ (x * w[:, None])) * SCATTERED
    if k2 <= CLEAR * np.sqrt(cov[2, 2]) or min(base_x, base_y) <= 0.0:
        return sigma, 0.0, 0.0
    rough = {**sigma, "imu.ax": float(np.sqrt(base_x)), "imu.ay": float(np.sqrt(base_y))}
    return rough, float(np.sqrt(k2)), float(0.5 * np.sqrt(cov[2, 2] / k2))
