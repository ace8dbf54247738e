"""Worlds for the MuJoCo robot: glass, a 1 cm obstacle, a wall, a kidnapping, plain missions. Each is drawn by its seed.

`world(name, seed)` makes a world once per process. The robot is driven by a navigator that knows where it is, so that
what a run is like does not depend on any estimator. The experiments are those of Lee, Shin and Cho; sizes are theirs
where they give them (1 m, 90 degrees, 1 cm).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from core.robot import Pose
from tests.plants.mujoco_robot import BEACONS, CONTROL, RADIUS, Flaws, Floats, Lie, Machine, Mark, Sensors, World, sense

Point = tuple[float, float]
SPIN = 0.12  # m/s of slip that counts as spinning


def _turn_towards(m: Machine, heading: float, limit: float = 1.2) -> float:
    error = math.remainder(heading - m.pose[2], math.tau)
    return max(-limit, min(limit, 3.0 * error))


def rest(m: Machine, seconds: float) -> None:
    """Stand still."""
    end = m.time + seconds
    while m.time < end - 1e-9 and not m.over:
        m.go(0.0, 0.0)


def face(m: Machine, heading: float, patience: float = 8.0) -> None:
    """Turn on the spot."""
    end = m.time + patience
    while abs(math.remainder(heading - m.pose[2], math.tau)) > 0.02 and m.time < end and not m.over:
        m.go(0.0, _turn_towards(m, heading))
    rest(m, 0.4)


def line(
    m: Machine, to: Point, v: float = 0.4, patience: float = 20.0, until: Callable[[], bool] | None = None
) -> None:
    """Drive straight to a point, steering back onto the line to it."""
    x0, y0, _ = m.pose
    course, length = math.atan2(to[1] - y0, to[0] - x0), math.hypot(to[0] - x0, to[1] - y0)
    end = m.time + patience
    while m.time < end and not m.over and not (until is not None and until()):
        x, y, _ = m.pose
        along = (x - x0) * math.cos(course) + (y - y0) * math.sin(course)
        across = -(x - x0) * math.sin(course) + (y - y0) * math.cos(course)
        left = length - along
        if left < 0.005:
            break
        heading = course - max(-0.6, min(0.6, 1.5 * across))
        m.go(min(v, math.sqrt(1.0 * left)), _turn_towards(m, heading, 1.6))
    rest(m, 0.6)


def visit(m: Machine, points: Iterable[Point], v: float = 0.4, stop: float = 0.0) -> None:
    """Turn towards each point and drive there."""
    for x, y in points:
        face(m, math.atan2(y - m.pose[1], x - m.pose[0]))
        line(m, (x, y), v)
        rest(m, stop)


def _made(
    m: Machine, name: str, seed: int, rng: np.random.Generator, flaws: Flaws, sensors: Sensors, lie: Lie | None = None
) -> World:
    h = m.history()
    in_hand = np.zeros(len(h.t), bool)
    for mark in h.marks:
        in_hand |= (mark.kind == "carried") & (h.t >= mark.t0) & (h.t <= mark.t1 + 0.3)
    marks = [*h.marks, *_stretches(h.t, (h.spin > SPIN) & ~in_hand)]
    run = sense(h, f"{name} {seed}", rng, flaws, sensors, lie)
    return World(run, tuple(sorted(marks, key=lambda mark: mark.t0)), flaws)


def _stretches(t: Floats, flags: np.ndarray, kind: str = "spin") -> list[Mark]:
    """Where flags hold; pauses under 0.2 s do not end a stretch, stretches under 0.1 s are left out."""
    at = np.flatnonzero(flags)
    if not at.size:
        return []
    breaks = np.flatnonzero(np.diff(t[at]) > 0.2)
    first, last = np.concatenate(([0], breaks + 1)), np.concatenate((breaks, [at.size - 1]))
    pairs = ((float(t[at[a]]), float(t[at[b]])) for a, b in zip(first, last, strict=True))
    return [Mark(kind, t0, t1) for t0, t1 in pairs if t1 - t0 >= 0.1]


def mission(seed: int, sensors: Sensors, seconds: float = 90.0) -> World:
    """(e) Points of a room by chance, with rests of 0 to 4 s between them."""
    rng = np.random.default_rng((5, seed))
    flaws = Flaws.of(rng)
    m = Machine(flaws, seconds, start=Pose(0.5, 0.5, float(rng.uniform(-3, 3))))
    rest(m, float(rng.uniform(2, 5)))
    while m.time < seconds - 6.0:
        to = (float(rng.uniform(-1.0, 5.0)), float(rng.uniform(-2.0, 3.0)))
        visit(m, [to], float(rng.uniform(0.25, 0.6)), float(rng.uniform(0, 4)))
    while not m.over:
        m.go(0.0, 0.0)
    return _made(m, "mission", seed, rng, flaws, sensors)


GLASS_WAYS = ("lost", "offset", "mirror", "jumps", "mixed")


def glass(seed: int, sensors: Sensors) -> World:
    """(a) Straight 1 m under a glass plate, 90 degrees left, from side to side, to the middle, 1 m out again."""
    rng = np.random.default_rng((1, seed))
    flaws = Flaws.of(rng)
    way = GLASS_WAYS[seed % len(GLASS_WAYS)]
    plate = (1.0, 3.0, -1.0, 1.0)  # x0, x1, y0, y1 [m]
    offset = rng.uniform(0.4, 1.2) * np.array((math.cos(a := rng.uniform(-3, 3)), math.sin(a)))
    m = Machine(flaws, 50.0)
    rest(m, 2.0)
    visit(m, [(1.0, 0.0), (2.0, 0.0), (2.0, 0.7), (2.0, -0.7), (2.0, 0.0), (3.0, 0.0), (4.0, 0.0)], 0.35)
    rest(m, 4.0)
    lie = _under(plate, way, offset)
    h = m.history()
    under = _inside(h.pose, plate)
    marks = _stretches(h.t, under, "lost" if way == "lost" else "lying")
    world = _made(m, f"glass {way}", seed, rng, flaws, sensors, lie)
    return replace(world, marks=tuple(sorted((*world.marks, *marks), key=lambda mark: mark.t0)))


def _inside(pose: Floats, plate: tuple[float, float, float, float]) -> np.ndarray:
    x0, x1, y0, y1 = plate
    return (pose[:, 0] > x0) & (pose[:, 0] < x1) & (pose[:, 1] > y0) & (pose[:, 1] < y1)


def _under(plate: tuple[float, float, float, float], way: str, offset: Floats) -> Lie:
    def lie(t: Floats, tag: Floats, rng: np.random.Generator) -> tuple[Floats, np.ndarray]:
        under = _inside(tag, plate)
        seen, lost = tag.copy(), np.zeros(len(t), bool)
        slot = np.floor(t / 1.5).astype(int) % 3  # mixed: each 1.5 s another fault
        on = {
            "lost": under if way == "lost" else under & (way == "mixed") & (slot == 0),
            "offset": under if way == "offset" else under & (way == "mixed") & (slot == 1),
            "mirror": under if way == "mirror" else under & (way == "mixed") & (slot == 2),
            "jumps": under & (way == "jumps"),
        }
        lost |= on["lost"]
        seen[on["offset"], :2] += offset
        seen[on["mirror"], 1] = 2.0 - seen[on["mirror"], 1]  # off a pane at y = 1
        seen[on["mirror"], 2] *= -1.0
        wild = rng.standard_normal((len(t), 2)) * 0.6
        seen[on["jumps"], :2] += wild[on["jumps"]]
        lost |= on["jumps"] & (rng.random(len(t)) < 0.4)
        return seen, lost

    return lie


def obstacle(seed: int, sensors: Sensors) -> World:
    """(b) 1 m, a bar 1 cm high that one tyre cannot climb and spins at, 1 m more, rest."""
    rng = np.random.default_rng((2, seed))
    flaws = Flaws.of(rng)
    side = (1.0, -1.0)[seed % 2]
    slip_for = float(rng.uniform(1.3, 1.9))
    depth = float(rng.uniform(0.015, 0.03))
    bar = (
        f'<geom name="grip" type="box" size="{depth} 0.4 0.005" pos="1.08 {-0.4 * side} 0.005"/>'
        f'<geom name="slick" type="box" size="{depth} 0.4 0.005" pos="1.08 {0.4 * side} 0.005" priority="1"'
        f' friction="0.02"/>'
    )
    m = Machine(flaws, 40.0, bar, Pose(0.0, 0.0, float(rng.uniform(-0.03, 0.03))))
    rest(m, 2.0)
    stuck: list[float] = []
    slick = m.model.geom("slick").id

    def watch() -> bool:
        """The tyre finds grip some time after it began to spin."""
        if not stuck and m.pose[0] > 1.08 - 0.03 - depth - RADIUS:
            stuck.append(m.time)
        if stuck and m.time - stuck[0] > slip_for:
            m.model.geom_friction[slick] = (0.9, 0.005, 0.0001)
        return False

    line(m, (2.1, 0.0), float(rng.uniform(0.25, 0.35)), 25.0, watch)
    rest(m, 4.0)
    return _made(m, "obstacle", seed, rng, flaws, sensors)


def wall(seed: int, sensors: Sensors) -> World:
    """(c) Against a wall, tyres spinning for 2 to 5 s, then back and away."""
    rng = np.random.default_rng((3, seed))
    flaws = Flaws.of(rng)
    lean = float(rng.uniform(-0.25, 0.25))
    box = f'<geom name="wall" type="box" size="0.05 1.5 0.2" pos="1.6 0 0.2" euler="0 0 {lean}" friction="0.3"/>'
    m = Machine(flaws, 60.0, box)
    rest(m, 3.0)
    visit(m, [(0.3, 0.4), (0.3, 0.0)], 0.4)
    face(m, 0.0)
    push = float(rng.uniform(2.0, 5.0))
    met: list[float] = []

    def held() -> bool:
        if not met and m.pose[0] > 1.2 and abs(m.record[m.done - 1, 12]) < 0.08:
            met.append(m.time)
        return bool(met) and m.time - met[0] > push

    line(m, (2.5, 0.0), float(rng.uniform(0.3, 0.5)), 20.0, held)
    if met:
        m.mark("contact", met[0])
    back = m.time + 2.5
    while m.time < back:
        m.go(-0.25, 0.0)
    rest(m, 1.0)
    visit(m, [(0.0, 1.0), (-0.8, 0.0)], 0.4)
    rest(m, 4.0)
    return _made(m, "wall", seed, rng, flaws, sensors)


def carried(seed: int, sensors: Sensors) -> World:
    """(d) Lifted while it stands, carried elsewhere and turned in 3 s, set down; then it drives on."""
    rng = np.random.default_rng((4, seed))
    flaws = Flaws.of(rng)
    m = Machine(flaws, 70.0)
    rest(m, 3.0)
    visit(m, [(1.5, 0.0), (1.5, 1.0)], 0.4)
    rest(m, 1.0)
    t0 = m.time
    away = (float(rng.uniform(1.0, 2.0)) * rng.choice((-1, 1)), float(rng.uniform(-2.0, -0.8)))
    _carry(m, away, float(rng.uniform(0.5, 2.5)) * rng.choice((-1, 1)), 3.0)
    m.mark("carried", t0)
    rest(m, 1.5)
    visit(m, [(0.0, 0.0), (2.5, -0.5), (2.5, 1.0)], 0.4)
    rest(m, 4.0)
    return _made(m, "carried", seed, rng, flaws, sensors)


def _carry(m: Machine, by: Point, turn: float, seconds: float) -> None:
    """A hand grips the body, moves it along a smooth path 0.15 m above the floor, and lets go."""
    x, y, theta = m.pose
    grip, hand = m.model.equality("grip").id, 0
    steps = round(seconds / CONTROL)
    rise = 0.15 * np.sin(np.pi * np.arange(1, steps + 1) / steps)
    for i in range(steps):
        s = (i + 1) / steps
        eased = s * s * (3 - 2 * s)
        m.data.mocap_pos[hand] = (x + by[0] * eased, y + by[1] * eased, RADIUS + rise[i])
        angle = theta + turn * eased
        m.data.mocap_quat[hand] = (math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2))
        if i == 0:
            m.model.eq_data[grip, 3:10] = (0, 0, 0, 1, 0, 0, 0)
            m.data.eq_active[grip] = 1
        m.go(0.0, 0.0)
    m.data.eq_active[grip] = 0
    m.data.mocap_pos[hand] = (0.0, 0.0, -1.0)


WORLDS: dict[str, Callable[[int, Sensors], World]] = {
    "glass": glass,
    "obstacle": obstacle,
    "wall": wall,
    "carried": carried,
    "mission": mission,
}
VARIANTS = 5


@functools.cache
def world(name: str, seed: int = 0, sensors: Sensors = Sensors()) -> World:
    """The world of that name and seed, made once per process."""
    return WORLDS[name](seed, sensors)


__all__ = ["BEACONS", "VARIANTS", "WORLDS", "Flaws", "Mark", "Sensors", "World", "world"]
