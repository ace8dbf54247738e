"""The 3D view in a browser: it draws, its robots follow the page's time cursor, and it asks nobody else."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from typing import Any

import pytest
from playwright.sync_api import Page

pytestmark = pytest.mark.browser

PATIENCE_MS = 60_000  # software WebGL on a shared machine
SMALL = {"width": 640, "height": 360}


def viewers(page: Page, run_id: str) -> dict[str, dict[str, Any]]:
    answer = page.request.get(f"/api/v1/scenes/{run_id}").json()
    return {v["viewer"]: v for v in answer["viewers"]}


def until(page: Page, condition: Callable[[], Any]) -> Any:
    """The condition's first true value."""
    end = time.monotonic() + PATIENCE_MS / 1000
    while not (found := condition()):
        assert time.monotonic() < end, "it did not come true"
        page.wait_for_timeout(100)
    return found


def key_of(page: Page) -> str:
    """The viewer of the page's 3D view."""
    address = page.get_attribute("#split-scene iframe", "src")
    assert address is not None
    return address.split("/")[3]


def open_scene(page: Page, run: dict[str, Any], query: str = "") -> str:
    """The run's page with its 3D view drawn; the viewer's key."""
    page.goto(f"/runs/{run['id']}?view=scene{query}")
    page.wait_for_selector("#split-scene[data-scene]", state="attached")
    page.eval_on_selector("#split-scene", "e => e.scrollIntoView()")
    page.wait_for_selector("#split-scene[data-scene=ready]", timeout=PATIENCE_MS)
    page.frame_locator("#split-scene iframe").locator("canvas").last.wait_for(timeout=PATIENCE_MS)
    return key_of(page)


@pytest.fixture
def small(new_page: Callable[..., Page]) -> Page:
    return new_page(with_3d=True, color_scheme="light", viewport=SMALL)


def test_the_robots_move_with_the_pages_cursor(small: Page, mission: dict[str, Any]) -> None:
    run_id = mission["id"]
    key = open_scene(small, mission)
    start = until(small, lambda: viewers(small, run_id).get(key))
    assert start["clients"] == 1
    assert {"truth", "encoders", "fused"} <= set(start["poses"])
    small.keyboard.press("Space")  # play
    playing = until(small, lambda: (v := viewers(small, run_id)[key])["playing"] and v)
    moved = until(small, lambda: (v := viewers(small, run_id)[key])["poses"]["fused"] != start["poses"]["fused"] and v)
    assert moved["t"] > playing["t"] or moved["t"] > start["t"]
    small.keyboard.press("Space")
    until(small, lambda: not viewers(small, run_id)[key]["playing"])
    small.keyboard.press("f")
    until(small, lambda: viewers(small, run_id)[key]["follow"])


def test_what_is_drawn_changes_when_the_cursor_moves(small: Page, square: dict[str, Any]) -> None:
    open_scene(small, square, "&t=5")
    canvas = small.frame_locator("#split-scene iframe").locator("canvas").last
    pictures = [""]

    def still() -> bool:
        small.wait_for_timeout(500)
        pictures.append(canvas.evaluate("c => c.toDataURL()"))
        return pictures[-1] == pictures[-2]

    until(small, still)
    small.keyboard.press("Space")
    until(small, lambda: canvas.evaluate("c => c.toDataURL()") != pictures[-1])


def test_theme_and_methods_are_the_pages(new_page: Callable[..., Page], mission: dict[str, Any]) -> None:
    page = new_page(with_3d=True, viewport=SMALL, color_scheme="dark")
    key = open_scene(page, mission)
    before = until(page, lambda: viewers(page, mission["id"]).get(key))
    assert before["theme"] == "dark"
    assert (before["playing"], before["leader"]) == (False, "fused")
    page.keyboard.press("1")
    after = until(page, lambda: (v := viewers(page, mission["id"])[key])["methods"] != before["methods"] and v)
    assert set(after["methods"]) ^ set(before["methods"]) == {"encoders"}


def test_a_scene_in_its_own_tab_has_a_panel_that_moves_it(small: Page, square: dict[str, Any]) -> None:
    small.set_viewport_size({"width": 900, "height": 420})  # viser folds its panel below 576
    small.goto(f"/scene/{square['id']}/?theme=dark")
    small.locator("canvas").last.wait_for(timeout=PATIENCE_MS)
    small.get_by_text("speed ×").wait_for(timeout=PATIENCE_MS)
    small.get_by_text("Software WebGL").wait_for(state="hidden")  # no note over the picture
    key = small.url.split("/")[5]
    assert viewers(small, square["id"])[key]["theme"] == "dark"
    small.locator("xpath=//*[text()='follow']/following::input[@type='checkbox'][1]").dispatch_event("click")
    until(small, lambda: viewers(small, square["id"])[key]["follow"])


def test_an_unknown_run_is_a_page_that_says_so(small: Page) -> None:
    answer = small.goto("/scene/0123456789abcdef/")
    assert answer is not None
    assert answer.status == 404
    assert "0123456789abcdef" in small.content()


def test_the_exported_file_draws_by_itself(
    small: Page, square: dict[str, Any], tmp_path: Any, new_page: Callable[..., Page]
) -> None:
    answer = small.request.get(f"/api/v1/runs/{square['id']}/files/scene.html")
    path = tmp_path / "scene.html"
    path.write_bytes(answer.body())
    context = small.context.browser.new_context(offline=True, viewport=SMALL)  # type: ignore[union-attr]
    try:
        page = context.new_page()
        asked: list[str] = []
        page.on("request", lambda r: asked.append(r.url) if r.url.startswith("http") else None)
        page.goto(path.as_uri())
        page.locator("canvas").last.wait_for(timeout=PATIENCE_MS)
        assert asked == [], json.dumps(asked)
    finally:
        context.close()
