"""`/guide` and `/guide/{name}`: the guide's pages, rendered from `app/guide/*.md`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from fastapi import APIRouter, Request, Response
from fastapi.responses import RedirectResponse
from markupsafe import Markup

from app import guide
from app.pages.base import Page, render, route

router = APIRouter()


@dataclass(frozen=True)
class GuidePage(Page):
    template: ClassVar[str] = "guide.html"
    place: ClassVar[str] = "guide"
    name: str
    html: Markup
    sections: tuple[guide.Section, ...]
    pages: dict[str, str]


@router.get("/guide", include_in_schema=False)
def first() -> Response:
    """The guide begins at its first page."""
    return RedirectResponse(f"/guide/{next(iter(guide.PAGES))}")


@route(router, "/guide/{name}")
def show(request: Request, name: str) -> Response:
    page = guide.render(name)
    # The text is ours, from the package; nothing of a user's goes into it.
    html = Markup(page.html)
    return render(request, GuidePage(page.title, "", name, html, page.sections, guide.PAGES))
