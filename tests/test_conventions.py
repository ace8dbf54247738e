"""House rules that a machine can check: members stand in their tables, pages have their files, git holds our own."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from core.sensors import STREAMS

ROOT = Path(__file__).resolve().parents[1]
PYTHON = sorted([*(ROOT / "core").rglob("*.py"), *(ROOT / "app").rglob("*.py")])


def tracked() -> list[str]:
    if not (ROOT / ".git").exists() or shutil.which("git") is None:
        return [str(p.relative_to(ROOT)) for d in ("core", "app", "static", "tests") for p in (ROOT / d).rglob("*.*")]
    out = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return out.splitlines()


def test_every_sensor_file_is_in_the_table_and_in_the_run() -> None:
    from core.run import Run

    files = {p.stem for p in (ROOT / "core" / "sensors").glob("*.py")} - {"__init__", "base"}
    assert files == set(STREAMS)
    assert set(STREAMS) <= set(Run.__dataclass_fields__)


def test_every_stream_and_column_is_in_the_guide() -> None:
    text = (ROOT / "app" / "guide" / "run-format.md").read_text(encoding="utf-8")
    for stream in STREAMS.values():
        row = next(line for line in text.splitlines() if line.startswith(f"| `{stream.name}`"))
        assert all(re.search(rf"\b{c.name}\b", row) for c in stream.columns), stream.name


def test_every_method_is_in_the_guide_and_has_a_colour() -> None:
    from core.estimation.pipeline import METHODS

    text = (ROOT / "app" / "guide" / "methods.md").read_text(encoding="utf-8")
    css = "".join(p.read_text(encoding="utf-8") for p in (ROOT / "static" / "css").glob("*.css"))
    for name in METHODS:
        assert f"## `{name}`" in text, name
        assert f"--method-{name.replace('+', '-')}" in css, name


def test_every_effect_is_in_the_guide() -> None:
    from core.effects import EFFECTS

    text = (ROOT / "app" / "guide" / "effects.md").read_text(encoding="utf-8")
    for effect in EFFECTS.values():
        row = next(line for line in text.splitlines() if line.startswith(f"| `{effect.id}`"))
        assert all(p.name in row for p in effect.parameters), effect.id


def test_every_page_has_its_three_files() -> None:
    stems = {p.stem for p in (ROOT / "app" / "pages").glob("*.py")} - {"__init__", "base"}
    for stem in stems:
        assert (ROOT / "app" / "templates" / f"{stem}.html").is_file(), stem
        assert (ROOT / "static" / "pages" / f"{stem}.js").is_file(), stem


def test_nothing_foreign_is_tracked() -> None:
    names = tracked()
    assert not [n for n in names if re.search(r"\.min\.(js|css)$|node_modules/|(^|/)vendor/", n)]
    large = [n for n in names if (ROOT / n).is_file() and (ROOT / n).stat().st_size > 5 << 20]
    assert not large
    locks = [ROOT / n for n in names if n.endswith((".lock", "lock.json"))]
    assert not [p.name for p in locks if re.search(r"https?://", p.read_text(encoding="utf-8"))]


@pytest.mark.parametrize("path", PYTHON, ids=lambda p: str(p.relative_to(ROOT)))
def test_module_is_documented_and_small(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    tree = ast.parse(text)
    assert not text.strip() or ast.get_docstring(tree), "a module says what it is"
    # A kernel stays one file: numba's cache looks for changes in the file of the outermost function only.
    assert text.count("\n") <= (600 if path.name.endswith("_numba.py") else 450), "a module that needs walls"
    if not path.name.endswith("_numba.py"):
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                assert (node.end_lineno or 0) - node.lineno < 60, f"{node.name} is over a screen"
