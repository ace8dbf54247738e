"""Events and consistency on the run page: read, decide, export, come back by a link."""

from __future__ import annotations

import csv
import io
import re
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, expect

pytestmark = pytest.mark.browser


def open_run(page: Page, run: dict[str, Any], query: str) -> None:
    page.goto(f"/runs/{run['id']}?{query}")
    page.wait_for_selector('html[data-ready="run"]')


def test_an_event_is_looked_at_dismissed_and_taken_back(page: Page, mission: dict[str, Any]) -> None:
    open_run(page, mission, "view=map")
    rows = page.locator("#events tbody tr")
    before = page.inner_text("#verdict")
    slip = page.locator('#events tr[data-event^="slip-"]').first
    key = str(slip.get_attribute("data-event"))
    slip.locator("td").first.click()
    page.wait_for_function(
        "t => Math.abs(Number(document.querySelector('.strip-track').dataset.time) - t) < 0.01",
        arg=int(key.split("-")[1]) / 1000,
    )
    expect(page.locator(f'#events tr[data-event="{key}"]')).to_have_class(re.compile("now"))
    page.wait_for_selector('[data-map][data-events]:not([data-events="0"])')
    dismiss = page.locator(f'#events tr[data-event="{key}"] [data-decision="dismissed"]')
    dismiss.click()
    expect(dismiss).to_have_attribute("aria-pressed", "true")
    expect(page.locator("#verdict")).not_to_have_text(before)
    page.reload()
    expect(dismiss).to_have_attribute("aria-pressed", "true")
    with page.expect_download() as download:
        page.get_by_role("region", name="Events").get_by_role("link", name="CSV").click()
    exported = list(csv.DictReader(io.StringIO(Path(download.value.path()).read_text())))
    assert len(exported) == rows.count()
    assert [r["decision"] for r in exported].count("dismissed") == 1
    dismiss.click()
    expect(page.locator("#verdict")).to_have_text(before)
    expect(dismiss).to_have_attribute("aria-pressed", "false")


def test_the_map_leaves_as_a_drawing_with_ellipses_and_events(page: Page, mission: dict[str, Any]) -> None:
    open_run(page, mission, "view=map&m=fused")
    page.wait_for_selector('[data-map][data-events]:not([data-events="0"])')
    page.get_by_role("button", name="Ellipses along the paths").click()
    page.locator("[data-map] .chart-menu summary").click()
    with page.expect_download() as download:
        page.locator('[data-map] [data-export="svg"]').click()
    drawing = Path(download.value.path()).read_text()
    assert drawing.count("<ellipse ") > 5
    assert "slip at " in drawing


def test_every_sensor_is_judged_and_the_method_is_in_the_link(page: Page, mission: dict[str, Any]) -> None:
    open_run(page, mission, "tab=consistency")
    page.wait_for_selector('#consistency[data-method="fused"]')
    assert page.inner_text("#cons-verdict").endswith(".")
    chart = '[data-chart="nis-beacon"]'
    page.wait_for_selector(f'{chart}[data-state="ready"]')
    page.wait_for_selector('[data-chart="nees"][data-state="ready"]')
    page.wait_for_selector('[data-chart="nis-beacon-white"][data-state="ready"]')
    sensors = page.eval_on_selector_all("[data-sensor-row]", "all => all.map(e => e.dataset.sensorRow)")
    assert {"beacon", "ranges", "wheels.turn"} <= set(sensors)
    page.locator('#consistency [data-method="published"]').click()
    page.wait_for_selector('#consistency[data-method="published"]')
    page.wait_for_url(re.compile("by=published"))
    page.reload()
    page.wait_for_selector('#consistency[data-method="published"]')
