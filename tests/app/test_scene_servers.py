"""The 3D view over the wire: a real server, viser behind it, browsers that speak viser's protocol."""

from __future__ import annotations

import gc
import logging
import re
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import pytest
import websockets
from scene_world import DURATION, Browser, Hand, Site, Store, eventually, serve
from websockets.sync.client import connect

from app import security
from app.scene.pool import BusyError, Scenes
from app.settings import Settings


@pytest.fixture
def local(tmp_path: Path) -> Settings:
    return Settings(data=tmp_path)


@pytest.fixture
def site(local: Settings) -> Iterator[Site]:
    with serve(local, Store("run-a", "run-b")) as site:
        yield site


def viewers(site: Site, run: str) -> dict[str, dict]:
    answer = httpx.get(f"{site.http}/api/v1/scenes/{run}").raise_for_status().json()
    return {v["viewer"]: v for v in answer["viewers"]}


# --- the page


def test_the_page_is_visers_client_compressed_with_its_own_policy(site: Site) -> None:
    answer = httpx.get(f"{site.http}/scene/run-a/v1/")
    assert answer.status_code == 200
    assert answer.headers["content-encoding"] == "gzip"
    assert "<canvas" in answer.text or "<div" in answer.text
    policy = answer.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "frame-ancestors 'self'" in policy
    assert not re.search(r"https?:|\*|'unsafe-eval'", policy)
    plain = httpx.get(f"{site.http}/scene/run-a/v1/", headers={"Accept-Encoding": "identity"})
    assert plain.text == answer.text


def test_a_scene_by_itself_gets_a_viewer_of_its_own_with_a_panel(site: Site) -> None:
    places = [httpx.get(f"{site.http}/scene/run-a{end}?theme=dark").headers["location"] for end in ("", "/")]
    assert all(re.fullmatch(r"/scene/run-a/[0-9a-f]{16}/\?theme=dark&panel", place) for place in places)
    assert places[0] != places[1]
    with_panel = httpx.get(site.http + places[0]).text
    without = httpx.get(f"{site.http}/scene/run-a/v1/").text
    assert len(without) > len(with_panel)


def test_an_unknown_run_is_a_404_page(site: Site) -> None:
    answer = httpx.get(f"{site.http}/scene/nowhere/v1/", headers={"Accept": "text/html"})
    assert answer.status_code == 404
    assert "text/html" in answer.headers["content-type"]
    assert "nowhere" in answer.text
    assert httpx.get(f"{site.http}/scene/../v1/").status_code == 404


# --- the connection


def test_a_browser_sees_paths_beacons_and_robots(site: Site) -> None:
    browser = Browser(site, "run-a", "v1").look()
    heard = browser.hear(lambda m: str(m.get("name", "")).startswith("/world/robots/beacon/")) + browser.quiet()
    names = {str(m.get("name")) for m in heard}
    assert {
        "/world/methods/truth/light/path",
        "/world/methods/encoders/dark/spread",
        "/world/beacons/B1/label",
        "/world/fixes/points",
        "/world/ground/light/grid",
        "/world/robots/truth/body",
        "/world/robots/encoders/left",
        "/world/now/encoders",
    } <= names
    assert browser.socket.subprotocol is not None
    browser.close()


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1"])
def test_a_foreign_origin_is_refused(site: Site, origin: str) -> None:
    with pytest.raises(websockets.InvalidStatus) as refused:
        Browser(site, "run-a", "v1", Origin=origin)
    assert refused.value.response.status_code == 403
    with pytest.raises(websockets.InvalidStatus):
        connect(f"{site.ws}/api/v1/scenes/run-a/cursor?viewer=v1", additional_headers={"Origin": origin}, proxy=None)
    assert len(site.scenes) == 0


def test_an_unknown_run_is_refused_at_the_socket(site: Site) -> None:
    with pytest.raises(websockets.InvalidStatus):
        Browser(site, "nowhere", "v1")
    hand = connect(f"{site.ws}/api/v1/scenes/nowhere/cursor?viewer=v1", proxy=None)
    assert '"problem"' in str(hand.recv(timeout=5))
    with pytest.raises(websockets.ConnectionClosed) as closed:
        hand.recv(timeout=5)
    assert closed.value.rcvd is not None
    assert closed.value.rcvd.code == 4404


def test_beyond_loopback_page_and_sockets_ask_for_the_token(tmp_path: Path) -> None:
    settings = Settings(data=tmp_path, host="0.0.0.0", token="open sesame")
    with serve(settings, Store("run-a")) as site:
        assert httpx.get(f"{site.http}/api/v1/scenes/run-a").status_code == 401
        assert httpx.get(f"{site.http}/scene/run-a/v1/").status_code == 401
        with pytest.raises(websockets.InvalidStatus):
            Browser(site, "run-a", "v1")
        cookie = f"{security.COOKIE}={security.cookie_value('open sesame')}"
        browser = Browser(site, "run-a", "v1", Cookie=cookie).look()
        browser.hear(lambda m: m.get("name") == "/world/robots/truth")
        browser.close()


def test_visers_own_port_talks_to_nobody_but_the_proxy(site: Site) -> None:
    scene = site.scenes.open("run-a")
    assert scene.address.startswith("ws://127.0.0.1:")
    with connect(scene.address, subprotocols=[websockets.Subprotocol("viser-v1.1.1")], proxy=None) as socket:
        with pytest.raises(websockets.ConnectionClosed) as closed:
            socket.recv(timeout=5)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code in (1002, 1008)


def test_only_cameras_and_the_panel_pass_from_a_browser(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    import viser

    asked: list[str] = []
    for cls in (viser.ViserServer, type(site.scenes.open("run-a")._server)):
        monkeypatch.setattr(cls, "request_share_url", lambda self, verbose=True: asked.append("share"))
    browser = Browser(site, "run-a", "v1")
    browser.send({"type": "ShareUrlRequest"})
    browser.socket.send(b"\xff\xff not msgpack")
    browser.socket.send("text")
    browser.socket.send(b"\x00" * 100_000)
    browser.look().hear(lambda m: m.get("name") == "/world/robots/truth")
    browser.quiet()
    assert not asked
    browser.close()


def test_leaving_in_any_phase_is_quiet(site: Site, caplog: pytest.LogCaptureFixture) -> None:
    import socket as sockets

    with caplog.at_level(logging.WARNING):
        host, port = site.host.split(":")
        raw = sockets.create_connection((host, int(port)))
        raw.sendall(b"GET /scene/run-a/v0 HTTP/1.1\r\nHost: %s\r\nUpgrade: websocket\r\n" % site.host.encode())
        raw.close()
        Browser(site, "run-a", "v1").close()
        Browser(site, "run-a", "v2").look().close()
        torn = Browser(site, "run-a", "v3").look()
        torn.hear(lambda m: m.get("name") == "/world")
        torn.socket.socket.close()
        stopped = Browser(site, "run-a", "v4").look()
        stopped.hear(lambda m: m.get("name") == "/world")
        site.scenes.open("run-a").stop()  # the viser side goes first
        with pytest.raises(websockets.ConnectionClosed):
            stopped.hear(lambda m: False)
    assert [r for r in caplog.records if r.levelno >= logging.ERROR] == []
    assert httpx.get(f"{site.http}/api/v1/scenes/run-b").status_code == 200


# --- cursors


def test_two_viewers_have_each_their_own_run_and_cursor(site: Site) -> None:
    browsers = [
        Browser(site, run, viewer).look() for run, viewer in (("run-a", "v1"), ("run-b", "v2"), ("run-a", "v3"))
    ]
    for browser in browsers:
        browser.hear(lambda m: m.get("name") == "/world/now/encoders")
    hands = [Hand(site, "run-a", "v1"), Hand(site, "run-b", "v2")]
    hands[0].move(t=10.0, methods=["truth"])
    hands[1].move(t=20.0, theme="dark")
    assert eventually(lambda: viewers(site, "run-a")["v1"]["t"] == 10.0)
    assert eventually(lambda: viewers(site, "run-b")["v2"]["t"] == 20.0)
    a, b, c = viewers(site, "run-a")["v1"], viewers(site, "run-b")["v2"], viewers(site, "run-a")["v3"]
    assert (a["methods"], a["theme"], a["leader"]) == (["truth"], "light", "truth")
    assert (b["methods"], b["theme"], b["leader"]) == (["truth", "encoders", "beacon", "fixes"], "dark", "encoders")
    assert (c["t"], c["clients"]) == (0.0, 1)
    assert set(viewers(site, "run-a")) == {"v1", "v3"}
    for end in (*browsers, *hands):
        end.close()


def test_moving_the_cursor_sends_poses_and_nothing_else_and_only_to_its_viewer(site: Site) -> None:
    moved, other = Browser(site, "run-a", "v1").look(), Browser(site, "run-a", "v2").look()
    for browser in (moved, other):
        browser.hear(lambda m: m.get("name") == "/world/now/encoders")
        browser.quiet()
    hand = Hand(site, "run-a", "v1")
    hand.move(t=15.0)
    heard = moved.hear(lambda m: m["type"] == "SetPositionMessage" and m["name"] == "/world/robots/truth")
    heard += moved.quiet()
    position = next(m["position"] for m in heard if m.get("name") == "/world/robots/truth" and "position" in m)
    assert position == pytest.approx([4.0, 0.0, 0.0], abs=0.02)
    kinds = {m["type"] for m in heard}
    assert kinds <= {"SetPositionMessage", "SetOrientationMessage", "SceneNodeUpdateMessage"}
    assert not {m["type"] for m in other.quiet()} & kinds
    for end in (moved, other, hand):
        end.close()


def test_a_playing_cursor_moves_the_robots_by_itself_and_rests_at_the_end(site: Site) -> None:
    browser, hand = Browser(site, "run-a", "v1").look(), Hand(site, "run-a", "v1")
    browser.hear(lambda m: m.get("name") == "/world/now/encoders")
    hand.move(t=DURATION - 5, speed=10.0, playing=True)
    poses = browser.hear(
        lambda m: (
            m["type"] == "SetPositionMessage"
            and m["name"] == "/world/robots/encoders"
            and m["position"][0] == pytest.approx(0.01 * DURATION, abs=1e-3)
        )
    )
    steps = [m for m in poses if m["type"] == "SetPositionMessage" and m["name"] == "/world/robots/truth"]
    assert len(steps) > 3
    end = hand.hear(lambda m: m["by"] == "scene" and m["t"] == DURATION)
    assert end["playing"] is False
    hand.move(playing=True)  # play at the end starts anew
    assert eventually(lambda: 0 < viewers(site, "run-a")["v1"]["t"] < DURATION - 5)
    hand.close()
    assert eventually(lambda: viewers(site, "run-a")["v1"]["playing"] is False)  # a page that leaves pauses
    browser.close()


def test_following_moves_the_world_under_the_camera_and_letting_go_brings_it_back(site: Site) -> None:
    browser, hand = Browser(site, "run-a", "v1").look(), Hand(site, "run-a", "v1")
    browser.hear(lambda m: m.get("name") == "/world/now/encoders")
    hand.move(methods=["truth"], follow=True)
    browser.hear(lambda m: m["type"] == "SetCameraLookAtMessage" and abs(m["look_at"][0]) < 0.1)
    hand.move(t=15.0)  # the robot is at (4, 0): so the world goes to (-4, 0)
    shift = browser.hear(lambda m: m["type"] == "SetPositionMessage" and m["name"] == "/world")[-1]["position"]
    assert shift == pytest.approx([-4.0, 0.0, 0.0], abs=0.02)
    hand.move(follow=False)
    heard = browser.hear(lambda m: m["type"] == "SetCameraLookAtMessage" and m["look_at"][0] > 3.9)
    assert any(m.get("name") == "/world" and m.get("position") == [0.0, 0.0, 0.0] for m in heard)
    browser.close()
    hand.close()


def test_a_wrong_message_is_answered_and_changes_nothing(site: Site) -> None:
    hand = Hand(site, "run-a", "v1")
    for text in (
        "{",
        '{"t": "soon"}',
        '{"speed": -1}',
        "[1]",
        '{"t": 1, "x": 2}',
        '{"methods": ["' + "m" * 5000 + '"]}',
    ):
        hand.socket.send(text)
        problem = hand.hear(lambda m: m["type"] == "problem")
        assert problem["status"] == 422
        assert problem["detail"]
    hand.move(t=7.0)
    assert eventually(lambda: viewers(site, "run-a")["v1"]["t"] == 7.0)
    hand.close()


def test_two_hands_on_one_viewer_hear_of_each_other(site: Site) -> None:
    one, two = Hand(site, "run-a", "v1"), Hand(site, "run-a", "v1")
    two.hear(lambda m: m["by"] == "scene")
    one.move(t=33.0)
    assert two.hear(lambda m: m["by"] == "page")["t"] == 33.0
    one.close()
    two.close()


# --- opening and closing


def test_a_scene_nobody_looks_at_is_closed_and_comes_back(local: Settings) -> None:
    store = Store("run-a")
    with serve(local, store, idle_seconds=2.0) as site:
        browser = Browser(site, "run-a", "v1").look()
        browser.hear(lambda m: m.get("name") == "/world/robots/truth")
        assert not eventually(lambda: len(site.scenes) == 0, patience=2.6)  # somebody looks
        browser.close()
        assert eventually(lambda: len(site.scenes) == 0)
        again = Browser(site, "run-a", "v1").look()
        again.hear(lambda m: m.get("name") == "/world/robots/truth")
        again.close()
    assert store.loads == 2


def test_never_more_scenes_than_the_limit_and_the_oldest_unused_goes_first() -> None:
    store = Store("a", "b", "c", "d")
    scenes = Scenes(store.load, store.revision, limit=2, grace_seconds=0.0)
    try:
        scenes.open("a")
        b = scenes.open("b")
        scenes.open("a")
        b.listen("v1", lambda state: None)
        b.call(lambda: None)
        scenes.open("c")
        assert (scenes.get("a"), len(scenes)) == (None, 2)
        scenes.open("c").listen("v1", lambda state: None)
        scenes.open("c").call(lambda: None)
        with pytest.raises(BusyError):
            scenes.open("d")
    finally:
        scenes.stop()
    assert len(scenes) == 0


def test_many_at_once_open_one_scene() -> None:
    store = Store("a")
    scenes = Scenes(store.load, store.revision)
    try:
        with ThreadPoolExecutor(8) as pool:
            opened = set(pool.map(lambda _: id(scenes.open("a")), range(16)))
        assert len(opened) == 1
        assert store.loads == 1
    finally:
        scenes.stop()


def test_new_estimates_show_to_who_comes_next_and_nobody_is_thrown_out(local: Settings) -> None:
    store = Store("run-a")
    with serve(local, store) as site:
        old = Browser(site, "run-a", "v1").look()
        old.hear(lambda m: m.get("name") == "/world/robots/truth")
        store.revisions["run-a"] = "2"
        new = Browser(site, "run-a", "v2").look()
        new.hear(lambda m: m.get("name") == "/world/robots/truth")
        assert (store.loads, len(site.scenes)) == (2, 2)
        old.send(Browser.CAMERA)  # still connected
        old.close()
        assert eventually(lambda: site.scenes.close_idle(3600) == 1 or len(site.scenes) == 1)
        new.close()


def test_opening_and_closing_leaves_no_threads_and_no_sockets() -> None:
    store = Store(*(f"run-{i}" for i in range(6)))
    scenes = Scenes(store.load, store.revision)
    scenes.open("run-0")
    scenes.close_idle(0)
    gc.collect()
    threads, files = threading.active_count(), len(list(Path("/proc/self/fd").iterdir()))
    for run_id in store.revisions:
        scenes.open(run_id)
    assert threading.active_count() > threads
    assert scenes.close_idle(0) == 6
    gc.collect()
    assert eventually(lambda: threading.active_count() <= threads)
    assert eventually(lambda: len(list(Path("/proc/self/fd").iterdir())) <= files)
    scenes.stop()


def test_the_scene_comes_as_one_file(site: Site) -> None:
    answer = httpx.get(f"{site.http}/api/v1/runs/run-a/files/scene.html?theme=dark", timeout=30)
    assert answer.status_code == 200
    assert 'filename="run-a-scene.html"' in answer.headers["content-disposition"]
    assert "__VISER_EMBED_DATA__" in answer.text
    assert not re.search(r"""(src|href)=["']https?://""", answer.text)
    assert httpx.get(f"{site.http}/api/v1/runs/nowhere/files/scene.html").status_code == 404
