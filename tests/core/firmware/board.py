"""The firmware compiled and run: on this machine, and on a Cortex-M7 that QEMU emulates."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

HERE = Path(__file__).parent
WARNINGS = ("all", "extra", "conversion", "double-promotion", "shadow", "cast-qual", "undef", "strict-prototypes")
WARNINGS += ("missing-prototypes", "switch-default", "error")
STRICT = ["-std=c99", "-O2", "-pedantic", *(f"-W{name}" for name in WARNINGS)]
M7 = ["-mcpu=cortex-m7", "-mfpu=fpv5-sp-d16", "-mfloat-abi=hard", "-mthumb"]
OUT = ("ax", "ay", "az", "gx", "gy", "gz", "rate", "heading", "heading_sd", "bias", "bias_sd")


@dataclass(frozen=True)
class Replay:
    """What the firmware gave, by sample. values: by OUT, (n,) float32; status, instructions (n,)."""

    values: dict[str, npt.NDArray[np.float32]]
    at_rest: npt.NDArray[np.bool_]
    status: npt.NDArray[np.uint8]
    instructions: npt.NDArray[np.uint32]


def write(files: dict[str, str], folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    return folder


def build(folder: Path, board: str, uptime: float = 0.0) -> Path:
    """The harness with the firmware in `folder`, for "host" or "m7"; the IMU has had power for `uptime` [s] before
    the log. A warning is an error."""
    made = folder / f"harness-{board}"
    common = [*STRICT, f"-I{folder}", f"-I{HERE / board}", f"-DUPTIME_S={uptime}f", str(HERE / "harness.c")]
    common += [str(path) for path in sources(folder)]
    if board == "host":
        _call(["gcc", *common, "-lm", "-o", str(made)])
    else:
        link = ["-nostartfiles", f"-Wl,-T,{HERE / 'm7' / 'board.ld'}", "--specs=nano.specs", "-lm", "-lc", "-lgcc"]
        _call(["arm-none-eabi-gcc", *M7, *common, str(HERE / "m7" / "startup.c"), *link, "-o", str(made)])
    return made


def sources(folder: Path) -> list[Path]:
    """The firmware's own C files."""
    return [folder / "driftscope.c", *sorted(folder.glob("ds_*.c"))]


def records(t: npt.ArrayLike, readings: npt.ArrayLike, temperature: object = None, moving: object = None) -> bytes:
    """Samples for the harness: t (n,) [s], readings (n, 6), temperature (n,) [deg C], moving (n,)."""
    stamps = microseconds(t)
    rows = np.zeros((len(stamps), 9), np.uint32)
    rows[:, 0] = stamps & 0xFFFFFFFF
    rows[:, 1:7] = np.ascontiguousarray(readings, np.float32).view(np.uint32)
    warm = np.full(len(stamps), -1000.0) if temperature is None else np.asarray(temperature)
    rows[:, 7] = warm.astype(np.float32).view(np.uint32)
    rows[:, 8] = 0 if moving is None else np.asarray(moving, np.uint32)
    return rows.tobytes()


def microseconds(t: npt.ArrayLike) -> npt.NDArray[np.int64]:
    return np.round(np.asarray(t, np.float64) * 1e6).astype(np.int64)


def run(harness: Path, log: bytes) -> Replay:
    """Replay a log. On the emulated board every instruction is counted."""
    folder = harness.parent
    (folder / "in.bin").write_bytes(log)
    if harness.name.endswith("host"):
        command = [str(harness)]
    else:
        command = [
            "qemu-system-arm",
            "-M",
            "mps2-an500",
            "-kernel",
            harness.name,
            "-display",
            "none",
            "-serial",
            "none",
        ]
        command += ["-monitor", "none", "-icount", "shift=6", "-semihosting-config", "enable=on,target=native"]
    _call(command, folder)
    words = np.frombuffer((folder / "out.bin").read_bytes(), np.uint32).reshape(-1, 13)
    values = {name: words[:, i].copy().view(np.float32) for i, name in enumerate(OUT)}
    return Replay(values, (words[:, 11] & 1) == 1, (words[:, 11] >> 8).astype(np.uint8), words[:, 12].copy())


def size(folder: Path) -> tuple[int, int, int]:
    """Bytes of the firmware alone on the Cortex-M7, without the C library: flash (code and constants), RAM (one
    ds_state; the code itself has no data), and stack, at most (all functions' frames together: nothing recurses)."""
    flash = ram = stack = 0
    probe = folder / "state.c"
    probe.write_text('#include "driftscope.h"\nextern ds_state state;\nds_state state;\n', encoding="utf-8")
    for path in [*sources(folder), probe]:
        made = path.with_suffix(".o")
        options = ["-fno-common", "-fstack-usage", "-c", str(path), "-o", str(made)]
        _call(["arm-none-eabi-gcc", *M7, *STRICT, *options])
        text, data, bss = _call(["arm-none-eabi-size", str(made)]).splitlines()[1].split()[:3]
        flash += int(text) + int(data)
        ram += int(data) + int(bss)
        frames = made.with_suffix(".su").read_text(encoding="utf-8").splitlines()
        assert all(line.split("\t")[2] == "static" for line in frames), "a frame of no fixed size"
        stack += sum(int(line.split("\t")[1]) for line in frames)
    return flash, ram, stack


def _call(command: list[str], folder: Path | None = None) -> str:
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder, check=False, timeout=120)
    assert done.returncode == 0, f"{' '.join(command)}\n{done.stdout}{done.stderr}"
    return done.stdout
