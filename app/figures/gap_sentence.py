"""The sentence at the top of a diagnosis: what a colleague could repeat. From gap/1 to words; `code` in backticks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from app.figures.gap_words import as_set, difference, label, share
from app.figures.units import significant

JOINT = 0.5  # causes above this probability are the joint explanation (gap/1)
SURE = 0.9  # below this the rivals are named too
NAMED = 3  # causes by name; more are counted
LITTLE = 0.005  # of the gap: below this a cause is counted, not named
MOST = 0.8  # of the gap: below this its part is said
ALMOST_ALL = 0.9  # of what the gap shrinks by: below this the immaterial effects are named as those that do the rest
AT_FLOOR = 1.25  # times the floor: nothing to speak of above it

VERDICTS = {
    "none": "no gap",
    "explained": "explained",
    "partly_explained": "partly explained",
    "unknown": "unknown cause",
}
REGRESSORS = {
    "t": "time", "time": "time", "truth.w": "turn rate", "truth.v": "speed", "w": "turn rate", "v": "speed",
    "a": "acceleration", "turn": "turn rate", "turning": "turn rate", "theta": "heading", "truth.theta": "heading",
    "truth.x": "place", "truth.y": "place", "imu.temperature": "temperature",
    "ranges.range": "distance", "truth.a": "acceleration", "truth.alpha": "turn acceleration",
    "alpha": "turn acceleration",
    "wheels.left": "left wheel's angle", "wheels.right": "right wheel's angle",
}  # fmt: skip
STREAMS = {
    "wheels.left": "left encoder", "wheels.right": "right encoder", "imu.gz": "gyro", "imu.ax": "forward acceleration",
    "imu.ay": "sideways acceleration", "beacon.x": "fixes along x", "beacon.y": "fixes along y",
    "beacon.theta": "fixes' heading", "ranges.range": "ranges", "truth.x": "reference x", "truth.y": "reference y",
    "truth.theta": "reference heading",
}  # fmt: skip


def stream_name(stream: str) -> str:
    """`imu.gz` as `gyro`; a beacon's ranges by its name; what is unknown as it is."""
    if stream in STREAMS:
        return STREAMS[stream]
    head, _, tail = stream.partition(".")
    return f"ranges to {tail}" if head == "ranges" and tail else stream


def regressor_name(regressor: str) -> str:
    """`truth.w` as `turn rate`."""
    return REGRESSORS.get(regressor, regressor.replace("_", " "))


def joint(result: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """The causes that explain the gap together, the strongest first."""
    return [cause for cause in result["causes"] if (cause["probability"] or 0.0) > JOINT]


def sentence(result: Mapping[str, Any]) -> str:
    """One to four short sentences for any gap/1."""
    causes, verdict = joint(result), result["verdict"]
    if verdict == "none":
        return _none(result)
    if not causes:
        return " ".join(part for part in (_unknown(result), _rivals(result)) if part)
    first = difference(causes[0]["effect"], causes[0]["parameters"])
    parts = [first, f"{_explains(causes, result['gap'])}; {_remedy(causes, result)}.", _doubt(causes, result)]
    if verdict == "partly_explained":
        parts.append(_left(result))
    return " ".join(part for part in parts if part)


def headline(result: Mapping[str, Any]) -> str:
    """A few words for lists: `track width 96 %`."""
    causes = joint(result)
    if result["verdict"] == "none" or not causes:
        return VERDICTS.get(str(result["verdict"]), str(result["verdict"]))
    shown = ", ".join(f"{label(c['effect'])} {share(part)}" for c, part in parts_of(causes, result["gap"])[:NAMED])
    more = f" and {len(causes) - NAMED} more" if len(causes) > NAMED else ""
    return shown + more + ("; a part unknown" if result["verdict"] == "partly_explained" else "")


def times(value: float | None) -> str:
    """A gap in units of the noise: 3.2, 1.05, 41."""
    if value is None:
        return "an unknown number of"
    if abs(value) < 1e-6:  # rounding of equal readings, as of wheels held against a simulator that shares them
        return "0"
    return significant(value, 3 if 1 <= abs(value) < 2 else 2) if abs(value) < 100 else f"{value:,.0f}"


def _none(result: Mapping[str, Any]) -> str:
    gap = result["gap"]
    before, floor = gap["before"], gap["floor"]
    if before is None or floor is None:
        return "Nothing material was found, but these runs give no measure of the gap."
    if before <= AT_FLOOR * max(floor, 1e-9):
        return (
            f"Robot and simulator agree: {_whose(gap)} is {times(before)} times the noise, and the noise floor "
            f"itself {times(floor)}. No listed effect of material size is left."
        )
    return (
        f"No listed effect of material size was found, yet {_whose(gap)} is {times(before)} times the noise against a "
        f"floor of {times(floor)}: what is left is small per effect, or of no shape that these runs show."
    )


def _whose(gap: Mapping[str, Any]) -> str:
    return "the held-out error" if gap["held_out"] else "the error of these runs"


def parts_of(causes: Sequence[Mapping[str, Any]], gap: Mapping[str, Any]) -> list[tuple[Mapping[str, Any], float]]:
    """Each cause with its part of the gap: of what is explained, times how much of the gap that is.

    Shares are what leaving a cause out brings back; of causes that act in the same streams they add up to more than
    all, and are told in proportion.
    """
    shrink = gap["shrink"]
    whole = min(max(shrink, 0.0), 1.0) if shrink is not None else 1.0
    whole /= max(sum(cause["share"] or 0.0 for cause in causes), 1.0)
    return [(cause, (cause["share"] or 0.0) * whole) for cause in causes]


def _explains(causes: Sequence[Mapping[str, Any]], gap: Mapping[str, Any]) -> str:
    parts = parts_of(causes, gap)
    if len(parts) == 1:
        cause, part = parts[0]
        of = f"{share(part)} of the gap" if part >= LITTLE else "next to nothing of the gap"
        return f"{_capital(label(cause['effect']))} explains {of} (probability {cause['probability']:.2f})"
    large = [(cause, part) for cause, part in parts[:NAMED] if part >= LITTLE] or parts[:1]
    named = [f"{label(cause['effect'])} ({share(part)})" for cause, part in large]
    if rest := len(parts) - len(large):
        named.append(f"{rest} smaller {'effect' if rest == 1 else 'effects'}")
    whole = sum(part for _, part in parts)
    of = "the gap" if whole >= MOST else f"{share(whole)} of the gap"
    least = min(cause["probability"] for cause in causes)
    return f"{_capital(_listed(named))} explain {of} together (probability at least {least:.2f})"


def _remedy(causes: Sequence[Mapping[str, Any]], result: Mapping[str, Any]) -> str:
    gap = result["gap"]
    what = f"add `{as_set(causes[0]['effect'], causes[0]['parameters'])}`" if len(causes) == 1 else "add them"
    small, whole = len(result["immaterial"]), sum(part for _, part in parts_of(causes, gap))
    if small and gap["shrink"] is not None and whole < ALMOST_ALL * min(gap["shrink"], 1.0):
        many = "the immaterial effect" if small == 1 else f"the {small} immaterial effects"
        what += f" with {many}"
    before, after = gap["before"], gap["after"]
    if before is None or after is None:
        return f"{what}; these runs give no measure of what that brings"
    verb = "falls" if after < 0.995 * before else "rises" if after > 1.005 * before else "stays"
    floor = f" (floor {times(gap['floor'])})" if above_floor(gap) else ""
    if verb == "stays":
        return f"{what}, though {_whose(gap)} stays at {times(before)} times the noise{floor}"
    return f"{what} and {_whose(gap)} {verb} from {times(before)} to {times(after)} times the noise{floor}"


def above_floor(gap: Mapping[str, Any]) -> bool:
    """Whether a gap worth a word remains once the causes are added."""
    after, floor = gap["after"], gap["floor"]
    return after is not None and floor is not None and after > AT_FLOOR * max(floor, 1e-9)


def _doubt(causes: Sequence[Mapping[str, Any]], result: Mapping[str, Any]) -> str:
    """Rivals that these runs cannot tell from a cause."""
    told = {c["effect"] for c in causes}
    for cause in causes:
        rivals = [label(name) for name in cause.get("confusable_with") or () if name not in told]
        if rivals and cause["probability"] < SURE:
            drive = result.get("next_experiment")
            how = f"; drive `{drive['profile']}` to decide" if drive else ""
            return f"These runs cannot tell {label(cause['effect'])} from {_listed(rivals, 'or')}{how}."
    return ""


def _unknown(result: Mapping[str, Any]) -> str:
    gap, rest = result["gap"], result.get("unexplained")
    size = f"{_whose(gap)} is {times(gap['before'])} times the noise (floor {times(gap['floor'])})"
    if rest is None:
        return f"Something acts on the robot that is in no list: {size}, and no listed effect explains it."
    own = gap["by_stream"].get(rest["stream"])
    if own:
        error = f"{'its held-out error' if gap['held_out'] else 'its error'} is {times(own['before'])} times the noise"
        size = f"{error} (floor {times(own['floor'])})"
    return f"Something in no list acts on the {stream_name(rest['stream'])}{_depends(rest)}: {size}."


def _left(result: Mapping[str, Any]) -> str:
    rest = result.get("unexplained")
    if rest is None:
        return "A part of the gap is of no listed effect."
    return f"What is left is in no list: the {stream_name(rest['stream'])}{_depends(rest)}."


def _depends(rest: Mapping[str, Any]) -> str:
    names = list(dict.fromkeys(regressor_name(name) for name in rest.get("depends_on") or ()))
    return f", depending on {_listed(names)}" if names else ""


def _rivals(result: Mapping[str, Any]) -> str:
    near = [c for c in result["causes"] if (c["probability"] or 0.0) > 0.05][:2]
    if not near:
        return ""
    told = [f"{label(c['effect'])} (probability {c['probability']:.2f})" for c in near]
    return f"Nearest: {_listed(told)}."


def _listed(names: Sequence[str], word: str = "and") -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {word} {names[-1]}"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
