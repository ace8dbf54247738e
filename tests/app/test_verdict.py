"""The sentence at the top of a run."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from app.figures.consistency import sentence
from app.figures.verdict import Case, Judged, lead_of, verdict

DEGREE_PER_HOUR = math.radians(1) / 3600


def judged(method: str, final: float | None = None, ate: float | None = None, **more: float | None) -> Judged:
    return Judged(method, {"final_m": final, "ate_rmse_m": ate, **more})


def test_the_closest_path_leads_and_the_plainest_is_named_beside_it() -> None:
    case = Case(1200, [judged("encoders", 0.94, 0.6), judged("fused", 0.021, 0.03), judged("beacon", 0.1, 0.1)])
    assert verdict(case) == "Fused path ends 2.1 cm from truth (encoders 0.940 m)."


def test_a_plain_method_that_wins_is_said_to_win() -> None:
    case = Case(80, [judged("encoders", 0.029, 0.02), judged("fused", 0.032, 0.03)])
    assert verdict(case) == "Encoder path ends 2.9 cm from truth (fused 3.2 cm)."


def test_bias_and_events_follow() -> None:
    events = [
        {"kind": "slip", "t0": 3.0, "t1": 3.5},
        {"kind": "slip", "t0": 9.0, "t1": 9.2},
        {"kind": "beacon_loss", "t0": 20.0, "t1": 28.0},
    ]
    lead = Judged("fused", {"final_m": 0.021, "ate_rmse_m": 0.03, "bias_drift_rad_s": -14 * DEGREE_PER_HOUR}, events)
    sentence = verdict(Case(1200, [lead]))
    assert "Gyro bias moved 14 °/h in 20 min 00 s." in sentence
    assert sentence.endswith("1 beacon loss of 8.0 s, 2 slips.")


def test_many_losses_are_summed() -> None:
    events = [{"kind": "beacon_loss", "t0": float(10 * i), "t1": 10.0 * i + 2} for i in range(3)]
    assert verdict(Case(60, [Judged("fused", {}, events)])).endswith("3 beacon losses, 6.0 s in all.")


def test_a_bias_that_stays_is_said_to_stay() -> None:
    lead = Judged("fused", {"final_m": 1.0, "ate_rmse_m": 1.0, "bias_drift_rad_s": 0.1 * DEGREE_PER_HOUR})
    assert "stayed within 1.0 °/h" in verdict(Case(60, [lead]))


def test_without_truth_the_claim_stands_in() -> None:
    lead = Judged("fused", {"distance_m": 34.2}, final_sd=0.03)
    assert verdict(Case(60, [lead])) == (
        "Fused path is 34.2 m long and claims ± 3.0 cm at its end; there is no truth to judge it by."
    )
    assert "does not overlap" in verdict(Case(60, [lead], has_truth=True))


def test_truth_with_a_heading_alone_judges_the_heading() -> None:
    lead = judged("encoders+gyro", heading_rmse_rad=math.radians(1.5))
    assert verdict(Case(60, [lead])) == (
        "Heading by encoders with gyro is 1.50° from truth on average; positions have no truth."
    )


def test_without_estimates_the_job_speaks() -> None:
    def said(state: str, **more: object) -> str:
        return verdict(Case(69, job={"state": state, **more}))

    assert said("running") == "This run of 1 min 09 s is being estimated; its paths appear here when they are done."
    assert "waits" in said("queued")
    assert said("failed", error={"detail": "no fix before the first turn."}) == (
        "The estimate failed: no fix before the first turn."
    )
    assert "cancelled" in said("cancelled")
    assert verdict(Case(5, reasons={"encoders": "no wheels"})).startswith("No method can give a path")
    assert verdict(Case(5, reasons={"encoders": None})).endswith("have not been estimated yet.")


@given(st.lists(st.tuples(st.sampled_from(["encoders", "fused", "beacon"]), st.floats(0, 1e4) | st.none()), min_size=1))
def test_the_lead_has_the_smallest_error_of_those_judged(found: list[tuple[str, float | None]]) -> None:
    estimates = [judged(method, ate, ate) for method, ate in found]
    errors = [ate for _, ate in found if ate is not None]
    lead = lead_of(estimates)
    assert lead.metrics["ate_rmse_m"] == (min(errors) if errors else None)
    assert verdict(Case(10, estimates)).endswith(".")


def test_fused_leads_and_hindsight_is_told_beside_it() -> None:
    paths = [judged("encoders", 0.94, 0.6), judged("fused", 0.021, 0.03), judged("smoothed", 0.018, 0.01)]
    assert lead_of(paths).method == "fused"
    assert verdict(Case(1200, paths)) == "Fused path ends 2.1 cm from truth (encoders 0.940 m, smoothed 1.8 cm)."
    unjudged = [Judged("smoothed", {}), Judged("fused", {})]
    assert lead_of(unjudged).method == "fused"


def test_dismissed_events_are_not_counted() -> None:
    events = [{"kind": "slip", "t0": 3.0, "t1": 3.5, "decision": "dismissed"}, {"kind": "pushed", "t0": 9.0, "t1": 9.2}]
    assert verdict(Case(60, [Judged("fused", {}, events)])).endswith("1 push.")


def test_the_noise_advice_names_the_sensor_and_the_factor() -> None:
    def sensor(factor: float, *, fits: bool = False, single: bool = True) -> dict[str, object]:
        advice = {"factor": factor, "low": 0.8 * factor, "high": 1.2 * factor, "wide": 30.0, "fits": fits}
        return {"advice": {**advice, "single": single}, "whiteness": None}

    def said(**sensors: dict[str, object]) -> str:
        return sentence({"sensors": {k.replace("_", "."): v for k, v in sensors.items()}, "nees": None})

    assert said(beacon_position=sensor(0.09), wheels_turn=sensor(0.001)) == (
        "Fixes stray 0.30 times as far as the filter expects: R should be about 0.090 times what it is "
        "(0.072 to 0.11). "
        "1 more of 2 sensors does not fit."
    )
    assert said(ranges=sensor(1.1, fits=True)) == "Every sensor is about as noisy as the filter expects."
    assert "half of them call for 1.0 times the R that is set, the widest tenth for 30 times" in said(
        ranges=sensor(1.0, single=False)
    )
    assert "estimate again" in sentence(None)


def test_what_is_wrong_with_the_run_is_said() -> None:
    wrong = "The ranges read millimetres in place of metres: converted."
    notes = [wrong, "Slip learnt from this run: 0.004 m after one metre (assumed at first: 0.0066)."]
    cases = [judged("encoders", 0.9, 0.9), Judged("fused", {"final_m": 0.02, "ate_rmse_m": 0.02}, notes=notes)]
    assert verdict(Case(60, cases)).endswith(wrong)
