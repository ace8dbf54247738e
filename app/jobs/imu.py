"""The IMU room's analysis of a run, in a worker: noise of every axis, its segments, the gyro's bias by every method.

Each part is computed by itself: what one of them misses (too short for an Allan deviation, no rest, no reference) is
kept as that part's error and the others stand. No database here.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from app.figures.imu import ALLAN, SEGMENTS
from app.jobs.tasks import Progress
from core.errors import CancelledError, DriftscopeError, MissingStreamError, ParameterError

log = logging.getLogger("driftscope.jobs")

AXES = ("gx", "gy", "gz", "ax", "ay", "az")
REST_WHOLE = 0.98  # a record at rest for this share is taken as a whole,
MOVED = 1.05  # unless what is not rest widens the readings' deviation by this factor
KNOWN = 3.0  # times the least deviation of the run: from then on the bias is known, before it is the filter's guess
REST_LEAST_S = 2.0  # less rest than that says nothing about noise
Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Made:
    """What a part gives: arrays to store, figures (SI, plain), notes."""

    arrays: Mapping[str, npt.NDArray[Any]]
    figures: Mapping[str, Any]
    notes: Sequence[str] = ()


@dataclass
class Case:
    """The run, the settings, and what earlier parts found that later ones go by."""

    run: Any
    config: Mapping[str, Any]
    bias: dict[str, Any] = field(default_factory=dict)  # BiasEstimate by method

    def values(self, axis: str) -> npt.NDArray[np.floating]:
        """The readings of an axis; MissingStreamError where the run has none."""
        imu = self.run.imu
        values = None if imu is None or not len(imu) else getattr(imu, axis)
        if values is None:
            raise MissingStreamError(f"the run has no imu.{axis}", missing=f"imu.{axis}")
        return np.asarray(values)

    def still(self) -> npt.NDArray[np.bool_] | None:
        """(n,) which readings are at rest, by `best`, else by the methods of segments; None where none of them ran."""
        made = next((self.bias[name] for name in ("best", "C", "B") if name in self.bias), None)
        if made is None:
            return None
        t, verdict = self.run.imu.t, made.segments.verdict == 1
        step = float(np.median(np.diff(made.segments.t))) if len(verdict) > 1 else float(t[-1] - t[0])
        place = np.searchsorted(made.segments.t + step / 2, t).clip(0, len(verdict) - 1)
        inside = np.abs(made.segments.t[place] - t) <= step / 2 * (1 + 1e-9)
        return np.asarray(verdict[place] & inside)


Part = Callable[[Case], Made]


def axes_of(columns: Sequence[str]) -> list[str]:
    """The axes among an IMU's columns, in their order."""
    return [axis for axis in AXES if axis in columns]


def analyse(
    data: Path,
    progress: Progress,
    *,
    manifest: Mapping[str, Any],
    axes: Sequence[str] | None,
    methods: Sequence[str] | None,
    config: Mapping[str, float],
) -> dict[str, Any]:
    """Every part of the analysis of a stored run; {"parts": [...]} for `app.store.imu`.

    `axes`, `methods`: None means all there are. `config`: `length` [s] and `n` of the segments.
    """
    from app.store import arrays

    case = Case(arrays.run_from_manifest(data, manifest), config)
    columns = [] if case.run.imu is None else list(case.run.imu.columns())
    if not axes_of(columns):
        raise MissingStreamError("the run has no IMU: there is nothing to analyse", missing="imu")
    plan = list(parts(axes_of(columns) if axes is None else axes, methods, "temperature" in columns))
    made = []
    for i, (name, label, part) in enumerate(plan):
        progress(i / len(plan), label)
        made.append(stored_part(data, case, name, part))
    progress(1.0, "saving")
    return {"parts": made}


def parts(axes: Sequence[str], methods: Sequence[str] | None, warm: bool) -> Iterator[tuple[str, str, Part]]:
    """(name, what the progress says, part) of all that is computed; bias first, since it is what people wait for."""
    from core.imu.bias import METHODS

    for method in METHODS if methods is None else methods:
        yield f"bias.{method}", f"bias by {method}", partial(bias, method=method)
    for axis in axes:
        yield f"segments.{axis}", f"segments of {axis}", partial(segments, axis=axis)
        yield f"allan.{axis}", f"Allan deviation of {axis}", partial(allan, axis=axis)
    if warm and (methods is None or set(methods) & {"A", "B", "C"}):
        yield "temperature", "bias against temperature", temperature


def stored_part(data: Path, case: Case, name: str, part: Part) -> dict[str, Any]:
    """One part as `app.store.imu` keeps it: its arrays in the data folder, or why it could not be computed."""
    from app.store import arrays
    from app.store.provenance import code_version

    began = time.perf_counter()
    made, error = Made({}, {}), None
    try:
        made = part(case)
    except CancelledError:
        raise
    except DriftscopeError as refusal:
        error = {"code": refusal.code, "detail": refusal.message, "where": dict(refusal.where)}
    except Exception as fault:  # a fault in one part must not take the others' results with it
        log.exception("the part %s of an IMU analysis failed", name)
        error = {"code": "internal", "detail": f"{type(fault).__name__}: {fault}", "where": {}}
    return {
        "part": name,
        "runtime_s": time.perf_counter() - began,
        "arrays": {key: arrays.put(data, column) for key, column in made.arrays.items()},
        "figures": plain(made.figures),
        "notes": list(made.notes),
        "error": plain(error),
        "config": dict(case.config),
        "code_version": code_version(),
    }


def plain(value: Any) -> Any:
    """Numbers as JSON has them: None for what is not finite."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


# ---- the parts


def allan(case: Case, axis: str) -> Made:
    """Allan and Hadamard curves, each (k, 8) by ALLAN, and the noise fitted to the first.

    Of the readings at rest where the robot also moved (those in movement are left out as if they were lost), and then
    `whole` is the Allan curve of all of them.
    """
    from core.errors import NotEnoughDataError
    from core.imu.allan import allan_of
    from core.imu.grid import to_grid
    from core.imu.noise import fit_noise
    from core.imu.oddities import saturated
    from core.imu.units import degrees

    values, t = case.values(axis), case.run.imu.t
    still = case.still()
    share = 0.0 if still is None else float(still.mean())
    rest_only = share * (t[-1] - t[0]) > REST_LEAST_S and (share < REST_WHOLE or _moved(values, still))
    record = to_grid(t, values if still is None or not rest_only else np.where(still, values, np.nan))
    curve = allan_of(record)
    notes = [*_told(rest_only, share), *(n for n in curve.notes if not (rest_only and "missing" in n))]
    notes = [*saturated(values, axis), *notes]
    if axis.startswith("g"):
        notes = [*degrees(t, values, rested=still is None or rest_only), *notes]
    figures: dict[str, Any] = {"tau0": curve.tau0, "duration": curve.duration, "jitter": record.jitter}
    figures |= {"readings": "rest" if rest_only else "whole", "rest_share": share}
    model = np.full(len(curve.tau), np.nan)
    try:
        fit = fit_noise(curve)
        model = fit.model
        notes += fit.notes
        terms = {name: getattr(fit, name) for name in ("Q", "N", "B", "K", "markov_sd", "markov_tau")}
        figures |= {"chi2": fit.chi2, "dof": fit.dof}
        figures["terms"] = {name: {"value": term.value, "sd": term.sd} for name, term in terms.items()}
    except NotEnoughDataError as error:
        notes.append(error.message)
    arrays = {"allan": _curve(curve, model), "hadamard": _curve(allan_of(record, kind="hadamard"))}
    if rest_only:
        arrays["whole"] = _curve(allan_of(to_grid(t, values)))
    return Made(arrays, figures, notes)


def _moved(values: npt.NDArray[np.floating], still: npt.NDArray[np.bool_] | None) -> bool:
    """Whether the few readings that are not at rest (n,) show more than noise."""
    if still is None or still.all():
        return False
    return bool(np.nanstd(values) > MOVED * np.nanstd(values[still]))


def _told(rest_only: bool, share: float) -> list[str]:
    if rest_only:
        return [f"The robot moved: only its readings at rest, {share:.1%} of all, are used."]
    if share < REST_WHOLE:
        return ["Hardly a rest was found: the curve shows the robot's motion, not only the sensor's noise."]
    return []


def _curve(curve: Any, model: Floats | None = None) -> Floats:
    model = np.full(len(curve.tau), np.nan) if model is None else model
    columns = {**{name: getattr(curve, name) for name in ALLAN[:-1]}, "model": model}
    return np.column_stack([np.asarray(columns[name], np.float64) for name in ALLAN])


def segments(case: Case, axis: str) -> Made:
    """Statistics of each segment of an axis, (M, 12) by SEGMENTS, and the mean sd of those at rest."""
    from core.imu.segments import segments as cut
    from core.imu.segments import still_sd

    values = case.values(axis)
    finite = np.isfinite(values)
    t = case.run.imu.t
    found = cut(t, values, _length(case)) if finite.all() else cut(t[finite], values[finite], _length(case))
    table = np.column_stack([np.asarray(getattr(found, name), np.float64) for name in SEGMENTS])
    return Made({"segments": table}, {"length": _length(case), "segments": len(found), "sigma_sr": still_sd(found)})


def _length(case: Case) -> float:
    from core.imu.segments import LENGTH

    return float(case.config.get("length", LENGTH))


def bias(case: Case, method: str) -> Made:
    """Bias and heading by one method, the verdict on each segment, and the heading's error where there is truth."""
    from core.imu.bias import METHODS, SegmentConfig, heading_errors, track_bias

    if method not in METHODS:
        raise ParameterError(f"there is no bias method {method!r}", parameter="methods", expected=list(METHODS))
    config = None
    if METHODS[method].config is SegmentConfig:
        given: dict[str, Any] = {"length": _length(case)}
        given |= {"n": int(case.config["n"])} if "n" in case.config else {}
        config = SegmentConfig(**given)
    made = case.bias[method] = track_bias(case.run, method, config)
    columns: dict[str, npt.NDArray[Any]] = {
        "t": made.t,
        "bias": made.bias,
        "sd": made.sd,
        "theta": made.theta,
        "segment_t": made.segments.t,
        "segment_mean": made.segments.mean,
        "segment_verdict": made.segments.verdict,
    }
    if made.theta_sd is not None:
        columns["theta_sd"] = made.theta_sd
    figures = _bias_figures(made)
    errors = heading_errors(made, case.run.truth)
    if errors is not None:
        columns |= {"error_t": errors.t, "error": errors.error, "reference": _reference(made, errors)}
        figures |= {
            "final_rad": errors.error[-1],
            "max_rad": errors.max_rad,
            "net_rate": errors.net_rate,
            "hourly_rate": errors.hourly_rate,
            "judged_s": errors.t[-1] - errors.t[0],
        }
    return Made(columns, figures, made.notes)


def _bias_figures(made: Any) -> dict[str, Any]:
    from core.imu.bias.result import ACCEPTED, EMPTY, REJECTED_BY_BAND, REJECTED_BY_RANGE

    verdict = made.segments.verdict
    rest = longest_rest(made.segments.t, verdict == ACCEPTED)
    first = int(np.argmax(made.sd <= KNOWN * np.nanmin(made.sd))) if np.isfinite(made.sd).any() else 0
    return {
        "accepted": int((verdict == ACCEPTED).sum()),
        "rejected_by_range": int((verdict == REJECTED_BY_RANGE).sum()),
        "rejected_by_band": int((verdict == REJECTED_BY_BAND).sum()),
        "empty": int((verdict == EMPTY).sum()),
        "segments": len(verdict),
        "bias_start": made.bias[first],
        "bias_end": made.bias[-1],
        "bias_drift": made.bias[-1] - made.bias[first],
        "bias_sd_end": made.sd[-1],
        "theta_end": made.theta[-1],
        "theta_sd_end": None if made.theta_sd is None else made.theta_sd[-1],
        "rest": rest,
        "used": {k: float(v) for k, v in made.figures.items()},
    }


def _reference(made: Any, errors: Any) -> Floats:
    """The reference heading at the errors' stamps, on the estimate's own zero."""
    inside = np.interp(errors.t, made.t, made.theta)
    return np.asarray(errors.error + inside, np.float64)


def longest_rest(t: Floats, accepted: npt.NDArray[np.bool_]) -> list[float] | None:
    """[t0, t1] of the longest stretch of accepted segments that follow each other; None where there is none."""
    if not accepted.any() or len(t) < 2:
        return None
    half = float(np.median(np.diff(t))) / 2
    edges = np.flatnonzero(np.diff(np.concatenate(([0], accepted.astype(np.int8), [0]))))
    begin, end = edges[::2], edges[1::2]
    spans = t[end - 1] - t[begin]
    k = int(np.argmax(spans))
    return [float(t[begin[k]] - half), float(t[end[k] - 1] + half)]


def temperature(case: Case) -> Made:
    """Mean temperature and mean reading of each segment of gz that a method took for rest, and a line through them."""
    from core.errors import NotEnoughDataError
    from core.imu.bias.result import ACCEPTED
    from core.imu.segments import segments as cut

    made = case.bias.get("C") or next((b for name, b in case.bias.items() if name in ("B", "A")), None)
    imu = case.run.imu
    if made is None:
        raise NotEnoughDataError("no method by segments ran: there is no bias to set against temperature")
    warmth = np.asarray(imu.temperature, np.float64)
    known = np.isfinite(warmth)
    if known.sum() < 8:
        raise NotEnoughDataError(f"{int(known.sum())} temperatures are too few", stream="imu", column="temperature")
    found = cut(imu.t[known], warmth[known], _length(case), quartiles=False)
    kelvin = np.interp(made.segments.t, (found.t0 + found.t1) / 2, found.mean)
    taken = (made.segments.verdict == ACCEPTED) & np.isfinite(kelvin)
    if taken.sum() < 3:
        raise NotEnoughDataError("fewer than three segments at rest: no bias to set against temperature")
    x, y = kelvin[taken], made.segments.mean[taken]
    figures: dict[str, Any] = {"from": float(x.min()), "to": float(x.max()), "method": made.method}
    if np.ptp(x) > 0:
        slope, offset = np.polyfit(x - x.mean(), y, 1)
        figures |= {"slope": slope, "at_mean": offset, "mean": x.mean(), "correlation": _correlation(x, y)}
    table = np.column_stack((made.segments.t[taken], x, y))
    return Made({"points": table}, figures)


def _correlation(x: Floats, y: Floats) -> float | None:
    return float(np.corrcoef(x, y)[0, 1]) if np.ptp(x) > 0 and np.ptp(y) > 0 else None
