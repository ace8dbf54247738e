"""The IMU tab and the calibrations: what the gyro is worth, seen; a calibration, chosen, applied and taken away."""

from __future__ import annotations

import csv
import io
import json
import re
import zipfile
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Page, expect

pytestmark = pytest.mark.browser

MODEL = {
    "schema": "calibration/1",
    "gyro": {"static_bias": [0.0, 0.0, 0.004], "noise_sd": [0.0013, 0.0013, 0.0013]},
    "accel": {"static_bias": [0.0, 0.0, 0.01]},
}


def open_imu(page: Page, run: dict[str, Any], query: str = "") -> None:
    page.goto(f"/runs/{run['id']}?tab=imu{query}")
    page.wait_for_selector('.imu[data-state="ready"]')


def chart(page: Page, name: str) -> str:
    """A chart of the tab, scrolled to and drawn."""
    section = {"signal": "signal", "bias": "bias", "heading": "heading", "error": "heading", "allan": "allan"}
    section |= {"histogram": "statistics", "probability": "statistics", "temperature": "temperature"}
    page.locator(f"#imu-{section[name]}-section").scroll_into_view_if_needed()
    selector = f'[data-chart="imu-{name}"]'
    page.wait_for_selector(f'{selector}[data-state="ready"]')
    page.locator(selector).evaluate("e => e.scrollIntoView({block: 'nearest'})")  # it may be drawn anew meanwhile
    return selector


def inked(page: Page, canvas: str) -> int:
    return page.eval_on_selector(
        canvas,
        """c => new Set(new Uint32Array(c.getContext('2d').getImageData(0, 0, c.width, c.height).data.buffer)).size""",
    )


def drag(page: Page, selector: str, share0: float, share1: float) -> None:
    box = page.locator(f"{selector} .u-over").bounding_box()
    assert box is not None
    y = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + share0 * box["width"], y)
    page.mouse.down()
    page.mouse.move(box["x"] + (share0 + share1) / 2 * box["width"], y)
    page.mouse.move(box["x"] + share1 * box["width"], y)
    page.mouse.up()


def test_the_sentence_then_every_plot(page: Page, mission: dict[str, Any]) -> None:
    open_imu(page, mission)
    expect(page.locator("#imu-verdict")).to_have_text(
        re.compile(r"Gyro z: \S+ °/s/√Hz white .* bias moved .*; best heading ends \S+° from truth, C \S+°\.")
    )
    for name in ("signal", "bias", "heading", "error", "allan", "histogram", "probability", "temperature"):
        selector = chart(page, name)
        assert inked(page, f"{selector} canvas") > 5, name
        assert int(page.get_attribute(selector, "data-points") or 0) > 5, name
    rows = page.locator("#imu-methods tbody tr")
    assert rows.evaluate_all("all => all.map(r => r.dataset.biasMethod)") == ["A", "B", "C", "best", "smoothed"]
    white = page.locator('[data-term-row="N"]')
    expect(white).to_contain_text("rad/s/√Hz")
    expect(white).to_contain_text("°/√h")
    expect(white).to_contain_text("√2")  # the one-sided figure says how it comes about
    marks = page.locator('[data-chart="imu-bias"] .legend-item').evaluate_all("all => all.map(e => e.dataset.series)")
    assert marks[:3] == ["accepted", "rejected_by_range", "rejected_by_average"]


def test_axis_methods_and_segments_are_in_the_link(page: Page, mission: dict[str, Any]) -> None:
    page.goto(f"/runs/{mission['id']}?tab=bias")  # as links said before
    page.wait_for_selector('.imu[data-state="ready"]')
    bias = chart(page, "bias")
    page.locator('[data-bias="A"]').click()
    for name in ("bias", "heading", "error"):
        expect(page.locator(f'{chart(page, name)} [data-series="A"]')).to_have_attribute("aria-pressed", "false")
    chart(page, "bias")
    page.locator("#imu-focus").select_option("C")
    page.locator('[data-axis="ax"]').click()
    page.wait_for_url(re.compile(r"tab=imu.*axis=ax.*seg=C.*off=A"))
    expect(page.locator(f"{chart(page, 'allan')} .chart-unit")).to_have_text("m/s²")
    page.reload()
    page.wait_for_selector('.imu[data-state="ready"]')
    expect(page.locator('[data-axis="ax"]')).to_have_attribute("aria-pressed", "true")
    chart(page, "bias")
    expect(page.locator(f'{bias} [data-series="A"]')).to_have_attribute("aria-pressed", "false")
    expect(page.locator("#imu-focus")).to_have_value("C")


def test_a_dragged_range_is_the_stretch(page: Page, mission: dict[str, Any]) -> None:
    open_imu(page, mission)
    chart(page, "histogram")
    expect(page.locator("#imu-stretch")).to_contain_text("the longest rest")
    drag(page, chart(page, "signal"), 0.0, 0.1)
    page.wait_for_url(re.compile(r"[?&]t1="))
    expect(page.locator("#imu-stretch")).to_contain_text("the range that you look at")
    chart(page, "histogram")
    readings = int(re.search(r"^([\d,]+) readings", page.inner_text("#imu-stretch"))[1].replace(",", ""))  # type: ignore[index]
    assert readings == pytest.approx(mission["duration_s"] * 100 / 10, rel=0.05)
    expect(page.locator('[data-statistic="kurtosis"] td')).to_have_text(re.compile(r"\d"))


def test_the_allan_plot_leaves_as_csv_and_drawing(page: Page, mission: dict[str, Any]) -> None:
    open_imu(page, mission)
    allan = chart(page, "allan")
    for kind in ("csv", "svg"):
        page.locator(f"{allan} .chart-menu summary").click()
        with page.expect_download() as download:
            page.locator(f'{allan} [data-export="{kind}"]').click()
        text = Path(download.value.path()).read_text()
        if kind == "svg":
            assert text.startswith("<svg ") and text.count("<path") > 4
            continue
        rows = list(csv.reader(io.StringIO(text)))
        assert rows[0][0] == "averaging time τ [s]" and rows[0][1] == "adev [rad/s]"
        column = [float(r[1]) for r in rows[1:] if r[1]]
        assert len(column) > 20 and max(column) < 0.01  # SI, though the plot is in °/h


def test_what_a_run_cannot_show_says_why(page: Page, server: Any, square: dict[str, Any]) -> None:
    open_imu(page, square)
    expect(page.locator(".imu .calm")).to_contain_text("No IMU")
    rows = "\n".join(f"{i / 100},0.001,{0.001 * (i % 7)}" for i in range(450))
    files = {"run.json": '{"format": "run/1", "name": "dead z"}', "imu.csv": f"t,gz,gx\n{rows}\n"}
    answer = server.client.post("/api/v1/runs", params={"filename": "dead.zip"}, content=zipped(files))
    run = answer.raise_for_status().json()
    open_imu(page, run)
    page.wait_for_selector("#imu-allan-section [role=alert]")  # the analysis may come while we look
    expect(page.locator("#imu-allan-section")).to_contain_text("equal")
    expect(page.locator("#imu-heading-section")).to_contain_text("no reference heading")
    page.locator('[data-axis="gx"]').click()
    chart(page, "allan")


def test_a_calibration_is_uploaded_applied_and_deleted(page: Page, mission: dict[str, Any], tmp_path: Path) -> None:
    broken, good = tmp_path / "broken.json", tmp_path / "spare.json"
    broken.write_text(json.dumps({**MODEL, "gyro": {"static_bias": [1, 2]}}))
    good.write_text(json.dumps(MODEL))
    page.goto("/calibrations")
    page.wait_for_selector('html[data-ready="calibrations"]')
    page.locator("#upload-form input[type=file]").set_input_files(broken)
    page.locator("#upload-form button").click()
    expect(page.locator("#upload-form [role=alert]")).to_contain_text("gyro.static_bias")
    page.locator("#upload-form input[type=file]").set_input_files(good)
    page.locator("#upload-form button").click()
    page.wait_for_selector('html[data-ready="calibration"]')
    expect(page.locator('#numbers-gyro [data-axis="gz"]')).to_contain_text("0.2292")  # °/s
    page.locator('[aria-label="Name"]').fill("spare part")
    page.keyboard.press("Enter")
    expect(page.locator("#calibration-name")).to_have_text("spare part")
    with page.expect_download() as download:
        page.locator('[data-file="kalibr-imu.yaml"]').click()
    assert "gyroscope_noise_density: 1.3" in Path(download.value.path()).read_text()
    here = page.url
    open_imu(page, mission)
    page.locator("#imu-calibration-section").scroll_into_view_if_needed()
    page.locator("#imu-calibration").select_option(label="spare part")
    expect(page.locator("#imu-calibration-section")).to_contain_text("Gyro z reads")
    page.get_by_role("button", name="Make the corrected run").click()
    page.locator("#corrected-run").click()
    page.wait_for_selector('html[data-ready="run"]')
    expect(page.locator("#run-name")).to_contain_text("(corrected)")
    page.goto(here)
    page.click("#delete-calibration")
    page.get_by_role("button", name="Delete for good").click()
    page.wait_for_url(re.compile("/calibrations$"))
    expect(page.locator("#calibrations")).not_to_contain_text("spare part")


def zipped(files: dict[str, str]) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, text in files.items():
            archive.writestr(name, text)
    return buffer.getvalue()
