"""Every bad input through `driftscope estimate` with every method: named, the sound rest processed, no NaN. By hand.

`python -m tests.bench.bench_bad_input [--only WORDS]`. The world of tests/core/estimation/world.py (60 s), spoilt in
one way at a time. Per mistake and method: largest error of the path [m] (or the reason why there is none), and whether
no note names it. A path of `beacon` may have no heading; NaN stands in no other number.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import io
import json
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl

from app.cli import main as cli
from core.estimation import METHODS
from core.formats import write_run
from core.run import Run
from tests.core.estimation.world import BEACONS, Sensors, simulate

METHOD_NAMES = tuple(METHODS)
Change = Callable[[Run], Run]


def meta(**changes: object) -> Change:
    return lambda run: dataclasses.replace(run, meta=dataclasses.replace(run.meta, **changes))


def robot(**factors: float) -> Change:
    def change(run: Run) -> Run:
        scaled = {name: getattr(run.meta.robot, name) * factor for name, factor in factors.items()}
        return meta(robot=dataclasses.replace(run.meta.robot, **scaled))(run)

    return change


def column(stream: str, **changes: Callable[[np.ndarray], np.ndarray]) -> Change:
    def change(run: Run) -> Run:
        log = getattr(run, stream)
        made = {name: f(np.asarray(getattr(log, name), np.float64)) for name, f in changes.items()}
        return dataclasses.replace(run, **{stream: dataclasses.replace(log, **made)})

    return change


def times(factor: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda values: values * factor


def exchanged(run: Run) -> Run:
    assert run.wheels is not None
    return dataclasses.replace(
        run, wheels=dataclasses.replace(run.wheels, left=run.wheels.right, right=run.wheels.left)
    )


def unknown_start(change: Change) -> Change:
    return lambda run: meta(start=None)(change(run))


def standing(run: Run) -> Run:
    """Nothing but the rest at its begin, and nobody knows the start."""
    return meta(start=None)(run.crop(0.0, 2.0))


def jumping(values: np.ndarray) -> np.ndarray:
    return values + np.where(np.arange(len(values)) > 0.4 * len(values), 500.0, 0.0)


def mirrored(name: str) -> Change:
    def change(run: Run) -> Run:
        spoilt = {"y": times(-1.0), "theta": times(-1.0)} if name == "y" else {"x": times(-1.0)}
        if name != "y":
            spoilt["theta"] = lambda theta: np.pi - theta
        return column("beacon", **spoilt)(run)

    return change


def mirrored_beacons(run: Run) -> Run:
    return meta(beacons={name: (x, -y, z) for name, (x, y, z) in run.meta.beacons.items()})(run)


SWAPPED = {**BEACONS, "B1": BEACONS["B3"], "B3": BEACONS["B1"]}
LINE = {name: (2.0 * i - 3.0, -3.0, 2.5) for i, name in enumerate(BEACONS)}
MM = {name: (1e3 * x, 1e3 * y, 1e3 * z) for name, (x, y, z) in BEACONS.items()}
FIXES: dict[str, tuple[Change, str]] = {
    "nothing wrong": (lambda run: run, ""),
    "heading not observable": (lambda run: column("beacon", theta=times(np.nan))(standing(run)), "heading"),
    "mirrored map": (mirrored("y"), "mirrored"),
    "mirrored map, unknown start": (unknown_start(mirrored("y")), "mirrored"),
    "map mirrored in x": (mirrored("x"), "mirrored"),
    "encoder jumps": (column("wheels", left=jumping), "jumps"),
    "encoders wrap": (column("wheels", left=lambda a: a % 6.283185307, right=lambda a: a % 6.283185307), "wraps"),
    "IMU upside down, sign of gz": (column("imu", gz=times(-1.0), az=times(np.nan)), "upside down"),
    "IMU upside down, all axes": (column("imu", gz=times(-1.0), ay=times(-1.0), az=times(-1.0)), "upside down"),
    "wheels exchanged": (exchanged, "exchanged"),
    "gyro in degrees": (column("imu", gz=np.degrees), "degrees"),
    "accelerometer in g": (column("imu", **dict.fromkeys(("ax", "ay", "az"), times(1 / 9.80665))), " g "),
    "wheels in degrees": (column("wheels", left=np.degrees, right=np.degrees), "degrees"),
    "fixes in millimetres": (column("beacon", x=times(1e3), y=times(1e3)), "millimetres"),
    "fixes' headings in degrees": (column("beacon", theta=np.degrees), "degrees"),
    "wheel radius in millimetres": (robot(wheel_radius=1e3), "millimetres"),
    "track width in millimetres": (robot(track_width=1e3), "millimetres"),
}
RANGES: dict[str, tuple[Change, str]] = {
    "ranges: nothing wrong": (lambda run: run, ""),
    "ranges in millimetres": (column("ranges", range=times(1e3)), "millimetres"),
    "beacons' places in millimetres": (meta(beacons=MM), "millimetres"),
    "two beacons exchanged": (meta(beacons=SWAPPED), "exchanged"),
    "two exchanged, unknown start": (unknown_start(meta(beacons=SWAPPED)), "exchanged"),
    "an unknown beacon": (meta(beacons={k: v for k, v in BEACONS.items() if k != "B4"}), "unsurveyed"),
    "beacons' places mirrored": (mirrored_beacons, "mirrored"),
    "places mirrored, unknown start": (unknown_start(mirrored_beacons), "mirrored"),
    "ranges: heading not observable": (standing, "eading"),
}


def on_one_line(run: Run) -> Run:
    """Four beacons on one line, and ranges as they would measure there."""
    log, truth, tag = run.ranges, run.truth, run.meta.robot.tag
    assert log is not None and truth is not None
    assert truth.x is not None and truth.y is not None and truth.theta is not None
    x, y, theta = (np.interp(log.t, truth.t, column) for column in (truth.x, truth.y, truth.theta))
    places = np.array([LINE[name] for name in log.names])[log.beacon]
    ex = x + np.cos(theta) * tag.x - np.sin(theta) * tag.y - places[:, 0]
    ey = y + np.sin(theta) * tag.x + np.cos(theta) * tag.y - places[:, 1]
    noise = 0.05 * np.random.default_rng(5).standard_normal(len(log.t))
    ranges = np.sqrt(ex**2 + ey**2 + (tag.z - places[:, 2]) ** 2) + noise
    return meta(beacons=LINE)(dataclasses.replace(run, ranges=dataclasses.replace(log, range=ranges)))


RANGES["beacons on one line"] = (on_one_line, "one line")
RANGES["beacons on one line, unknown start"] = (unknown_start(on_one_line), "one line")


def tried(run: Run, method: str, words: str, folder: Path) -> str:
    """One cell of the table."""
    if not (folder / "run").exists():
        write_run(run, folder / "run", "folder-parquet")
    out, said, told = folder / "path.csv", io.StringIO(), io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(told):
        status = cli(["estimate", str(folder / "run"), "--method", method, "--out", str(out), "--json", "-"])
    named = words.lower() in said.getvalue().lower()
    if status:
        return f"exit {status}{'' if named else ' UNNAMED'}: {said.getvalue().strip()[:70]}"
    path = pl.read_csv(out)
    result = json.loads(told.getvalue())
    holes = [name for name in path.columns if path[name].null_count()]
    wrong = [name for name in holes if not (method == "beacon" and "theta" in name)]
    errors = result["errors"]
    cell = "-" if not errors or errors["max_m"] is None else f"{errors['max_m']:.2f}"
    return f"{cell}{'' if named or not words else ' UNNAMED'}{f' NAN {wrong}' if wrong else ''}"


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--only", default="", help="mistakes whose name holds these words")
    chosen = options.parse_args()
    fixed, ranged = simulate(31, 60.0).run, simulate(32, 60.0, sensors=Sensors(fixes=0, ranges=20)).run
    print("| mistake | " + " | ".join(f"`{name}`" for name in METHOD_NAMES) + " |")
    print("| --- |" + " --- |" * len(METHOD_NAMES))
    for base, mistakes in ((fixed, FIXES), (ranged, RANGES)):
        assert base.imu is not None
        flat = dataclasses.replace(base.imu, az=np.full(len(base.imu), 9.80665))
        base = dataclasses.replace(base, imu=flat)
        for name, (change, words) in mistakes.items():
            if chosen.only not in name:
                continue
            with tempfile.TemporaryDirectory() as folder:
                cells = [tried(change(base), method, words, Path(folder)) for method in METHOD_NAMES]
            print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
