"""Tables, verdicts, escaping and the policy of a page, without a browser."""

import json
import re
from html.parser import HTMLParser

import pytest
from traffic import recording, tracks

from pmbm.intervals import COUNT, SHARE
from pmbm.reports.page import script_json
from pmbm.reports.render import run_page
from pmbm.reports.tables import judge, markdown_table, metric_row, shown_metric, words
from pmbm.reports.values import ReplayPage, Section
from pmbm.study import TrialResult, estimate, summarise

HOSTILE = "</script><img src=x onerror=alert(1)>&\u2028'\""


def summary(**values):
    """tracker=[value per trial] for GOSPA."""
    trials = len(next(iter(values.values())))
    return summarise(
        [
            TrialResult("s", 0, t, "d", {k: {"gospa": v[t]} for k, v in values.items()}, {})
            for t in range(trials)
        ]
    )


def test_numbers_end_where_their_uncertainty_ends():
    text = words(estimate([1.0, 1.2, 1.4]), 3)
    # Student t with 2 degrees of freedom: 4.3027 x 0.2 / sqrt(3) = 0.4968
    assert (text.mean, text.half, text.detail) == ("1.20", "0.50", "sem 0.12")
    assert words(estimate([None, None]), 2) is None
    assert words(estimate([2.34567]), 1).mean == "2.346"
    for values in ([-0.0], [-0.0, -0.0], [-1e-9, 1e-2, -1e-2]):
        assert words(estimate(values), len(values), signed=True).mean.strip("0.") == ""
    assert words(estimate([1.0, 1.2, None]), 3).detail.endswith("n 2")
    assert words(estimate([-1200.0, -800.0]), 2, signed=True).mean == "−1000"


def test_counts_are_told_by_the_ends_of_their_interval():
    none = words(estimate([0.0] * 20, COUNT), 20)
    # ln(.025) / -20 = 0.184
    assert (str(none), none.half, none.detail) == ("0.000 [0.000, 0.184]", "", "")
    worse = words(estimate([1, 0, 2, 1] * 4 + [None], COUNT.of_differences), 17, signed=True)
    assert re.fullmatch(r"\+1\.00 \[\+0\.\d\d, \+1\.\d\d\]", str(worse))
    assert worse.detail == "n 16"
    assert judge(estimate([1.0] * 20, COUNT.of_differences), -1) == "worse"
    assert judge(estimate([1.0] * 2, COUNT.of_differences), -1) == "tie"


def test_one_value_in_every_trial_has_no_width_of_zero():
    assert str(words(estimate([2.5] * 20), 20)) == "2.5 in all 20"
    assert str(words(estimate([1.0] * 20, SHARE), 20)) == "1.000 [0.832, 1.000]"
    assert judge(estimate([2.5] * 20), -1) == "worse"
    assert judge(estimate([2.5] * 2), -1) == "tie"


def test_a_verdict_needs_an_interval_that_excludes_zero():
    worse = estimate([1.0, 1.1, 0.9])
    assert judge(worse, -1) == "worse"
    assert judge(worse, +1) == "better"
    assert judge(worse, 0) == "tie"
    assert judge(estimate([1.0, -1.1, 0.9]), -1) == "tie"
    assert judge(estimate([1.0]), -1) == "tie"


def test_bars_lie_on_the_side_of_the_difference():
    row = metric_row(summary(a=[1.0, 1.1, 0.9], b=[2.0, 2.2, 2.1]), "gospa")
    bar = row.differences[0].bar
    assert 75 < bar.low < bar.at < bar.high == 143
    assert bar.verdict == "worse"
    assert row.differences[0].text.mean.startswith("+1.1")


def test_metrics_are_named_for_people():
    assert shown_metric("gospa_missed").name == "GOSPA missed"
    assert shown_metric("gospa_missed").unit == "m²"
    assert shown_metric("mota_observable").name == "MOTA, observable"
    assert shown_metric("mota").sign == 1
    assert shown_metric("id_switches").sign == -1
    assert shown_metric("my_own").name == "my_own"


def test_markdown_cells_cannot_break_the_table():
    table = markdown_table(["a|b", "n"], [["<img src=x>\nline", "1"]])
    assert table.splitlines()[2] == "| &lt;img src=x&gt; line | 1 |"
    assert "a\\|b" in table


@pytest.mark.parametrize("value", [HOSTILE, {HOSTILE: [HOSTILE]}, "<!--<script>"])
def test_embedded_json_cannot_leave_its_element(value):
    text = script_json(value)
    assert json.loads(text) == value
    assert not re.search("[<>&\u2028\u2029]", text)


class Outline(HTMLParser):
    def __init__(self):
        super().__init__()
        self.tags, self.links, self.handlers, self.policy = [], [], [], ""

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.links += [v for k, v in attrs if k in ("src", "href", "action", "data", "srcset")]
        self.handlers += [k for k, _ in attrs if k.startswith("on") or k == "style"]
        if ("http-equiv", "Content-Security-Policy") in attrs:
            self.policy = dict(attrs)["content"]


def test_a_hostile_page_has_no_foreign_elements_and_loads_nothing():
    scene = recording(frames=4, name=HOSTILE, object_name={11: HOSTILE})
    section = Section(
        name=HOSTILE,
        stresses=HOSTILE,
        summary=summary(**{HOSTILE: [1.0, 2.0], "b": [2.0, 3.0]}),
        replay=ReplayPage(recording=scene, tracks={HOSTILE: tracks(scene)}, title=HOSTILE),
        provenance={HOSTILE: {HOSTILE: HOSTILE}},
    )
    page = run_page([section, section], title=HOSTILE, command=HOSTILE)
    outline = Outline()
    outline.feed(page)
    assert "img" not in outline.tags
    assert outline.handlers == []
    assert all(link == "data:," or link.startswith("#section-") for link in outline.links)
    assert outline.policy.startswith("default-src 'none'; style-src 'sha256-")
    assert "unsafe" not in outline.policy
    assert "http" not in outline.policy


def test_one_trial_has_no_intervals():
    section = Section(name="s", stresses="x", summary=summary(a=[1.5], b=[2.5]))
    page = run_page([section], title="t", command="c")
    assert "One trial: no intervals" in page
    assert "±" not in page.split("<main>")[1].split("</main>")[0]


def test_the_same_results_make_the_same_page():
    scene = recording(frames=6)
    section = Section(
        name="s",
        stresses="x",
        summary=summary(a=[1.0, 2.0]),
        replay=ReplayPage(recording=scene, tracks={"a": tracks(scene)}),
    )
    assert run_page([section], title="t", command="c") == run_page(
        [section], title="t", command="c"
    )
