"""Who may ask what: host and origin checks, the token, body limits, and the headers that every answer carries."""

from __future__ import annotations

import hashlib
import hmac
from urllib.parse import urlencode, urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection, Request
from starlette.responses import RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app import errors
from app.settings import Settings
from core.errors import TooLargeError

COOKIE = "driftscope"
CSP = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
    "font-src 'self'; frame-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "Content-Security-Policy": CSP,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=()",
}
SAFE_METHODS = frozenset({"GET", "HEAD", "OPTIONS", "TRACE"})
OPEN_PATHS = ("/login", "/static/")
SMALL_BODY = 1 << 20
STREAMED = (("POST", "/api/v1/runs"), ("PATCH", "/api/v1/uploads/"))  # count for themselves: `max_upload_bytes`


def cookie_value(token: str) -> str:
    """What the cookie holds: proof of the token, not the token."""
    return hmac.new(token.encode(), b"driftscope page cookie", hashlib.sha256).hexdigest()


def same(given: str, expected: str) -> bool:
    """Whether two secrets are equal, in a time that doesn't depend on where they differ."""
    return hmac.compare_digest(given.encode("utf-8", "surrogateescape"), expected.encode())


def authorized(connection: HTTPConnection, settings: Settings) -> bool:
    """Whether the request carries the token: `Authorization: Bearer ...`, or the cookie of the login page."""
    if not settings.token:
        return True
    scheme, _, bearer = connection.headers.get("authorization", "").partition(" ")
    if scheme.lower() == "bearer" and same(bearer.strip(), settings.token):
        return True
    return same(connection.cookies.get(COOKIE, ""), cookie_value(settings.token))


def refusal(connection: HTTPConnection, settings: Settings) -> errors.ForbiddenError | None:
    """Why the request's host or origin is not ours, or None.

    A page elsewhere can make a browser send requests here: by its own name resolved to loopback (the Host header
    shows it) or straight (the Origin header shows it; browsers always send it where something could change).
    """
    host = connection.headers.get("host", "")
    if settings.is_loopback and _hostname(host) not in settings.allowed_hosts:
        return errors.ForbiddenError(
            f"this server does not answer to the host {host!r}", expected=[*settings.allowed_hosts], found=host
        )
    origin = connection.headers.get("origin")
    changing = connection.scope["type"] == "websocket" or connection.scope["method"] not in SAFE_METHODS
    if changing and origin is not None and urlsplit(origin).netloc.lower() != host.lower():
        return errors.ForbiddenError(f"requests from the origin {origin!r} are refused", expected=host, found=origin)
    return None


def _hostname(host: str) -> str:
    try:
        return urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return ""


class Guard:
    """Outermost middleware: refuses what may not come in, and puts the security headers on what goes out."""

    def __init__(self, app: ASGIApp, settings: Settings) -> None:
        self.app, self.settings = app, settings

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        refused = self._refusal(scope)
        if refused is None:
            limited = receive if scope["type"] == "websocket" else limit_body(scope, receive)
            await self.app(scope, limited, send_with_headers)
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008})
        else:
            await refused(scope, receive, send_with_headers)

    def _refusal(self, scope: Scope) -> Response | None:
        connection = HTTPConnection(scope)
        path = scope["path"]
        found: errors.ForbiddenError | errors.UnauthorizedError | TooLargeError | None
        found = refusal(connection, self.settings)
        if found is None and not path.startswith(OPEN_PATHS) and not authorized(connection, self.settings):
            found = errors.UnauthorizedError("this server asks for its token", scheme="Bearer")
        if found is None and scope["type"] == "http":
            found = _declared_too_large(scope)
        if found is None:
            return None
        if scope["type"] == "websocket":
            return Response(status_code=403)
        request = Request(scope)
        if isinstance(found, errors.UnauthorizedError) and errors.wants_page(request):
            query = f"?{request.url.query}" if request.url.query else ""
            return RedirectResponse(f"/login?{urlencode({'next': path + query})}", 303)
        return errors.response(request, errors.problem_of(found, path))


def _is_streamed(scope: Scope) -> bool:
    path: str = scope["path"]
    return any(
        scope["method"] == method and (path.startswith(where) if where.endswith("/") else path == where)
        for method, where in STREAMED
    )


def _declared_too_large(scope: Scope) -> TooLargeError | None:
    declared = Headers(scope=scope).get("content-length", "0")
    if _is_streamed(scope) or not declared.isdigit() or int(declared) <= SMALL_BODY:
        return None
    return _too_large(int(declared))


def _too_large(found: int) -> TooLargeError:
    return TooLargeError(f"the request's body is over {SMALL_BODY} bytes", expected=SMALL_BODY, found=found)


def limit_body(scope: Scope, receive: Receive) -> Receive:
    """`receive` that stops at SMALL_BODY bytes; requests that stream uploads count for themselves."""
    if _is_streamed(scope):
        return receive
    seen = 0

    async def counted() -> Message:
        nonlocal seen
        message = await receive()
        seen += len(message.get("body", b""))
        if seen > SMALL_BODY:
            raise HTTPException(413, _too_large(seen).message)  # of other errors here FastAPI makes a 400
        return message

    return counted
