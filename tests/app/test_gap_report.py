"""The sentence and the report of a diagnosis, over every shape of answer and evidence."""

from __future__ import annotations

import math
import re
from html.parser import HTMLParser
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.api.diagnosis_schemas import SUMMARY
from app.figures import gap_reasons, gap_report
from app.figures.gap import heat, level, rms
from app.figures.gap_sentence import VERDICTS, headline, sentence, times
from app.figures.gap_which import chances, sizes
from app.figures.gap_words import WORDS, as_set, difference, quantity
from app.figures.plot import Curve, plot, ticks
from app.pages.diagnosis import report
from core.effects import EFFECTS
from core.effects.chosen import effects_of
from tests.app.gap_documents import answer, bare_evidence, cause, evidence

GAPS = st.one_of(st.none(), st.floats(0.0, 1e4))


@st.composite
def answers(draw: st.DrawFn) -> dict[str, Any]:
    """Any gap/1: verdicts, none to five causes of any size, figures that may be missing."""
    verdict = draw(st.sampled_from(list(VERDICTS)))
    names = draw(st.lists(st.sampled_from(list(EFFECTS)), max_size=5, unique=True))
    causes = []
    for name in names:
        values = {
            p.name: ("B1" if p.text else draw(st.floats(1e-6, 2.0)), draw(st.sampled_from([None, 0.0, 1e-4])))
            for p in EFFECTS[name].parameters
        }
        made = cause(name, draw(st.floats(0.0, 1.0)), draw(st.floats(0.0, 1.0)), **values)
        causes.append({**made, "confusable_with": draw(st.sampled_from([[], ["track_width"]]))})
    ci = draw(st.sampled_from([None, [0.9, 1.0], [None, None]]))
    whole = {"before": draw(GAPS), "after": draw(GAPS), "floor": draw(GAPS)}
    gap = {**whole, "shrink": draw(GAPS), "shrink_ci": ci, "held_out": draw(st.booleans()), "by_stream": {}}
    return answer(verdict, causes=causes, gap=gap, unexplained=draw(st.sampled_from([None, LEFT])))


LEFT = {"stream": "imu.gz", "depends_on": ["truth.w", "t"], "description": "so"}


@given(answers())
@settings(max_examples=60, deadline=None)
def test_every_answer_has_a_sentence_that_people_can_read(result: dict[str, Any]) -> None:
    text = sentence(result)
    assert 20 < len(text) < 900 and text[0].isupper() and text.endswith(".")
    assert not re.search(r"nan|inf\b|None|\{|_name|  ", text), text
    assert text.count("`") % 2 == 0 and headline(result)
    gap_report.parts(result, None)


def test_the_sentence_of_one_cause_is_the_example() -> None:
    one = answer(causes=[cause("track_width", 0.97, 0.98, scale=(1.021, 0.0004))])
    one["gap"] |= {"shrink": 0.98}
    assert sentence(one) == (
        "Your simulator turns 2.1 % more than the robot. Track width explains 96 % of the gap (probability 0.97); "
        "add `track_width: 1.021` and the held-out error falls from 3.2 to 1.05 times the noise."
    )
    assert headline(one) == "track width 96 %"


@pytest.mark.parametrize(
    ("result", "words"),
    [
        (answer("none"), "Robot and simulator agree: the held-out error is 1.03 times the noise"),
        (
            answer("unknown"),
            "on the gyro, depending on turn rate and time: its held-out error is 7.0 times the noise",
        ),
        (answer("partly_explained"), "What is left is in no list: the gyro, depending on turn rate and time."),
        (answer(), "Track width (88 %) and gyro bias (9.8 %) explain the gap together (probability at least 0.91)"),
    ],
    ids=["none", "unknown", "partly", "two"],
)
def test_each_verdict_is_told(result: dict[str, Any], words: str) -> None:
    assert words in sentence(result)


def test_what_cannot_be_told_apart_is_said_with_the_drive_that_would() -> None:
    torn = {**cause("track_width", 0.6, 1.0, scale=(1.02, 0.001)), "confusable_with": ["gyro_scale"]}
    drive = {"profile": "square_ccw", "separates": [], "reason": "so", "chance": 0.9}
    text = sentence(answer(causes=[torn], next_experiment=drive))
    assert text.endswith("These runs cannot tell track width from gyro scale; drive `square_ccw` to decide.")


def test_a_gap_that_nothing_explains_is_not_called_agreement() -> None:
    text = sentence(answer("none", gap={**answer()["gap"], "before": 15.0, "after": 15.0, "floor": 2.0}))
    assert "agree" not in text and "15 times the noise against a floor of 2.0" in text
    assert [times(1.4e-13), times(0.0), times(7.4e-4)] == ["0", "0", "0.00074"]


def test_every_effect_has_its_words_and_a_value_to_type_in() -> None:
    assert set(WORDS) == set(EFFECTS)
    for effect in EFFECTS.values():
        far = {
            p.name: 0.5 if p.high == math.inf else p.low + 0.6 * (p.high - p.low)
            for p in effect.parameters
            if not p.text
        }
        told = cause(
            effect.id,
            0.9,
            1.0,
            **{n: (v, 1e-3) for n, v in far.items()},
            **dict.fromkeys((p.name for p in effect.parameters if p.text), ("B1", None)),
        )
        assert difference(effect.id, told["parameters"]).endswith(".")
        assert as_set(effect.id, told["parameters"]).startswith(f"{effect.id}: ")
        assert len(sizes(effect.id, told["parameters"])) == len(effect.parameters)
        assert dict(effects_of(answer(causes=[told])))[effect.id]


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (math.radians(2.0), "rad", "2.00°"), (math.radians(1 / 3600), "rad/s", "1.00 °/h"), (0.05, "m", "5.00 cm"),
        (0.06, "s", "60.0 ms"), (2.5, "m/s", "2.50 m/s"), (1.02, "", "1.02"), (None, "m/s", "no limit"),
    ],
)  # fmt: skip
def test_units_are_people_s(value: float | None, unit: str, text: str) -> None:
    assert quantity(value, unit) == text


class Seen(HTMLParser):
    """Every tag opened and closed, and every address asked for."""

    VOID = ("meta", "br", "path", "circle", "rect", "input", "link")

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: set[str] = set()
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.addresses += [v or "" for k, v in attrs if k in ("src", "href", "action", "data")]
        assert not any(k.startswith("on") for k, _ in attrs)
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open.pop() == tag, tag


def found(result: dict[str, Any], **changed: Any) -> dict[str, Any]:
    effects = dict(effects_of(result))
    more = {"notes": "", "config": {"tolerances": {}}, "seed": 1, "code_version": "0+core.x", "runtime_s": 2.0}
    return {
        **SUMMARY,
        **more,
        "sentence": sentence(result),
        "result": result,
        "gap": result["gap"],
        "effects": effects,
        **changed,
    }


@pytest.mark.parametrize("verdict", list(VERDICTS))
@pytest.mark.parametrize("behind", [evidence(), bare_evidence(), None], ids=["whole", "bare", "none"])
def test_the_report_is_whole_in_one_file(verdict: str, behind: dict[str, Any] | None) -> None:
    text = report(found(answer(verdict)), behind)
    seen = Seen()
    seen.feed(text)
    seen.close()
    assert seen.open == [] and not seen.addresses
    assert not seen.tags & {"script", "link", "img", "iframe", "object", "base"}
    assert "url(" not in text and "@import" not in text and "http" not in text
    assert all(
        f"<h2>{h}</h2>" in text for h in ("Where", "Which", "How far", "What is left", "Next", "How it was made")
    )


def test_what_users_wrote_cannot_become_markup() -> None:
    text = report(found(answer(), name="<script>x</script>", notes="<img src=x onerror=y>"), evidence())
    assert "<script" not in text and "<img" not in text and "&lt;script&gt;" in text


def test_the_report_shows_what_is_there() -> None:
    drawn = gap_report.parts(answer("partly_explained"), evidence())
    assert [c.effect for c in drawn.chances][:2] == ["track_width", "gyro_scale"], "a set stands together"
    assert {c.bracket for c in drawn.chances if c.effect in ("track_width", "gyro_scale")} == {0}
    assert drawn.links[1].guilty and drawn.links[1].level == 3
    assert len(drawn.heat.rows) == 7 and drawn.heat.rows[1][2][3] is not None and drawn.heat.rows[1][2][3].significant
    assert drawn.left_facts[0] == "It repeats every 180° of heading." and drawn.drive is not None
    assert [line.label for line in drawn.considered] == ["gyro scale", "wheel radius"]
    runs = gap_report.runs(evidence())
    assert runs[0].overlay is None and runs[1].overlay is not None and runs[1].path is not None


def test_reasons_come_in_plain_words_and_what_says_the_same_comes_once() -> None:
    nothing = "adds nothing beside the causes (drop of deviance 0; chance gives up to 24)"
    rows = [{"effect": name, "reason": nothing} for name in ("motor_lag", "bump", "side_slip", "gyro_bias")]
    rows.append(
        {"effect": "wheel_radius", "reason": "refitted, it takes 47.7% of what a shape of no listed effect takes"}
    )
    first, rest = gap_reasons.considered(answer(), {"considered": rows})
    assert (first.label, first.number) == ("wheel radius", "48 %") and "the cause that is in no list" in first.text
    assert rest.label == "4 effects" and "motor lag, bump, side slip, gyro bias" in rest.text
    rest_of = "imu.gz is off, like w³; that shape takes 98% of what is left there (drop of deviance 16338)"
    assert gap_reasons.described(rest_of) == "The gyro is off, like w³ (w: turn rate); that shape takes 98 % of it."
    unseen = [
        {"effect": "deadband", "parameter": "width", "visible_from": 4e8, "unit": "m/s"},
        {"effect": "command_delay", "parameter": "delay", "visible_from": 0.4, "unit": "s"},
    ]
    told = {line.label: line.text for line in gap_reasons.cannot_see(answer(), {"cannot_see": unseen})}
    assert told == {"command delay": "delay: from 400 ms on", "dead band": gap_reasons.BLIND}


def test_a_remedy_names_the_immaterial_effects_that_do_most_of_it() -> None:
    small = [{"effect": "motor_lag", "parameters": {"tau": {"value": 0.003, "std": 0.0004}}}]
    causes = [{**answer()["causes"][0], "share": 0.2}]
    told = answer(causes=causes, immaterial=small)
    assert "with the immaterial effect and the held-out error" in sentence(told)
    assert "immaterial" not in sentence({**told, "causes": [{**causes[0], "share": 0.98}]})
    assert set(effects_of(told, immaterial=True)) == {causes[0]["effect"], "motor_lag"} != set(effects_of(told))


def test_what_is_left_above_the_floor_is_said_though_it_has_no_shape() -> None:
    left = answer(gap={**answer()["gap"], "before": 71.0, "after": 5.6, "floor": 0.85})
    assert "falls from 71 to 5.6 times the noise (floor 0.85)" in sentence(left)
    assert "still 5.6 times the noise, over a floor of 0.85" in gap_report.parts(left, None).unexplained
    little = answer(gap={**answer()["gap"], "before": 2939.0, "after": 2884.0, "floor": 27.0, "shrink": 0.0189})
    assert "explain 1.9 % of the gap together" in sentence(little)
    driven = gap_report.runs(evidence())[1].driven
    assert re.fullmatch(
        r"Distance from the real path at the end: simulated .+ and patched .+; on the whole .+\.", driven
    )


def test_colours_step_up_with_the_gap_and_cells_without_readings_are_no_cells() -> None:
    assert [level(v) for v in (None, 1.0, 1.1, 2.0, 3.0, 5.0, 10.0, 99.0)] == [0, 0, 1, 2, 3, 4, 5, 6]
    cells = [{**one, "rows": 0 if one["regime"] == "still" else one["rows"]} for one in evidence()["cells"]]
    assert "still" not in heat(evidence(cells=cells)).regimes
    assert rms({"a": [3.0, None], "b": [4.0, None]}, 2) == [pytest.approx(math.sqrt(12.5)), None]
    assert chances(answer("none", causes=[], probabilities={"none": 0.95}), bare_evidence())[0].label == "no gap at all"


@given(
    st.lists(st.one_of(st.none(), st.floats(-1e6, 1e6)), min_size=2, max_size=30), st.booleans(),
    st.floats(-1e6, 1e6), st.floats(1e-6, 1e6),
)  # fmt: skip
@settings(max_examples=40, deadline=None)
def test_a_plot_stays_in_its_box(values: list[float | None], equal: bool, start: float, span: float) -> None:
    drawn = plot([Curve("c", "s", list(range(len(values))), values)], x_label="x", y_label="y", equal=equal)
    numbers = [float(n) for n in re.findall(r"-?\d+\.\d+", drawn.curves[0].d)]
    assert all(-1 <= x <= drawn.width + 1 for x in numbers[::2]) and all(
        -1 <= y <= drawn.height + 1 for y in numbers[1::2]
    )
    marks = ticks((start, start + span))
    assert all(start - 1e-6 * span <= m <= start + span * (1 + 1e-6) or abs(start) > 1e6 * span for m in marks)
