"""The run page: see a run's path and plots, zoom, toggle, export, and find the view again by its link."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit

import pytest
from playwright.sync_api import Page, expect

pytestmark = pytest.mark.browser

MAP = "[data-map]"
ERROR = '[data-chart="error-xy"]'


def open_run(page: Page, run: dict[str, Any], query: str = "view=map") -> None:
    """The page of a run, drawn; without 3D unless asked for, which has tests of its own."""
    page.goto(f"/runs/{run['id']}?{query}")
    page.wait_for_selector('html[data-ready="run"]')


def ready(page: Page, chart: str) -> None:
    page.wait_for_selector(f'{chart}[data-state="ready"]')


def range_of(page: Page, chart: str) -> tuple[float, float]:
    """The range that the plot's readings were asked for."""
    a, b = page.get_attribute(chart, "data-range").split(",")
    return float(a), float(b)


def inked(page: Page, canvas: str) -> int:
    """Different colours on a canvas: one where nothing is drawn."""
    return page.eval_on_selector(
        canvas,
        """c => new Set(new Uint32Array(c.getContext('2d').getImageData(0, 0, c.width, c.height).data.buffer)).size""",
    )


def box_of(page: Page, selector: str) -> tuple[float, float, float, float]:
    """x, y, width and height of an element, in sight."""
    page.locator(selector).scroll_into_view_if_needed()
    box = page.locator(selector).bounding_box()
    assert box is not None
    return box["x"], box["y"], box["width"], box["height"]


def zoom_by_drag(page: Page, chart: str, share0: float, share1: float) -> None:
    x, y, width, height = box_of(page, f"{chart} .u-over")
    page.mouse.move(x + share0 * width, y + height / 2)
    page.mouse.down()
    page.mouse.move(x + (share0 + share1) / 2 * width, y + height / 2)
    page.mouse.move(x + share1 * width, y + height / 2)
    page.mouse.up()


def test_path_and_plots_appear_with_the_verdict_first(page: Page, mission: dict[str, Any]) -> None:
    open_run(page, mission)
    ready(page, ERROR)
    assert re.search(r"ends .* from truth \(.*\)\.", page.inner_text("#verdict"))
    page.wait_for_selector(f'{MAP}[data-paths~="fused"][data-paths~="truth"][data-time]')
    assert inked(page, f"{MAP} canvas.map-canvas") > 20
    for chart in ("error-xy", "error-theta", "bias"):
        ready(page, f'[data-chart="{chart}"]')
        assert inked(page, f'[data-chart="{chart}"] canvas') > 5
        assert int(page.get_attribute(f'[data-chart="{chart}"]', "data-points")) > 10
    assert re.search(r"\d points$", page.inner_text(f"{ERROR} .chart-sampling"))


def test_every_stream_of_the_run_is_under_signals(page: Page, mission: dict[str, Any]) -> None:
    open_run(page, mission, "tab=signals")
    ready(page, '[data-chart="commands-v"]')
    sections = page.eval_on_selector_all("[data-stream]", "all => all.map(e => e.dataset.stream)")
    assert sections == [s["name"] for s in mission["streams"]]
    page.locator('[data-signal="imu-gz"]').scroll_into_view_if_needed()
    ready(page, '[data-chart="imu-gz"]')
    assert page.inner_text('[data-chart="imu-gz"] .chart-unit') == "°/s"


def test_methods_toggle_everywhere_at_once(page: Page, square: dict[str, Any]) -> None:
    open_run(page, square)
    ready(page, ERROR)
    chip, legend = page.locator('[data-method="encoders"].method'), page.locator(f'{ERROR} [data-series="encoders"]')
    expect(chip).to_have_attribute("aria-pressed", "true")
    chip.click()
    expect(legend).to_have_attribute("aria-pressed", "false")
    page.wait_for_selector(f'{MAP}[data-shown]:not([data-shown~="encoders"])')
    legend.click()
    expect(chip).to_have_attribute("aria-pressed", "true")
    key = chip.locator("kbd").inner_text()
    page.keyboard.press(key)
    expect(chip).to_have_attribute("aria-pressed", "false")
    page.wait_for_url(re.compile(r"[?&]m=(?!.*encoders(,|&|$))"))


def test_zoom_asks_the_server_for_finer_readings(page: Page, mission: dict[str, Any]) -> None:
    open_run(page, mission, "tab=signals")
    chart = '[data-chart="imu-gz"]'
    page.locator('[data-signal="imu-gz"]').scroll_into_view_if_needed()
    ready(page, chart)
    whole = range_of(page, chart)
    shown, total = counts(page, chart)
    assert shown < total
    sampling = page.locator(f"{chart} .chart-sampling")
    coarse = sampling.inner_text()
    with page.expect_response(lambda r: "/streams/imu" in r.url and "t0=" in r.url) as answer:
        zoom_by_drag(page, chart, 0.4, 0.5)
    asked = parse_qs(urlsplit(answer.value.url).query)
    span = float(asked["t1"][0]) - float(asked["t0"][0])
    assert span == pytest.approx((whole[1] - whole[0]) / 10, rel=0.05)
    page.wait_for_function(
        "([c, n]) => !document.querySelector(c).dataset.range.startsWith(n)", arg=[chart, f"{whole[0]:g},"]
    )
    expect(sampling).not_to_have_text(coarse)
    finer_shown, finer_total = counts(page, chart)
    assert finer_total < total / 8
    assert finer_shown / finer_total > 2 * shown / total
    page.locator(f"{chart} .u-over").dblclick()
    page.wait_for_function("c => document.querySelector(c).dataset.range.startsWith('0,')", arg=chart)
    assert range_of(page, chart) == whole


def counts(page: Page, chart: str) -> tuple[float, float]:
    """`1,000 of 16.6 M points` as numbers."""
    text = page.inner_text(f"{chart} .chart-sampling")
    numbers = [float(n.replace(",", "")) * (1e6 if m else 1) for n, m in re.findall(r"([\d,]+(?:\.\d+)?)( M)?", text)]
    return numbers[0], numbers[-1]


def test_two_fingers_zoom_and_one_pans(new_page: Callable[..., Page], mission: dict[str, Any]) -> None:
    page = new_page(has_touch=True, viewport={"width": 820, "height": 1180})
    open_run(page, mission, "tab=signals")
    chart = '[data-chart="commands-v"]'
    ready(page, chart)
    x, y, width, height = box_of(page, f"{chart} .u-over")
    devtools = page.context.new_cdp_session(page)

    def touch(kind: str, *shares: float) -> None:
        points = [{"x": x + s * width, "y": y + height / 2, "id": i} for i, s in enumerate(shares)]
        devtools.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    touch("touchStart", 0.45)
    touch("touchStart", 0.45, 0.55)
    touch("touchMove", 0.35, 0.65)
    touch("touchMove", 0.3, 0.7)
    touch("touchEnd")
    quarter = mission["duration_s"] / 4  # from a tenth of the plot between the fingers to four tenths
    page.wait_for_function(
        """([c, n]) => { const [a, b] = document.querySelector(c).dataset.range.split(",").map(Number);
                         return b - a < n; }""",
        arg=[chart, quarter * 1.02],
    )
    zoomed = range_of(page, chart)
    assert zoomed[1] - zoomed[0] == pytest.approx(quarter, rel=0.02)
    touch("touchStart", 0.5)
    touch("touchMove", 0.4)
    touch("touchMove", 0.3)
    touch("touchEnd")
    page.wait_for_function(
        "([c, n]) => Number(document.querySelector(c).dataset.range.split(',')[0]) > n", arg=[chart, zoomed[0] + 1]
    )
    panned = range_of(page, chart)
    assert panned[1] - panned[0] == pytest.approx(zoomed[1] - zoomed[0])


def test_one_range_for_all_plots(page: Page, mission: dict[str, Any]) -> None:
    open_run(page, mission)
    ready(page, ERROR)
    zoom_by_drag(page, ERROR, 0.2, 0.4)
    page.wait_for_url(re.compile(r"[?&]t0="))
    wanted = None
    for chart in ("error-xy", "error-theta", "bias"):
        page.wait_for_function(
            """c => { const e = document.querySelector(`[data-chart="${c}"]`);
                      return e.dataset.state === "ready" && !e.dataset.range.startsWith("0,"); }""",
            arg=chart,
        )
        found = range_of(page, f'[data-chart="{chart}"]')
        assert wanted is None or found == wanted
        wanted = found


def test_the_time_cursor_moves_plots_map_and_strip_together(page: Page, mission: dict[str, Any]) -> None:
    open_run(page, mission)
    ready(page, ERROR)
    x, y, width, height = box_of(page, f"{ERROR} .u-over")
    page.mouse.click(x + 0.5 * width, y + height / 2)
    page.mouse.move(5, 5)
    half = mission["t0"] + mission["duration_s"] / 2
    for selector in (ERROR, '[data-chart="bias"]', MAP, "#strip .strip-track"):
        page.wait_for_function(
            "([s, t]) => Math.abs(Number(document.querySelector(s).dataset.time) - t) < 0.02 * t", arg=[selector, half]
        )
    assert page.inner_text(f'{ERROR} [data-series="fused"] .legend-value') != "–"
    before = float(page.get_attribute(MAP, "data-time"))
    page.keyboard.press(".")
    page.wait_for_function("([s, t]) => Number(document.querySelector(s).dataset.time) > t", arg=[MAP, before])
    page.keyboard.press(" ")
    page.wait_for_function("([s, t]) => Number(document.querySelector(s).dataset.time) > t + 0.4", arg=[MAP, before])
    page.keyboard.press(" ")
    expect(page.locator(".strip-play")).to_have_attribute("aria-label", "Play")


def test_a_link_restores_the_exact_view(page: Page, new_page: Callable[..., Page], mission: dict[str, Any]) -> None:
    open_run(page, mission)
    ready(page, ERROR)
    zoom_by_drag(page, ERROR, 0.3, 0.6)
    page.wait_for_url(re.compile(r"[?&]t0="))
    page.keyboard.press("2")
    page.locator(f"{ERROR} .chart-enlarge").click()
    page.wait_for_url(re.compile(r"big=error-xy.*m=|m=.*big=error-xy"))
    ready(page, ERROR)
    other = new_page()
    other.goto(page.url)
    ready(other, ERROR)
    assert range_of(other, ERROR) == pytest.approx(range_of(page, ERROR), abs=1e-4)
    expect(other.locator('[data-multiple="error-xy"]')).to_have_class(re.compile("enlarged"))
    pressed = "all => all.map(e => e.getAttribute('aria-pressed'))"
    assert other.eval_on_selector_all(".method", pressed) == page.eval_on_selector_all(".method", pressed)
    assert other.get_attribute("#split", "data-view") == "map"


def test_metrics_sort_and_mark_the_best(page: Page, mission: dict[str, Any]) -> None:
    open_run(page, mission)
    ate = {e["method"]: e["metrics"]["ate_rmse_m"]["value"] for e in mission["estimates"]}
    names = "rows => rows.map(r => r.dataset.method)"
    head = page.locator('#metrics [data-metric="ate_rmse_m"] button')
    head.click()
    rows = page.eval_on_selector_all("#metrics tbody tr[data-method]", names)
    assert rows == sorted(ate, key=lambda m: ate[m])
    expect(page.locator("#metrics td.best").first).to_be_visible()
    head.click()
    assert page.eval_on_selector_all("#metrics tbody tr[data-method]", names) == rows[::-1]


def test_csv_holds_the_visible_range_with_units(page: Page, square: dict[str, Any]) -> None:
    open_run(page, square, "view=map&t0=10&t1=20")
    ready(page, ERROR)
    page.locator(f"{ERROR} .chart-menu summary").click()
    with page.expect_download() as download:
        page.locator(f'{ERROR} [data-export="csv"]').click()
    rows = list(csv.reader(io.StringIO(Path(download.value.path()).read_text())))
    assert rows[0][0] == "t [s]"
    assert all(re.fullmatch(r"\S+ error_xy \[m\]", name) for name in rows[0][1:])
    times = [float(r[0]) for r in rows[1:]]
    assert len(times) > 20
    assert min(times) >= 10
    assert max(times) <= 20
    assert times == sorted(times)


@pytest.mark.parametrize("kind", ["png", "svg"])
def test_pictures_of_a_plot(page: Page, square: dict[str, Any], kind: str) -> None:
    open_run(page, square)
    ready(page, ERROR)
    page.locator(f"{ERROR} .chart-menu summary").click()
    with page.expect_download() as download:
        page.locator(f'{ERROR} [data-export="{kind}"]').click()
    picture = Path(download.value.path()).read_bytes()
    assert picture.startswith(b"\x89PNG" if kind == "png" else b"<svg ")
    assert len(picture) > 3000


@pytest.fixture
def borrowed(lawn: dict[str, Any], server: Any) -> Iterator[dict[str, Any]]:
    """A run that a test may rename, tag and note; afterwards it is as others know it."""
    yield lawn
    kept = {name: lawn[name] for name in ("name", "tags", "notes")}
    server.client.patch(f"/api/v1/runs/{lawn['id']}", json=kept).raise_for_status()


def test_rename_tag_and_note_are_kept(page: Page, borrowed: dict[str, Any]) -> None:
    open_run(page, borrowed, "tab=notes")
    page.click("#rename")
    page.fill(".rename-input", "lawn in the rain")
    page.keyboard.press("Enter")
    expect(page.locator("#run-name")).to_have_text("lawn in the rain")
    page.fill(".tag-add", "wet")
    page.keyboard.press("Enter")
    expect(page.locator("#run-tags")).to_contain_text("wet")
    page.fill(".notes-area", "slips near the hedge")
    expect(page.locator(".notes [role=status]")).to_have_text("Saved.")
    page.reload()
    expect(page.locator("#run-name")).to_have_text("lawn in the rain")
    expect(page.locator("#run-tags")).to_contain_text("wet")
    expect(page.locator(".notes-area")).to_have_value("slips near the hedge")


def test_delete_can_be_undone(page: Page, lawn: dict[str, Any], server: Any) -> None:
    open_run(page, lawn, "tab=files")
    page.click("#delete")
    page.get_by_role("button", name="Undo").wait_for()
    assert server.client.get(f"/api/v1/runs/{lawn['id']}").status_code == 404
    page.get_by_role("button", name="Undo").click()
    expect(page.locator("#undo")).to_be_empty()
    assert server.client.get(f"/api/v1/runs/{lawn['id']}").status_code == 200


def test_the_odometry_is_calibrated_from_the_files_tab(page: Page, square: dict[str, Any]) -> None:
    open_run(page, square, "tab=files")
    page.click("#calibrate-odometry")
    row = page.locator("#odometry-found [data-parameter=track_width]")
    expect(row).to_contain_text("0.201")
    expect(row).to_contain_text("±")
    expect(page.locator("#odometry-found [data-parameter=gyro_scale]")).to_contain_text("no run has an imu")


def test_estimating_again_reports_progress_and_refreshes_the_page(page: Page, square: dict[str, Any]) -> None:
    open_run(page, square)
    ready(page, ERROR)
    page_loaded = datetime.now(UTC).isoformat()
    with page.expect_response(lambda r: r.url.endswith(f"/runs/{square['id']}.json")) as fresh:
        page.click("#re-estimate")
    made = {e["method"]: e["created_at"] for e in fresh.value.json()["estimates"]}
    assert all(at > page_loaded for at in made.values())
    assert set(made) == {e["method"] for e in square["estimates"]}
    expect(page.locator("#re-estimate")).to_be_enabled()
    ready(page, ERROR)
    assert page.inner_text("#verdict") == fresh.value.json()["sentence"]


def test_a_run_without_wheels_says_what_each_method_misses(page: Page, server: Any) -> None:
    rows = "\n".join(f"{i / 100},{0.001 * (i % 7)}" for i in range(500))
    files = {"run.json": '{"format": "run/1", "name": "at rest"}', "imu.csv": f"t,gz\n{rows}\n"}
    answer = server.client.post("/api/v1/runs", params={"filename": "rest.zip"}, content=zipped(files))
    run = answer.raise_for_status().json()
    open_run(page, run, "")
    expect(page.locator(".calm")).to_contain_text("No path can be estimated")
    expect(page.locator(".calm")).to_contain_text("Encoders")
    page.get_by_role("tab", name="Signals").click()
    ready(page, '[data-chart="imu-gz"]')


def zipped(files: dict[str, str]) -> bytes:
    import zipfile

    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, text in files.items():
            archive.writestr(name, text)
    return buffer.getvalue()
