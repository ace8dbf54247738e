"""Who is let in: hosts, origins, the token; what every answer carries; how large a body may be."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from fastapi import FastAPI, WebSocket
from fastapi.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from app.main import create_app
from app.security import CSP, SMALL_BODY
from app.settings import Settings
from core.errors import ParameterError

TOKEN = "correct horse battery staple"
API = "/api/v1"


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FastAPI]:
    """A server beyond loopback, with a token and a websocket of its own."""
    app = create_app(Settings(data=tmp_path_factory.mktemp("guarded"), host="0.0.0.0", token=TOKEN))
    add_echo(app)
    with TestClient(app):
        yield app


@pytest.fixture(scope="module")
def local(tmp_path_factory: pytest.TempPathFactory) -> Iterator[FastAPI]:
    app = create_app(Settings(data=tmp_path_factory.mktemp("local")))
    add_echo(app)
    with TestClient(app):
        yield app


def add_echo(app: FastAPI) -> None:
    @app.websocket("/test/echo")
    async def echo(socket: WebSocket) -> None:
        await socket.accept()
        await socket.send_text("in")
        await socket.close()


def visitor(app: FastAPI, base: str = "http://robot.lan:8000", **headers: str) -> TestClient:
    return TestClient(app, base_url=base, headers=headers, raise_server_exceptions=False, follow_redirects=False)


@pytest.mark.parametrize("host", ["0.0.0.0", "::", "192.168.1.5", "robot.lan"])
def test_no_token_no_listening_beyond_loopback(host: str) -> None:
    with pytest.raises(ParameterError, match="without a token"):
        Settings(host=host)
    assert Settings(host=host, token=TOKEN).token == TOKEN


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "localhost", "127.8.0.1"])
def test_loopback_needs_none(host: str) -> None:
    assert Settings(host=host).is_loopback


@pytest.mark.parametrize("scheme", ["", "Bearer wrong", f"Basic {TOKEN}", f"Bearer {TOKEN}x", "Bearer ", "Bearer é"])
def test_the_api_asks_for_the_token(guarded: FastAPI, scheme: str) -> None:
    answer = visitor(guarded).get(f"{API}/runs", headers={"Authorization": scheme.encode()} if scheme else {})
    assert answer.status_code == 401 and answer.json()["code"] == "unauthorized"
    assert answer.headers["www-authenticate"].startswith("Bearer")
    assert "items" not in answer.text


def test_the_bearer_is_let_in(guarded: FastAPI) -> None:
    assert visitor(guarded, Authorization=f"bearer {TOKEN}").get(f"{API}/runs").status_code == 200


@pytest.mark.parametrize("path", [f"{API}/openapi.json", "/runs.json", "/scene/x/", "/nothing", f"{API}/jobs/events"])
def test_nothing_else_is_open(guarded: FastAPI, path: str) -> None:
    assert visitor(guarded).get(path).status_code == 401


def test_login_by_cookie(guarded: FastAPI) -> None:
    client = visitor(guarded, Accept="text/html")
    sent_away = client.get("/runs?q=a b")
    assert sent_away.status_code == 303 and sent_away.headers["location"].startswith("/login?next=%2Fruns%3Fq%3D")
    form = client.get(sent_away.headers["location"])
    assert form.status_code == 401 and "<form" in form.text
    assert client.get("/static/css/base.css").status_code == 200
    refused = client.post("/login", content="token=wrong&next=/runs")
    assert refused.status_code == 401 and "set-cookie" not in refused.headers
    let_in = client.post("/login", content=f"token={TOKEN.replace(' ', '+')}&next=/runs")
    assert let_in.status_code == 303 and let_in.headers["location"] == "/runs"
    cookie = let_in.headers["set-cookie"]
    assert "HttpOnly" in cookie and "SameSite=strict" in cookie and TOKEN not in cookie
    assert client.get("/runs").status_code == 200
    client.post("/logout")
    assert client.get("/runs").status_code == 303


@pytest.mark.parametrize("target", ["//evil.example", "https://evil.example/x", "/\\evil.example", "javascript:1", "x"])
def test_login_leads_nowhere_else(guarded: FastAPI, target: str) -> None:
    answer = visitor(guarded).post("/login", data=None, content=f"token={TOKEN}&next={target}")
    assert answer.headers["location"] == "/"


@pytest.mark.parametrize("cookie", ["x", TOKEN.replace(" ", ""), "0" * 64])
def test_a_made_up_cookie_is_refused(guarded: FastAPI, cookie: str) -> None:
    assert visitor(guarded, Cookie=f"driftscope={cookie}").get(f"{API}/runs").status_code == 401


@pytest.mark.parametrize("host", ["127.0.0.1", "127.0.0.1:8000", "localhost:1234", "[::1]:8000", "LOCALHOST"])
def test_loopback_answers_to_its_own_names(local: FastAPI, host: str) -> None:
    assert visitor(local, "http://127.0.0.1").get(f"{API}/runs", headers={"Host": host}).status_code == 200


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example", "localhost@evil.example:1", "", "[::1"])
def test_loopback_does_not_answer_to_a_rebound_name(local: FastAPI, host: str) -> None:
    answer = visitor(local, "http://127.0.0.1").get(f"{API}/runs", headers={"Host": host})
    assert answer.status_code == 403 and answer.json()["code"] == "forbidden"


HERE = "http://127.0.0.1:8000"


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:9999", "https://127.0.0.1"])
def test_changes_from_a_foreign_origin_are_refused(local: FastAPI, origin: str) -> None:
    client = visitor(local, HERE, Origin=origin)
    for method, path in (
        ("POST", f"{API}/runs?filename=a.zip"),
        ("DELETE", f"{API}/runs/x"),
        ("PATCH", f"{API}/runs/x"),
    ):
        answer = client.request(method, path)
        assert answer.status_code == 403 and answer.json()["code"] == "forbidden"
    assert client.get(f"{API}/runs").status_code == 200  # reading is what the browser itself keeps off
    assert "access-control-allow-origin" not in client.get(f"{API}/runs").headers


def test_changes_from_here_and_from_programs_pass(local: FastAPI) -> None:
    for headers in ({"Origin": HERE}, {}):
        answer = visitor(local, HERE, **headers).delete(f"{API}/runs/none")
        assert answer.status_code == 404


def test_websockets_check_origin_host_and_token(local: FastAPI, guarded: FastAPI) -> None:
    def talk(app: FastAPI, base: str, **headers: str) -> str:
        with visitor(app).websocket_connect(f"{base.replace('http', 'ws')}/test/echo", headers=headers) as socket:
            return socket.receive_text()

    assert talk(local, HERE, Origin=HERE) == talk(local, HERE) == "in"
    for headers in ({"Origin": "http://evil.example"}, {"Origin": "null"}, {"Host": "evil.example"}):
        with pytest.raises(WebSocketDisconnect):
            talk(local, HERE, **headers)
    robot = "http://robot.lan:8000"
    assert talk(guarded, robot, Origin=robot, Authorization=f"Bearer {TOKEN}") == "in"
    for headers in ({"Origin": robot}, {"Origin": "http://evil.example", "Authorization": f"Bearer {TOKEN}"}):
        with pytest.raises(WebSocketDisconnect):
            talk(guarded, robot, **headers)


@pytest.mark.parametrize("path", [f"{API}/runs", "/nothing", "/static/css/base.css", f"{API}/openapi.json"])
def test_headers_of_every_answer(local: FastAPI, path: str) -> None:
    headers = visitor(local, HERE).get(path).headers
    assert headers["content-security-policy"] == CSP
    assert headers["x-content-type-options"] == "nosniff" and headers["referrer-policy"] == "same-origin"
    assert "unsafe" not in CSP and "default-src 'none'" in CSP


def test_refusals_carry_them_too(guarded: FastAPI) -> None:
    assert visitor(guarded).get(f"{API}/runs").headers["content-security-policy"] == CSP


def test_bodies_are_limited(local: FastAPI) -> None:
    client = visitor(local, HERE)
    path, json = f"{API}/runs/{'0' * 16}", {"Content-Type": "application/json"}
    declared = client.patch(path, content=b" " * (SMALL_BODY + 1), headers=json)
    streamed = client.patch(path, content=iter([b" " * SMALL_BODY, b" "]), headers=json)
    for answer in (declared, streamed):
        assert answer.status_code == 413 and answer.json()["code"] == "too_large"
    assert client.patch(path, content=b'{"notes": "' + b"x" * 10_000 + b'"}', headers=json).status_code == 404


def test_json_is_compressed_and_archives_are_not(local: FastAPI) -> None:
    client = visitor(local, HERE)
    assert client.get(f"{API}/openapi.json").headers["content-encoding"] == "gzip"
    assert "content-encoding" not in client.get(f"{API}/runs").headers  # too small to gain


def test_the_data_folder_is_not_served(local: FastAPI) -> None:
    client = visitor(local, HERE)
    for path in ("/static/../data/driftscope.db", "/static/%2e%2e/pyproject.toml", "/static//etc/passwd"):
        assert client.get(path).status_code == 404
    assert Path(local.state.settings.data, "driftscope.db").exists()
