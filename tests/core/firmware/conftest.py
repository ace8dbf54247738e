"""The firmware's tests need compilers and an emulator: without them they fail with the names of what to install."""

from __future__ import annotations

import pytest

from tests.core.firmware import install


@pytest.fixture(scope="session", autouse=True)
def tools() -> None:
    lacking = install.missing()
    if lacking:
        pytest.fail(f"install {' '.join(lacking)} first: python tests/core/firmware/install.py", pytrace=False)
