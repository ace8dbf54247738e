"""`driftscope`: the command line. Imports come with the command that needs them, so that help is there at once.

Exit status: 0 done, 2 bad input, 1 a failure; errors are one line on standard error.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from app.cli_calibrate import add_commands as add_calibrate_commands
from app.cli_common import BAD_INPUT, FAILED, INTERRUPTED, OK, RUN_HELP, progress_on_terminal, run_of, write_json
from app.cli_firmware import add_commands as add_firmware_commands
from app.cli_gap import add_commands as add_gap_commands
from app.cli_imu import add_commands as add_imu_commands
from app.cli_live import add_commands as add_live_commands
from app.cli_simulate import add_commands as add_simulate_commands

if TYPE_CHECKING:
    from core.errors import DriftscopeError
    from core.estimation.result import Estimate
    from core.run import Run


class Parser(argparse.ArgumentParser):
    """argparse that tells an error in one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"{self.prog}: {message} (see {self.prog} --help)\n")


def parser() -> argparse.ArgumentParser:
    """All commands and their options."""
    top = Parser(
        prog="driftscope",
        description="Where was the robot, how does its gyro's bias move, why does the simulator disagree.",
    )
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=Parser)

    serve = commands.add_parser("serve", help="run the dashboard")
    serve.add_argument("--host", help="address to listen on (default 127.0.0.1; any other needs DRIFTSCOPE_TOKEN)")
    serve.add_argument("--port", type=_port, help="port to listen on (default 8000; 0 takes a free one)")
    serve.add_argument("--data", type=Path, help="data folder (default data)")
    serve.add_argument("--demo", action="store_true", default=None, help="also load the example runs")
    serve.add_argument("--drive", action="store_true", default=None, help="let real robots be driven")
    serve.set_defaults(run=_serve)

    store = commands.add_parser("import", help="store runs; prints their ids")
    store.add_argument("runs", nargs="+", metavar="RUN", help="a run folder, a .zip of one, or any file to import")
    store.add_argument("--data", type=Path, help="data folder (default data)")
    store.add_argument("--json", metavar="FILE", help="ids and names as JSON (- for standard output)")
    store.set_defaults(run=_import)

    estimate = commands.add_parser("estimate", help="path by one method")
    estimate.add_argument("source", metavar="RUN", help=RUN_HELP)
    estimate.add_argument(
        "--method", required=True, metavar="M", help="encoders, beacon, encoders+gyro, published, fused, smoothed"
    )
    estimate.add_argument("--out", required=True, type=Path, metavar="FILE.csv", help="t,x,y,theta and deviations")
    estimate.add_argument("--json", metavar="FILE", help="the result as JSON (- for standard output)")
    estimate.add_argument("--data", type=Path, help="data folder of stored runs (default data)")
    estimate.set_defaults(run=_estimate)
    add_imu_commands(commands, RUN_HELP)
    add_simulate_commands(commands, RUN_HELP)
    add_calibrate_commands(commands, RUN_HELP)
    add_firmware_commands(commands)
    add_gap_commands(commands, RUN_HELP)
    add_live_commands(commands, RUN_HELP)
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; its exit status."""
    options = parser().parse_args(argv)
    from core.errors import DriftscopeError

    try:
        status: int = options.run(options)
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:  # the reader of our output has gone; so do we
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except DriftscopeError as error:
        return _complain(error.message, _status(error))
    except OSError as error:
        return _complain(_of_system(error), FAILED)
    except Exception as error:  # a fault of ours: still one line, the whole story on demand
        if os.environ.get("DRIFTSCOPE_DEBUG"):
            raise
        return _complain(f"internal error: {type(error).__name__}: {error} (DRIFTSCOPE_DEBUG=1 tells more)", FAILED)
    return status


def _serve(options: argparse.Namespace) -> int:
    from app.settings import Settings

    chosen = {name: getattr(options, name) for name in ("host", "port", "data", "demo", "drive")}
    settings = Settings.from_env(**chosen)
    from app.serve import serve

    return serve(settings)


def _import(options: argparse.Namespace) -> int:
    from app.settings import Settings
    from app.store.offline import Store
    from core.errors import DriftscopeError

    status, stored = OK, []
    with Store(Settings.from_env(data=options.data)) as store:
        for name in options.runs:
            try:
                run = store.add(_existing(name), progress_on_terminal(name))
            except DriftscopeError as error:
                named = error.message if Path(name).name in error.message else f"{name}: {error.message}"
                status = _complain(named, _status(error))
                continue
            stored.append(run)
            if options.json != "-":
                sys.stdout.write(run["id"] + "\n")
    if options.json:
        write_json(options.json, {"schema": "import/1", "runs": stored})
    return status


def _estimate(options: argparse.Namespace) -> int:
    progress = progress_on_terminal(options.method)
    progress(0.0, "reading")
    run = run_of(options.source, options.data)
    from core.estimation.pipeline import estimate

    progress(0.3, "estimating")
    import time

    began = time.perf_counter()
    made = estimate(run, options.method)
    runtime = time.perf_counter() - began
    progress(0.9, "writing")
    write_path(made, options.out)
    for note in made.notes:
        sys.stderr.write(f"driftscope: note: {note}\n")
    if options.json:
        write_json(options.json, published(run, made, runtime))
    progress(1.0, "done")
    return OK


def write_path(made: Estimate, out: Path) -> None:
    """The path as CSV: t, x, y, theta and, where the method states them, sd_x, sd_y, sd_theta."""
    import polars as pl

    path = made.trajectory
    columns = {"t": path.t, "x": path.x, "y": path.y, "theta": path.theta}
    sd = path.sd
    if sd is not None:
        columns |= {"sd_x": sd[:, 0], "sd_y": sd[:, 1], "sd_theta": sd[:, 2]}
    text = pl.DataFrame(columns).fill_nan(None).write_csv()
    out.write_text(text, encoding="utf-8")


def published(run: Run, made: Estimate, runtime: float) -> dict[str, Any]:
    """The result in schema estimate/1; lengths in m, headings in rad but for `final_deg`."""
    import math

    from app.jobs.outcome import claimed_consistency, final_pose, finite
    from core.metrics import evaluate

    errors: dict[str, float | None] | None = None
    if run.truth is not None and len(made.trajectory):
        judged = evaluate(made.trajectory, run.truth)
        final_deg = None if judged.final_rad is None else math.degrees(judged.final_rad)
        errors = {
            "ate_rmse_m": finite(judged.ate_rmse_m),
            "final_m": finite(judged.final_m),
            "final_deg": finite(final_deg),
            "max_m": finite(judged.max_m),
        }
    claim = claimed_consistency(run, made.trajectory)
    return {
        "schema": "estimate/1",
        "method": made.method,
        "final": final_pose(made.trajectory),
        "errors": errors,
        "events": [{"kind": e.kind, "t0": e.t0, "t1": e.t1} for e in made.events],
        "nees": None if claim is None else finite(claim.mean),
        "runtime_s": runtime,
    }


def _existing(name: str) -> Path:
    from core.errors import FormatError

    path = Path(name)
    if not path.exists():
        raise FormatError("no such file or folder", file=name)
    return path


def _status(error: DriftscopeError) -> int:
    """2 where the input is to blame, 1 where this machine is."""
    return FAILED if error.code in ("disk_full", "cancelled") else BAD_INPUT


def _of_system(error: OSError) -> str:
    if error.filename is not None and error.strerror:
        return f"{error.filename}: {error.strerror}"
    return str(error)


def _complain(message: str, status: int) -> int:
    sys.stderr.write("driftscope: " + " ".join(message.split()) + "\n")
    return status


def _port(text: str) -> int:
    if not text.isdecimal() or int(text) > 65535:
        raise argparse.ArgumentTypeError(f"{text!r} is no port, expected 0 to 65535")
    return int(text)


if __name__ == "__main__":
    sys.exit(main())
