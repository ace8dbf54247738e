"""The scene's geometry and cursor: plain functions with known answers."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scene_world import DURATION, scene_data

from app.scene import shapes
from app.scene.build import event_labels
from app.scene.cursor import Cursor, check_change
from app.scene.data import ScenePath, Spread, events_on
from core.errors import ParameterError


def test_a_short_path_is_drawn_whole_and_a_long_one_within_its_limit_with_its_extremes() -> None:
    assert len(shapes.rows_to_draw(np.arange(50.0), np.zeros(50))) == 50
    n = 300_000
    x, y = np.cumsum(np.ones(n)), np.sin(np.arange(n) / 5e3)
    y[123_456] = 9.0
    rows = shapes.rows_to_draw(x, y)
    assert len(rows) <= shapes.MAX_SEGMENTS
    assert (rows[0], rows[-1]) == (0, n - 1)
    assert 123_456 in rows
    assert (np.diff(rows) > 0).all()


def test_nothing_is_drawn_across_a_gap() -> None:
    x = np.array([0.0, 1.0, np.nan, 3.0, 4.0])
    segments = shapes.polyline(x, np.zeros(5), (), z=0.5, unit=1.0)
    assert segments[:, :, 0].tolist() == [[0, 1], [3, 4]]
    assert (segments[:, :, 2] == 0.5).all()


def test_dashes_cover_their_share_of_the_path_and_lie_on_it() -> None:
    x = np.linspace(0.0, 100.0, 1001)
    segments = shapes.polyline(x, 0.5 * x, (3.0, 1.0), z=0.0, unit=1.0)
    length = np.hypot(*(segments[:, 1, :2] - segments[:, 0, :2]).T)
    assert length.sum() == pytest.approx(0.75 * 100 * np.hypot(1, 0.5), rel=0.01)
    assert np.abs(segments[..., 1] - 0.5 * segments[..., 0]).max() < 1e-5


def test_a_very_long_path_gets_longer_dashes_not_more_of_them() -> None:
    angle = np.linspace(0, 2000 * np.pi, 20_000)  # a thousand laps
    segments = shapes.polyline(np.cos(angle), np.sin(angle), (1.0, 1.0), z=0.0, unit=1e-3)
    assert len(segments) <= len(angle) + 2 * shapes.MAX_DASHES


@given(a=st.floats(0.01, 5), b=st.floats(0.01, 5), turn=st.floats(-1.5, 1.5), sigmas=st.floats(0.5, 3))
def test_an_ellipse_has_the_axes_and_the_direction_of_its_covariance(
    a: float, b: float, turn: float, sigmas: float
) -> None:
    major, minor = max(a, b), min(a, b)
    c, s = np.cos(turn), np.sin(turn)
    rotation = np.array([[c, -s], [s, c]])
    covariance = rotation @ np.diag((major**2, minor**2)) @ rotation.T
    axes, angle = shapes.ellipses(covariance[None], sigmas)
    assert axes[0] == pytest.approx([sigmas * major, sigmas * minor], rel=1e-6)
    rim = shapes.outlines(np.zeros((1, 2)), axes, angle, 0.0)[:, 0, :2].astype(float)
    mahalanobis = np.einsum("ni,ij,nj->n", rim, np.linalg.inv(covariance), rim)
    assert mahalanobis == pytest.approx(np.full(len(rim), sigmas**2), rel=1e-3)


@pytest.mark.parametrize(("size", "pitch"), [(1.0, 0.1), (12.0, 1.0), (13.0, 2.0), (50.0, 5.0), (700.0, 100.0)])
def test_the_grid_has_a_round_pitch(size: float, pitch: float) -> None:
    assert shapes.grid_pitch(size) == pytest.approx(pitch)


def test_the_extent_ignores_what_is_not_a_number_and_is_never_empty() -> None:
    extent = shapes.extent_of([np.array([[1.0, 2.0], [np.nan, 9.0], [3.0, -2.0]])])
    assert (extent.x0, extent.y0, extent.x1, extent.y1) == (1.0, -2.0, 3.0, 2.0)
    assert shapes.extent_of([np.zeros((0, 2))]).size > 0


def test_a_pose_is_taken_between_rows_the_short_way_round_and_held_past_the_ends() -> None:
    t = np.array([0.0, 1.0, 3.0])
    path = ScenePath("m", "m", t, np.array([0.0, 2.0, 2.0]), np.zeros(3), np.array([3.0, -3.0, -3.0]))
    x, y, theta = path.pose_at(0.5)
    assert (x, y) == (1.0, 0.0)
    assert np.cos(theta) == pytest.approx(-1.0)  # 3 rad and -3 rad are 0.28 rad apart, across the back
    assert path.pose_at(-5.0)[0] == 0.0
    assert path.pose_at(99.0)[0] == 2.0


def test_a_spread_without_covariance_lies_along_the_axes() -> None:
    spread = Spread(np.array([0.1, 0.2]), np.array([0.3, 0.4]))
    assert spread.covariance(1)[0] == pytest.approx(np.diag((0.04, 0.16)))


def test_a_playing_cursor_runs_on_at_its_speed_and_stops_at_the_end() -> None:
    cursor = Cursor(t=10.0, stamp=100.0, playing=True, speed=2.0)
    assert cursor.now(103.0, 0.0, 60.0) == 16.0
    assert cursor.now(1e6, 0.0, 60.0) == 60.0
    faster = cursor.moved({"speed": 4.0}, 103.0, 0.0, 60.0)
    assert (faster.t, faster.now(104.0, 0.0, 60.0)) == (16.0, 20.0)
    assert cursor.moved({"t": -3.0, "playing": False}, 103.0, 0.0, 60.0).now(500.0, 0.0, 60.0) == 0.0


@pytest.mark.parametrize(
    "message",
    [
        [],
        "t",
        {"t": "soon"},
        {"t": float("nan")},
        {"t": True},
        {"speed": 0},
        {"speed": 1e9},
        {"playing": 1},
        {"methods": "fused"},
        {"methods": [1]},
        {"methods": ["m"] * 65},
        {"theme": "pink"},
        {"position": [0, 0]},
    ],
)
def test_a_wrong_cursor_message_is_refused(message: object) -> None:
    with pytest.raises(ParameterError):
        check_change(message)


def test_a_right_cursor_message_comes_through() -> None:
    message = {"t": 3, "playing": True, "speed": 2.5, "follow": False, "methods": ["a", "a", "b"], "theme": "dark"}
    assert check_change(message) == {**message, "t": 3.0, "methods": ("a", "b")}
    assert check_change({"methods": None}) == {"methods": None}


def test_a_scene_straight_from_core_objects_has_truth_methods_and_fixes() -> None:
    from app.scene.data import from_core
    from core.run import Run, RunMeta
    from core.sensors import BeaconLog, TruthLog
    from core.trajectory import Trajectory

    given = scene_data().paths[0]
    truth = TruthLog(given.t, given.x, given.y)
    beacon = BeaconLog(given.t[:5], given.x[:5], given.y[:5])
    run = Run(RunMeta(name="hall", beacons={"B": (1.0, 2.0, 3.0)}), truth=truth, beacon=beacon)
    trajectory = Trajectory(given.t, given.x, given.y, given.theta, np.tile(np.diag((0.04, 0.09, 0.01)), (600, 1, 1)))
    data = from_core(run, {"encoders": trajectory}, {"encoders": "Encoders"}, "r1")
    assert data.methods == ("truth", "encoders", "fixes")
    assert (data.name, data.t1, data.fixes.shape) == ("hall", DURATION, (5, 2))
    assert data.paths[1].spread is not None
    assert data.paths[1].spread.covariance(0)[0] == pytest.approx(np.diag((0.04, 0.09)))
    assert np.isnan(data.paths[0].pose_at(1.0)[2])


@pytest.mark.parametrize(
    "extent",
    [
        shapes.Extent(-5, -3, 5, 3, 2.5),
        shapes.Extent(100, 100, 101, 140),
        shapes.Extent(0, 0, 300, 2, 4),
        shapes.Extent(0, 0, 0, 0),
    ],
)
def test_the_first_view_shows_everything_and_not_from_far_away(extent: shapes.Extent) -> None:
    position, target = (np.array(p) for p in shapes.camera(extent))
    back = (position - target) / np.linalg.norm(position - target)
    up = np.array((0.0, back[2], -back[1]))
    xs, ys = (extent.x0, extent.x1), (extent.y0, extent.y1)
    corners = np.array([(x, y, z) for x in xs for y in ys for z in (0.0, extent.height)]) - position
    depth, half = corners @ -back, np.tan(shapes.CAMERA_FOV / 2)
    assert (depth > 0).all()
    vertical, sideways = corners @ up / depth / half, corners[:, 0] / depth / half / shapes.CAMERA_ASPECT
    assert max(np.abs(vertical).max(), np.abs(sideways).max()) < 1.0
    assert np.linalg.norm(position - target) < 3.2 * max(extent.size, extent.height)


def test_ellipses_along_a_path_stand_clear_of_each_other() -> None:
    centres = np.column_stack((np.linspace(0, 10, 101), np.zeros(101)))
    radius = np.linspace(0.0, 3.0, 101)
    chosen = shapes.apart(centres, radius, gap=0.5, widest=2.0)
    assert chosen
    assert radius[chosen].max() <= 2.0
    assert radius[chosen].min() > 0.0
    gaps = np.diff(centres[chosen, 0])
    assert (gaps >= np.maximum(0.5, 0.8 * (radius[chosen][1:] + radius[chosen][:-1])) - 1e-9).all()


def test_events_stand_on_their_path_and_share_labels_where_they_crowd() -> None:
    t = np.arange(11.0)
    path = ScenePath("fused", "Fused", t, t, 0 * t, 0 * t)
    found = [
        {"kind": k, "t0": at} for k, at in (("slip", 2.5), ("collision", 2.6), ("slip", 2.7), ("beacon_loss", 9.0))
    ]
    events = events_on(path, found)
    assert [(e.kind, e.x) for e in events] == [("slip", 2.5), ("collision", 2.6), ("slip", 2.7), ("beacon_loss", 9.0)]
    assert event_labels(events, 1.0, 1.0) == ["slip × 2, 1 more", "", "", "beacon loss"]
    assert event_labels(events, 0.01, 0.01) == ["slip", "collision", "slip", "beacon loss"]
