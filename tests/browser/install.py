"""Makes sure that there is a Chromium for the browser tests: one on PATH, else Debian's, else playwright's own.

Prints nothing when all is well. Run by `make test`; `find()` is also what the tests use.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

NAMES = ("chromium", "chromium-browser", "google-chrome-stable", "google-chrome", "chrome")
APT = ["apt-get", "-y", "-qq", "-o=Dpkg::Use-Pty=0"]


def find() -> str | None:
    """The path of a Chromium, or None. DRIFTSCOPE_CHROMIUM says which to take."""
    chosen = os.environ.get("DRIFTSCOPE_CHROMIUM")
    if chosen:
        return shutil.which(chosen)
    return next((path for name in NAMES if (path := shutil.which(name))), None) or _of_playwright()


def _of_playwright() -> str | None:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        path = playwright.chromium.executable_path
    return path if Path(path).is_file() else None


def install() -> str:
    """Install one; the path of it, or the reasons why there is none."""
    tried = []
    if hasattr(os, "geteuid") and os.geteuid() == 0 and shutil.which("apt-get"):
        tried.append([*APT, "update"])
        tried.append([*APT, "install", "--no-install-recommends", "chromium"])
    tried.append([sys.executable, "-m", "playwright", "install", "chromium"])
    said = []
    for command in tried:
        environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
        done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
        if done.returncode != 0:
            said.append(f"  {' '.join(command)}\n    {(done.stderr or done.stdout).strip().splitlines()[-1:]}")
        elif command[1] != "update" and find():
            return ""
    return "\n".join(said)


def main() -> int:
    if find():
        return 0
    sys.stderr.write("installing a Chromium for the browser tests ..." + "\n")
    reasons = install()
    if find():
        return 0
    sys.stderr.write(
        "The browser tests need Chromium, and it could not be installed:\n"
        f"{reasons}\n"
        "Install it yourself (Debian, Ubuntu: `apt-get install chromium`), or say where one is: DRIFTSCOPE_CHROMIUM.\n"
    )
    return 1


if __name__ == "__main__":
    sys.exit(main())
