"""Fixtures that every part's tests share."""

from __future__ import annotations

from pathlib import Path

import pytest

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The larger recorded sets beside the project; tests that need them are marked `shared`."""
    if not SHARED_DATA.is_dir():
        pytest.skip("the recorded sets are not beside the project")
    return SHARED_DATA
