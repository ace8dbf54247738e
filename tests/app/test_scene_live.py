"""The 3D scene of a run that goes on: it grows with what its feed tells, in memory that does not."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import pytest
from scene_world import eventually

from app.scene.live import MOST, Growing, LiveScene, coloured, range_lines
from app.scene.shapes import linear
from app.scene.style import GAP, SPEED
from core.robot import RobotParams
from core.run import RunMeta

COLUMNS = ("t", "x", "y", "theta", "sd_x", "sd_y", "sd_theta", "cov_xy")


class Feed:
    """A robot that is told step by step where it is."""

    run_id, name = "live-1", "hall"
    meta = RunMeta(beacons={"B1": (3.0, 4.0, 0.0)}, robot=RobotParams(0.075, 0.32))

    def __init__(self) -> None:
        self.hear: Callable[[Mapping[str, Any]], None] | None = None

    def subscribe(self, hear: Callable[[Mapping[str, Any]], None]) -> Callable[[], None]:
        self.hear = hear
        method = {"method": "fused", "label": "Fused", "reason": None}
        hear({"type": "snapshot", "run_id": "live-1", "t": 0.0, "paths": {"fused": path([0.0], [0.0])}, "ranges": {},
              "methods": [method]})  # fmt: skip
        return self.leave

    def leave(self) -> None:
        self.hear = None

    def tell(self, t: float, x: float, **more: Any) -> None:
        assert self.hear is not None
        self.hear({"type": "update", "t": t, "trail": {"fused": path([t], [x])}, "poses": {}, "ranges": {}, **more})


def path(t: list[float], x: list[float]) -> dict[str, list[Any]]:
    return dict(
        zip(COLUMNS, (t, x, [0.0] * len(t), [0.1] * len(t), *([[0.02] * len(t)] * 3), [None] * len(t)), strict=True)
    )


@pytest.fixture
def feed() -> Feed:
    return Feed()


@pytest.fixture
def scene(feed: Feed) -> Iterator[LiveScene]:
    made = LiveScene(feed, "live")
    yield made
    made.stop()


def test_a_viewer_sees_the_newest_moment_and_cannot_leave_it(scene: LiveScene, feed: Feed) -> None:
    scene.listen("v1", lambda state: None)
    feed.tell(1.0, 0.5)
    feed.tell(2.0, 1.0)
    assert eventually(lambda: scene.states()[0]["poses"]["fused"][0] == 1.0)
    scene.change("v1", {"t": 0.0, "playing": True})
    state = scene.states()[0]
    assert (state["t"], state["playing"], state["live"]) == (2.0, False, True)


def test_the_floor_grows_when_the_robot_leaves_it(scene: LiveScene, feed: Feed) -> None:
    before = scene.call(lambda: scene.sizes.extent)
    feed.tell(1.0, before.x1 - 0.1)
    feed.tell(2.0, before.x1 + 40.0)
    assert eventually(lambda: scene.data.t1 == 2.0)
    after = scene.call(lambda: scene.sizes.extent)
    assert after.x1 > before.x1 + 40.0 and after.size > 2 * before.size


def test_what_of_another_run_comes_is_not_drawn(scene: LiveScene, feed: Feed) -> None:
    assert feed.hear is not None
    feed.hear({"type": "snapshot", "run_id": "live-2", "t": 9.0, "paths": {}, "ranges": {}, "methods": []})
    feed.tell(1.0, 0.5)
    assert eventually(lambda: scene.data.t1 == 1.0)
    scene.stop()
    assert feed.hear is None


def test_a_path_stays_within_its_memory_and_keeps_ends_and_newest() -> None:
    growing = Growing("fused", "Fused")
    for k in range(3 * MOST // 500):
        t = [0.01 * (500 * k + i) for i in range(500)]
        growing.extend(path(t, t))
    kept = growing.path()
    assert len(kept.t) <= MOST and growing.thinned > 0
    assert kept.t[0] == 0.0 and kept.t[-1] == pytest.approx(t[-1])
    assert (np.diff(kept.t) > 0).all() and np.diff(kept.t)[-1000:].max() < 0.011
    growing.extend(path([1.0], [9.0]))  # late
    assert growing.path().x[-1] == pytest.approx(t[-1])


def test_the_trail_is_coloured_by_speed_and_by_gap_for_who_asks(scene: LiveScene, feed: Feed) -> None:
    scene.listen("v1", lambda state: None)
    scene.change("v1", {"trail": "speed"})
    for k in range(1, 41):  # 1 m/s, then twice as fast, while a link leaves its floor
        links = [{"excess": 1.0 if k < 20 else 9.0}, {"excess": None}]
        feed.tell(0.1 * k, 0.1 * min(k, 20) + 0.2 * max(k - 20, 0), links=links)
    assert eventually(lambda: scene.data.t1 == pytest.approx(4.0))
    assert eventually(lambda: any(name.startswith("/world/trail/speed") for name in scene._lines))
    assert not any(name.startswith("/world/trail/gap") for name in scene._lines)
    x, y, speed = scene.call(lambda: scene._paths["fused"].trail("speed"))
    assert speed[10] == pytest.approx(1.0) and speed[-1] == pytest.approx(2.0)
    pieces, colours = coloured(x, y, speed, "speed", 0.1)
    assert pieces.shape == colours.shape == (40, 2, 3)
    assert (colours[-1, 0] == linear(SPEED)[-1]).all() and (colours[10] == linear(SPEED)[3]).all()
    x, y, gap = scene.call(lambda: scene._paths["fused"].trail("gap"))
    pieces, colours = coloured(x, y, gap, "gap", 0.1)
    assert len(pieces) == 39 and (colours[0] == linear(GAP)[0]).all() and (colours[-1] == linear(GAP)[-1]).all()


def test_a_range_is_drawn_from_its_beacon_as_long_as_measured(scene: LiveScene, feed: Feed) -> None:
    feed.tell(5.0, 0.0)
    assert eventually(lambda: scene.data.t1 == 5.0)
    (line,) = range_lines(scene.data, {"B1": (4.9, 4.0), "gone": (4.9, 1.0)})
    assert line[0].tolist() == [3.0, 4.0, 0.0]
    assert math.dist(line[0], line[1]) == pytest.approx(4.0) and line[1].tolist() == pytest.approx([0.6, 0.8, 0.0])
    assert len(range_lines(scene.data, {"B1": (3.0, 4.0)})) == 0  # too old
