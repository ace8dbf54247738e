"""The live protocol, `driftscope-live/1`: every message as a typed structure. SI units and radians; names as in runs.

Frames    a text frame is one message as JSON, a binary frame the same object as MessagePack. The server answers in the
          kind of frame that the other side used last (viewers: JSON unless they ask with `?encoding=msgpack`).
Robot     WebSocket `/api/v1/live/{robot}`, `robot` a name of 1 to 64 letters, digits, `.`, `_`, `-`.
              robot: Hello -> server: Welcome
              robot: Batch n, n + 1, ... -> server: Ack n (all up to n are on disk), Throttle, Command, Stop
              robot: End -> server: Ended, then the connection is closed
              server: Error, then the connection is closed; `detail` says what is wrong, `where` the same as data
          Batches are numbered from 0. After a connection broke, the same `session` in Hello goes on with the same run:
          send again from `Welcome.next`. A batch that is known already is acknowledged and ignored.
          Stamps `t` are seconds since the start of the run on the robot's clock, increasing within a stream; rows that
          are not newer than what is there of their stream are dropped and counted in `Quality.late_rows`.
HTTP      `POST /api/v1/live/{robot}/rows`, NDJSON: one Hello, Batch or End per line; the answer is that to the last.
Viewer    WebSocket `/api/v1/live/{robot}/watch`: server: Snapshot, then Update at most 20 times a second and once at
          least, whatever the robot does; Driver when somebody takes the stick or leaves it, Refused, Gone when the run
          has ended (a later run of the same robot begins with a new Snapshot on the same connection). viewer:
          DriveRequest, DriveRelease, Drive, ViewerStop.
          A viewer that reads too slowly misses updates (`seq` jumps); it is never waited for.
List      `GET /api/v1/live`: LiveRobot of every robot that is connected, or silent for less than the time-out.
"""

from __future__ import annotations

from typing import Any, Literal, NotRequired, TypedDict

PROTOCOL = "driftscope-live/1"

Columns = dict[str, list[Any]]
"""Columns of one stream by name, equal lengths, `t` among them; null where a reading is missing. MessagePack may hold
a column as binary: float64, little-endian."""


# ---------------------------------------------------------------------------------------------- robot to server


class Hello(TypedDict):
    """First message of a robot."""

    type: Literal["hello"]
    protocol: str  # PROTOCOL
    session: str  # chosen by the robot once per run, 1 to 64 printable characters; the same one goes on with the run
    run: dict[str, Any]  # run.json, as of the run format
    drive: NotRequired[bool]  # the robot obeys Command and Stop; default false
    virtual: NotRequired[bool]  # no real robot: may be driven without `serve --drive`; default false
    limits: NotRequired[DriveLimits]  # how fast it may be driven


class DriveLimits(TypedDict):
    """Fastest commands that the robot accepts: |v| [m/s], |w| [rad/s]."""

    v: float
    w: float


class Batch(TypedDict):
    """Rows of any streams. A robot may send as many as come in 10 to 100 ms in one batch."""

    type: Literal["batch"]
    n: int  # 0, 1, 2, ...
    sent: float  # robot's clock when it was sent [s], any epoch (Unix time is best)
    streams: dict[str, Columns]
    heard: NotRequired[list[float]]  # [`at` of the last Ack, robot's clock when it came]: shows the clocks' offset


class End(TypedDict):
    """The run is over: it becomes an ordinary stored run."""

    type: Literal["end"]


# ---------------------------------------------------------------------------------------------- server to robot


class Limits(TypedDict):
    """What the server takes of one robot; more is refused (size) or throttled (rate)."""

    batch_rows: int  # rows of all streams in one batch
    batch_bytes: int
    rows_per_s: float
    batches_per_s: float
    unacknowledged: int  # batches that may be under way


class Welcome(TypedDict):
    """Answer to Hello."""

    type: Literal["welcome"]
    protocol: str
    run_id: str  # of the live run; leads to the stored run once it has ended
    next: int  # number of the batch that the server wants next
    limits: Limits
    drive: bool  # commands may come
    at: float  # server's clock, Unix time [s]


class Ack(TypedDict):
    """All batches up to and with `n` are on disk."""

    type: Literal["ack"]
    n: int
    at: float  # server's clock when it was sent, Unix time [s]


class Throttle(TypedDict):
    """Too fast: wait, then send again from `next`."""

    type: Literal["throttle"]
    code: str  # rate, backlog, gap
    reason: str
    wait_s: float
    next: int


class Error(TypedDict):
    """Refused; the connection is closed after it. Codes: schema, protocol, format, too_large, name_taken, clock,
    flood, disk_full, replaced, unavailable."""

    type: Literal["error"]
    code: str
    detail: str
    where: dict[str, Any]


class Command(TypedDict):
    """Drive at v [m/s], w [rad/s] for `valid_s` at most: without a newer command the robot stops by itself."""

    type: Literal["command"]
    v: float
    w: float
    seq: int
    valid_s: float


class Stop(TypedDict):
    """Stop now, and until a newer command."""

    type: Literal["stop"]
    seq: int


class Ended(TypedDict):
    """Answer to End: all rows are on disk."""

    type: Literal["ended"]
    run_id: str
    n: int  # batches


# --------------------------------------------------------------------------------------------- server to viewer


class Pose(TypedDict):
    """Newest pose by one method: t [s], x, y [m], theta [rad], one sigma each where known, covariance of x and y."""

    t: float
    x: float
    y: float
    theta: float
    sd_x: float | None
    sd_y: float | None
    sd_theta: float | None
    cov_xy: float | None


class Path(TypedDict):
    """Poses over time by one method, in columns; sd_ one sigma, null where unknown."""

    t: list[float]
    x: list[float]
    y: list[float]
    theta: list[float]
    sd_x: list[float | None]
    sd_y: list[float | None]
    sd_theta: list[float | None]
    cov_xy: list[float | None]


class Signal(TypedDict):
    """Readings of one column, thinned so that minima and maxima stay."""

    t: list[float]
    y: list[float | None]


class Bias(TypedDict):
    """Gyro bias [rad/s] over time with one sigma."""

    t: list[float]
    value: list[float]
    sd: list[float]


class LiveEvent(TypedDict):
    """An event as `core.estimation.result.Event`; `t1` is null while it goes on."""

    kind: str
    t0: float
    t1: float | None
    evidence: str


class Link(TypedDict):
    """One link of the chain commands -> wheels -> body -> sensors against its noise floor."""

    link: str  # "commands to wheels", "wheels to gyro", "wheels to accelerometer", "body to beacon", "body to ranges"
    streams: list[str]
    excess: float | None  # rms of the standardised residual over the last seconds; 1 is the noise floor; null: no data
    level: float  # above it chance is no explanation
    warn: bool  # excess has left the level, and stayed there
    rows: int  # residuals that it is made of


class Quality(TypedDict):
    """How good the connection is, over the last seconds."""

    rate_hz: dict[str, float]  # rows per second, per stream
    batches_hz: float
    latency_ms: float | None  # median time from sending a batch to its estimate, clock offset taken out
    latency_p99_ms: float | None
    delay_ms: float | None  # median of the same by the two clocks as they are
    loss: float  # share of batches that had to be sent again, or rows that were dropped
    late_rows: int  # since the start
    clock_offset_s: float | None  # robot's clock minus the server's
    offset_sd_s: float | None  # half of the shortest round trip
    silent_s: float  # since the last message
    backlog: int  # batches received and not yet estimated


class MethodState(TypedDict):
    """Whether a method runs; else why not (yet)."""

    method: str
    label: str
    reason: str | None


class Ranges(TypedDict):
    """Last range of each beacon: t [s], range [m]."""

    t: float
    range: float


class DriverState(TypedDict):
    """Who drives. `who` is null when nobody does."""

    who: str | None
    you: bool
    allowed: bool
    reason: str | None  # why nobody may drive
    limits: DriveLimits


class Snapshot(TypedDict):
    """All of the run so far, thinned: the first message to a viewer, and when a new run begins."""

    type: Literal["snapshot"]
    seq: int
    robot: str
    run_id: str
    state: Literal["live", "silent", "ended", "waiting"]  # waiting: no such robot yet; then the rest is empty
    run: dict[str, Any]  # run.json
    t: float  # newest stamp
    methods: list[MethodState]
    paths: dict[str, Path]
    signals: dict[str, Signal]
    units: dict[str, str]  # of the signals
    bias: Bias
    events: list[LiveEvent]
    links: list[Link]
    ranges: dict[str, Ranges]
    quality: Quality
    rows: dict[str, int]  # per stream
    driver: DriverState


class Update(TypedDict):
    """What is new since the update before it (`seq` - 1)."""

    type: Literal["update"]
    seq: int
    state: Literal["live", "silent"]
    t: float
    poses: dict[str, Pose]
    trail: dict[str, Path]  # new poses since the last update, thinned
    signals: dict[str, Signal]  # new readings
    bias: Bias  # new values
    events: list[LiveEvent]  # new, or changed: same kind and t0
    links: list[Link]
    ranges: dict[str, Ranges]
    quality: Quality
    rows: dict[str, int]
    methods: NotRequired[list[MethodState]]  # only when one has changed


class Driver(TypedDict):
    """Who drives has changed."""

    type: Literal["driver"]
    who: str | None
    you: bool
    allowed: bool
    reason: str | None
    limits: DriveLimits


class Refused(TypedDict):
    """A viewer's message was not obeyed; the connection stays. Codes: driving, not_driver,
    drive_off, schema, no_robot."""

    type: Literal["refused"]
    code: str
    detail: str


class Gone(TypedDict):
    """The run has ended; once it is stored a second one follows with `stored_as`, the id that it has from then on."""

    type: Literal["gone"]
    run_id: str
    stored_as: str | None


# --------------------------------------------------------------------------------------------- viewer to server


class DriveRequest(TypedDict):
    """Ask for the stick. `take_over` takes it from who has it; without, it is given only where nobody has it."""

    type: Literal["drive_request"]
    name: NotRequired[str]  # shown to the others
    take_over: NotRequired[bool]


class DriveRelease(TypedDict):
    """Give the stick back; the robot stops."""

    type: Literal["drive_release"]


class Drive(TypedDict):
    """Where the stick stands: v [m/s], w [rad/s]. Send at least every 0.1 s while it is held; the dead-man time-out is
    DEAD_MAN_S, at the server and at the robot."""

    type: Literal["drive"]
    v: float
    w: float


class ViewerStop(TypedDict):
    """Stop the robot, whoever drives: any viewer may. Another who drove has the stick no more and must ask for it."""

    type: Literal["stop"]


DEAD_MAN_S = 0.5  # a command holds so long
UPDATE_HZ = 20.0  # most updates a second


class LiveRobot(TypedDict):
    """A row of `GET /api/v1/live`."""

    robot: str
    run_id: str
    name: str
    state: Literal["live", "silent"]
    virtual: bool
    started_at: str  # UTC, ISO 8601
    duration_s: float
    viewers: int
    driver: str | None
    rows: dict[str, int]
    quality: Quality
