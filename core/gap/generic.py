"""Shapes that no listed effect has: what an unknown cause could do to a channel, as columns beside the effects'.

Each shape is a function of what the robot does (turning, speed, acceleration, time, temperature, heading, wheel angle,
place) added to one channel, or to the body's motion (then gyro, accelerometer and poses see it together).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.gap.floor import wrap
from core.gap.linear import Problem, White
from core.gap.whiten import Events, events_of, imu_sigma, jumps_of, residuals_of, white_imu, white_poses, white_wheels
from core.gap.world import IMU, WHEELS, World
from core.robot import EffectSet
from core.simulation._batch_numba import Outputs

Array = npt.NDArray[np.float64]

SLOW = 0.05
"""Speeds above this [m/s, rad/s] have a direction."""


@dataclass(frozen=True)
class Shape:
    """One shape: the channel (or "body.w", "body.v") it acts on, the regressor it depends on, what it looks like."""

    channel: str
    regressor: str
    text: str

    @property
    def key(self) -> str:
        """Name of its column."""
        return f"?{self.channel}:{self.text}"


def regressors(world: World, body: Outputs) -> dict[str, Array]:
    """What the robot does at the IMU's stamps: w, v, a, alpha, t, warmth, theta, phi (mean wheel angle), x, y."""
    t = world.body_inputs.imu
    w, v = body.gz[0], body.speed[0]
    rate = np.maximum(np.gradient(t), 1e-6)
    out = {"w": w, "v": v, "a": np.gradient(v) / rate, "alpha": np.gradient(w) / rate, "t": t / max(float(t[-1]), 1.0)}
    out["temperature"] = world.body_inputs.warmth
    if len(world.stamps) > 3:
        out["theta"] = np.interp(t, world.stamps, np.unwrap(body.theta[0]))
        out["x"] = np.interp(t, world.stamps, body.x[0])
        out["y"] = np.interp(t, world.stamps, body.y[0])
    wheels = world.run.wheels
    if wheels is not None:
        for side in ("left", "right"):
            out[f"phi_{side}"] = np.interp(t, wheels.t, np.nan_to_num(getattr(wheels, side)))
    return out


def imu_shapes(name: str, r: Mapping[str, Array]) -> dict[Shape, Array]:
    """Shapes that add to one axis of the IMU."""
    w, v, a, alpha, t = (r[key] for key in ("w", "v", "a", "alpha", "t"))
    table: list[tuple[str, str, Array]] = [
        ("w", "w³", w**3), ("w", "|w|", np.abs(w)), ("w", "w²", w**2), ("w", "sign of w", np.tanh(w / SLOW)),
        ("v", "v", v), ("v", "v²", v**2), ("v", "|v|", np.abs(v)), ("v", "moving", np.tanh(np.abs(v) / SLOW)),
        ("a", "a", a), ("a", "|a|", np.abs(a)), ("alpha", "dw/dt", alpha), ("alpha", "|dw/dt|", np.abs(alpha)),
        ("t", "t", t), ("t", "t²", t**2), ("t", "w·t", w * t), ("t", "v·t", v * t),
        ("v", "v·w", v * w), ("v", "v·|w|", v * np.abs(w)),
    ]  # fmt: skip
    if name != "imu.gz":
        table += [("w", "w", w), ("a", "a·|a|", a * np.abs(a)), ("v", "sign of v", np.tanh(v / SLOW))]
    if np.ptp(r["temperature"]) > 0.0:
        warm = r["temperature"]
        table += [("temperature", "temperature²", warm**2), ("temperature", "w·temperature", w * warm)]
        if name != "imu.gz":
            table.append(("temperature", "temperature", warm))
    if "theta" in r:
        for k in (1, 2):
            if name == "imu.gz" or k == 2:
                table += [
                    ("theta", f"sin {k}θ", np.sin(k * r["theta"])),
                    ("theta", f"cos {k}θ", np.cos(k * r["theta"])),
                ]
    for side in ("left", "right"):
        if f"phi_{side}" in r:
            phi = r[f"phi_{side}"]
            table += [
                (f"wheels.{side}", f"sin φ {side}", np.sin(phi)),
                (f"wheels.{side}", f"cos φ {side}", np.cos(phi)),
            ]
    return {Shape(name, regressor, text): value for regressor, text, value in table}


def motion_shapes(r: Mapping[str, Array]) -> dict[Shape, tuple[Array, Array, Array]]:
    """Shapes that add to the body's motion: (forward [m/s], sideways [m/s], turning [rad/s])."""
    w, v, a, t = (r[key] for key in ("w", "v", "a", "t"))
    zero = np.zeros_like(w)
    turns = [
        ("v", "v", v), ("v", "|v|", np.abs(v)), ("v", "v²", v * np.abs(v)), ("w", "w|w|", w * np.abs(w)),
        ("w", "w³", w**3), ("w", "|w|", np.abs(w)), ("w", "sign of w", np.tanh(w / SLOW)), ("a", "a", a),
        ("t", "w·t", w * t), ("t", "v·t", v * t), ("v", "moving", np.tanh(np.abs(v) / SLOW)), ("v", "v·w", v * w),
        ("v", "|v|·w", np.abs(v) * w),
    ]  # fmt: skip
    ways = [
        ("w", "|w|", np.abs(w)), ("w", "w", w), ("v", "v|v|", v * np.abs(v)), ("v", "v³", v**3), ("t", "v·t", v * t),
        ("v", "|v|", np.abs(v)), ("v", "sign of v", np.tanh(v / SLOW)), ("w", "v·|w|", v * np.abs(w)),
    ]  # fmt: skip
    sides = [("v", "v", v), ("w", "w", w), ("v", "v²", v * np.abs(v)), ("w", "v·|w|", v * np.abs(w))]
    if "theta" in r:
        moving = np.abs(v) + 0.1 * np.abs(w)
        for text, wave in (("sin θ", np.sin(r["theta"])), ("cos θ", np.cos(r["theta"]))):
            turns.append(("theta", f"v·{text}", v * wave))
            ways.append(("theta", f"|v|·{text}", moving * wave))
            sides.append(("theta", f"|v|·{text}", moving * wave))
    for side in ("left", "right"):
        if f"phi_{side}" in r:
            phi = r[f"phi_{side}"]
            turns += [(f"wheels.{side}", f"v·{n} φ {side}", v * f(phi)) for n, f in (("sin", np.sin), ("cos", np.cos))]
    out = {Shape("body.w", regressor, text): (zero, zero, value) for regressor, text, value in turns}
    out |= {Shape("body.v", regressor, text): (value, zero, zero) for regressor, text, value in ways}
    out |= {Shape("body.vy", regressor, text): (zero, value, zero) for regressor, text, value in sides}
    out[Shape("body.v", "a", LAGS)] = (-YIELDS * a, zero, -YIELDS * r["alpha"])
    return out


YIELDS, LAGS = 0.02, "its own lag"
"""A body that follows its wheels so much later [s], on tyres that yield, and how that is told."""


def later(model: EffectSet, seconds: float) -> EffectSet:
    """The model with its IMU's stamps later: what an IMU feels of a body that lags as a whole, edges and all."""
    offset = float(model.get("imu_clock", {}).get("offset", 0.0))
    return {**model, "imu_clock": {"offset": offset + seconds}}


NEAR = 0.5
"""Width of a place that a gyro may be disturbed at [m]."""


def found_shapes(world: World, residual: Array, r: Mapping[str, Array]) -> dict[Shape, Array]:
    """Shapes of the gyro's offset that are looked for in what is left: a step in time, and a place (a magnet)."""
    t, keep = world.body_inputs.imu, world.keep("imu.gz")
    length = max(SHORTEST, float(t[-1] - t[0]) / BLOCKS)
    number = np.floor(t[keep] / length)
    cuts = np.flatnonzero(np.diff(number, prepend=-1.0))
    count = np.diff(np.append(cuts, len(number)))
    size = np.minimum(np.abs(residual), 4.0 * max(float(np.median(np.abs(residual))), 1e-9)) * np.sign(residual)
    total = np.add.reduceat(size, cuts)
    if len(cuts) < MANY:
        return {}
    left, n = total.sum() - np.cumsum(total), np.maximum(count.sum() - np.cumsum(count), 1)
    k = int(np.argmax((left**2 / n)[EDGE:-EDGE])) + EDGE
    out = {Shape("imu.gz", "t", "a step"): (t >= t[keep][cuts[k + 1]]).astype(float)}
    if "x" in r:
        x, y = (r[name][keep][cuts + count // 2] for name in ("x", "y"))
        near = np.exp(-0.5 * ((x[:, None] - x) ** 2 + (y[:, None] - y) ** 2) / NEAR**2)
        best = int(np.argmax((near @ total) ** 2 / np.maximum(near**2 @ count, 1e-9)))
        far = (r["x"] - x[best]) ** 2 + (r["y"] - y[best]) ** 2
        out[Shape("imu.gz", "x", "near a place")] = np.exp(-0.5 * far / NEAR**2)
    return out


SHORTEST, BLOCKS = 0.1, 600.0
"""What is left is looked at in blocks of so many seconds, or so many of them."""
MANY, EDGE = 100, 30
"""A run of fewer blocks shows no step, nor do so many at its ends."""


def wheel_shapes(world: World, name: str, predicted: Array) -> dict[Shape, Array]:
    """Shapes that add to one encoder's angle; speeds are integrated."""
    t = world.times[name]
    step = np.diff(t, prepend=t[:1])
    rate = np.gradient(predicted) / np.maximum(np.gradient(t), 1e-6)
    top = max(float(np.abs(rate).max()), 1e-9)
    u = rate / top
    du = np.gradient(u) / np.maximum(np.gradient(t), 1e-6)
    share = t / max(float(t[-1]), 1.0)
    speeds = [
        ("v", "this side alone", u), ("v", "|speed|", np.abs(u)), ("v", "speed·|speed|", u * np.abs(u)),
        ("v", "speed³", u**3),
        ("v", "sign of speed", np.tanh(u / 0.05)), ("t", "speed·t", u * share), ("t", "speed·t²", u * share**2),
        ("a", "|acceleration|", np.abs(du)), ("a", "speeding up", np.maximum(du * np.sign(u), 0.0)),
    ]  # fmt: skip
    out = {Shape(name, regressor, text): np.cumsum(value * step) * top for regressor, text, value in speeds}
    phi = world.readings[name]
    for k in (1, 2):
        out[Shape(name, name, f"sin {k}φ")] = np.sin(k * phi)
        out[Shape(name, name, f"cos {k}φ")] = np.cos(k * phi)
    return out


def fix_shapes(world: World, name: str, pose: Array, t: Array) -> dict[Shape, Array]:
    """Shapes that add to a fix's column or a range; pose (N, 3): the predicted pose at its stamps."""
    x, y, theta = pose.T
    share = t / max(float(t[-1]), 1.0)
    table = [("x", "x", x), ("y", "y", y), ("t", "t", share), ("x", "x²", x**2), ("y", "y²", y**2), ("x", "x·y", x * y)]
    table += [("theta", "sin θ", np.sin(theta)), ("theta", "cos θ", np.cos(theta))]
    table += [("theta", "sin 2θ", np.sin(2.0 * theta)), ("theta", "cos² θ", np.cos(theta) ** 2)]
    table.append(("theta", "sin² θ", np.sin(theta) ** 2))
    if name == "beacon.theta":
        table.append(("theta", "constant", np.ones_like(x)))
    if name == "ranges.range" and world.run.ranges is not None:
        beacon = world.run.ranges.beacon[world.keep(name)]
        far = world.readings[name]
        table.append(("range", "range²", far**2))
        for k, label in enumerate(world.run.ranges.names):
            table += [
                (f"ranges.{label}", f"{label} long", (beacon == k).astype(float)),
                (f"ranges.{label}", f"{label} in scale", (beacon == k) * far),
            ]
    return {Shape(name, regressor, text): value for regressor, text, value in table}


Sizes = dict[str, list[float]]
"""Sum of squares and number of a shape's own values, by its key: in the units of `TRIFLE`."""
TRIFLE = {
    "wheels.left": 6e-4, "wheels.right": 6e-4, "imu.gz": 4e-4, "imu.ax": 5e-3, "imu.ay": 5e-3, "body.w": 8e-4,
    "body.v": 6e-4, "body.vy": 6e-4, "beacon.x": 4e-3, "beacon.y": 4e-3, "beacon.theta": 1.5e-3, "ranges.range": 4e-3,
}  # fmt: skip
"""Root mean square below which a shape is immaterial, as the effects on its channel are below their tolerances: rim
speed [m/s], rad/s, m/s², rad/s, m/s, m/s, m, m, rad, m."""
WOBBLE = 0.3
"""The same of what a wheel's angle is off, for each metre per second of `TRIFLE` [s]."""


def _add(sizes: Sizes, shape: Shape, values: Array, unit: float = 1.0) -> None:
    one = sizes.setdefault(shape.key, [0.0, 0.0])
    one[0] += float(np.einsum("i,i->", values, values)) * unit * unit
    one[1] += len(values)


def generic_columns(
    problem: Problem, model: EffectSet, scope: str
) -> tuple[list[Shape], list[dict[str, White]], dict[str, float]]:
    """All shapes, per run and channel their white columns about a model, and each one's root mean square."""
    sizes: Sizes = {}
    shapes: dict[str, int] = {}
    listed: list[Shape] = []
    whites = []
    for world in problem.worlds:
        rows: dict[str, list[tuple[Shape, Array]]] = {}
        if scope == "wheels":
            predicted = world.wheels([problem.overlay(model, "wheels")])
            for name in WHEELS:
                base = predicted[name][0, world.keep(name)]
                found = wheel_shapes(world, name, base)
                white = white_wheels(world, name, np.array(list(found.values())), problem.floor)
                radius = world.run.meta.robot.wheel_radius or 0.0
                step = np.maximum(np.gradient(world.times[name]), 1e-6)
                for shape, value in found.items():
                    if shape.regressor == name:
                        _add(sizes, shape, value, radius / WOBBLE)
                    else:
                        _add(sizes, shape, np.gradient(value) / step, radius)
                rows[name] = list(zip(found, white, strict=True))
        else:
            rows = _body_rows(problem, world, model, sizes)
        for pairs in rows.values():
            for shape, _ in pairs:
                if shape.key not in shapes:
                    shapes[shape.key] = len(listed)
                    listed.append(shape)
        whites.append(
            {
                name: White(
                    world.times[name],
                    np.zeros(len(world.times[name])),
                    np.array([row for _, row in pairs]),
                    np.array([shapes[shape.key] for shape, _ in pairs], dtype=np.int64),
                )
                for name, pairs in rows.items()
                if pairs
            }
        )
    return listed, whites, {key: float(np.sqrt(total / max(n, 1.0))) for key, (total, n) in sizes.items()}


def _body_rows(problem: Problem, world: World, model: EffectSet, sizes: Sizes) -> dict[str, list[tuple[Shape, Array]]]:
    body = world.body([problem.overlay(model, "body")])
    rows: dict[str, list[tuple[Shape, Array]]] = {name: [] for name in world.channels if name not in WHEELS}
    r = regressors(world, body) if len(world.body_inputs.imu) > 3 else {}
    sigma = {name: imu_sigma(world, name, body, problem.floor) for name in IMU if name in rows}
    for name in sigma:
        keep = world.keep(name)
        for shape, value in imu_shapes(name, r).items():
            rows[name].append((shape, value[keep]))
            _add(sizes, shape, value)
    residuals = residuals_of(
        world, {name: np.zeros((1, len(world.run.wheels))) for name in WHEELS} if world.run.wheels else {}, body
    )
    events = events_of(world, body, problem.floor, residuals)
    motions = motion_shapes(r) if r else {}
    if world.wheel_inputs is None:  # smoothed encoders lag as they like
        motions = {shape: motion for shape, motion in motions.items() if shape.text != LAGS}
    if r and "imu.gz" in rows:
        for shape, value in found_shapes(world, residuals["imu.gz"], r).items():
            rows["imu.gz"].append((shape, value[world.keep("imu.gz")]))
            _add(sizes, shape, value)
    shifted = world.body([problem.overlay(later(model, YIELDS), "body")]) if motions and sigma else body
    for shape, motion in motions.items():
        lags = shape.text == LAGS  # material as the nuisance of its kind is: beyond 5 ms
        _add(sizes, shape, np.full(1, 4.0 * TRIFLE["body.v"]) if lags else motion[0] + motion[1] + motion[2])
    if motions:
        for name in sigma:
            keep = world.keep(name)
            for shape, motion in motions.items():
                value = felt(world, name, motion, r)[keep]
                if shape.text == LAGS:  # edges and all
                    value = world.channel(shifted, name)[0] - world.channel(body, name)[0]
                rows[name].append((shape, value))
    for name in sigma:
        white = white_imu(world, name, np.array([row for _, row in rows[name]]), sigma[name], problem.floor)
        rows[name] = [(shape, row) for (shape, _), row in zip(rows[name], white, strict=True)]
    if events is not None:
        _pose_rows(problem, world, body, events, motions, (rows, sizes))
    return rows


def _pose_rows(
    problem: Problem,
    world: World,
    body: Outputs,
    events: Events,
    motions: Mapping[Shape, tuple[Array, Array, Array]],
    into: tuple[dict[str, list[tuple[Shape, Array]]], Sizes],
) -> None:
    """Adds what pose readings see of shapes of their own and of the body's motion. into: rows and sizes."""
    rows, sizes = into
    stacked: list[Shape] = []
    values: dict[str, list[Array]] = {name: [] for name in events.names}
    jumps = []
    zero = np.zeros_like(jumps_of(world, body))
    for name in events.names:
        if name.startswith("truth"):
            continue
        at = world.at[name]
        pose = np.column_stack((body.x[0, at], body.y[0, at], wrap(body.theta[0, at])))
        for shape, column in fix_shapes(world, name, pose, world.times[name]).items():
            stacked.append(shape)
            _add(sizes, shape, column)
            jumps.append(zero)
            for other in events.names:
                values[other].append(column if other == name else np.zeros(len(world.times[other])))
    if motions and len(world.stamps) > 3:
        for shape, motion in motions.items():
            moved, jump = displaced(world, body, motion)
            stacked.append(shape)
            jumps.append(-jump)
            for name in events.names:
                values[name].append(seen(world, body, name, moved))
    if not stacked:
        return
    floor = problem.floor
    posed, _ = white_poses(events, {n: np.array(v) for n, v in values.items()}, np.array(jumps), floor.walk, floor.side)
    for name in events.names:
        rows[name] += list(zip(stacked, posed[name], strict=True))


def felt(world: World, name: str, motion: tuple[Array, Array, Array], r: Mapping[str, Array]) -> Array:
    """What one IMU axis reads of a small further motion."""
    forward, sideways, turn = motion
    if name == "imu.gz":
        return turn
    rate = np.maximum(np.gradient(world.body_inputs.imu), 1e-6)
    fx = np.gradient(forward) / rate - r["w"] * sideways
    fy = r["v"] * turn + r["w"] * forward + np.gradient(sideways) / rate
    c, s = np.cos(world.run.meta.robot.imu.yaw), np.sin(world.run.meta.robot.imu.yaw)
    return c * fx + s * fy if name == "imu.ax" else c * fy - s * fx


def displaced(world: World, body: Outputs, motion: tuple[Array, Array, Array]) -> tuple[Array, Array]:
    """(E, 3) by how much the path is displaced at each stamp since its window's start, and (K, 3) at windows' ends."""
    t = world.body_inputs.imu
    at = world.stamps
    forward, sideways, turn = (np.interp(at, t, part) for part in motion)
    x, y, theta = body.x[0], body.y[0], body.theta[0]
    step = np.diff(at, prepend=at[:1])
    c, s = np.cos(theta), np.sin(theta)
    swung = np.cumsum(turn * step)
    ax, ay = np.cumsum((c * forward - s * sideways) * step), np.cumsum((s * forward + c * sideways) * step)
    bx, by = np.cumsum(turn * step * x), np.cumsum(turn * step * y)
    window = np.searchsorted(world.restarts[:, 0], at, "right") - 1
    first = np.searchsorted(at, world.restarts[:, 0] - 1e-9)
    origin = np.where(window >= 0, first[np.clip(window, 0, None)] if len(first) else 0, 0)
    origin = np.clip(origin, 0, len(at) - 1)

    def since(total: Array) -> Array:
        return total - total[origin]

    angle = since(swung)
    dx = since(ax) - (y * angle - since(by))
    dy = since(ay) + (x * angle - since(bx))
    moved = np.column_stack((dx, dy, angle))
    return moved, moved[world.ends]


def seen(world: World, body: Outputs, name: str, moved: Array) -> Array:
    """What one channel reads of a displaced path."""
    at = world.at[name]
    far = moved[at]
    if name.endswith(".x"):
        return far[:, 0]
    if name.endswith(".y"):
        return far[:, 1]
    if name.endswith("theta"):
        return far[:, 2]
    place = world.body_inputs.anchors[world.body_inputs.anchor[world.keep(name)]]
    dx, dy = body.x[0, at] - place[:, 0], body.y[0, at] - place[:, 1]
    distance = np.maximum(np.hypot(dx, dy), 1e-6)
    return (dx * far[:, 0] + dy * far[:, 1]) / distance
