"""Maps and scenes show beacons and fixes as the estimates take them."""

from __future__ import annotations

import dataclasses

import numpy as np

from app.figures.path import figure
from app.figures.understood import understood
from core.simulation import simulate
from core.simulation.scenarios import SCENARIOS


def test_exchanged_beacons_and_fixes_in_millimetres_are_drawn_where_they_are() -> None:
    run = simulate(SCENARIOS["figure-eight"].run().crop(0.0, 40.0), {}, 0)
    assert run.beacon is not None
    places = dict(run.meta.beacons)
    wrong = dataclasses.replace(
        run,
        meta=dataclasses.replace(run.meta, beacons={**places, "B1": places["B3"], "B3": places["B1"]}),
        beacon=dataclasses.replace(run.beacon, x=run.beacon.x * 1e3, y=run.beacon.y * 1e3),
    )
    for _ in range(2):  # found, then kept
        shown = understood("a", wrong)
        assert shown.beacon is not None
        np.testing.assert_allclose(shown.beacon.x, run.beacon.x, rtol=1e-6)
        drawn = figure(shown, [], t0=None, t1=None, points=10)["beacons"]
        assert {b["name"]: (b["x"], b["y"], b["z"]) for b in drawn} == places
    assert understood("b", run) is run
