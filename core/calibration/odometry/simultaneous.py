"""Maximum-likelihood calibration of both wheel radii, track width, gyro scale, tag, IMU mount and clocks at once.

Given: any runs of one robot with wheels and a reference (truth, fixes or ranges), better with an IMU. Done: all poses
and all unknowns are solved for together by Gauss-Newton (`chain.py` says what is measured, `arrow.py` solves it);
readings that do not fit count less; slip is learnt from the runs by the likelihood. What the information matrix says
the runs do not show is None with a reason. Source of the idea: Censi, Franchi, Marchionni, Oriolo, "Simultaneous
Calibration of Odometry and Sensor Parameters for Mobile Robots", IEEE Transactions on Robotics 29(2), 2013.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace

import numpy as np
import numpy.typing as npt

from core.calibration.odometry.arrow import Arrow, Eliminated, eliminate
from core.calibration.odometry.chain import Chain, Noise
from core.calibration.odometry.model import (
    DELAY,
    GYRO,
    IMU_CLOCK,
    LEFT,
    RIGHT,
    SHARED,
    TABLE,
    TAG_X,
    TAG_Y,
    TAG_YAW,
    TRACK,
    OdometryCalibration,
)  # fmt: skip
from core.calibration.odometry.mounts import imu_mount
from core.calibration.odometry.reference import find_reference
from core.errors import MissingStreamError, NotEnoughDataError
from core.estimation import needs
from core.estimation.result import Value
from core.run import Run

Array = npt.NDArray[np.float64]

ROUNDS, FINAL_ROUNDS = 3, 1  # of reweighing; noise is learnt between them
PLAIN, STEPS = 3, 2  # Gauss-Newton steps before the first round, and in each
SHOWN = 0.3  # a parameter is shown where its sd is below this share of its plausible width
FARTHEST = 10.0  # plausible widths from nominal; beyond, the search has not found the robot
ALIKE = 0.9  # correlation worth telling
LEARN_FROM, FEWEST = 4000, 400  # knots of all runs, of each at least, that noise is learnt from
SLIPS = (2e-4, 0.1)  # m/sqrt(m), range of what is learnt
USUAL, USUAL_SPREAD = Noise(), 2.0  # slips before the runs speak: within this factor of e


def calibrate_odometry(
    runs: Sequence[Run], *, reference: str = "auto", learn_noise: bool = True, own_clocks: bool = False
) -> OdometryCalibration:
    """Everything that these runs of one robot show.

    reference: truth, beacon, ranges, or auto (the first of these that a run has). learn_noise: slip from the runs, and
    the reference's noise where no run states it. own_clocks: each run's reference has a delay of its own, as where
    someone aligned the logs by hand. Raises MissingStreamError, NotEnoughDataError, ParameterError.
    """
    if not runs:
        raise NotEnoughDataError("no runs given", expected=1, found=0)
    chains, unknowns = _chains(runs, reference, own_clocks)
    shared = np.zeros(unknowns)
    free, reasons = _present(chains, unknowns)
    width = np.array([p.width for p in TABLE[:SHARED]])
    pull = np.zeros(len(shared))
    pull[:SHARED] = 1 / width**2
    shared, noise = _fit(chains, shared, free, Noise(), learn_noise, pull, ROUNDS)
    information, _ = _reduced(chains, noise)
    shown, hidden = _shown(information, free)
    reasons |= hidden
    # What is not shown stays within its plausible width, so that it widens the others' deviations; what is, is free.
    pull[:SHARED] = np.where(shown, 0.0, 1 / width**2)
    shared, noise = _fit(chains, shared, free, noise, learn_noise, pull, FINAL_ROUNDS)
    if not np.all(np.abs(shared[:SHARED]) <= FARTHEST * width):
        worst = TABLE[int(np.nanargmax(np.abs(shared[:SHARED]) / width))].name
        raise NotEnoughDataError(
            f"the search ran away ({worst} is not plausible): wheels, gyro and reference do not tell of one motion",
            parameter=worst,
        )
    information, _ = _reduced(chains, noise)
    covariance = _inverse(information + np.diag(pull), free)
    values = _values(runs[0], shared, covariance, shown)
    mount, why = imu_mount(chains, shared)
    return OdometryCalibration(
        parameters={p.name: {**values, **mount}.get(p.name) for p in TABLE},
        reasons={**reasons, **why},
        correlation=_alike(covariance, shown),
        noise=asdict(noise),
        reference=", ".join(sorted({c.reference.kind for c in chains})),
        notes=_remarks(chains),
    )


def _chains(runs: Sequence[Run], reference: str, own_clocks: bool) -> tuple[list[Chain], int]:
    """A chain per run, and how many unknowns they share in all."""
    chains, column = [], SHARED
    for run in runs:
        reason = needs.for_encoders(run)
        if reason is not None:
            raise MissingStreamError(
                f"run {run.meta.name!r} cannot be used: {reason}", method="calibrate_odometry", missing=reason
            )
        if run.imu is not None and len(run.imu) < 2:
            run = replace(run, imu=None)
        found, pose = find_reference(run, reference)
        k = len(found.t)
        chain = Chain(run, found, pose, slice(column, column), np.ones(k - 1), np.ones(k))
        if run.imu is not None:
            column += len(chain.nodes())
            chain.columns = slice(chain.columns.start, column)
        if own_clocks:
            chain.delay = column
            column += 1
        chains.append(chain)
    return chains, column


def _present(chains: Sequence[Chain], unknowns: int) -> tuple[npt.NDArray[np.bool_], dict[str, str]]:
    """Which unknowns the streams can show at all, and why not the others."""
    free = np.ones(unknowns, bool)
    reasons: dict[str, str] = {}
    if all(c.run.imu is None for c in chains):
        free[[GYRO, IMU_CLOCK]] = False
        reasons |= dict.fromkeys(("gyro_scale", "imu_clock"), "no run has an imu")
    if all(c.reference.kind == "truth" for c in chains):
        free[[TAG_X, TAG_Y]] = False
        reasons |= dict.fromkeys(("tag_x", "tag_y"), "the reference is truth: of the body's origin, not of the tag")
    if all(c.reference.z.shape[1] < 3 for c in chains):
        free[TAG_YAW] = False
        reasons["tag_yaw"] = "the reference has no heading"
    if any(c.delay is not None for c in chains):
        free[DELAY] = False
        reasons["reference_delay"] = "each run was given a delay of its own"
    return free, reasons


Part = tuple[Arrow, Eliminated, float]


def _reduced(chains: Sequence[Chain], noise: Noise) -> tuple[Array, list[Part]]:
    """Information (n, n) on the shared with all poses unknown, and each chain's part, where last linearised."""
    parts = []
    for chain in chains:
        arrow, logdet = chain.normal(noise)
        parts.append((arrow, eliminate(arrow), logdet))
    return np.asarray(sum(e.information for _, e, _ in parts)), parts


def _linearise(chains: Sequence[Chain], shared: Array) -> None:
    for chain in chains:
        chain.linearise(shared)


def _fit(
    chains: Sequence[Chain],
    shared: Array,
    free: npt.NDArray[np.bool_],
    noise: Noise,
    learn: bool,
    pull: Array,
    rounds: int,
) -> tuple[Array, Noise]:
    """Gauss-Newton with reweighing; pull (n,): information that holds each unknown near its nominal value."""
    for attempt in range(rounds + 1):
        for _ in range(STEPS if attempt else PLAIN):
            _linearise(chains, shared)
            information, parts = _reduced(chains, noise)
            H = (information + np.diag(pull))[np.ix_(free, free)]
            right = np.sum([e.right for _, e, _ in parts], axis=0) - pull * shared
            step = np.zeros(len(shared))
            step[free] = np.linalg.solve(H + 1e-12 * np.diag(np.diag(H)), right[free])
            shared = shared + step
            for chain, (_, eliminated, _) in zip(chains, parts, strict=True):
                chain.pose = chain.pose + eliminated.poses(step)
        _linearise(chains, shared)
        if learn and 0 < attempt < rounds:
            noise = _learnt(chains, shared, free, noise, pull)
        if attempt < rounds:
            for chain in chains:
                chain.normal(noise)  # misfits at the new estimate
                chain.reweigh()
    return shared, noise


def _learnt(chains: Sequence[Chain], shared: Array, free: npt.NDArray[np.bool_], noise: Noise, pull: Array) -> Noise:
    """Slip, side slip, and the reference's noise where unstated, by the restricted likelihood around the estimate."""
    from scipy.optimize import minimize

    stated = all(c.reference.stated for c in chains)
    chains = [c.head(max(LEARN_FROM // len(chains), FEWEST)) for c in chains]

    def noise_of(logs: Array) -> Noise:
        slip, side = np.clip(np.exp(logs[:2]), *SLIPS)
        seen = (1.0, 1.0, 0.0) if stated else np.exp(np.clip(logs[2:], -12, 5))
        return Noise(float(slip), float(side), *(float(value) for value in seen))

    def unlikely(logs: Array) -> float:
        information, parts = _reduced(chains, noise_of(logs))
        H = (information + np.diag(pull))[np.ix_(free, free)] + 1e-12 * np.eye(free.sum())
        right = (np.sum([e.right for _, e, _ in parts], axis=0) - pull * shared)[free]
        cost = sum(a.cost - e.gain for a, e, _ in parts) - 0.5 * float(right @ np.linalg.solve(H, right))
        dets = sum(logdet + e.logdet for _, e, logdet in parts) + float(np.linalg.slogdet(H)[1])
        usual = np.log((USUAL.slip, USUAL.side))
        return cost + 0.5 * dets + 0.5 * float(np.sum(((logs[:2] - usual) / USUAL_SPREAD) ** 2))

    now = (noise.slip, noise.side, noise.places, noise.headings, max(noise.jitter, 2e-3))
    start = np.log(now[: 2 if stated else 5])
    simplex = np.vstack((start, start + 0.7 * np.eye(len(start))))
    options = {"maxfev": (24 if stated else 120), "xatol": 0.05, "fatol": 0.05, "initial_simplex": simplex}
    return noise_of(np.asarray(minimize(unlikely, start, method="Nelder-Mead", options=options).x))


def _inverse(information: Array, free: npt.NDArray[np.bool_]) -> Array:
    covariance = np.full(information.shape, np.nan)
    covariance[np.ix_(free, free)] = np.linalg.inv(information[np.ix_(free, free)])
    return covariance


def _shown(information: Array, free: npt.NDArray[np.bool_]) -> tuple[npt.NDArray[np.bool_], dict[str, str]]:
    """Which of the shared the runs show, by the information matrix; the reasons for the others."""
    width = np.array([p.width for p in TABLE[:SHARED]])
    shown, reasons = free[:SHARED].copy(), {}
    while shown.any():
        pull = np.zeros(len(information))
        pull[:SHARED] = np.where(shown, 1e-3, 1.0) / width**2  # so that what nothing shows can be inverted
        covariance = _inverse(information + np.diag(pull), free)
        share = np.where(shown, np.sqrt(np.diag(covariance)[:SHARED]) / width, 0.0)
        worst = int(np.argmax(share))
        if share[worst] < SHOWN:
            break
        reasons[TABLE[worst].name] = _reason(worst, information, covariance, shown, width)
        shown[worst] = False
    return shown, reasons


def _reason(i: int, information: Array, covariance: Array, shown: npt.NDArray[np.bool_], width: Array) -> str:
    sd = float(np.sqrt(covariance[i, i]))
    alone = float(1 / np.sqrt(max(information[i, i], 1e-30)))
    told = f"the runs leave an sd of {sd:.2g}, more than {SHOWN:.0%} of what is plausible ({width[i]:.2g})"
    if alone < SHOWN * width[i]:
        scale = np.sqrt(np.diag(covariance)[:SHARED])
        others = np.where(shown, np.abs(covariance[i, :SHARED]) / (scale * scale[i]), 0.0)
        others[i] = 0.0
        j = int(np.nanargmax(others))
        return f"cannot be told apart from {TABLE[j].name} ({told}): {TABLE[i].advice}"
    return f"{told}: {TABLE[i].advice}"


def _values(run: Run, shared: Array, covariance: Array, shown: npt.NDArray[np.bool_]) -> dict[str, Value | None]:
    """Corrections as what they mean: radii and track in metres, the gyro's scale as reading over rate."""
    robot = run.meta.robot
    r, b = robot.wheel_radius or 0.0, robot.track_width or 0.0
    base = {LEFT: (r, r), RIGHT: (r, r), TRACK: (b, b), GYRO: (1.0, 1.0), TAG_X: (robot.tag.x, 1.0),
            TAG_Y: (robot.tag.y, 1.0), TAG_YAW: (0.0, 1.0), IMU_CLOCK: (0.0, 1.0), DELAY: (0.0, 1.0)}  # fmt: skip
    sd = np.sqrt(np.diag(covariance))
    values: dict[str, Value | None] = {}
    for i, (nominal, unit) in base.items():
        found = Value(nominal + unit * float(shared[i]), unit * float(sd[i]), TABLE[i].unit)
        values[TABLE[i].name] = found if shown[i] else None
    return values


def _alike(covariance: Array, shown: npt.NDArray[np.bool_]) -> dict[str, float]:
    sd = np.sqrt(np.diag(covariance))
    pairs = ((i, j) for i in range(SHARED) for j in range(i) if shown[i] and shown[j])
    found = {f"{TABLE[j].name}, {TABLE[i].name}": float(covariance[i, j] / (sd[i] * sd[j])) for i, j in pairs}
    return {name: value for name, value in found.items() if abs(value) > ALIKE}


def _remarks(chains: Sequence[Chain]) -> tuple[str, ...]:
    notes = []
    odd = float(np.mean(np.concatenate([c.weight_steps for c in chains]) < 0.5))
    wild = float(np.mean(np.concatenate([c.weight_reference for c in chains]) < 0.5))
    if odd > 0.01:
        notes.append(f"{odd:.0%} of the wheels' steps do not fit (slip, bumps) and count less.")
    if wild > 0.01:
        notes.append(f"{wild:.0%} of the reference's readings do not fit and count less.")
    if any(c.reference.kind != "truth" for c in chains):
        notes.append("Lengths are in the beacons' metres: a wrong speed of sound scales the radii with it.")
    return tuple(notes)
