"""The page of an error, and the page that asks for the token. Their routes and handlers are the application's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

from fastapi import Request, Response

from app.pages.frame import Page, render


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
