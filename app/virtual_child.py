"""The command line as a child of the server: it ends when its parent does, however that ended."""

from __future__ import annotations

import os
import sys
import threading
import time

LOOK_S = 1.0


def _leave_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(LOOK_S)
    os._exit(0)


if __name__ == "__main__":
    from app.cli import main

    threading.Thread(target=_leave_with, args=(os.getppid(),), daemon=True).start()
    sys.exit(main(sys.argv[1:]))
