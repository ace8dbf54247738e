"""Makes sure that there are the compilers and the emulator for the firmware's tests; from Debian's packages where
there is apt and root. Prints nothing when all is well. Run by `make test`; `missing()` is also what the tests use."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys

PROGRAMS = {"gcc": "gcc libc6-dev", "arm-none-eabi-gcc": "gcc-arm-none-eabi", "qemu-system-arm": "qemu-system-arm"}
LIBRARY = "libnewlib-arm-none-eabi"
APT = ["apt-get", "-y", "-qq", "-o=Dpkg::Use-Pty=0"]


def missing() -> list[str]:
    """Debian's names of what is not there."""
    found = [package for name, package in PROGRAMS.items() if shutil.which(name) is None]
    if shutil.which("arm-none-eabi-gcc") is None or not _newlib():
        found.append(LIBRARY)
    return " ".join(found).split()


def _newlib() -> bool:
    """Whether the cross compiler finds a C library: it answers with a bare name where there is none."""
    command = ["arm-none-eabi-gcc", "-print-file-name=libc.a"]
    return os.path.sep in subprocess.run(command, capture_output=True, text=True, check=False).stdout


def install() -> str:
    """Install what is missing; the reasons where that fails."""
    if not (hasattr(os, "geteuid") and os.geteuid() == 0 and shutil.which("apt-get")):
        return "  that takes apt-get and root\n"
    environment = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    for command in ([*APT, "update"], [*APT, "install", "--no-install-recommends", *missing()]):
        done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
        if done.returncode != 0 and command[-1] != "update":
            return f"  {' '.join(command)}\n    {(done.stderr or done.stdout).strip().splitlines()[-1:]}\n"
    return ""


def main() -> int:
    lacking = missing()
    if not lacking:
        return 0
    sys.stderr.write(f"installing {' '.join(lacking)} for the firmware's tests ...\n")
    reasons = install()
    if not missing():
        return 0
    sys.stderr.write(
        "The firmware's tests compile it for this machine and for a Cortex-M7, and run that one in QEMU. Missing:\n"
        f"  {' '.join(missing())}\n{reasons}"
        "Install them yourself (Debian, Ubuntu: `apt-get install` and these names; elsewhere the programs "
        f"{', '.join(PROGRAMS)} and newlib).\n"
    )
    return 1


if __name__ == "__main__":
    sys.exit(main())
