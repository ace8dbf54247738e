"""One recorded run beside its simulator: every channel predicted from the recorded stream before it.

Wheels are predicted from commands, the body from the wheels as their encoders report them, sensors from the body. The
body is set down anew at the start of each window, at the reference pose, so that errors do not pile up.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.effects import EFFECTS
from core.gap.smoothing import smooth_wheels
from core.robot import EffectSet
from core.run import Run
from core.simulation import params as P
from core.simulation._batch_numba import Inputs, Outputs
from core.simulation.inputs import prepare, with_drive
from core.simulation.simulate import simulate_sets

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

WHEELS = ("wheels.left", "wheels.right")
IMU = ("imu.gz", "imu.ax", "imu.ay")
POSES = ("beacon.x", "beacon.y", "beacon.theta", "ranges.range", "truth.x", "truth.y", "truth.theta")
CHANNELS = WHEELS + IMU + POSES
FIELDS = {
    **{name: name.split(".")[1] for name in WHEELS + IMU},
    "beacon.x": "beacon_x",
    "beacon.y": "beacon_y",
    "beacon.theta": "beacon_theta",
    "ranges.range": "range",
}
"""Where `Outputs` holds a channel; truth is taken from the path."""
BEFORE = 1e-6
"""A stretch's end is looked at this long before the restart [s]."""
ROWS_AT_ONCE = 16_000_000
"""Readings predicted in one batch: bounds memory."""


def drive_effects(effects: EffectSet) -> dict[str, Mapping[str, float | str]]:
    """Those of the drive's family."""
    return {name: values for name, values in effects.items() if EFFECTS[name].family == "drive"}


def without_drive(effects: EffectSet) -> dict[str, Mapping[str, float | str]]:
    """All but the drive's."""
    return {name: values for name, values in effects.items() if EFFECTS[name].family != "drive"}


@dataclass(frozen=True)
class World:
    """A run, its reference pose at each restart, and the kernels' inputs.

    restarts (K, 4): t, x, y, theta of each window's start. stamps (E,): union of all stamps of pose readings and the
    instants before restarts; `at` says where a channel's stamps lie in it, `kept` which rows of a stream are known,
    `order` how readings of poses, channel after channel, then restarts follow each other in time. `drive`: the drive as
    the encoders show it, used for the body; None where the
    recorded wheels drive it (then `body_inputs` holds their rim speeds). rough: driven by what smoothing makes of
    rounded angles.
    """

    run: Run
    readings: Mapping[str, Array]
    times: Mapping[str, Array]
    restarts: Array
    stamps: Array
    at: Mapping[str, Indices]
    ends: Indices
    body_inputs: Inputs
    wheel_inputs: Inputs | None
    kept: Mapping[str, Indices | slice]
    order: Indices
    drive: EffectSet | None = None
    rough: bool = False
    seen: Mapping[str, Mapping[str, float | str]] = dataclasses.field(default_factory=dict)

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that this run has, in the table's order."""
        return tuple(name for name in CHANNELS if name in self.readings)

    @property
    def wheels_lead(self) -> bool:
        """Whether the body is driven by what the encoders report; else commands go straight to the body."""
        return self.run.wheels is not None and self.run.meta.robot.wheel_radius is not None

    def pack(self, effects: EffectSet) -> Array:
        """Packed parameters of the body's link: what the effects say beyond the drive as the encoders show it."""
        if not self.wheels_lead:
            return P.pack(self.run.meta, effects)
        both = without_drive({**self.run.meta.effects, **effects})
        meta = dataclasses.replace(self.run.meta, effects={})
        par = P.pack(meta, {**both, **(self.drive or {})})
        lost = self.seen.get("missed_ticks", {})
        for slot, missed, side in ((P.SCALE_L, P.MISSED_LEFT, "left"), (P.SCALE_R, P.MISSED_RIGHT, "right")):
            par[slot] *= (1.0 - float(lost.get(side, 0.0))) / (1.0 - par[missed])
        return par

    def wheels(self, sets: Sequence[EffectSet]) -> dict[str, Array]:
        """Both encoders' angles under the commands, (B, rows) each; the body's own effects do not matter."""
        if self.wheel_inputs is None:
            return {}
        packed = np.stack([P.pack(self.run.meta, effects) for effects in sets])
        out, _ = simulate_sets(self.wheel_inputs, packed)
        return {"wheels.left": out.left, "wheels.right": out.right}

    def body(self, sets: Sequence[EffectSet]) -> Outputs:
        """Sensors and the path at `stamps` (columns x, y, theta), (B, rows) each; the gyro clipped."""
        packed = np.stack([self.pack(effects) for effects in sets])
        out, _ = simulate_sets(self.body_inputs, packed)
        limit = packed[:, P.GYRO_CLIP, None]
        return out._replace(gz=np.clip(out.gz, -limit, limit)) if np.isfinite(limit).any() else out

    def batches(self, count: int) -> list[range]:
        """Indices of `count` sets in batches that fit into memory."""
        rows = 3 * len(self.stamps) + 4 * len(self.body_inputs.imu)
        size = max(2, ROWS_AT_ONCE // max(rows, 1))
        return [range(i, min(i + size, count)) for i in range(0, count, size)]

    def channel(self, out: Outputs, name: str) -> Array:
        """(B, rows) predictions of one channel of the body's link."""
        if name.startswith("truth."):
            values: Array = getattr(out, name.split(".")[1])[:, self.at[name]]
            return values
        column: Array = getattr(out, FIELDS[name])
        return column[:, self.keep(name)]

    def keep(self, name: str) -> Indices | slice:
        """Rows of a stream whose reading is known."""
        return self.kept[name]

    def with_wheels(self, t: Array, left: Array, right: Array, rough: bool = False) -> World:
        """Driven by these rim speeds [m/s], linear between the stamps, in place of commands."""
        inputs = with_drive(self.body_inputs, t, left, right)
        return dataclasses.replace(self, body_inputs=inputs, drive=None, rough=rough, seen={})

    def driven_as(self, other: World) -> World:
        """Driven as another world of the same run is."""
        lead = other.body_inputs
        inputs = self.body_inputs._replace(times=lead.times, left=lead.left, right=lead.right, begin=lead.begin)
        return dataclasses.replace(self, body_inputs=inputs, drive=other.drive, rough=other.rough, seen=other.seen)

    def with_drive(self, effects: EffectSet) -> World:
        """Driven by commands through this drive; missed ticks among the effects are what encoders hide."""
        seen = {name: values for name, values in effects.items() if name == "missed_ticks"}
        merged = {**drive_effects(self.run.meta.effects), **drive_effects(effects)}
        return dataclasses.replace(self, drive=merged, rough=False, seen=seen)


def make_world(run: Run, restarts: Array) -> World:
    """A run ready for prediction. restarts (K, 4): t, x, y, theta, t increasing. Raises as `core.simulation.inputs`."""
    readings = {name: _column(run, name) for name in CHANNELS if _has(run, name)}
    known = {name: np.isfinite(values) for name, values in readings.items()}
    times = {name: getattr(run, name.split(".")[0]).t[known[name]] for name in readings}
    readings = {name: values[known[name]] for name, values in readings.items()}
    instants = [times[name] for name in POSES if name in times]
    stamps = np.unique(np.concatenate([*instants, restarts[:, 0] - BEFORE]))
    inputs = prepare(_driving(run), restarts)
    inputs = inputs._replace(truth=stamps, wheels=np.empty(0))
    wheel_inputs = None
    if run.commands is not None and run.wheels is not None and len(run.commands):
        wheel_inputs = prepare(dataclasses.replace(run, imu=None, beacon=None, ranges=None, truth=None))
    else:
        readings = {name: values for name, values in readings.items() if name not in WHEELS}
    at = {name: np.searchsorted(stamps, times[name]) for name in POSES if name in times}
    ends = np.searchsorted(stamps, restarts[:, 0] - BEFORE)
    kinds = [np.full(len(rows), k) for k, rows in enumerate((*at.values(), ends))]
    return World(
        run=run,
        readings=readings,
        times=times,
        restarts=restarts,
        stamps=stamps,
        at=at,
        ends=ends,
        kept={name: slice(None) if one.all() else np.flatnonzero(one) for name, one in known.items()},
        order=np.lexsort((np.concatenate(kinds), np.concatenate((*at.values(), ends)))),
        body_inputs=inputs,
        wheel_inputs=wheel_inputs,
        drive=drive_effects(run.meta.effects) if run.commands is not None else None,
        rough=run.commands is None and run.wheels is not None,
    )


def _driving(run: Run) -> Run:
    """The run by whose commands, or smoothed wheels, the body is driven."""
    if run.commands is not None or run.wheels is None:
        return dataclasses.replace(run, wheels=None)
    ticks = run.meta.robot.ticks_per_rev
    return dataclasses.replace(run, wheels=smooth_wheels(run.wheels, 2.0 * np.pi / ticks if ticks else None))


def _column(run: Run, name: str) -> Array:
    stream, column = name.split(".")
    return np.asarray(getattr(getattr(run, stream), column), dtype=np.float64)


def _has(run: Run, name: str) -> bool:
    stream, column = name.split(".")
    log = getattr(run, stream)
    return log is not None and len(log) > 0 and getattr(log, column) is not None
