"""Two runs over each other: chosen in the list, one cursor, figures that differ, a link that brings it all back."""

from __future__ import annotations

import re
from typing import Any

import pytest
from conftest import Server
from playwright.sync_api import Page, expect

pytestmark = pytest.mark.browser

ERROR = '[data-chart="error-xy"]'


@pytest.fixture
def pair(square: dict[str, Any], mission: dict[str, Any]) -> str:
    return f"{square['id']},{mission['id']}"


def open_compare(page: Page, query: str) -> None:
    page.goto(f"/compare?{query}")
    expect(page.locator("html")).to_have_attribute("data-ready", "compare")
    page.wait_for_selector(f'{ERROR}[data-state="ready"]')


def test_runs_are_chosen_in_the_list_and_laid_over_each_other(
    page: Page, square: dict[str, Any], mission: dict[str, Any]
) -> None:
    page.goto("/runs")
    for run in (square, mission):
        page.get_by_label(f"Select {run['name']}").check()
    page.keyboard.press("c")
    page.wait_for_url("**/compare?runs=*")
    expect(page.locator("#legend li")).to_have_count(2)
    expect(page.locator("[data-map]")).to_have_attribute("data-paths", "A B")
    page.wait_for_selector(f'{ERROR}[data-state="ready"]')
    expect(page.locator("#metrics thead")).to_contain_text(square["name"])


def test_the_figures_are_the_stored_ones(page: Page, server: Server, pair: str, mission: dict[str, Any]) -> None:
    open_compare(page, f"runs={pair}&method=encoders")
    found = server.client.get(f"/api/v1/runs/{mission['id']}").json()["estimates"]
    ate = next(e for e in found if e["method"] == "encoders")["metrics"]["ate_rmse_m"]["value"]
    cell = page.locator('tr[data-metric="ate_rmse_m"] td').nth(2).locator(".q")
    digits = (cell.inner_text()).replace(",", "").split("\u00a0")[0]
    shown = float(re.match(r"[\d.]+", digits).group())  # type: ignore[union-attr]
    scale = 0.01 if "cm" in digits else 1.0
    assert shown * scale == pytest.approx(ate, rel=0.02)


def test_another_method_is_a_click_away(page: Page, pair: str) -> None:
    open_compare(page, f"runs={pair}&method=fused")
    page.locator("#methods").get_by_role("button", name="encoders", exact=True).click()
    page.wait_for_url("**method=encoders**")
    expect(page.locator('#methods [aria-pressed="true"]')).to_have_text("encoders")
    expect(page.locator("#verdict")).to_contain_text("By encoders")


def test_only_differences_hides_what_is_equal(page: Page, pair: str) -> None:
    open_compare(page, f"runs={pair}&method=encoders")
    equal = page.locator("#descriptions tr.same")
    assert equal.count() > 0
    page.keyboard.press("d")
    expect(equal).to_have_count(0)
    assert page.locator("#descriptions tbody tr").count() > 0
    expect(page).to_have_url(re.compile("diff=1"))
    page.reload()
    expect(page.locator("#only-differences")).to_be_checked()


def test_the_plots_share_one_cursor_and_the_link_keeps_the_view(page: Page, pair: str) -> None:
    open_compare(page, f"runs={pair}&method=encoders&t0=5&t1=25&t=12")
    for chart in (ERROR, '[data-chart="error-theta"]'):
        expect(page.locator(chart)).to_have_attribute("data-range", "5,25")
        expect(page.locator(chart)).to_have_attribute("data-time", "12")
    expect(page.locator("[data-map]")).to_have_attribute("data-time", "12")
    page.locator("#legend button").first.click()
    expect(page).to_have_url(re.compile("hide=A"))
    page.locator(f"{ERROR} .u-over").hover()
    hovered = page.locator(ERROR).get_attribute("data-time")
    assert hovered != "12"
    expect(page.locator('[data-chart="error-theta"]')).to_have_attribute("data-time", hovered or "")
