"""What a diagnosis tells: where, how far, with what evidence; what is left; what to drive next; other simulators."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.effects import EFFECTS as LISTED
from core.errors import ParameterError
from core.gap import Diagnosis, diagnose, evidence_json
from core.gap.candidates import Reach
from core.gap.discoveries import hierarchical, simes, step_up
from core.gap.experiment import Rivals, chance, separation
from core.gap.floor import Floor
from core.gap.judge import clear_of_small
from core.gap.linear import Problem, with_floor
from core.gap.reference import restarts_of
from core.gap.scatter import scatters
from core.gap.shrink import Scored, figures, show
from core.gap.stretches import GAP, HELD, spans_of, without
from core.gap.types import Value
from core.gap.world import make_world
from core.robot import EffectSet
from core.run import Run
from core.simulation import simulate
from core.simulation.foreign import Foreign, recorded
from tests.plants.gap_plant import Effects, Plan, record

EFFECTS: Effects = {"track_width": {"scale": 1.03}, "gyro_bias": {"bias": 0.006}}
KEYS = {
    "schema", "noise_floor", "links", "cells", "runs", "signatures", "sets", "considered", "cannot_see",
    "unexplained", "next",
}  # fmt: skip


def made(seconds: float, **options: object) -> Run:
    """One drive of the plant."""
    return record(Plan(11, seconds=seconds, sensors="none", **options))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def found() -> Diagnosis:
    """One run, long enough to hold a stretch of it out."""
    return diagnose([made(75.0, effects=EFFECTS)])


@pytest.fixture(scope="module")
def strange() -> Diagnosis:
    """A cause outside the library."""
    return diagnose([made(30.0, outside={"gyro_cubic": 0.03})])


def test_evidence_is_plain_json_with_every_key(found: Diagnosis, strange: Diagnosis) -> None:
    for one in (found, strange):
        out = json.loads(json.dumps(evidence_json(one), allow_nan=False))
        assert set(out) == KEYS
        assert out["schema"] == "gap-evidence/1"
        assert all(len(run["timeline"]["t"]) <= 2000 for run in out["runs"])


def test_where_names_the_stream_and_what_the_robot_does_there(found: Diagnosis) -> None:
    assert found.where[0].stream in ("imu.gz", "truth.theta")
    assert {one.regime for one in found.where} == {"turning", "always"}
    assert not any(one.stream.startswith("wheels") for one in found.where)
    cells = {(one.stream, one.regime): one for one in found.evidence.cells}
    assert cells["imu.gz", "turning"].significant
    assert cells["imu.gz", "turning"].before > 2.0 * cells["imu.gz", "turning"].after
    assert not cells["wheels.left", "turning"].significant
    links = {one.link: one for one in found.evidence.links}
    assert links["body to gyro"].before > 2.0 and links["body to gyro"].after == pytest.approx(1.0, abs=0.1)
    assert links["commands to wheels"].p_value > 0.001


def test_a_clean_run_shows_nothing_anywhere() -> None:
    clean = diagnose([made(25.0)])
    assert clean.where == ()
    assert not any(one.significant for one in clean.evidence.cells)
    assert clean.evidence.unexplained is None and clean.evidence.next is None


def test_how_far_is_scored_on_a_stretch_that_took_no_part(found: Diagnosis) -> None:
    gap = found.gap
    assert gap.held_out
    assert gap.shrink is not None and gap.shrink > 0.95
    assert gap.shrink_ci is not None and gap.shrink_ci[0] <= gap.shrink <= gap.shrink_ci[1]
    assert gap.without["track_width"] > gap.without["gyro_bias"] > gap.total.after
    assert sum(one.share for one in found.causes) == pytest.approx(1.0, abs=0.6)


def test_the_free_run_nears_the_real_path_as_the_effects_are_added(found: Diagnosis) -> None:
    one = found.evidence.runs[0].free_run
    assert one is not None
    far = [float(np.hypot(path.x[-1] - one.real.x[-1], path.y[-1] - one.real.y[-1])) for path in one.paths]
    assert far[0] > 0.3
    assert far[-1] < 0.1 * far[0]
    assert far == sorted(far, reverse=True)


def test_a_signature_shows_the_effects_own_law(found: Diagnosis) -> None:
    one = found.evidence.signatures["track_width"]
    assert (one.stream, one.regressor) == ("imu.gz", "turn rate")
    slope = np.polyfit(one.x, one.residual, 1)[0]
    assert slope == pytest.approx(1.0 / 1.03 - 1.0, rel=0.1)
    assert np.abs(one.after).max() < 0.1 * np.abs(one.residual).max()


def test_what_these_runs_cannot_see_is_said_with_the_size_from_which_they_could(found: Diagnosis) -> None:
    unseen = {(one.effect, one.parameter): one.visible_from for one in found.evidence.cannot_see}
    assert unseen["range_bias", "bias"] is None  # no ranges
    assert ("gyro_scale", "scale") not in unseen  # 0.2 % is seen with ease beside truth
    assert all(size is None or size > 0.0 for size in unseen.values())


def test_an_unlisted_cause_is_described_by_its_curve(strange: Diagnosis) -> None:
    left = strange.evidence.unexplained
    assert left is not None and left.stream == "imu.gz"
    curve = left.shapes[0]
    assert curve.regressor == "turn rate"
    far = int(np.argmax(np.abs(curve.x)))
    assert curve.y[far] == pytest.approx(0.03 * curve.x[far] ** 3, rel=0.3)
    assert curve.lo[far] <= curve.y[far] <= curve.hi[far]
    assert left.nearest and all("imu.gz" in LISTED[one.effect].streams and one.takes < 1.0 for one in left.nearest)
    assert [one.regime for one in strange.where] == ["fast turning"]


def test_near_its_tolerance_nothing_is_sure() -> None:
    known = {"x": Value(1.012, 0.0015), "y": Value(1.0, 0.0015)}
    chances = [clear_of_small("accel_scale", size, known) for size in (1.0, 1.2, 1.5, 2.5)]
    assert chances == sorted(chances)
    assert chances[1] < 0.5 < chances[2]
    assert chances[3] > 0.99
    assert clear_of_small("motor_lag", 1.1, {}) == 1.0  # beyond a delay's tolerance and its own


def test_an_effect_that_makes_held_out_data_worse_is_called_harmful() -> None:
    run = made(25.0)
    world = make_world(run, restarts_of(run))
    floor = with_floor(Problem((world,), Floor({}, {}, {}), {}), {}).floor
    wrong: EffectSet = {"gyro_bias": {"bias": 0.01}}
    shown = show(world, {}, wrong, floor)
    gap, harmful = figures(Scored([world], [shown], ("gyro_bias",), True), floor, {}, 0)
    assert harmful == ("gyro_bias",)
    assert gap.total.after > gap.total.before
    assert figures(Scored([world], [shown], ("gyro_bias",), False), floor, {}, 0)[1] == ()


def test_shadow_and_outliers_lie_within_their_deviations() -> None:
    """A disc without fixes, and far-off fixes, as the readings themselves tell them."""
    true = {"beacon_shadow": {"x": 2.5, "y": 2.0, "radius": 0.6}, "beacon_outliers": {"rate": 0.1, "size": 0.5}}
    run = record(Plan(1234, "mixed", 40.0, true))
    problem = with_floor(Problem((make_world(run, restarts_of(run)),), Floor({}, {}, {}), {}), {})
    found = {one.effect: one.parameters for one in scatters(problem, {}, ())}
    for effect, values in true.items():
        for name, value in values.items():
            told, sd = found[effect][name]
            assert abs(told - value) < 3.0 * sd < 0.5 * value


def test_held_out_stretches_leave_no_reading_to_the_fit() -> None:
    run = made(75.0)
    spans = spans_of(run)
    assert [b - a for a, b in spans] == [HELD]
    fewer = without(run, spans)
    assert fewer.commands is run.commands
    for name in ("wheels", "imu", "truth"):
        t = getattr(fewer, name).t
        assert not ((t > spans[0][0] - GAP) & (t < spans[0][1] + GAP)).any()
        assert len(t) < len(getattr(run, name).t)
    assert spans_of(run.crop(0.0, 40.0)) == ()


def test_the_users_own_simulator_is_compared_as_it_is() -> None:
    run = made(16.0, effects={"gyro_bias": {"bias": 0.01}})
    added: EffectSet = {"track_width": {"scale": 1.03}}
    odd = Foreign("odd", lambda asked, _, seed: simulate(asked, added, seed, noise=False))
    sizes = {
        one.effect: float(next(iter(one.parameters.values())).value)
        for one in diagnose([run], odd).causes
        if one.probability > 0.5
    }
    assert sizes == {"track_width": pytest.approx(1.0, abs=2e-3), "gyro_bias": pytest.approx(0.01, abs=5e-4)}


def test_a_simulator_that_does_not_fit_the_runs_is_refused() -> None:
    run = made(12.0)
    sim = recorded("sim", run)
    with pytest.raises(ParameterError, match="1 runs and 2 simulators"):
        diagnose([run], [sim, sim])
    with pytest.raises(ParameterError, match="no commands"):
        diagnose([dataclasses.replace(run, commands=None)], sim)


def test_the_next_drive_is_one_on_which_the_rivals_differ() -> None:
    run = made(12.0)
    floor = Floor({"imu.gz": 2e-3, "wheels.left": 1e-3, "wheels.right": 1e-3}, {}, {})
    pair = Rivals("track_width", "gyro_drift", 0.0)
    model: EffectSet = {"track_width": {"scale": 1.02}}
    reach = Reach(0.7, 1.0, 1.2)
    straight, turning = (separation(run, name, model, pair, floor, reach) for name in ("straight", "in-place"))
    assert straight < 1.0 < 20.0 < turning
    assert chance(straight**2) < 0.05 < 0.95 < chance(turning**2)


def test_step_up_is_benjamini_and_hochbergs_rule() -> None:
    small = [0.0001, 0.0004, 0.0019, 0.0095, 0.0201, 0.0278, 0.0298, 0.0344, 0.0459]
    p = np.array([*small, 0.3240, 0.4262, 0.5719, 0.6528, 0.7590, 1.0])
    assert step_up(p, 0.05).sum() == 4  # their example of 1995
    assert step_up(p, 0.05, dependent=True).sum() == 3
    assert simes(np.array([0.04, 0.5])) == pytest.approx(0.08)


@settings(max_examples=40)
@given(st.lists(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=8), min_size=1, max_size=5))
def test_discoveries_hold_the_smallest_p_values_and_no_family_without_one(families: list[list[float]]) -> None:
    table = {str(k): np.array(p) for k, p in enumerate(families)}
    found = hierarchical(table)
    for name, p in table.items():
        if found[name].any():
            assert p[found[name]].max() <= p[~found[name]].min(initial=1.0)
            assert simes(p) <= 0.05
