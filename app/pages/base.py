"""What all pages share: the frame around them, and one context rendered as HTML or as its JSON twin."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import metadata
from typing import Any, ClassVar, TypeVar

from fastapi import APIRouter, Request, Response
from fastapi.encoders import jsonable_encoder
from fastapi.responses import HTMLResponse, JSONResponse
from jinja2 import Environment, FileSystemLoader, StrictUndefined, select_autoescape
from markupsafe import Markup

from app.paths import STATIC, TEMPLATES

THEMES = ("auto", "dark", "light")
_IMPORT = re.compile(r"""^(?:import|export)\b[^;]*?["'](\.[^"']+)["']""", re.MULTILINE)
Handler = TypeVar("Handler", bound=Callable[..., Any])


@dataclass(frozen=True)
class Place:
    """One entry of the rail."""

    name: str
    label: str
    path: str


RAIL = (
    Place("runs", "Runs", "/runs"),
    Place("live", "Live", "/live"),
    Place("compare", "Compare", "/compare"),
    Place("sandbox", "Sandbox", "/sandbox"),
    Place("diagnoses", "Diagnoses", "/diagnoses"),
    Place("calibrations", "Calibrate", "/calibrations"),
    Place("jobs", "Jobs", "/jobs"),
    Place("guide", "Guide", "/guide"),
    Place("about", "About", "/about"),
)


@dataclass(frozen=True)
class Page:
    """What every page says: its title, and the sentence a colleague could repeat. Subclasses add the evidence.

    `template` is the file in `app/templates`; `place` the entry of the rail that is lit.
    """

    template: ClassVar[str]
    place: ClassVar[str] = ""
    title: str
    sentence: str


@cache
def version() -> str:
    """The version of the installed package."""
    try:
        return metadata.version("driftscope")
    except metadata.PackageNotFoundError:
        return "unknown"


def data_block(value: Any) -> Markup:
    """`value` as the text of a `<script type="application/json">`: nothing in it can close the element."""
    text = json.dumps(jsonable_encoder(value), allow_nan=False, separators=(",", ":"))
    return Markup(text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e"))


@cache
def environment() -> Environment:
    """The Jinja2 environment of all templates; an undefined name is an error."""
    env = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=select_autoescape(default=True),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    env.filters["data_block"] = data_block
    env.globals.update(rail=RAIL, version=version())
    return env


@cache
def modules(template: str) -> tuple[str, ...]:
    """The scripts of a page under `static/`, imports of imports included; none for a page without a script."""
    found: list[str] = []
    waiting = [STATIC / "lib" / "frame.js", STATIC / "pages" / f"{template.removesuffix('.html')}.js"]
    while waiting:
        path = waiting.pop(0)
        name = path.relative_to(STATIC).as_posix()
        if name in found or not path.is_file():
            continue
        found.append(name)
        if not name.startswith("vendor/"):
            waiting += [(path.parent / i).resolve() for i in _IMPORT.findall(path.read_text(encoding="utf-8"))]
    return tuple(found)


def as_dict(page: Page) -> dict[str, Any]:
    """The context as plain data: what the template gets and what the JSON twin says."""
    return {f.name: getattr(page, f.name) for f in dataclasses.fields(page)}


def render(request: Request, page: Page, status: int = 200) -> Response:
    """The page as HTML, or as JSON where the path ends in `.json`."""
    if request.url.path.endswith(".json"):
        return JSONResponse(jsonable_encoder(as_dict(page)), status_code=status)
    return HTMLResponse(html(request, page), status_code=status, headers={"Cache-Control": "no-cache"})


def html(request: Request, page: Page) -> str:
    """The page in its frame, in the reader's colours."""
    theme = request.cookies.get("theme", "auto")
    template = environment().get_template(page.template)
    shown = theme if theme in THEMES else "auto"
    return template.render(
        as_dict(page), place=page.place, theme=shown, request=request, modules=modules(page.template)
    )


def route(router: APIRouter, path: str) -> Callable[[Handler], Handler]:
    """Serve a handler at `path.json` (first, or `/runs/{id}` would swallow it) and at `path`, outside the API."""

    def add(handler: Handler) -> Handler:
        for p in (f"{path}.json", path):
            router.add_api_route(p, handler, methods=["GET"], include_in_schema=False, response_model=None)
        return handler

    return add


@dataclass(frozen=True)
class ErrorPage(Page):
    """A problem as RFC 9457 has it, for people: `sentence` is its detail."""

    template: ClassVar[str] = "error.html"
    status: int = 500
    code: str = "error"
    where: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class LoginPage(Page):
    """Asks for the token; `next` is the path to go to afterwards."""

    template: ClassVar[str] = "login.html"
    next: str = "/"


def error_page(
    request: Request, status: int, title: str, detail: str, code: str = "error", where: Mapping[str, Any] | None = None
) -> Response:
    """The error page of a problem."""
    return render(request, ErrorPage(title, detail, status, code, where or {}), status)


def login_page(request: Request, next_path: str = "/", refused: bool = False) -> Response:
    """The login page: a form that posts `token` and `next` to `/login`."""
    sentence = (
        "That token is not the one this server was started with."
        if refused
        else "This server listens beyond its own machine, so it asks for its token."
    )
    return render(request, LoginPage("Log in", sentence, next_path), 401)
