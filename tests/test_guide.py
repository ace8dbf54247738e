"""The guide and the README: every page renders, every link leads somewhere, every block marked `run` runs."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

import pytest

from app import guide

ROOT = Path(__file__).resolve().parents[1]
DOCS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "app" / "guide").glob("*.md"))]
# What blocks without `run` may hold: these start servers, containers or the whole suite.
NOT_RUN = {"make run", "make test", "make check", "make bench", "docker compose up"}


def blocks(path: Path) -> Iterator[tuple[str, str, int]]:
    """(info string, code, line number) of each fenced block."""
    text = path.read_text(encoding="utf-8")
    for found in re.finditer(r"^```([^\n]*)\n(.*?)^```$", text, re.M | re.S):
        yield found[1].strip(), found[2], text[: found.start()].count("\n") + 1


@pytest.fixture(scope="module")
def server_url(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a server of its own, for blocks that speak to one."""
    data = tmp_path_factory.mktemp("guide") / "data"
    command = [sys.executable, "-m", "app.cli", "serve", "--port", "0", "--data", str(data)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT) as process:
        assert process.stdout is not None
        greeting = process.stdout.readline()
        assert greeting.startswith("Driftscope is at "), "the server did not start"
        yield greeting.split()[-1]
        process.terminate()


RUNNABLE = [
    pytest.param(info, code, id=f"{path.name}:{line}")
    for path in DOCS
    for info, code, line in blocks(path)
    if info.endswith(" run")
]


@pytest.mark.parametrize("name", guide.PAGES)
def test_page_renders_without_script_or_style(name: str) -> None:
    page = guide.render(name)
    assert page.sections or name == "start"
    assert "<script" not in page.html
    assert not re.search(r"\sstyle=", page.html)  # an attribute of its own, not MathML's displaystyle
    for math in re.findall(r"<math.*?</math>", page.html, re.S):
        ET.fromstring(math)
        assert "$" not in math


def test_table_lists_every_page() -> None:
    assert set(guide.PAGES) == {p.stem for p in (ROOT / "app" / "guide").glob("*.md")}


@pytest.mark.parametrize("path", DOCS, ids=lambda p: p.name)
def test_links_lead_somewhere(path: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", path.read_text(encoding="utf-8")):
        if re.match(r"https?://", target) or target == "/api/v1/openapi.json":
            continue
        file, _, anchor = target.partition("#")
        there = (path.parent / file) if file else path
        assert there.is_file(), f"{path.name} links to {target}"
        if anchor:
            assert anchor in {s.anchor for s in guide.render(there.stem).sections}, f"{path.name} links to {target}"


@pytest.mark.parametrize("path", DOCS, ids=lambda p: p.name)
def test_blocks_that_do_not_run_are_few(path: Path) -> None:
    for info, code, line in blocks(path):
        if info not in ("sh", "python"):
            continue
        for command in (text.partition("#")[0].strip() for text in code.splitlines()):
            assert not command or command in NOT_RUN, f"{path.name}:{line}: mark the block `{info} run`: {command}"


@pytest.mark.parametrize(("info", "code"), RUNNABLE)
def test_block_runs(info: str, code: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    (tmp_path / "app").mkdir()
    (tmp_path / "app" / "examples").symlink_to(ROOT / "app" / "examples")
    env = os.environ | {
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
    }
    if "127.0.0.1:8000" in code:
        code = code.replace("http://127.0.0.1:8000", request.getfixturevalue("server_url"))
    shell = [sys.executable, "-c"] if info.startswith("python") else [shutil.which("bash") or "sh", "-ec"]
    done = subprocess.run([*shell, code], cwd=tmp_path, env=env, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
