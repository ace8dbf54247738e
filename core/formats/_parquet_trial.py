"""The process that reads parquet files on trial: one request a line on stdin, one answer a line on stdout.

Run as a script by `core.formats.parquet_trial`, never imported; needs polars alone.
"""

import json
import sys

import polars as pl


def trial(path: str, limit: int) -> str | None:
    """Decode the whole file, within `limit` bytes of memory; the reason if the engine refuses it."""
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_DATA, (limit, resource.getrlimit(resource.RLIMIT_DATA)[1]))
    except (ImportError, ValueError, OSError):  # no such limit on this system
        pass
    try:
        for _ in pl.scan_parquet(path, glob=False, use_statistics=False).collect_batches(engine="streaming"):
            pass
    except (Exception, pl.exceptions.PanicException) as error:
        return (str(error).strip() or type(error).__name__).splitlines()[0]
    return None


if __name__ == "__main__":
    for line in sys.stdin:
        request = json.loads(line)
        sys.stdout.write(json.dumps({"error": trial(request["path"], request["limit"])}) + "\n")
        sys.stdout.flush()
