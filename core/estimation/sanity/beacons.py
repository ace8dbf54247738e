"""Surveyed beacons against the ranges to them: names that are exchanged, places that are mirrored or on one line."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import numpy.typing as npt

from core.estimation.assumptions import Assumptions
from core.estimation.beacon import unsurveyed_note
from core.estimation.fusion.events import FARTHEST
from core.estimation.fusion.range_start import fit_ranges
from core.estimation.sanity.mirrored import CLEARLY, FIRST, MIRRORS, two_witnesses
from core.estimation.sanity.units import ENOUGH, Mended, leading
from core.geometry import compose
from core.run import Run

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.intp]
Places = dict[str, tuple[float, float, float]]

MOST_FITTED = 160  # ranges by which maps are told apart where nobody knows the start


def beacons(run: Run, numbers: Assumptions) -> Mended:
    """Ranges against the dead-reckoned path: whether other names or a mirrored map explain what the given cannot."""
    log = run.ranges
    stretch = leading(run, log.t) if log is not None else None
    if log is None or stretch is None:
        return run, ()
    at, rows = stretch
    limit = 3 * numbers.range + 0.3
    if run.meta.start is None:
        found = _without_start(run, at, rows, numbers, limit)
    else:
        found = _from_start(run, at, rows, limit)
    if found is None:
        return run, ()
    places, note = found
    return dataclasses.replace(run, meta=dataclasses.replace(run.meta, beacons=places)), (note,)


def _from_start(run: Run, at: Array, rows: Rows, limit: float) -> tuple[Places, str] | None:
    """With a known start every range of every beacon has its expected value: the best of all ways to give the names."""
    from scipy.optimize import linear_sum_assignment

    log, start, given = run.ranges, run.meta.start, dict(run.meta.beacons)
    assert log is not None and start is not None
    pose = compose(np.broadcast_to(np.array((start.x, start.y, start.theta)), at.shape), at)
    ranges, which = np.asarray(log.range, np.float64)[rows], log.beacon[rows]
    seen = {
        name: mine for k, name in enumerate(log.names)
        if name in given and max(map(abs, given[name])) <= FARTHEST
        and len(mine := np.flatnonzero((which == k) & (np.abs(ranges) <= FARTHEST))) >= ENOUGH // 2
    }  # fmt: skip

    def misfit(name: str, place: tuple[float, float, float]) -> float:
        x, y = pose[seen[name], 0] - place[0], pose[seen[name], 1] - place[1]
        far = np.sqrt(x * x + y * y + (run.meta.robot.tag.z - place[2]) ** 2)
        return float(np.median(np.abs(ranges[seen[name]] - far)))

    now = {name: misfit(name, given[name]) for name in seen}
    if sum(m > limit for m in now.values()) < 2:
        return None
    names = list(seen)
    each = np.array([[misfit(a, given[b]) for b in names] for a in names])
    to = linear_sum_assignment(np.minimum(each, 1e3 * limit))[1]
    moved = [i for i in range(len(names)) if to[i] != i]
    if moved and all(now[names[i]] > max(limit, CLEARLY * each[i, to[i]]) and each[i, to[i]] < limit for i in moved):
        return {**given, **{names[i]: given[names[to[i]]] for i in moved}}, _exchanged([names[i] for i in moved])
    for words, (matrix, _) in MIRRORS.items() if two_witnesses(run) else ():
        places = _mirror(given, matrix)
        left = float(np.median([misfit(name, places[name]) for name in names]))
        if left < limit and np.median(list(now.values())) > CLEARLY * left:
            return places, _mirror_note(words)
    return None


def _without_start(run: Run, at: Array, rows: Rows, numbers: Assumptions, limit: float) -> tuple[Places, str] | None:
    """Where nobody knows the start: no pose explains the ranges, one does with two names exchanged, or mirrored."""
    log, tag, given = run.ranges, run.meta.robot.tag, dict(run.meta.beacons)
    assert log is not None
    known = np.array([name in given for name in log.names])
    kept = known[log.beacon[rows]] & (np.abs(log.range[rows]) <= FARTHEST)
    at, rows = at[kept], rows[kept]
    names = [name for name, surveyed in zip(log.names, known, strict=True) if surveyed]
    if len(names) < 3 or len(rows) < 4 * ENOUGH:
        return None
    some = np.unique(np.linspace(0, len(rows) - 1, min(MOST_FITTED, len(rows))).astype(np.intp))
    at, rows = at[some], rows[some]
    local = compose(at, np.broadcast_to(np.array((tag.x, tag.y, 0.0)), at.shape))[:, :2]
    ranges = np.asarray(log.range, np.float64)[rows]

    def misfit(places: Places) -> float:
        anchors = np.array([places.get(name, (0.0, 0.0, 0.0)) for name in log.names], np.float64)[log.beacon[rows]]
        return fit_ranges(local, anchors, ranges, tag.z, numbers.range, numbers.range_scale_sd).misfit

    now = misfit(given)
    if now < limit:
        return None
    tried = [
        ({**given, a: given[b], b: given[a]}, _exchanged([a, b])) for a, b in itertools.combinations(sorted(names), 2)
    ]
    why = "; nobody tells the axis, so the map may be turned"
    if two_witnesses(run):
        tried.append((_mirror(given, MIRRORS[FIRST][0]), _mirror_note(FIRST + why)))
    left = [misfit(places) for places, _ in tried]
    best = int(np.argmin(left))
    return tried[best] if left[best] <= limit and now >= CLEARLY * left[best] else None


def _exchanged(names: list[str]) -> str:
    listed = f"{', '.join(names[:-1])} and {names[-1]}"
    return f"Beacons {listed} are exchanged: their ranges fit each other's place. Put right."


def _mirror(places: Places, matrix: Array) -> Places:
    turned = {name: matrix @ np.array(place[:2]) for name, place in places.items()}
    return {name: (float(turned[name][0]), float(turned[name][1]), place[2]) for name, place in places.items()}


def _mirror_note(words: str) -> str:
    return f"The map of the beacons is mirrored: only so do the ranges fit wheels and gyro. Put right: {words}."


def unsurveyed(run: Run, numbers: Assumptions) -> Mended:
    """Ranges to beacons whose place nobody knows."""
    unknown = sorted(set(run.ranges.names) - set(run.meta.beacons)) if run.ranges is not None else []
    return run, (unsurveyed_note(unknown),) if unknown else ()


def one_line(run: Run, numbers: Assumptions) -> Mended:
    """Beacons on one line, or fewer than three."""
    if run.ranges is None:
        return run, ()
    places = [run.meta.beacons[name][:2] for name in run.ranges.names if name in run.meta.beacons]
    if not places:
        return run, ()
    xy = np.array(places)
    spread = np.linalg.svd(xy - xy.mean(axis=0), compute_uv=False)
    if len(places) > 2 and spread[1] > 1e-3 * max(float(spread[0]), 1e-9):
        return run, ()
    return run, (
        "The beacons stand on one line: ranges alone cannot tell its two sides apart, only the start and turns can.",
    )
