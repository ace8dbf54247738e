"""The web server as a process: one worker, one port, an address once it is up, and a prompt end."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import fcntl
import gc
import os
import signal
import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from types import FrameType

import uvicorn

from app.main import create_app
from app.settings import Settings

WS_MAX_BYTES = 50 << 20  # a 3D scene's largest message
GRACE_S = 2  # what still runs then is cut off


class Server(uvicorn.Server):
    """uvicorn that ends its event streams when it stops, instead of waiting for their readers to go."""

    def __init__(self, settings: Settings, greet: bool = False) -> None:
        self.app = create_app(settings)
        self._settings, self._greet = settings, greet
        super().__init__(
            uvicorn.Config(
                self.app,
                host=settings.host,
                port=settings.port,
                workers=1,  # 3D scenes and the job engine live in this process
                log_level="warning",
                access_log=False,
                ws_per_message_deflate=False,  # a scene of 24 MB takes 0.2 s without, 1.3 s with
                ws_max_size=WS_MAX_BYTES,
                timeout_graceful_shutdown=GRACE_S,
                lifespan="on",
            )
        )

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Listen; then let the workers warm up, so that the first page does not wait for them."""
        await super().startup(sockets)
        if self.started:
            gc.collect()
            gc.freeze()  # what was imported stays: collections then take a millisecond, not a tenth of a second
            if self._greet:
                print(f"Driftscope is at {address(self._settings, sockets)}", flush=True)  # noqa: T201
            self.app.state.jobs.prepare()
            self._offer_robot(sockets)

    def _offer_robot(self, sockets: list[socket.socket] | None) -> None:
        """Tell the virtual robot where to find us; with `--demo` it comes at once."""
        robot = self.app.state.virtual_robot
        here = address(self._settings, sockets)
        robot.address = here.replace("//0.0.0.0:", "//127.0.0.1:").replace("//[::]:", "//[::1]:")
        if self._settings.demo:
            robot.start()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Stop within GRACE_S."""
        if hasattr(self.app.state, "virtual_robot"):
            await asyncio.to_thread(self.app.state.virtual_robot.stop)  # while it can still say that its run is over
        if hasattr(self.app.state, "jobs"):
            self.app.state.jobs.events.close()
        await super().shutdown(sockets)


def address(settings: Settings, sockets: list[socket.socket] | None = None) -> str:
    """Where a browser finds the server."""
    port = sockets[0].getsockname()[1] if sockets else settings.port
    host = f"[{settings.host}]" if ":" in settings.host else settings.host
    return f"http://{host}:{port}"


def listen(settings: Settings) -> socket.socket:
    """The socket to serve on; OSError whose message says what to do."""
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    try:
        return socket.create_server((settings.host, settings.port), family=family, backlog=2048)
    except OSError as error:
        where = f"{settings.host}:{settings.port}"
        if error.errno == errno.EADDRINUSE:
            raise OSError(f"{where} is in use: stop what listens there, or choose another --port") from None
        raise OSError(f"cannot listen on {where}: {error.strerror or error}") from None


@contextlib.contextmanager
def sole_server(data: Path) -> Iterator[None]:
    """Hold the data folder for this process; OSError where another server has it: each would run the other's jobs."""
    with (data / "server.lock").open("a") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise OSError(f"the data folder {data} is in use by another server: stop it, or choose --data") from None
        yield


def serve(settings: Settings) -> int:
    """Serve until told to stop (SIGINT, SIGTERM); the exit status."""
    signal.signal(signal.SIGTERM, _leave)
    with contextlib.ExitStack() as stack:
        sock = stack.enter_context(listen(settings))
        settings.data.mkdir(parents=True, exist_ok=True)
        stack.enter_context(sole_server(settings.data))
        server = Server(settings, greet=True)
        with contextlib.suppress(KeyboardInterrupt, SystemExit):  # raised by uvicorn once it has stopped
            server.run(sockets=[sock])
    if not getattr(server.app.state, "jobs_stopped", True):
        os._exit(0)  # a cluster that was still starting is not waited for; its processes end with this one
    return 0 if server.started else 1


def _leave(number: int, frame: FrameType | None) -> None:
    sys.exit(0)
