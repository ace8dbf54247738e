"""What the poses are held against: truth, beacon fixes with heading or without, or single ranges."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from core.calibration.odometry.model import DELAY, TAG_X, TAG_Y, TAG_YAW
from core.errors import MissingStreamError, NotEnoughDataError, ParameterError
from core.estimation.beacon import gather_rounds, multilaterate
from core.estimation.cleaning import gyro_readings
from core.estimation.fusion.start import fit_rigid
from core.estimation.odometry import arcs, wheel_path
from core.estimation.rest import wheels_still
from core.geometry import compose, wrap_angle
from core.run import Run

Array = npt.NDArray[np.float64]

REFERENCES = ("truth", "beacon", "ranges")
CLOSEST = {"truth": 0.1, "beacon": 0.0, "ranges": 0.0}  # s between two poses of the chain, at least
MOST = 40_000  # poses of a chain
DEFAULT_SD = {"truth": (0.002, 0.002), "beacon": (0.05, 0.05), "ranges": (0.1, 0.1)}  # m, rad


@dataclass(frozen=True)
class Reference:
    """t (K,); z (K, d) readings: x, y, theta or x, y or one range, NaN where absent; sd (d,); stated: whether the run
    gives that sd; places (K, 3) of the beacon of each range, tag (x, y, z) nominal."""

    kind: str
    t: Array
    z: Array
    sd: Array
    stated: bool
    tag: tuple[float, float, float]
    places: Array | None = None

    def residuals(
        self, pose: Array, v: Array, w: Array, shared: Array, more_delay: float = 0.0
    ) -> tuple[Array, Array, Array]:
        """Expected less read (K, d), Jacobians by the pose (K, d, 3) and by the tag's x, y, yaw and delay (K, d, 4)."""
        tx, ty = self.tag[0] + shared[TAG_X], self.tag[1] + shared[TAG_Y]
        then = pose.copy()
        late = shared[DELAY] + more_delay
        cos, sin = np.cos(pose[:, 2]), np.sin(pose[:, 2])
        then[:, 0] -= late * v * cos
        then[:, 1] -= late * v * sin
        then[:, 2] -= late * w
        cos, sin = np.cos(then[:, 2]), np.sin(then[:, 2])
        x, y = then[:, 0] + cos * tx - sin * ty, then[:, 1] + sin * tx + cos * ty
        arm_x, arm_y = -sin * tx - cos * ty, cos * tx - sin * ty
        k = len(pose)
        A, J = np.zeros((k, 3, 3)), np.zeros((k, 3, 4))
        A[:, range(3), range(3)] = 1.0
        A[:, 0, 2], A[:, 1, 2] = arm_x, arm_y
        none = np.zeros(k)
        J[:, 0] = np.column_stack((cos, -sin, none, -v * cos - w * arm_x))
        J[:, 1] = np.column_stack((sin, cos, none, -v * sin - w * arm_y))
        J[:, 2, 2], J[:, 2, 3] = 1.0, -w
        if self.places is None:
            d = self.z.shape[1]
            e = np.column_stack((x, y, then[:, 2] + shared[TAG_YAW]))[:, :d] - self.z
            if d == 3:
                e[:, 2] = wrap_angle(e[:, 2])
            return e, A[:, :d], J[:, :d]
        arm = np.column_stack((x, y, np.full(k, self.tag[2]))) - self.places
        far = np.linalg.norm(arm, axis=1)
        sight = (arm[:, :2] / np.maximum(far, 1e-6)[:, None])[:, None, :]
        return far[:, None] - self.z, sight @ A[:, :2], sight @ J[:, :2]


def find_reference(run: Run, kind: str = "auto") -> tuple[Reference, Array]:
    """The run's reference of that kind (auto: the first of REFERENCES that there is) and first guesses of the poses.

    Raises ParameterError for an unknown kind, MissingStreamError, NotEnoughDataError.
    """
    if kind not in ("auto", *REFERENCES):
        raise ParameterError(f"unknown reference {kind!r}", parameter="reference", expected=REFERENCES, found=kind)
    have = [name for name in REFERENCES if _usable(run, name)]
    wanted = kind if kind != "auto" else (have[0] if have else "")
    if wanted not in have:
        raise MissingStreamError(
            f"run {run.meta.name!r} has no {'truth with x and y, no fixes and no ranges' if kind == 'auto' else kind}",
            method="calibrate_odometry",
            missing=[kind],
        )
    reference = _ranges(run) if wanted == "ranges" else _poses(run, wanted)
    if len(reference.t) < 10:
        raise NotEnoughDataError(f"run {run.meta.name!r}: {len(reference.t)} readings of {wanted}", expected=10)
    return reference, _guess(run, reference)


def _usable(run: Run, name: str) -> bool:
    log = getattr(run, name)
    if log is None or not len(log):
        return False
    return name != "truth" or (log.x is not None and log.y is not None)


def _stamps(run: Run, t: Array, closest: float) -> npt.NDArray[np.intp]:
    """Rows of t within the time of wheels and IMU, not closer than that (nor more than MOST)."""
    assert run.wheels is not None
    begin, end = float(run.wheels.t[0]), float(run.wheels.t[-1])
    if run.imu is not None:
        begin, end = max(begin, float(run.imu.t[0])), min(end, float(run.imu.t[-1]))
    inside = np.flatnonzero((t >= begin) & (t <= end))
    if not inside.size:
        return inside
    closest = max(closest, (t[inside[-1]] - t[inside[0]]) / MOST)
    if closest <= 0:
        return inside
    _, first = np.unique(np.floor((t[inside] - t[inside[0]]) / closest + 1e-6), return_index=True)
    return inside[first]


def _poses(run: Run, kind: str) -> Reference:
    log, sheet, robot = getattr(run, kind), run.meta.noise, run.meta.robot
    columns = [np.asarray(c, np.float64) for c in (log.x, log.y, log.theta) if c is not None]
    rows = _stamps(run, log.t, CLOSEST[kind])
    z = np.column_stack(columns)[rows]
    kept = np.isfinite(z[:, :2]).all(axis=1)
    xy, theta = getattr(sheet, f"{kind}_xy"), getattr(sheet, f"{kind}_theta")
    default = DEFAULT_SD[kind]
    sd = np.array((xy or default[0], xy or default[0], theta or default[1]))[: z.shape[1]]
    tag = (robot.tag.x, robot.tag.y, robot.tag.z) if kind == "beacon" else (0.0, 0.0, 0.0)
    return Reference(kind, log.t[rows][kept], z[kept], sd, bool(xy), tag)


def _ranges(run: Run) -> Reference:
    log, tag = run.ranges, run.meta.robot.tag
    assert log is not None
    places = np.array([run.meta.beacons.get(name, (np.nan,) * 3) for name in log.names])[log.beacon]
    z = np.asarray(log.range, np.float64)
    rows = _stamps(run, log.t, 0.0)
    rows = rows[np.isfinite(z[rows]) & np.isfinite(places[rows]).all(axis=1)]
    sd = run.meta.noise.range
    stated = sd is not None
    return Reference(
        "ranges", log.t[rows], z[rows, None], np.array((sd or DEFAULT_SD["ranges"][0],)), stated,
        (tag.x, tag.y, tag.z), places[rows],
    )  # fmt: skip


def _guess(run: Run, reference: Reference) -> Array:
    """(K, 3): the path by wheels and gyro, laid onto the reference as a rigid body, then moved to it piece by piece."""
    wheels, robot = run.wheels, run.meta.robot
    assert wheels is not None and robot.wheel_radius
    path = wheel_path(wheels, robot.wheel_radius, robot.track_width)
    turn = path.turn
    if run.imu is not None:
        t, gz = gyro_readings(run.imu)
        still = wheels_still(wheels, t, 0.5)
        bias = float(np.median(gz[still])) if still.sum() > 10 else 0.0
        turned = np.concatenate(([0.0], np.cumsum((gz[1:] + gz[:-1]) / 2 * np.diff(t) - bias * np.diff(t))))
        turn = np.interp(path.t, t, turned)
    local = np.column_stack([np.interp(reference.t, path.t, c) for c in arcs(path.d, turn).T])
    if reference.kind == "ranges":
        at, seen = _trilaterated(run, reference)
        there = np.column_stack([np.interp(at, reference.t, c) for c in local.T])
    else:
        seen, there = reference.z[:, :2], local
    pose, _ = fit_rigid(there[:, :2], seen, float(reference.sd[0]))
    laid = compose(np.broadcast_to(pose, local.shape), local)
    if reference.kind != "ranges":
        laid[:, :2] = seen
        if reference.z.shape[1] == 3 and np.isfinite(reference.z[:, 2]).all():
            laid[:, 2] += wrap_angle(reference.z[:, 2] - laid[:, 2])
    return laid


def _trilaterated(run: Run, reference: Reference) -> tuple[Array, Array]:
    assert run.ranges is not None
    rounds, _ = gather_rounds(run.ranges, dict(run.meta.beacons))
    if len(rounds.t) < 3:
        raise NotEnoughDataError(
            f"run {run.meta.name!r}: {len(rounds.t)} rounds of ranges to three beacons", expected=3
        )
    xy, _, residual = multilaterate(rounds, reference.tag[2], float(reference.sd[0]))
    good = np.isfinite(xy).all(axis=1) & (residual < 5 * reference.sd[0])
    return rounds.t[good], xy[good]
