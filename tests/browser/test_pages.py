"""Every page: its own origin only, its JSON twin, its colours, its keys, its errors."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import pytest
from conftest import ROOT, Server
from playwright.sync_api import Page, expect

pytestmark = pytest.mark.browser

PLACES = ["/runs", "/compare", "/jobs", "/about"]


@pytest.mark.parametrize("path", PLACES)
def test_a_page_says_its_sentence_asks_nobody_else_and_has_a_json_twin(
    page: Page, server: Server, square: dict[str, Any], path: str
) -> None:
    page.goto(path)
    expect(page.locator(f'.rail-link[href="{path}"]')).to_have_attribute("aria-current", "page")
    twin = server.client.get(f"{path}.json").raise_for_status().json()
    expect(page.locator("h1")).to_contain_text(twin["title"])
    expect(page.locator("#verdict")).to_have_text(twin["sentence"])
    page.wait_for_load_state("networkidle")


def test_the_policy_forbids_scripts_and_styles_in_the_page(server: Server, square: dict[str, Any]) -> None:
    for path in [*PLACES, "/guide", f"/runs/{square['id']}"]:
        answer = server.client.get(path, headers={"Accept": "text/html"}, follow_redirects=True)
        policy = answer.headers["content-security-policy"]
        assert "script-src 'self';" in policy and "style-src 'self';" in policy and "unsafe" not in policy
        assert " style=" not in answer.text
        assert re.findall(r"<script(?![^>]*(?:src=|application/json))", answer.text) == []


def test_dark_and_light_look_different_and_the_choice_is_kept(new_page: Callable[..., Page]) -> None:
    light, dark = new_page(color_scheme="light"), new_page(color_scheme="dark")
    shots = []
    for page in (light, dark):
        page.goto("/about")
        expect(page.locator("[data-bytes]")).not_to_contain_text("bytes")
        shots.append(page.screenshot())
    assert shots[0] != shots[1]
    background = "getComputedStyle(document.body).backgroundColor"
    assert light.evaluate(background) != dark.evaluate(background)

    light.locator("#theme").click()  # as the system -> light
    light.locator("#theme").click()  # light -> dark
    assert light.evaluate(background) == dark.evaluate(background)
    light.goto("/jobs")
    expect(light.locator("html")).to_have_attribute("data-theme", "dark")
    assert light.evaluate(background) == dark.evaluate(background)


def test_keys_are_listed_in_a_panel_beside_the_page(page: Page) -> None:
    page.goto("/runs")
    page.keyboard.press("?")
    panel = page.locator("#help-panel")
    expect(panel).to_be_visible()
    expect(panel).to_contain_text("next run")
    expect(page.locator("#main")).to_be_visible()
    page.keyboard.press("?")
    expect(panel).to_be_hidden()
    page.keyboard.press("/")
    expect(page.locator("#search")).to_be_focused()
    page.keyboard.type("?")
    expect(panel).to_be_hidden()


def test_what_is_not_there_gets_a_page_that_says_so(page: Page, server: Server) -> None:
    answer = page.goto("/runs/0123456789abcdef")
    assert answer is not None and answer.status == 404
    expect(page.locator("#verdict")).to_contain_text("There is no run '0123456789abcdef'")
    page.get_by_role("link", name="All runs", exact=True).click()
    expect(page).to_have_url(f"{server.url}/runs")
    problem = server.client.get("/compare.json", params={"runs": "a"})
    assert problem.status_code == 422 and problem.json()["where"]["parameter"] == "runs"


def test_numbers_are_explained_on_hover_with_a_link_that_leads_somewhere(page: Page, mission: dict[str, Any]) -> None:
    page.goto("/runs?q=tag:simulated")
    page.locator("td.col-best .q").first.hover()
    hint = page.locator("#hint")
    expect(hint).to_contain_text("absolute trajectory error")
    expect(hint.locator(".si")).to_contain_text(" m")
    hint.get_by_role("link", name="In the guide").click()
    page.wait_for_url("**/guide/numbers#*")
    anchor = page.url.partition("#")[2]
    assert page.locator(f'[id="{anchor}"]').count() == 1


def test_every_explanation_has_its_place_in_the_guide(server: Server) -> None:
    files = sorted((ROOT / "static" / "lib").glob("terms*.js"))
    terms = "".join(path.read_text(encoding="utf-8") for path in files)
    links = set(re.findall(r'"((?:numbers|run-format|diagnoses)(?:#[a-z-]+)?)"\]', terms))
    assert {"numbers#ate", "numbers#noise"} <= links
    for link in links:
        path, _, anchor = link.partition("#")
        text = server.client.get(f"/guide/{path}").raise_for_status().text
        assert not anchor or f'id="{anchor}"' in text, link


def test_about_names_versions_licences_and_the_store(page: Page, server: Server) -> None:
    page.goto("/about")
    row = page.get_by_role("row").filter(has=page.get_by_role("cell", name="fastapi", exact=True))
    expect(row).to_contain_text("MIT")
    expect(page.locator("tr", has_text="uPlot")).to_contain_text(re.compile(r"\d+\.\d+\.\d+"))
    facts = server.client.get("/about.json").json()
    assert facts["database"] == "SQLite" and facts["data_bytes"] > 0


def test_jobs_are_shown_with_what_they_made_and_failures_with_their_reason(
    page: Page, server: Server, square: dict[str, Any]
) -> None:
    refused = server.client.post("/api/v1/runs", params={"filename": "broken.zip"}, content=b"PK\x05\x06 no zip")
    assert refused.status_code == 422
    page.goto("/jobs")
    done = page.locator('tr[data-state="done"]', has_text=square["name"])
    expect(done.first).to_be_visible()
    failed = page.locator('tr[data-state="failed"]', has_text="broken.zip").first
    expect(failed).to_be_visible()
    expect(page.locator("tr.detail .note").first).to_contain_text(refused.json()["detail"])
    page.keyboard.press("4")
    expect(failed).to_be_hidden()
    expect(done.first).to_be_visible()


def test_a_job_appears_and_ends_without_a_reload(page: Page, server: Server, mission: dict[str, Any]) -> None:
    page.goto("/jobs")
    expect(page.locator("html")).to_have_attribute("data-ready", "jobs")
    answer = server.client.post(f"/api/v1/runs/{mission['id']}/estimates", json={"methods": ["encoders"]})
    job = answer.raise_for_status().json()
    row = page.locator(f'tr[data-job="{job["id"]}"]')
    expect(row).to_have_attribute("data-state", "done")
    expect(row).to_contain_text(mission["name"])


def test_the_login_page_asks_for_the_token_and_lets_in(tmp_path: Any) -> None:
    from fastapi.testclient import TestClient

    from app.main import create_app
    from app.settings import Settings

    app = create_app(Settings(data=tmp_path, host="0.0.0.0", token="open sesame", workers=1))
    with TestClient(app, follow_redirects=False) as client:
        html = {"Accept": "text/html"}
        assert client.get("/runs", headers=html).headers["location"].endswith("/login?next=%2Fruns")
        assert 'name="token"' in client.get("/login", headers=html).text
        assert client.post("/login", data={"token": "wrong"}).status_code == 401
        entered = client.post("/login", data={"token": "open sesame", "next": "/jobs"})
        assert (entered.status_code, entered.headers["location"]) == (303, "/jobs")
        assert client.get("/jobs", headers=html).status_code == 200
