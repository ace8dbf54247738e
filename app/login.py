"""`/login`: trades the token for a cookie that pages carry; `/logout` takes it back."""

from __future__ import annotations

from urllib.parse import parse_qs, urlsplit

from fastapi import APIRouter, Request, Response
from fastapi.responses import RedirectResponse

from app.pages.base import login_page
from app.security import COOKIE, cookie_value, same
from app.settings import Settings

router = APIRouter()
COOKIE_AGE_S = 30 * 24 * 3600


@router.get("/login", name="login")
def show(request: Request, next: str = "/") -> Response:  # noqa: A002
    """The form; straight on where there is nothing to log in to."""
    settings: Settings = request.app.state.settings
    return login_page(request, _inside(next)) if settings.token else RedirectResponse(_inside(next), 303)


@router.post("/login")
async def log_in(request: Request) -> Response:
    """Check the token and set the cookie."""
    settings: Settings = request.app.state.settings
    form = parse_qs((await request.body()).decode("utf-8", "replace"), max_num_fields=10)
    onward = _inside(form.get("next", ["/"])[0])
    if settings.token and not same(form.get("token", [""])[0].strip(), settings.token):
        return login_page(request, onward, refused=True)
    response = RedirectResponse(onward, 303)
    if settings.token:
        response.set_cookie(
            COOKIE,
            cookie_value(settings.token),
            max_age=COOKIE_AGE_S,
            httponly=True,
            samesite="strict",
            secure=request.url.scheme == "https",
        )
    return response


@router.post("/logout")
def log_out() -> Response:
    """Forget the cookie."""
    response = RedirectResponse("/login", 303)
    response.delete_cookie(COOKIE, httponly=True, samesite="strict")
    return response


def _inside(target: str) -> str:
    """The target if it is a path of this server, else the start page: a link must not lead elsewhere."""
    parts = urlsplit(target.replace("\\", "/"))
    inside = not parts.scheme and not parts.netloc and target.startswith("/") and not target.startswith("//")
    return target if inside else "/"
