"""Holds a Python callable that simulates, so that it can be ended: `python -m app.simulator_host MODULE:NAME`.

A line of JSON in for each run (`run`, `out`: folders; `effects`; `seed`), a line out: `{}` or `{"error": "..."}`.
What the callable prints goes to standard error.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
from pathlib import Path

from core.formats import read_run, write_run
from core.run import Run


def main() -> None:
    """Answer until standard input ends."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    module, _, attribute = sys.argv[1].partition(":")
    for line in sys.stdin:
        asked = json.loads(line)
        reply = {}
        try:
            simulate = getattr(importlib.import_module(module), attribute)
            made = simulate(read_run(Path(asked["run"])), asked["effects"], asked["seed"])
            if not isinstance(made, Run):
                raise TypeError(f"gave {type(made).__name__}, expected a Run")
            write_run(made, Path(asked["out"]), "folder-parquet")
        except Exception as error:  # any fault of the callable, or of its module, is its answer
            reply = {"error": f"{type(error).__name__}: {error}"}
        answers.write(json.dumps(reply) + "\n")
        answers.flush()


if __name__ == "__main__":
    main()
