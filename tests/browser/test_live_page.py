"""The monitor: the virtual robot is driven around with the keyboard, seen on map and in 3D, stopped, and stored."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable
from typing import Any

import pytest
from conftest import Server
from playwright.sync_api import Page, WebSocketRoute, expect

pytestmark = [pytest.mark.browser, pytest.mark.xdist_group("browser")]  # one server and one browser for all of them

PATIENCE_S = 180.0  # a slow machine with cold kernels; nothing waits that long when it works


def until(page: Page, condition: Callable[[], Any]) -> Any:
    """The condition's first true value."""
    end = time.monotonic() + PATIENCE_S
    while not (found := condition()):
        assert time.monotonic() < end, "it did not come true"
        page.wait_for_timeout(50)
    return found


def pose(page: Page) -> tuple[float, float, float]:
    """x, y, theta that the leading method has on the page."""
    text = page.locator("html").get_attribute("data-pose") or "nan,nan,nan"
    x, y, theta = map(float, text.split(","))
    return x, y, theta


def way(a: tuple[float, ...], b: tuple[float, ...]) -> float:
    """Distance [m]; 0 where one is unknown."""
    distance = math.hypot(a[0] - b[0], a[1] - b[1])
    return distance if math.isfinite(distance) else 0.0


def hold(page: Page, keys: list[str], condition: Callable[[], Any]) -> None:
    """Hold keys until the condition is true, as a person does: pressed anew when the page has let go of the robot."""

    def press() -> None:
        for key in keys:
            page.keyboard.up(key)
            page.keyboard.down(key)

    press()
    pressed = time.monotonic()

    def come() -> Any:
        nonlocal pressed
        if page.locator("#driver").inner_text() != "You drive" and time.monotonic() - pressed > 2.0:
            press()
            pressed = time.monotonic()
        return condition()

    until(page, come)


def test_a_newcomer_drives_the_virtual_robot_and_finds_the_run_stored(
    new_page: Callable[..., Page], server: Server
) -> None:
    small = {"width": 900, "height": 560}  # WebGL is drawn in software
    page = new_page(with_3d=True, color_scheme="light", viewport=small)
    sockets: list[WebSocketRoute] = []
    page.route_web_socket("**/live/virtual/watch", lambda ws: (sockets.append(ws), ws.connect_to_server()))
    page.goto("/live")
    page.get_by_role("button", name="Start a virtual robot").click()
    page.wait_for_url("**/live/virtual")
    expect(page.locator("#state")).to_have_attribute("data-state", "live")
    start = until(page, lambda: (p := pose(page)) and math.isfinite(p[0]) and p)
    run_id = page.locator("html").get_attribute("data-run")
    assert run_id is not None
    page.locator("#scene[data-scene=ready]").wait_for()

    hold(page, ["ArrowUp"], lambda: page.locator("#commanded", has_text="0.40 m/s").count())
    hold(page, ["ArrowUp"], lambda: way(pose(page), start) > 0.3)
    sockets[-1].close()  # the robot stops; held keys do not set it off again when the connection is back
    expect(page.locator("#drive-off")).to_contain_text("press again")
    assert page.locator("#driver").inner_text() == "Nobody drives"
    turned = pose(page)[2]
    hold(page, ["ArrowUp", "ArrowLeft"], lambda: math.remainder(pose(page)[2] - turned, 2 * math.pi) > 0.5)
    page.keyboard.press("Space")
    expect(page.locator("#commanded")).to_contain_text("0.00 m/s")
    for key in ("ArrowUp", "ArrowLeft"):
        page.keyboard.up(key)

    def in_3d() -> dict[str, Any]:
        (viewer,) = server.client.get(f"/api/v1/scenes/{run_id}").json()["viewers"]
        assert viewer["live"] and viewer["clients"] == 1
        return viewer  # type: ignore[no-any-return]

    until(page, lambda: _rests(page) and way(in_3d()["poses"]["fused"], pose(page)) < 0.03)
    assert way(in_3d()["poses"]["fused"], start) > 0.3
    times = "[document.querySelector('[data-map]').dataset.time, document.documentElement.dataset.t].map(Number)"
    on_map, newest = page.evaluate(times)
    assert abs(on_map - newest) < 1
    expect(page.locator('tr[data-method="encoders"]')).to_contain_text(" m")
    expect(page.locator('[data-link="commands to wheels"] .link-said')).to_have_text(re.compile("inside|above|left"))

    listed = server.client.get("/api/v1/runs").json()["items"]
    assert next(r for r in listed if r["id"] == run_id)["is_live"]
    page.locator("#end").click()
    page.locator("#end").click()
    page.get_by_role("link", name="Open the stored run").click()
    page.wait_for_url(re.compile(r"/runs/(?!" + run_id + ")[0-9a-f]{16}"))
    stored = page.url.rsplit("/", 1)[1]
    streams = {s["name"]: s for s in server.client.get(f"/api/v1/runs/{stored}").json()["streams"]}
    assert streams["commands"]["rows"] > 10 and streams["imu"]["rows"] > 100
    commanded = server.client.get(f"/api/v1/runs/{stored}/streams/commands", params={"columns": "v"}).json()
    assert max(commanded["series"][0]["y"]) == pytest.approx(0.4, abs=0.01)
    assert server.client.get(f"/runs/{run_id}.json").headers["location"] == f"/runs/{stored}.json"


def _rests(page: Page) -> bool:
    before = pose(page)
    page.wait_for_timeout(250)
    return way(before, pose(page)) < 0.01


def test_a_page_without_its_robot_says_so_and_a_broken_connection_comes_back_by_itself(page: Page) -> None:
    sockets: list[WebSocketRoute] = []
    page.route_web_socket("**/live/nobody/watch", lambda ws: (sockets.append(ws), ws.connect_to_server()))
    page.add_init_script(
        "new MutationObserver(() => (window.states ??= []).push(document.documentElement.dataset.connection))"
        ".observe(document, { subtree: true, attributeFilter: ['data-connection'] })"
    )
    page.goto("/live/nobody?view=map&trail=speed")
    expect(page.locator("#verdict")).to_contain_text("No robot called nobody is connected")
    expect(page.locator("#drive-off")).to_have_text("No robot is connected.")
    expect(page.locator('#trail [data-trail="speed"]')).to_have_attribute("aria-pressed", "true")
    expect(page.locator("#scene")).to_be_hidden()
    page.keyboard.press("?")
    expect(page.locator("#help-panel")).to_contain_text("STOP, whoever drives")
    sockets[0].close()
    until(page, lambda: len(sockets) == 2)
    expect(page.locator("#state")).to_have_attribute("data-state", "waiting")
    assert page.evaluate("window.states") == ["connecting", "open", "lost", "connecting", "open"]


def test_an_hour_of_readings_takes_no_more_memory_than_a_minute(page: Page) -> None:
    page.goto("/about")
    kept = page.evaluate(
        """async () => {
            const { createTrack } = await import("/static/pages/monitor-tracks.js");
            const { createRing } = await import("/static/lib/ring.js");
            const [track, ring] = [createTrack(), createRing(["y"], 4000)];
            for (let k = 0; k < 72000; k++) {
                track.extend({ t: [k / 20], x: [k / 100], y: [0] }, null);
                const t = [0, 1, 2, 3, 4].map((i) => k / 20 + i / 100);
                ring.push(t, { y: t });
            }
            track.extend({ t: [1], x: [9], y: [9] }, null); // late
            const { t, y } = ring.since(3590);
            return { poses: track.rows.t.length, first: track.rows.x[0], last: track.rows.t.at(-1),
                     speed: track.rows.speed.at(-1), rows: ring.length, from: t[0], to: y.at(-1), n: t.length };
        }"""
    )
    assert kept["poses"] <= 3000 and kept["rows"] <= 8000
    assert (kept["first"], kept["last"]) == (0, pytest.approx(3599.95))
    assert kept["speed"] == pytest.approx(0.2)
    assert (kept["from"], kept["to"]) == (pytest.approx(3589.99), pytest.approx(3599.99)) and kept["n"] == 1001
