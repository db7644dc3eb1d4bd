"""Tables hold the data's numbers, the page is well formed and harmless, and what it says is true."""

import base64
import hashlib
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from measurement_for_tests import with_each
from records_for_tests import (
    adaptive,
    calibration,
    case,
    coverage,
    parameter_box,
    report_data,
    sensitivity,
    trials,
    uncertainty,
)

from simulation.case import KnownError
from simulation.parameters import ParameterSpace
from studies.blocks import Table
from studies.reporting.page import ReportData, write_page
from studies.reporting.sentences import calibration_sentences
from studies.reporting.tables import (
    calibrations_table,
    intervals_table,
    parameters_table,
)
from studies.results.stage_results import Calibration, Determined, EquationsFound
from studies.words.wording import (
    count,
    declared,
    difference_unit,
    listed,
    percent,
    significant,
    squared,
)

VOID = {"meta", "img", "br", "link", "hr"}
EVIL = "<script>alert('x')</script>\"&|$title${body}"


class Checker(HTMLParser):
    """Collects what a page contains and insists that every element is closed in its turn."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        for name, value in attrs:
            if name == "id":
                self.ids.append(value or "")
            if name in ("src", "href"):
                self.links.append(value or "")
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def checked(page: Path) -> Checker:
    checker = Checker()
    checker.feed(page.read_text(encoding="utf-8"))
    checker.close()
    assert checker.open == []
    assert len(set(checker.ids)) == len(checker.ids)
    return checker


def build(data: ReportData, folder: Path) -> Path:
    write_page(data, folder / "index.html")
    return folder / "index.html"


def small(*calibrations: Calibration, **changes: object) -> ReportData:
    """Return a report with few pictures."""
    nothing = {"coverage": None, "sensitivity": None, "trials": None, "tuned": ()}
    return report_data(*(calibrations or (calibration(64),)), **{**nothing, **changes})


def column(table: Table, title: str) -> list[str]:
    """Return the cells below a heading, whatever its unit."""
    titles = [one.title.partition(" [")[0] for one in table.columns]
    return [str(row[titles.index(title)]) for row in table.rows]


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(report_data(), tmp_path_factory.mktemp("full"))


def test_page_is_well_formed_and_needs_nothing_else(full: Path) -> None:
    page = checked(full)
    assert page.tags.count("figure") == 9
    anchors = {f"#{name}" for name in page.ids}
    (link,) = (link for link in page.links if link not in anchors)
    assert {one for one in page.links if one.startswith("#")} <= anchors
    assert link == "https://vega.github.io/vega-lite"
    assert full.stat().st_size < 5_000_000
    text = full.read_text(encoding="utf-8")
    assert "prefers-color-scheme: dark" in text
    assert "@media print" in text
    (style,) = re.findall(r"<style>(.*?)</style>", text, re.DOTALL)
    assert "url(" not in style


def test_the_page_runs_its_own_script_and_no_other(full: Path) -> None:
    text = full.read_text(encoding="utf-8")
    (program,) = re.findall(r"<script>(.*?)</script>", text, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(program.encode()).digest()).decode()
    (policy,) = re.findall(r'http-equiv="Content-Security-Policy" content="(.*?)"', text)
    assert f"script-src 'sha256-{digest}' 'unsafe-eval'" in policy
    assert policy.startswith("default-src 'none'")


def test_page_puts_the_note_and_the_numbers_first(full: Path) -> None:
    text = " ".join(checked(full).text)
    note, result = text.index("A virtual measurement"), text.index("MSE 0.006422 K² after 189 model calls")
    first_picture = text.index("Measured and polished")
    assert note < result < first_picture
    assert "studies calibrate office --n-train 64" in text


def test_whatever_comes_from_files_is_text(tmp_path: Path) -> None:
    whole, c = case(), calibration(64)
    first, *others = parameter_box().parameters
    renamed = {EVIL if name == first.name else name: value for name, value in c.theta.items()}
    assert c.screening is not None
    c = replace(
        c, stop_reason=EVIL, theta=renamed, screening=replace(c.screening, theta=renamed),
        outputs={EVIL: c.outputs["TAir"]},
    )  # fmt: skip
    strange = replace(
        whole, title=EVIL, note=EVIL, measurement=with_each(whole.measurement, name=EVIL, unit=EVIL),
        parameter_space=ParameterSpace((replace(first, name=EVIL, unit=EVIL), *others)),
        references=(KnownError(EVIL, 0.01, is_target=False), KnownError(EVIL, 0.02, is_target=True)),
    )  # fmt: skip
    data = small(
        c, label=EVIL, case=strange, coverage=coverage(8), commands=(EVIL,),
        sensitivity=replace(sensitivity(2), names=(EVIL, "b"), output_names=(EVIL,)),
    )  # fmt: skip
    index = build(data, tmp_path)
    page = checked(index)
    # One with the library, and one with values per picture; none that came from a file.
    assert page.tags.count("script") == page.tags.count("figure") + 1
    assert "<script>alert" not in index.read_text(encoding="utf-8")
    assert EVIL in "".join(page.text)


@pytest.mark.parametrize(
    "data",
    [
        small(calibrations=()),
        small(calibrations=(), case=replace(case(), references=(), note=""), commands=()),
        small(case=replace(case(), references=())),
        small(trials=trials((64,), 2), sensitivity=sensitivity(n_undefined=480)),
    ],
)
def test_a_report_of_little_is_still_a_report(data: ReportData, tmp_path: Path) -> None:
    text = " ".join(checked(build(data, tmp_path)).text)
    assert ("Nothing has been calibrated yet." in text) == (not data.calibrations)


def test_calibrations_table_holds_the_numbers() -> None:
    data = report_data()
    table = calibrations_table(data.case, data.calibrations)
    assert column(table, "training set") == ["32", "64", "256"]
    assert table.emphasized == 1
    for k, one in enumerate(data.calibrations):
        c = one.result
        assert c.screening is not None
        reached = c.history_calls[c.history_mse <= 0.0125]
        expected = {
            "MSE surrogate": significant(c.screening.mse_surrogate),
            "MSE screened": significant(c.screening.mse),
            "gap": significant(c.screening.mse - c.screening.mse_surrogate),
            "polish calls": "124",
            "final MSE": significant(c.mse),
            "calls, paper's count": str(c.n_train + 1 + 124),
            "calls, all": f"{c.n_train + 1 + 124 + 640:,}",
            "calls to 0.0125": str(reached[0]),
        }
        assert {title: column(table, title)[k] for title in expected} == expected


def test_parameters_table_flags_the_bounds() -> None:
    c, whole = calibration(64), case()
    box = whole.parameter_space
    table = parameters_table(whole, c)
    flagged = {name: note for name, note in zip(box.names, column(table, ""), strict=True) if note}
    lower, upper = "at the lower bound: widen it?", "at the upper bound: widen it?"
    assert flagged == {"cInt": upper, "rExt1": lower, "VSUP": upper}
    assert column(table, "estimate")[0] == "0.7"
    assert column(table, "polished") == [f"{value:.6g}" for value in c.theta.values()]
    assert [column(table, f"{end} bound")[1] for end in ("lower", "upper")] == ["293.15", "306.15"]
    # Where others compensate it as well: that the value went to its bound is no reason to widen that.
    open_one = Determined(spread=dict.fromkeys(box.names, 0.2), open=("cInt",), pairs=())
    compensated = column(parameters_table(whole, replace(c, determined_by_data=open_one)), "")
    assert compensated[box.names.index("cInt")] == "at the upper bound; not determined: ±20 % of the range"
    # The share counts in the logarithm where there is one.
    for share, said in ((0.009, lower), (0.011, ""), (0.989, ""), (0.991, upper)):
        linear = box.lower + share * (box.upper - box.lower)
        near = np.where(box.is_log, box.lower * (box.upper / box.lower) ** share, linear)
        at = replace(c, theta=dict(zip(box.names, near.tolist(), strict=True)))
        assert column(parameters_table(whole, at), "") == [said] * 14


def test_intervals_keep_their_ends_apart_and_are_on_the_page(tmp_path: Path) -> None:
    found = uncertainty()
    near = {"TTABSInit": (301.15031, 301.15037), "rInt": (0.1, 0.9)}
    known = {
        name: replace(one, calibrated=sum(near[name]) / 2, interval=near[name], linear=near[name])
        if name in near
        else one
        for name, one in found.parameters.items()
    }
    found = replace(found, parameters=known)
    table = intervals_table(parameter_box(), found)
    assert table.rows[2][:5] == ["rInt", "m2.K/W", "0.5000", "0.1000", "0.9000"]
    assert table.rows[1][3:5] == ["301.15031", "301.15037"]
    page = build(report_data(adaptive(), uncertainties=(found,)), tmp_path)
    text = checked(page).text
    assert "How sure the adaptive calibration is" in text
    assert {"90 % bands of the outputs", "Intervals of the parameters between their bounds"} <= {*text}


def test_words_and_units() -> None:
    assert (count(1, "call"), count(4096, "call"), count(2, "trajectory", "trajectories")) == (
        "1 call", "4,096 calls", "2 trajectories",
    )  # fmt: skip
    assert [percent(x) for x in (0, 0.00001, 0.5, 0.996, 0.99999, 1)] == [
        "0 %", "under 0.1 %", "50 %", "99.6 %", "over 99.9 %", "100 %",
    ]  # fmt: skip
    assert [percent(x) for x in (-0.004, 0.004, -0.5, -0.0, -1, -1e-5, -0.9999)] == [
        "-0.4 %", "0.4 %", "-50 %", "0 %", "-100 %", "over -0.1 %", "under -99.9 %",
    ]  # fmt: skip
    assert (squared(difference_unit("degC")), squared("W/m2"), squared("")) == ("K²", "(W/m2)²", "")
    assert declared(0.7 / 5) == "0.14"
    assert (listed([]), listed(["a"]), listed(["a", "b", "c"])) == ("", "a", "a, b and c")


def test_an_adaptive_calibration_alone_has_a_report_without_a_surrogate(tmp_path: Path) -> None:
    data = small(adaptive())
    text = " ".join(checked(build(data, tmp_path)).text)
    assert "after 71 model calls" in text
    assert "screened" not in text.partition("All calibrations")[2].partition("Calibrations. MSE")[0]
    parameters, whole = (
        parameters_table(data.case, adaptive()),
        calibrations_table(data.case, data.calibrations),
    )
    assert not {"screened", "polished"} & {one.title for one in parameters.columns}
    assert column(whole, "method") == ["adaptive"]
    assert not {"test MAE [K]", "MSE screened [K²]", "polish calls"} & {one.title for one in whole.columns}


def test_the_page_says_what_became_of_state_equations_and_what_is_left_open(tmp_path: Path) -> None:
    equations = EquationsFound(3, 0, None, (), None, False, "they move too fast", ())
    open_ = Determined(dict.fromkeys(calibration().theta, 0.1), ("cInt",), ())
    found = replace(adaptive(), state_equations=equations, determined_by_data=open_)
    said = calibration_sentences(case(), found)
    assert said[0].startswith("State equations of 3 states: not learnt, for they move too fast")
    assert said[1] == "On days 0 to 10 TAir differs by 0.100 K (RMS), 90 % of it within the sensor's ±0.5 K"
    assert said[2].startswith("The data do not determine 1 of 14 parameters")
    text = " ".join(checked(build(small(found), tmp_path)).text)
    assert all(f"{line}." in text for line in said)
