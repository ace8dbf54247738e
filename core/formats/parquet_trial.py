"""Parquet files are read on trial in another process first.

A few wrong bytes inside a page can make the engine ask for exabytes, and Rust then aborts the whole process. So each
file is decoded once where that harms nobody, in bounded memory and time; the process stays for the next file.
"""

from __future__ import annotations

import atexit
import json
import os
import selectors
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

SCRIPT = Path(__file__).with_name("_parquet_trial.py")
SECONDS = 20.0  # patience for a small file
BYTES_PER_SECOND = 2_000_000  # and for a large one; decoding runs at a hundred times that
START_SECONDS = 40.0


class _Process:
    """The trial process of this process; started when first needed and again after it died."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._child: subprocess.Popen[bytes] | None = None
        self._owner = 0

    def ask(self, request: dict[str, Any], seconds: float) -> dict[str, Any] | None:
        """Its answer; None if it died or took too long."""
        with self._lock:
            fresh = self._child is None or self._owner != os.getpid() or self._child.poll() is not None
            child = self._start() if fresh or self._child is None else self._child
            assert child.stdin is not None and child.stdout is not None
            try:
                child.stdin.write(json.dumps(request).encode() + b"\n")
                child.stdin.flush()
                line = _line(child, seconds + (START_SECONDS if fresh else 0.0))
            except BrokenPipeError:
                line = b""
            if line:
                return json.loads(line)
            self._stop(child)
            return None

    def close(self) -> None:
        """Let the process end, if this process started it."""
        with self._lock:
            if self._child is not None and self._owner == os.getpid():
                self._stop(self._child)

    def _start(self) -> subprocess.Popen[bytes]:
        # -P: the folder of the script must not come before the libraries
        command = [sys.executable, "-P", str(SCRIPT)]
        pipe, null = subprocess.PIPE, subprocess.DEVNULL
        self._child = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=null)
        self._owner = os.getpid()
        return self._child

    def _stop(self, child: subprocess.Popen[bytes]) -> None:
        child.kill()
        child.wait()
        for pipe in (child.stdin, child.stdout):
            if pipe is not None:
                pipe.close()
        self._child = None


def _line(child: subprocess.Popen[bytes], seconds: float) -> bytes:
    """One line of the child's output; empty if it died or took too long. Answers are short: one write, one read."""
    assert child.stdout is not None
    with selectors.DefaultSelector() as selector:
        selector.register(child.stdout, selectors.EVENT_READ)
        if not selector.select(seconds):
            return b""
    return child.stdout.readline()


_PROCESS = _Process()
atexit.register(_PROCESS.close)


def refusal(path: Path, memory: int) -> str | None:
    """Why the engine cannot read a parquet file within `memory` bytes; None if it can."""
    seconds = SECONDS + path.stat().st_size / BYTES_PER_SECOND
    answer = _PROCESS.ask({"path": str(path.resolve()), "limit": memory}, seconds)
    if answer is None:
        return f"it cannot be decoded within {memory >> 20} MiB of memory and {seconds:.0f} s"
    return answer["error"]
