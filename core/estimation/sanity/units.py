"""Units and signs: gyro, accelerometer, wheels, fixes, ranges, and the numbers of run.json.

Each check compares two witnesses of the same motion and looks for the factor or sign that a mistake would leave.
"""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import numpy.typing as npt

from core.estimation.assumptions import Assumptions
from core.estimation.cleaning import gyro_readings
from core.estimation.fusion.events import FARTHEST
from core.estimation.fusion.start import LONGEST
from core.estimation.odometry import arcs, wheel_path
from core.run import Run
from core.sensors import ImuLog

Array = npt.NDArray[np.float64]
Mended = tuple[Run, tuple[str, ...]]
"""A run, and a sentence on what was put right or left out."""

DEGREES = 180.0 / math.pi
GRAVITY = 9.80665
WINDOW, MOST = 0.5, 4000  # s over which turns are compared, windows at most
TURNS, AGREE = 0.3, 0.8  # rad rms of turning in a window that is enough; least correlation of two witnesses
NEAR = 1.25  # a factor that is that near to a mistake's is the mistake
LENGTHS = {"millimetres": 1000.0, "centimetres": 100.0}
STRETCH, ROLLED = 2.0, 0.1  # s over which distances are compared; m that must be driven in them
ALL_ALIKE, USUAL = 0.4, 0.1  # least ratio of the factors of two stretches; share of a unit's factor in half of them
ENOUGH = 12  # fixes or ranges of one beacon
ALIKE, UNLIKE = 0.9, 0.5  # how much headings agree (mean direction of their differences) that are, that are not
WHEEL_MM, WHEEL_CM = 20.0, 2.0  # m: no robot's wheel has such a radius
TRACK_MM, TRACK_CM = 100.0, 10.0  # m: nor such a track


def dimensions(run: Run, numbers: Assumptions) -> Mended:
    """Wheel radius and track width of run.json in millimetres or centimetres."""
    robot, notes = run.meta.robot, []
    for name, mm, cm in (("wheel_radius", WHEEL_MM, WHEEL_CM), ("track_width", TRACK_MM, TRACK_CM)):
        value = getattr(robot, name)
        if value is None or not cm <= value < 1e3 * cm:
            continue
        unit = "millimetres" if value >= mm else "centimetres"
        robot = dataclasses.replace(robot, **{name: value / LENGTHS[unit]})
        notes.append(f"The {name.replace('_', ' ')} in run.json, {value:g} m, is in {unit}: converted.")
    return (dataclasses.replace(run, meta=dataclasses.replace(run.meta, robot=robot)), tuple(notes)) if notes else (
        run, ()
    )  # fmt: skip


def gravity(run: Run, numbers: Assumptions) -> Mended:
    """An accelerometer in g, or upside down."""
    imu = run.imu
    if imu is None or imu.az is None or not np.isfinite(imu.az).any():
        return run, ()
    up = float(np.nanmedian(imu.az))
    notes: tuple[str, ...] = ()
    for unit, factor in (("g", GRAVITY), ("mg", GRAVITY / 1000.0)):
        if 0.9 < abs(up) * factor / GRAVITY < 1.1:
            scaled = {k: getattr(imu, k) * factor for k in ("ax", "ay", "az") if getattr(imu, k) is not None}
            imu, up = dataclasses.replace(imu, **scaled), up * factor
            notes = (f"The accelerometer reads {unit} in place of m/s²: converted.",)
    if up < -0.5 * GRAVITY:
        imu = _turned_over(imu)
        notes += ("The IMU is upside down (gravity reads along its z axis): its y and z axes are turned back.",)
    return dataclasses.replace(run, imu=imu), notes


def _turned_over(imu: ImuLog) -> ImuLog:
    """As if the IMU were turned by half a turn about its x axis."""
    turned = {k: -getattr(imu, k) for k in ("gy", "gz", "ay", "az") if getattr(imu, k) is not None}
    return dataclasses.replace(imu, **turned)


def turning(run: Run, numbers: Assumptions) -> Mended:
    """The gyro against the wheels' turn: its sign and its unit."""
    imu, wheels, robot = run.imu, run.wheels, run.meta.robot
    if imu is None or wheels is None or not robot.track_width or not robot.wheel_radius or len(imu) < 10:
        return run, ()
    path = wheel_path(wheels, robot.wheel_radius, robot.track_width)
    t, gz = gyro_readings(imu)
    begin = max(t[0], path.t[0])
    grid = np.arange(begin, min(t[-1], path.t[-1], begin + MOST * WINDOW), WINDOW)
    if len(grid) < 8:
        return run, ()
    turned = np.concatenate(([0.0], np.cumsum(0.5 * (gz[1:] + gz[:-1]) * np.minimum(np.diff(t), 1.0))))
    by_gyro = np.diff(np.interp(grid, t, turned))
    by_wheels = np.diff(np.interp(grid, path.t, path.turn))
    if np.sqrt(np.mean(by_wheels**2)) < TURNS * WINDOW or np.ptp(by_gyro) == 0 or np.ptp(by_wheels) == 0:
        return run, ()
    agreement = float(np.corrcoef(by_gyro, by_wheels)[0, 1])
    large = _large(by_wheels)
    slope = float(np.median(np.abs(by_gyro)[large] / np.abs(by_wheels)[large]))
    if not abs(agreement) > AGREE:
        return run, ()
    notes: tuple[str, ...] = ()
    if 1 / NEAR < slope / DEGREES < NEAR:
        imu = dataclasses.replace(imu, gz=imu.gz / DEGREES)
        notes = ("The gyro reads degrees in place of radians: converted.",)
    if 1 / NEAR < slope * DEGREES < NEAR:
        run, notes = _wheels_converted(run)
        wheels = run.wheels
        assert wheels is not None
    if agreement < 0:
        right_way_up = imu.az is not None and float(np.nanmedian(imu.az)) > 0.5 * GRAVITY
        if right_way_up:
            wheels = dataclasses.replace(wheels, left=wheels.right, right=wheels.left)
            notes += (
                "Left and right wheel are exchanged (they turn against the gyro, which is right way up): put right.",
            )
        else:
            imu = dataclasses.replace(imu, gz=-imu.gz)
            notes += ("The gyro turns against the wheels, as an IMU that is upside down does: its sign is changed.",)
    return dataclasses.replace(run, imu=imu, wheels=wheels), notes


def _large(values: Array) -> npt.NDArray[np.bool_]:
    return np.asarray(np.abs(values) >= max(float(np.quantile(np.abs(values), 0.7)), 1e-9))


def reckoned(run: Run) -> tuple[Array, Array] | None:
    """Stamps (N,) and poses (N, 3) by wheels, and gyro where there is one, from the origin; None without wheels."""
    wheels, robot = run.wheels, run.meta.robot
    if wheels is None or not robot.wheel_radius or len(wheels) < 2:
        return None
    path = wheel_path(wheels, robot.wheel_radius, robot.track_width)
    turn = path.turn
    if run.imu is not None and len(run.imu) > 1:
        t, gz = gyro_readings(run.imu)
        steps = 0.5 * (gz[1:] + gz[:-1]) * np.minimum(np.diff(t), 1.0)
        turn = np.interp(path.t, t, np.concatenate(([0.0], np.cumsum(steps))))
    if not np.isfinite(turn).all():
        return None
    return path.t, arcs(path.d, turn)


def leading(run: Run, stamps: Array) -> tuple[Array, npt.NDArray[np.intp]] | None:
    """Dead-reckoned poses (K, 3) at those of the stamps that lie in the first LONGEST metres, and which."""
    found = reckoned(run)
    if found is None or not len(stamps):
        return None
    t, pose = found
    gone = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(pose[:, :2], axis=0).T))))
    end = t[min(int(np.searchsorted(gone, LONGEST)), len(t) - 1)]
    rows = np.flatnonzero((stamps >= t[0]) & (stamps <= end))[:2000]
    at = np.column_stack([np.interp(stamps[rows], t, column) for column in pose.T])
    return (at, rows) if len(rows) >= ENOUGH and np.ptp(at[:, :2], axis=0).max() > 1e-9 else None


def fixes(run: Run, numbers: Assumptions) -> Mended:
    """Fixes against the wheels' distance and the dead-reckoned path: units, and a map that is mirrored."""
    ratio = _metres_per_metre(run, numbers)
    fixes, wheels = run.beacon, run.wheels
    if ratio is None or fixes is None or wheels is None:
        return run, ()
    for words, factor in LENGTHS.items():
        if 1 / NEAR < ratio / factor < NEAR:
            fixes = dataclasses.replace(fixes, x=fixes.x / factor, y=fixes.y / factor)
            return dataclasses.replace(run, beacon=fixes), (f"The fixes read {words} in place of metres: converted.",)
    if 1 / NEAR < ratio * DEGREES < NEAR:
        return _wheels_converted(run)
    return _fix_headings(run)


def _wheels_converted(run: Run) -> Mended:
    assert run.wheels is not None
    left, right = run.wheels.left / DEGREES, run.wheels.right / DEGREES
    wheels = dataclasses.replace(run.wheels, left=left, right=right)
    return dataclasses.replace(run, wheels=wheels), ("The wheels read degrees in place of radians: converted.",)


def _metres_per_metre(run: Run, numbers: Assumptions) -> float | None:
    """How far fixes move per metre that the wheels roll, in the straightest stretches; None where they say little.

    A unit is one factor for all stretches: where these differ by more than turns make them, none is told.
    """
    fixes, wheels, robot = run.beacon, run.wheels, run.meta.robot
    if fixes is None or wheels is None or not robot.wheel_radius or len(fixes) < 2 * ENOUGH or len(wheels) < 2:
        return None
    path = wheel_path(wheels, robot.wheel_radius, robot.track_width)
    x, y = (np.asarray(column, np.float64)[:4000] for column in (fixes.x, fixes.y))
    x, y = (np.where(np.abs(column) <= FARTHEST, column, np.nan) for column in (x, y))
    d = np.interp(fixes.t[:4000], path.t, path.d)
    k = int(np.clip(round(STRETCH / max(float(np.median(np.diff(fixes.t))), 1e-3)), 1, len(x) // 2))
    seen, rolled = np.hypot(x[k:] - x[:-k], y[k:] - y[:-k]), np.abs(d[k:] - d[:-k])
    use = np.isfinite(seen) & (rolled >= max(float(np.quantile(rolled, 0.5)), ROLLED))
    if use.sum() < ENOUGH or float(np.median(seen[use])) < 5 * numbers.fix_xy:
        return None
    few, many = np.quantile(seen[use] / rolled[use], (0.3, 0.7))
    return float(many) if few > ALL_ALIKE * many else None


def _fix_headings(run: Run) -> Mended:
    """Headings of fixes against those of wheels and gyro: degrees in place of radians."""
    fixes = run.beacon
    stretch = leading(run, fixes.t) if fixes is not None else None
    if fixes is None or fixes.theta is None or stretch is None:
        return run, ()
    at, rows = stretch
    theta = np.asarray(fixes.theta, np.float64)[rows]
    good = np.isfinite(theta)
    if good.sum() < ENOUGH or np.ptp(at[good, 2]) < 1.0:
        return run, ()

    def alike(factor: float) -> float:
        return float(np.abs(np.mean(np.exp(1j * (theta[good] * factor - at[good, 2])))))

    if alike(1.0) > UNLIKE or alike(1 / DEGREES) < ALIKE:
        return run, ()
    fixes = dataclasses.replace(fixes, theta=np.asarray(fixes.theta, np.float64) / DEGREES)
    return dataclasses.replace(run, beacon=fixes), ("The fixes' headings read degrees in place of radians: converted.",)


def range_units(run: Run, numbers: Assumptions) -> Mended:
    """Ranges that change by more than the robot can have driven, by a factor that a unit leaves."""
    log, found = run.ranges, reckoned(run)
    if log is None or found is None or len(log) < 2 * ENOUGH:
        return run, ()
    t, pose = found
    gone = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(pose[:, :2], axis=0).T))))
    most = usual = 0.0
    for k in range(len(log.names)):
        mine = np.flatnonzero((log.beacon == k) & np.isfinite(log.range))[:1000]
        if len(mine) < ENOUGH:
            continue
        stamps, ranges = log.t[mine], np.asarray(log.range, np.float64)[mine]
        apart = int(np.clip(round(STRETCH / max(float(np.median(np.diff(stamps))), 1e-3)), 1, len(mine) // 2))
        driven = np.diff(np.interp(stamps, t, gone)[::apart])
        if driven.max() > 0.2:
            use = driven >= max(float(np.quantile(driven, 0.5)), ROLLED)
            half, nearly_all = np.quantile(np.abs(np.diff(ranges[::apart]))[use] / driven[use], (0.5, 0.9))
            most, usual = max(most, float(nearly_all)), max(usual, float(half))
    for words, factor in LENGTHS.items():
        if 0.3 < most / factor < NEAR and usual > USUAL * factor:
            log = dataclasses.replace(log, range=np.asarray(log.range, np.float64) / factor)
            return dataclasses.replace(run, ranges=log), (f"The ranges read {words} in place of metres: converted.",)
    return run, ()


def place_units(run: Run, numbers: Assumptions) -> Mended:
    """Beacons further apart than both of their ranges together can reach, by a factor that a unit leaves."""
    log, beacons = run.ranges, run.meta.beacons
    if log is None or len(log) < 2 * ENOUGH:
        return run, ()
    ranges, ratios = np.asarray(log.range, np.float64), []
    usual = {
        name: float(np.median(mine)) for k, name in enumerate(log.names)
        if name in beacons and (mine := ranges[(log.beacon == k) & (ranges > 0)][:1000]).size >= ENOUGH
    }  # fmt: skip
    for a, b in itertools.combinations(usual, 2):
        ratios.append(math.dist(beacons[a], beacons[b]) / (usual[a] + usual[b]))
    for words, factor in LENGTHS.items():
        if ratios and 0.15 < max(ratios) / factor < NEAR:
            places = {name: (x / factor, y / factor, z / factor) for name, (x, y, z) in beacons.items()}
            note = f"The beacons' places in run.json are in {words}: converted."
            return dataclasses.replace(run, meta=dataclasses.replace(run.meta, beacons=places)), (note,)
    return run, ()
