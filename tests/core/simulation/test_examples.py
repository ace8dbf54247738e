"""The example runs: they read, they stay small, and the simulated one is what its script makes."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest

from core.formats import read_run

EXAMPLES = Path(__file__).resolve().parents[3] / "app" / "examples"
NAMES = ("lawn-mower-with-uwb", "simulated-mission", "square-with-disturbance")


def test_examples_are_three_small_runs_each_with_its_page() -> None:
    assert sorted(p.parent.name for p in EXAMPLES.glob("*/run.json")) == sorted(NAMES)
    assert sum(p.stat().st_size for p in EXAMPLES.rglob("*") if p.is_file()) < 3_000_000
    listed = (EXAMPLES / "README.md").read_text()
    for name in NAMES:
        page = (EXAMPLES / f"{name}.md").read_text()
        assert "**Licence**" in page and f"({name}.md)" in listed


@pytest.mark.parametrize("name", NAMES)
def test_example_reads_without_a_warning(name: str) -> None:
    run = read_run(EXAMPLES / name)
    assert run.meta.name and run.truth is not None and run.wheels is not None and run.duration > 60.0


def test_script_makes_the_committed_run() -> None:
    made = runpy.run_path(str(EXAMPLES / "make_simulated.py"))["make"]()
    stored = read_run(EXAMPLES / "simulated-mission")
    assert made.logs().keys() == stored.logs().keys()
    for name, log in made.logs().items():
        other = stored.logs()[name].columns()
        for column, values in log.columns().items():
            np.testing.assert_allclose(values, other[column], rtol=0, atol=1e-5, err_msg=f"{name}.{column}")
