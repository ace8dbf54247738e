"""`/calibrations/{id}`: one IMU calibration, what it stands on, and how to take it elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from fastapi import APIRouter, Request, Response

from app.api.calibrations import detail
from app.db.session import reading
from app.pages.base import Page, render, route
from app.store import calibrations as store

router = APIRouter()


@dataclass(frozen=True)
class CalibrationPage(Page):
    """`calibration`, as the API has it."""

    template: ClassVar[str] = "calibration.html"
    place: ClassVar[str] = "calibrations"
    calibration: dict[str, Any]


@route(router, "/calibrations/{calibration_id}")
def calibration(request: Request, calibration_id: str) -> Response:
    with reading(request.app.state.engine) as session:
        found = detail(store.get_calibration(session, calibration_id))
    page = CalibrationPage(found.name, found.sentence, found.model_dump(mode="json"))
    return render(request, page)
