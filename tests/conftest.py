"""Fixtures that every part's tests share."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient
from hypothesis import settings as hypothesis_settings
from xdist.scheduler import LoadScopeScheduling

from app.db.migrate import migrate
from app.db.session import make_engine, writing
from app.ingest import IngestOptions, ingest_file
from app.main import create_app
from app.settings import Settings
from app.store.runs import add_run
from core.formats import write_run
from core.robot import RobotParams
from core.run import Run, RunMeta
from core.sensors import BeaconLog, ImuLog, RangeLog, TruthLog, WheelLog

# The same cases on every machine, and no verdict on how fast that is.
hypothesis_settings.register_profile("driftscope", deadline=None, derandomize=True)
hypothesis_settings.load_profile("driftscope")


class ByRoom(LoadScopeScheduling):  # type: ignore[misc]  # the package is not typed
    """Tests of one file go to one worker; all browser tests too, which share one server and one browser."""

    def _split_scope(self, nodeid: str) -> str:
        file = nodeid.partition("::")[0]
        return "tests/browser" if file.startswith("tests/browser/") else file


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> ByRoom:
    return ByRoom(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest work first: the browser's."""
    items.sort(key=lambda item: item.get_closest_marker("browser") is None)


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


def small_run(name: str = "lap", turn: float = 0.1, *, seconds: float = 20.0) -> Run:
    """A circle: wheels and gyro at 50 Hz (the gyro pauses once), float32 beacon, ranges and truth at 5 Hz."""
    t = np.arange(0.0, seconds, 0.02)
    fast = t[(t < 8.0) | (t > 10.0)]
    slow = t[::10]
    forward, base, radius = 0.4, 0.32, 0.075
    left, right = (forward - turn * base / 2) / radius, (forward + turn * base / 2) / radius
    x, y = forward / turn * np.sin(turn * slow), forward / turn * (1 - np.cos(turn * slow))
    return Run(
        meta=RunMeta(
            name=name,
            robot=RobotParams(wheel_radius=radius, track_width=base, ticks_per_rev=2048),
            beacons={"B1": (0.0, 0.0, 2.5), "B2": (5.0, 0.0, 2.5)},
        ),
        wheels=WheelLog(t, left * t, right * t),
        imu=ImuLog(fast, np.full(fast.shape, turn), ax=np.zeros(fast.shape)),
        beacon=BeaconLog(slow, x.astype(np.float32), y.astype(np.float32)),
        ranges=RangeLog(slow, np.arange(slow.size, dtype=np.int16) % 2, np.hypot(x, y) + 2.5, ("B1", "B2")),
        truth=TruthLog(slow, x, y, turn * slow),
    )


@pytest.fixture
def make_run() -> Callable[..., Run]:
    """`small_run`, as a fixture."""
    return small_run


@pytest.fixture
def store_run(settings: Settings, tmp_path: Path) -> Callable[..., str]:
    """Stores a core Run (default: `small_run`) as an upload would, without a job; its id."""

    def store(run: Run | None = None, **options: Any) -> str:
        path = tmp_path / "run.zip"
        path.unlink(missing_ok=True)
        write_run(run or small_run(), path, "zip-csv")
        manifest = ingest_file(settings.data, path, IngestOptions(file_name="run.zip", **options))
        engine = make_engine(settings.url)
        migrate(engine)
        with writing(engine) as session:
            run_id = add_run(session, manifest).id
        engine.dispose()
        return run_id

    return store
