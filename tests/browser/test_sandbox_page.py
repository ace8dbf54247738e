"""The sandbox: a moved slider moves path and gap, a link brings it back, an export leaves as a file."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Locator, Page, expect

pytestmark = pytest.mark.browser

EFFECTS = '{"track_width":{"scale":1.05}}'


def open_sandbox(page: Page, query: str) -> None:
    page.goto(f"/sandbox?{query}")
    expect(page.locator("html")).to_have_attribute("data-ready", "sandbox")


def slider(page: Page) -> Locator:
    return page.get_by_label("track width, scale", exact=True)


def test_a_move_changes_path_and_gap_and_goes_to_the_top(page: Page, square: dict[str, Any]) -> None:
    open_sandbox(page, f"run={square['id']}")
    expect(page.locator("[data-map]")).to_have_attribute("data-paths", "real nominal patched")
    gap, before = page.locator("#gap-now"), page.locator("#gap-before")
    nominal = before.inner_text()
    expect(gap).to_have_text(nominal)
    with page.expect_request("**/api/v1/sandbox/simulate") as asked:
        slider(page).focus()
        page.keyboard.press("PageUp")
    assert asked.value.post_data_json["effects"]["track_width"]["scale"] > 1.0
    page.get_by_label("track width, scale, value").fill("1.2")
    expect(page.locator("#verdict")).to_contain_text("track width 1.2")
    expect(gap).not_to_have_text(nominal)
    expect(before).to_have_text(nominal)
    expect(page.locator("#changed")).to_contain_text("track width")
    page.get_by_label("Reset track width").click()
    expect(gap).to_have_text(nominal)
    expect(page.locator("#changed [data-effect]")).to_have_count(0)


def test_a_link_restores_and_a_wrong_value_is_named(new_page: Callable[..., Page]) -> None:
    page = new_page(with_3d=True)
    open_sandbox(page, f"scenario=figure-eight&effects={EFFECTS}&noise=1&seed=4&t0=2&t1=9")
    field = page.get_by_label("track width, scale, value")
    expect(field).to_have_value("1.05")
    expect(page.locator("#noise")).to_be_checked()
    expect(page.locator("#seed")).to_have_value("4")
    expect(page.locator('[data-chart="wheels-left"]')).to_have_attribute("data-range", "2,9")
    expect(page.locator("#lines")).to_have_text("nominalpatched")
    expect(page.locator("#scene")).to_have_attribute("data-overlay", "patched simulated")
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    page.get_by_role("button", name="Copy as command").click()
    expect(page.get_by_role("button", name="Copied")).to_be_visible()
    command = page.evaluate("() => navigator.clipboard.readText()")
    assert "scenario:figure-eight --effects effects.json --seed 4 --out simulated" in command and EFFECTS in command
    field.fill("9")
    expect(page.locator("#problem")).to_contain_text("expected 0.3 to 3")
    expect(field).to_have_attribute("aria-invalid", "true")
    field.fill("1.01")
    expect(page.locator("#problem")).to_be_empty()
    page.wait_for_url("**1.01**")
    page.reload()
    expect(field).to_have_value("1.01")


def test_a_limit_is_switched_on_and_an_export_says_what_it_lacks(page: Page, tmp_path: Path) -> None:
    open_sandbox(page, f"scenario=straight&effects={EFFECTS}")
    page.get_by_label("speed limit, v_max, on").check()
    expect(page.get_by_label("speed limit, v_max, value")).to_have_value("1")
    page.locator("#export summary").click()
    with page.expect_download() as download:
        page.get_by_role("button", name="JSON", exact=True).click()
    download.value.save_as(tmp_path / "effects.json")
    made = json.loads((tmp_path / "effects.json").read_text())["effects"]
    assert made == {"speed_limit": {"v_max": 1.0}, "track_width": {"scale": 1.05}}
    page.locator("#export summary").click()
    with page.expect_download():
        page.get_by_role("button", name="ros2_control YAML").click()
    expect(page.locator("#export-note")).to_contain_text("Modelled")
