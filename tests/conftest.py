"""Fixtures that every part's tests share."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from app.main import create_app
from app.settings import Settings


@pytest.fixture
def settings(tmp_path: Path) -> Settings:
    """A server of this machine only, with an empty data folder; it answers to the test client's host name too."""
    return Settings(data=tmp_path / "data", workers=1, allowed_hosts=("testserver", "127.0.0.1", "localhost", "::1"))


@pytest.fixture
def app(settings: Settings) -> FastAPI:
    return create_app(settings)


@pytest.fixture
def client(app: FastAPI) -> Iterator[TestClient]:
    """A client of a started server; errors of the server come back as its answers, as they would to a user."""
    with TestClient(app, raise_server_exceptions=False) as client:
        yield client


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of larger recorded sets beside the project."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("the larger recorded sets are not beside this checkout")
    return folder
