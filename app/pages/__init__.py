"""The pages: one stem per page, `pages/x.py` (typed context), `templates/x.html`, `static/pages/x.js`.

To add a page: its three files and a row in PAGES. `app.pages.base` renders a context as HTML, or as JSON at the same
path with `.json` behind it.
"""

from __future__ import annotations

from fastapi import APIRouter

from app.pages import (
    about,
    calibration,
    calibrations,
    compare,
    diagnoses,
    diagnosis,
    guide,
    jobs,
    live,
    monitor,
    run,
    runs,
    sandbox,
)

PAGES: dict[str, APIRouter] = {
    "runs": runs.router,
    "run": run.router,
    "live": live.router,
    "monitor": monitor.router,
    "compare": compare.router,
    "sandbox": sandbox.router,
    "diagnoses": diagnoses.router,
    "diagnosis": diagnosis.router,
    "calibrations": calibrations.router,
    "calibration": calibration.router,
    "jobs": jobs.router,
    "guide": guide.router,
    "about": about.router,
}
"""Every page's router by its stem; `app.main` includes them all."""
