"""The server's own robot: offered to its own user or where it was asked for, and to nobody else."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.errors import ForbiddenError
from app.settings import Settings
from app.virtual_robot import VirtualRobot


def robot(**settings: object) -> VirtualRobot:
    made = VirtualRobot(Settings(data=Path(), **settings))  # type: ignore[arg-type]
    made.address = "http://127.0.0.1:1"
    return made


def test_a_server_for_others_has_one_only_where_it_was_asked_for() -> None:
    assert robot().available
    assert robot(host="0.0.0.0", token="t", demo=True).available
    production = robot(host="0.0.0.0", token="t")
    assert not production.available
    with pytest.raises(ForbiddenError, match="driftscope robot --to"):
        production.start()
    assert not production.running


def test_none_is_offered_before_the_server_listens() -> None:
    waiting = robot()
    waiting.address = ""
    assert not waiting.available
    waiting.stop()  # there is none: nothing to do
