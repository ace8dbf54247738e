"""The list of runs: add by drop, be told what is wrong, map columns, search, tag, delete, bring back, move by keys."""

from __future__ import annotations

import base64
import csv
import io
import json
import math
import re
import zipfile
import zlib
from pathlib import Path
from typing import Any

import pytest
from conftest import EXAMPLES, Server, Watch, zipped
from playwright.sync_api import Locator, Page, expect

pytestmark = pytest.mark.browser

SQUARE = EXAMPLES / "square-with-disturbance"

DROP = """(files) => {
  const transfer = new DataTransfer();
  for (const {name, data} of files) {
    const bytes = Uint8Array.from(atob(data), (c) => c.charCodeAt(0));
    transfer.items.add(new File([bytes], name));
  }
  for (const kind of ["dragenter", "dragover", "drop"])
    document.body.dispatchEvent(new DragEvent(kind, {dataTransfer: transfer, bubbles: true, cancelable: true}));
}"""


def drop(page: Page, files: dict[str, bytes]) -> None:
    """Drop files onto the page."""
    coded = [{"name": name, "data": base64.b64encode(data).decode()} for name, data in files.items()]
    page.evaluate(DROP, coded)


def panel(page: Page, name: str) -> Locator:
    return page.locator(f'.upload[data-file="{name}"]')


def open_list(page: Page, query: str = "") -> None:
    page.goto(f"/runs{query}")
    expect(page.locator("html")).to_have_attribute("data-ready", "runs")


def rows(page: Page) -> Locator:
    return page.locator("#table tr[data-run]")


def small_run(name: str, seconds: float = 4.0, **description: Any) -> dict[str, bytes]:
    """The files of a run that drives an arc, its own for each name: wheels and gyro, no truth."""
    speed = 4 + zlib.crc32(name.encode()) % 1000 / 1000
    t = [i / 20 for i in range(int(seconds * 20))]
    robot = {"wheel_radius": 0.05, "track_width": 0.3, "ticks_per_rev": 2048}
    meta = {"format": "run/1", "name": name, "robot": robot, **description}
    wheels = "t,left,right\n" + "".join(f"{x},{speed * x},{(speed + 1) * x}\n" for x in t)
    imu = "t,gz\n" + "".join(f"{x},{0.05 / 0.3 + 1e-4 * math.sin(x)}\n" for x in t)
    return {"run.json": json.dumps(meta).encode(), "wheels.csv": wheels.encode(), "imu.csv": imu.encode()}


def store(server: Server, tmp_path: Path, name: str, **options: str) -> dict[str, Any]:
    """A small run in the store, estimated."""
    folder = tmp_path / name.replace(" ", "-")
    folder.mkdir()
    for file, data in small_run(name).items():
        (folder / file).write_bytes(data)
    return server.upload(folder, **options)


def test_a_dropped_run_is_sent_read_and_can_be_opened(page: Page, server: Server) -> None:
    open_list(page)
    drop(page, {"square.zip": zipped(SQUARE)})
    added = panel(page, "square.zip")
    expect(added).to_have_attribute("data-state", "stored")
    expect(added.locator(".chip:not(.absent)")).to_have_text(["whl", "tru"])
    added.get_by_role("link", name="Open").click()
    page.wait_for_url(re.compile(r"/runs/[0-9a-f]{16}"))
    assert server.client.get(f"/api/v1{page.url.partition('?')[0].removeprefix(server.url)}").status_code == 200


def test_the_files_of_a_folder_dropped_together_are_one_run(page: Page) -> None:
    open_list(page)
    drop(page, small_run("loose files"))
    expect(panel(page, "run")).to_have_attribute("data-state", "stored")
    expect(page.locator("#table")).to_contain_text("loose files")


def test_a_lost_connection_is_taken_up_where_it_broke(page: Page, watch: Watch) -> None:
    watch.allow.append("net::ERR_CONNECTION_RESET")
    sent: list[int] = []

    def flaky(route: Any) -> None:
        sent.append(int(route.request.headers["upload-offset"]))
        if len(sent) in (1, 3):
            route.abort("connectionreset")
        else:
            route.continue_()

    open_list(page)
    page.route("**/api/v1/uploads/*", lambda r: flaky(r) if r.request.method == "PATCH" else r.continue_())
    files = small_run("long corridor", 400)
    files["imu.csv"] = b"t,gz\n" + b"".join(b"%.3f,%.17f\n" % (i / 1000, i * 1e-9) for i in range(400_000))
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    chooser = {"name": "corridor.zip", "mimeType": "application/zip", "buffer": buffer.getvalue()}
    page.set_input_files("#files", files=[chooser])
    expect(panel(page, "corridor.zip")).to_have_attribute("data-state", "stored")
    assert sent[:3] == [0, 0, 8 << 20] and sent[3] == 8 << 20


def test_a_broken_file_is_refused_with_stream_row_and_column(page: Page, server: Server) -> None:
    files = small_run("broken")
    lines = files["imu.csv"].splitlines()
    lines[17] = b"0.8,abc"
    open_list(page)
    before = server.client.get("/runs.json").json()["stored"]
    drop(page, {**files, "imu.csv": b"\n".join(lines) + b"\n"})
    refused = panel(page, "run")
    expect(refused).to_have_attribute("data-state", "failed")
    note = refused.locator(".note")
    expect(note.locator('[data-where="stream"]')).to_contain_text("imu")
    expect(note.locator('[data-where="row"]')).to_contain_text("17")
    expect(note.locator('[data-where="column"]')).to_contain_text("gz")
    expect(note.locator('[data-where="found"]')).to_contain_text("abc")
    assert server.client.get("/runs.json").json()["stored"] == before


def test_a_foreign_table_asks_what_its_columns_are_and_remembers(page: Page, server: Server) -> None:
    head = "time_ms,gyro_z_dps,enc_a,enc_b,battery\n"
    log = head + "".join(f"{i * 10},{-9.5 + 1e-3 * (i % 7)},{i * 13},{i * 16},12.1\n" for i in range(300))
    open_list(page)
    drop(page, {"hall.csv": log.encode()})
    step = panel(page, "hall.csv")
    expect(step).to_have_attribute("data-state", "mapping")
    go = step.get_by_role("button", name="Read with these columns")
    expect(step.get_by_label("What time_ms is")).to_have_value("t")
    expect(step.get_by_label("Unit of time_ms")).to_have_value("ms")
    step.get_by_label("What gyro_z_dps is").select_option("imu.gz")
    step.get_by_label("Unit of gyro_z_dps").select_option("deg/s")
    step.get_by_label("Sign of gyro_z_dps").select_option("-1")
    expect(step.locator('tr[data-column="gyro_z_dps"]')).to_contain_text("0.1658 rad/s")
    step.get_by_label("What enc_a is").select_option("wheels.left")
    expect(step.locator("[role=status].note")).to_contain_text("wheels needs right too")
    expect(go).to_be_disabled()
    step.get_by_label("What enc_b is").select_option("wheels.right")
    for column in ("enc_a", "enc_b"):
        step.get_by_label(f"Unit of {column}").select_option("ticks")
    expect(go).to_be_disabled()
    for field, value in {"Wheel radius": "0.05", "Track width": "0.3", "Encoder ticks per turn": "2048"}.items():
        step.get_by_label(field).fill(value)
        step.get_by_label(field).press("Tab")
    step.get_by_label("Remember this mapping as").fill("hall logger")
    go.click()
    expect(step).to_have_attribute("data-state", "stored")

    run_id = (step.get_by_role("link", name="Open").get_attribute("href") or "").rpartition("/")[2]
    shown = server.client.get(f"/api/v1/runs/{run_id}/streams/imu", params={"columns": "gz"}).json()["series"][0]
    assert math.isclose(shown["y"][0], math.radians(9.5), rel_tol=1e-5)
    assert math.isclose(shown["t"][-1], 2.99, rel_tol=1e-9)
    wheels = server.client.get(f"/api/v1/runs/{run_id}/streams/wheels", params={"columns": "right"}).json()["series"][0]
    assert math.isclose(wheels["y"][-1], 299 * 16 / 2048 * 2 * math.pi, rel_tol=1e-6)

    again = head + "".join(f"{i * 10},{-3.5 + 1e-3 * (i % 5)},{i * 3},{i * 6},12.0\n" for i in range(200))
    drop(page, {"hall-2.csv": again.encode()})
    second = panel(page, "hall-2.csv")
    second.get_by_label("Saved mapping").select_option("hall logger")
    expect(second.get_by_label("Unit of gyro_z_dps")).to_have_value("deg/s")
    expect(second.get_by_label("Encoder ticks per turn")).to_have_value("2048")
    second.get_by_role("button", name="Read with these columns").click()
    expect(second).to_have_attribute("data-state", "stored")


def test_search_and_facets_narrow_the_list_and_are_in_the_address(
    page: Page, square: dict[str, Any], mission: dict[str, Any]
) -> None:
    open_list(page)
    page.keyboard.press("/")
    page.keyboard.type("tag:square")
    expect(rows(page)).to_have_count(1)
    expect(rows(page)).to_contain_text(square["name"])
    expect(page).to_have_url(re.compile(r"\?q=tag%3Asquare$"))
    expect(page.locator("#verdict")).to_contain_text("1 of ")
    page.fill("#search", "")
    expect(page).to_have_url(re.compile(r"/runs$"))
    page.locator('[data-facet="has"] button', has_text="beacon").click()
    expect(page.locator("#search")).to_have_value("has:beacon")
    expect(rows(page).filter(has_text=square["name"])).to_have_count(0)
    expect(page.locator(f'#table tr[data-run="{mission["id"]}"]')).to_have_count(1)
    page.reload()
    expect(page.locator('[data-facet="has"] button[aria-pressed="true"]')).to_have_text(re.compile("beacon"))
    page.fill("#search", "tag:no-such-tag")
    expect(page.locator("#nothing")).to_contain_text("No run matches")
    page.get_by_role("button", name="Clear search").click()
    expect(rows(page).filter(has_text=square["name"])).to_have_count(1)


def test_columns_sort(page: Page, server: Server, square: dict[str, Any], mission: dict[str, Any]) -> None:
    open_list(page)
    page.get_by_role("button", name="Length").click()
    expect(page.locator("th.col-length")).to_have_attribute("aria-sort", "descending")
    listed = server.client.get("/api/v1/runs", params={"sort": "-duration_s"}).json()["items"]
    expect(rows(page).first).to_have_attribute("data-run", listed[0]["id"])
    page.get_by_role("button", name="Length").click()
    expect(page.locator("th.col-length")).to_have_attribute("aria-sort", "ascending")


def test_tags_are_edited_in_the_row(page: Page, server: Server, tmp_path: Path) -> None:
    run = store(server, tmp_path, "tagged lap")
    open_list(page, "?q=tagged")
    page.keyboard.press("j")
    page.keyboard.press("t")
    field = page.get_by_label("Tags of tagged lap")
    expect(field).to_be_focused()
    field.fill("wet, night shift")
    field.press("Enter")
    expect(rows(page).locator(".tag")).to_have_text(["night shift", "wet"])
    assert server.client.get(f"/api/v1/runs/{run['id']}").json()["tags"] == ["night shift", "wet"]
    rows(page).locator(".tag", has_text="wet").click()
    expect(page.locator("#search")).to_have_value("tagged tag:wet")


def test_a_deleted_run_can_be_brought_back(page: Page, server: Server, tmp_path: Path) -> None:
    store(server, tmp_path, "mistaken lap")
    open_list(page, "?q=mistaken")
    page.keyboard.press("j")
    page.keyboard.press("Delete")
    expect(page.locator("#undo")).to_contain_text("Deleted “mistaken lap”")
    expect(rows(page)).to_have_count(0)
    page.keyboard.press("u")
    expect(rows(page)).to_have_count(1)
    page.keyboard.press("j")
    page.keyboard.press("Delete")
    expect(rows(page)).to_have_count(0)
    page.reload()
    page.locator("#show-deleted").click()
    page.locator("#deleted tr", has_text="mistaken lap").get_by_role("button", name="Bring back").click()
    expect(rows(page)).to_have_count(1)


def test_keys_move_select_and_open(page: Page, server: Server, square: dict[str, Any], mission: dict[str, Any]) -> None:
    open_list(page)
    ids = [row.get_attribute("data-run") for row in rows(page).all()]
    page.keyboard.press("j")
    page.keyboard.press("j")
    expect(page.locator("tr.active")).to_have_attribute("data-run", ids[1] or "")
    page.keyboard.press("k")
    page.keyboard.press("x")
    expect(page.locator("tr.selected")).to_have_attribute("data-run", ids[0] or "")
    expect(page.locator("#compare")).to_be_disabled()
    page.keyboard.press("Enter")
    page.wait_for_url(f"**/runs/{ids[0]}*")


def test_the_list_goes_out_as_csv(page: Page, square: dict[str, Any]) -> None:
    open_list(page, "?q=tag:square")
    with page.expect_download() as download:
        page.keyboard.press("e")
    lines = list(csv.DictReader(Path(download.value.path()).read_text(encoding="utf-8").splitlines()))
    assert [line["id"] for line in lines] == [square["id"]]
    assert math.isclose(float(lines[0]["best_ate_m"]), square["best"]["ate_rmse_m"])
