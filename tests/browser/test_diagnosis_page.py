"""A diagnosis on its pages: the report with its slider and exports; the list, a new one, and a run's tab."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from conftest import Server, Watch
from playwright.sync_api import Page, expect

from app.db.session import make_engine, writing
from app.settings import Settings
from app.store import diagnoses
from tests.app.gap_documents import made

pytestmark = pytest.mark.browser


@pytest.fixture
def stored(server: Server, square: dict[str, Any], mission: dict[str, Any]) -> str:
    """A diagnosis written by hand, of the two examples."""
    engine = make_engine(Settings(data=server.data).url)
    with writing(engine) as session:
        row = diagnoses.add_diagnosis(session, [mission["id"]], [square["id"]], made(), job_id="0" * 16, name="by hand")
        found = row.id
    engine.dispose()
    return found


def test_the_report_says_it_shows_it_and_lets_it_go(
    page: Page, watch: Watch, mission: dict[str, Any], stored: str, tmp_path: Path
) -> None:
    page.goto(f"/diagnoses/{stored}?view=map")
    expect(page.locator("html")).to_have_attribute("data-ready", "diagnosis")
    expect(page.locator("#verdict")).to_contain_text("Your simulator turns 2.1 % more than the robot.")
    expect(page.locator(".g-chain li.guilty")).to_contain_text("wheels to body")
    page.locator("#heat-map td").nth(9).hover()
    expect(page.locator("#hint")).to_contain_text("times the noise before")
    expect(page.locator("#probabilities tr.joint")).to_have_count(2)
    expect(page.locator('[data-chart="gap-timeline"]')).to_have_attribute("data-state", "ready")
    gap_map = page.locator("#map-gap [data-map]")
    expect(gap_map).to_have_attribute("data-paths", re.compile(r"real gap-\d"))
    expect(page.locator("#map-overlay [data-map]")).to_have_attribute("data-paths", "real simulated patched")
    page.get_by_label("Share of the effects that is added").fill("40")
    expect(page.locator("#share-now")).to_have_text("40 %")
    page.locator(".jump").first.click()
    page.wait_for_url(re.compile(r"share=0\.40.*|t0=.*share"))
    page.reload()
    expect(page.locator("#share-now")).to_have_text("40 %")
    page.locator("#run-choice").get_by_role("button", name=mission["name"]).click()
    expect(page.locator("#overlay")).to_be_hidden()
    expect(page.locator("#copy-command")).to_have_attribute("data-hint", re.compile("--held-out .* --seed 3 "))
    page.locator("#patch summary").click()
    with page.expect_download() as patch:
        page.get_by_role("button", name="JSON", exact=True).click()
    patch.value.save_as(tmp_path / "effects.json")
    effects = json.loads((tmp_path / "effects.json").read_text())["effects"]
    assert effects["track_width"] == {"scale": 1.021}
    expect(page.locator("#open-sandbox")).to_have_attribute("href", re.compile("track_width"))
    page.locator("#download summary").click()
    with page.expect_download() as report:
        page.get_by_role("link", name="HTML, self-contained").click()
    report.value.save_as(tmp_path / "report.html")
    saved = (tmp_path / "report.html").as_uri()
    watch.allow.append(saved)  # any other request that it makes fails the test
    page.goto(saved)
    expect(page.locator(".verdict")).to_contain_text("Your simulator turns 2.1 % more")
    assert page.locator("svg.g-plot").count() >= 5


def test_a_run_leads_to_its_diagnosis_and_to_a_new_one(
    page: Page, stored: str, mission: dict[str, Any], square: dict[str, Any]
) -> None:
    page.goto(f"/runs/{mission['id']}")
    expect(page.locator("html")).to_have_attribute("data-ready", "run")
    page.keyboard.press("d")
    expect(page.locator("#gap-found")).to_contain_text("Your simulator turns 2.1 % more")
    page.get_by_role("link", name="With other runs").click()
    row = page.locator(f'#panel tr[data-run="{mission["id"]}"]')
    expect(row.get_by_label("Fit")).to_be_checked()
    page.locator(f'#panel tr[data-run="{square["id"]}"]').get_by_label("Hold out").check()
    page.get_by_role("button", name="Diagnose 1 run").click()
    expect(page.locator("#new-note .note")).to_contain_text("is of another robot than run 1")
    listed = page.locator(f'tr[data-diagnosis="{stored}"]')
    expect(listed).to_contain_text("3.2 → 1.1")
    listed.get_by_label("Delete by hand").click()
    expect(listed).to_have_count(0)
    page.get_by_role("button", name="Undo").click()
    expect(listed).to_be_visible()
    page.goto("/runs?q=gap:explained")
    expect(page.locator('section[data-facet="gap"] button[aria-pressed="true"]')).to_contain_text("explained")
    expect(page.locator(f'tr[data-run="{mission["id"]}"]')).to_contain_text("explained")
