"""Tables hold the data's numbers, the page is well formed and harmless, and what it says is true."""

import base64
import csv
import hashlib
import json
import math
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from records_for_tests import (
    adaptive,
    calibration,
    coverage,
    measured,
    parameter_box,
    report_data,
    sensitivity,
    trials,
    uncertainty,
)

from simulation.case import KnownError
from simulation.parameters import ParameterSpace
from studies.report import MeasuredSeries, Provenance, ReportData, build, captions
from studies.report.captions import enclosed_fraction, within_sensor
from studies.report.tables import sensitivity_table, tuning_table
from studies.report.tables_of_calibrations import (
    at_bound,
    calibrations_table,
    intervals_table,
    parameters_table,
)
from studies.report.wording import (
    count,
    declared,
    difference_unit,
    digits_between,
    listed,
    percent,
    setting,
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


def small(**changes: object) -> ReportData:
    """Return a report with few pictures."""
    nothing = {"coverage": None, "sensitivity": None, "trials": None, "tuned": ()}
    return report_data(**{**nothing, "calibrations": (calibration(64),), **changes})


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(report_data(), tmp_path_factory.mktemp("full"))


def test_page_is_well_formed_and_needs_nothing_else(full: Path) -> None:
    page = checked(full)
    assert page.tags.count("figure") == 9
    anchors = {f"#{name}" for name in page.ids}
    (link,) = (link for link in page.links if link not in anchors)
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
    note, result = text.index("A virtual measurement"), text.index("189 model calls")
    first_picture = text.index("Measured and polished")
    assert note < result < first_picture
    for words in ("studies calibrate office --n-train 64", "5a" * 32, "torch", "2.9.1", "quick"):
        assert words in text


def test_every_file_is_named_in_the_summary(full: Path) -> None:
    summary = json.loads((full.parent / "report.json").read_text(encoding="utf-8"))
    assert sorted(summary["files"]) == sorted(file.name for file in full.parent.iterdir())
    assert {figure["file"] for figure in summary["figures"]} < set(summary["files"])
    row = summary["tables"]["calibrations"][1]
    assert row["mse_polished"] == calibration(64).mse_polished
    assert row["calls_paper"] == 189


def test_building_again_gives_the_same_files(tmp_path: Path) -> None:
    first, second = (build(small(), tmp_path / name).parent for name in ("first", "second"))
    for file in first.iterdir():
        assert file.read_bytes() == (second / file.name).read_bytes(), file.name


def test_a_second_report_removes_what_the_first_no_longer_has(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("not part of a report")
    build(small(), tmp_path)
    build(small(calibrations=(calibration(128),)), tmp_path)
    names = {file.name for file in tmp_path.iterdir()}
    assert {"mine.txt", "figure-calibration-n0128.csv"} < names
    assert not any("n0064" in name for name in names)


def test_whatever_comes_from_files_is_text(tmp_path: Path) -> None:
    c = replace(calibration(64), stop_reason=EVIL)
    data = small(
        title=EVIL, label=EVIL, note=EVIL, calibrations=(c, calibration(128)),
        measurement=MeasuredSeries(replace(measured().measurement, output_names=(EVIL,)), (EVIL,)),
        parameters=ParameterSpace(
            (replace(parameter_box().parameters[0], name=EVIL, unit=EVIL), *parameter_box().parameters[1:])
        ),
        references=(KnownError(EVIL, 0.01, is_target=False), KnownError(EVIL, 0.02, is_target=True)),
        sensitivity=replace(sensitivity(2), names=(EVIL, "b"), output_names=(EVIL,)),
        coverage=replace(coverage(8), name=EVIL),
        provenance=Provenance((EVIL,), ((EVIL, EVIL),), ((EVIL, EVIL),), ((EVIL, EVIL),)),
    )  # fmt: skip
    index = build(data, tmp_path)
    page = checked(index)
    # One with the library, and one with values per picture; none that came from a file.
    assert page.tags.count("script") == page.tags.count("figure") + 1
    assert "<script>alert" not in index.read_text(encoding="utf-8")
    assert EVIL in "".join(page.text)
    rows = list(csv.reader((tmp_path / "parameters-n0064.csv").read_text(encoding="utf-8").splitlines()))
    assert rows[1][0] == EVIL


@pytest.mark.parametrize(
    "data",
    [
        small(calibrations=()),
        small(calibrations=(), references=(), provenance=Provenance(), note=""),
        small(references=()),
        small(trials=trials((64,), 2), sensitivity=sensitivity(n_undefined=480)),
    ],
)
def test_a_report_of_little_is_still_a_report(data: ReportData, tmp_path: Path) -> None:
    text = " ".join(checked(build(data, tmp_path)).text)
    assert ("Nothing has been calibrated yet." in text) == (not data.calibrations)
    json.loads((tmp_path / "report.json").read_text(encoding="utf-8"), parse_constant=pytest.fail)


def test_calibrations_table_holds_the_numbers() -> None:
    data = report_data()
    table = calibrations_table(data)
    assert [row[0] for row in table.rows] == [32, 64, 256]
    assert table.emphasized == 1
    for row, c in zip(table.records(), data.by_size, strict=True):
        assert row["mse_surrogate"] == c.mse_surrogate
        assert row["screening_gap"] == c.mse_screened - c.mse_surrogate
        assert row["n_polish"] == c.n_polish
        assert row["calls_paper"] == c.n_train + 1 + c.n_polish
        assert row["total_calls"] == c.n_train + 1 + c.n_polish + 640
        reached = c.history_calls[c.history_mse <= 0.0125]
        assert row["calls_to_0.0125"] == reached[0]
    read = list(csv.reader(table.to_csv().splitlines()))
    column = read[0].index("mse_polished [K²]")
    assert [float(line[column]) for line in read[1:]] == [c.mse_polished for c in data.by_size]


def test_what_is_unknown_is_a_dash_for_readers_and_empty_for_programs() -> None:
    c = replace(calibration(64), mse_screened=math.inf, test_mae=math.nan)
    table = calibrations_table(
        report_data(calibrations=(c,), references=(KnownError("far", 1e-9, is_target=True),))
    )
    row = table.records()[0]
    assert row["mse_screened"] is None
    assert row["test_mae"] is None
    assert row["calls_to_1e-09"] is None
    assert "∞" in table.texts()[0]
    assert "–" in table.texts()[0]
    assert "inf" not in table.to_csv()


def test_parameters_table_flags_the_bounds() -> None:
    c, box = calibration(64), parameter_box()
    table = parameters_table(box, c)
    rows = {row["name"]: row for row in table.records()}
    flagged = {name: row["at_bound"] for name, row in rows.items() if row["at_bound"]}
    assert flagged == {"cInt": "upper", "rExt1": "lower", "VSUP": "upper"}
    assert rows["UWin"]["estimate"] == 0.7
    assert [row["polished"] for row in table.records()] == c.theta_polished.tolist()
    assert table.texts()[1][3:5] == ["293.15", "306.15"]
    assert at_bound(box, replace(c, theta_polished=box.lower)) == ("lower",) * 14
    # As near as studies calibrate and studies show call it at the bound, in the logarithm where there is one.
    for share, said in ((0.009, "lower"), (0.011, ""), (0.989, ""), (0.991, "upper")):
        linear = box.lower + share * (box.upper - box.lower)
        near = np.where(box.is_log, box.lower * (box.upper / box.lower) ** share, linear)
        assert at_bound(box, replace(c, theta_polished=near)) == (said,) * 14
    assert at_bound(box, replace(c, theta_polished=np.sqrt(box.lower * box.upper))) == ("",) * 14


def test_an_estimate_that_is_not_declared_is_left_out() -> None:
    box = ParameterSpace(tuple(replace(one, estimate=None) for one in parameter_box().parameters))
    assert parameters_table(box, calibration(64)).records()[0]["estimate"] is None


def test_tuning_and_sensitivity_tables_hold_the_numbers() -> None:
    data = report_data()
    tuning, sobol = tuning_table(data.tuned), sensitivity_table(data)
    assert tuning is not None
    assert sobol is not None
    all_trials, indices = data.trials, data.sensitivity
    assert all_trials is not None
    assert indices is not None
    rows = tuning.records()
    assert [row["n_train"] for row in rows] == sorted({*all_trials.n_train.tolist()})
    for row, record in zip(rows, data.tuned, strict=True):
        (best,) = np.flatnonzero((all_trials.n_train == row["n_train"]) & all_trials.is_best)
        assert row["test_mae"] == all_trials.test_mae[best]
        assert row["test_p90"] == all_trials.test_p90[best]
        assert {name: row[name] for name in ("n_latent", "n_hidden", "beta")} == record.params
        assert row["pca_gp_test_mae"] == record.baseline["test/mae"]
        assert row["pca_gp_test_p90"] is None
    assert rows[0]["gain"] is None
    firsts = [row["first_order"] for row in sobol.records()]
    assert firsts == sorted(firsts, reverse=True)
    assert firsts[0] == pytest.approx(np.nanmean(indices.first_order[:, 0], axis=0).max(), rel=1e-12)
    assert tuning_table(()) is None
    assert sensitivity_table(small()) is None


def test_headline_is_the_lowest_error() -> None:
    low, high = replace(calibration(256), mse_polished=0.0104), replace(calibration(32), mse_polished=0.0121)
    assert report_data(calibrations=(high, low)).headline is low
    equal = replace(high, mse_polished=0.0104)
    assert report_data(calibrations=(low, equal)).headline is equal


def test_the_result_is_one_sentence_with_the_numbers_of_the_data() -> None:
    sentence = captions.headline_sentence(report_data())
    assert sentence == "189 model calls calibrated 14 parameters to an MSE of 0.00642 K²."


def test_intervals_keep_their_ends_apart_and_are_on_the_page(tmp_path: Path) -> None:
    record = uncertainty()
    ends = record.interval.copy()
    ends[:, 1:3] = [[301.15031, 0.1], [301.15037, 0.9]]
    record = replace(record, interval=ends, linear=ends, calibrated=ends.mean(axis=0))
    table = intervals_table(parameter_box(), record)
    assert table.texts()[2][:5] == ["rInt", "m2.K/W", "0.5000", "0.1000", "0.9000"]
    assert table.texts()[1][3:5] == ["301.15031", "301.15037"]
    assert (table.records()[2]["name"], table.records()[2]["low"]) == ("rInt", 0.1)
    page = build(report_data(calibrations=(adaptive(),), uncertainties=(record,)), tmp_path)
    assert "How sure the adaptive calibration is" in checked(page).text
    assert {"figure-bands-adaptive.csv", "figure-intervals-adaptive.csv"} <= {
        file.name for file in tmp_path.iterdir()
    }


def test_the_share_within_the_sensors_uncertainty_is_what_numpy_says() -> None:
    m, c = measured(), calibration(64)
    off = replace(c, y_polished=m.measurement.y + np.linspace(-1.0, 1.0, 480)[:, None])
    assert within_sensor(m, off, 0) == pytest.approx(0.5, abs=0.01)
    assert math.isnan(within_sensor(m, replace(c, y_polished=np.full_like(c.y_polished, np.nan)), 0))


def test_enclosed_fraction_counts_measured_values() -> None:
    m = measured(n_steps=4)
    values = m.measurement.y
    y = np.stack([values - 1, values + 1])
    y[:, 0] = values[0] + 5
    assert enclosed_fraction(m.measurement, y) == 0.75


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.01132, "0.0113"), (1.0623, "1.06"), (4297, "4,297"), (0, "0"), (math.nan, "–"), (math.inf, "∞"),
     (-math.inf, "−∞"), (2e-7, "2.00e-07"), (-0.5, "-0.500")],
)  # fmt: skip
def test_numbers_are_written_for_readers(value: float, text: str) -> None:
    assert significant(value) == text


def test_settings_lose_no_zero_that_counts() -> None:
    values = (100.0, 2000.0, 0.5, 3e-05, 128, True, "log", None)
    assert [setting(value) for value in values] == [
        "100", "2,000", "0.5", "3.00e-05", "128", "True", "log", "–",
    ]  # fmt: skip


@given(st.floats(1e-4, 1e6), st.integers(2, 6))
def test_significant_digits_are_kept(value: float, digits: int) -> None:
    assert float(significant(value, digits).replace(",", "")) == pytest.approx(
        value, rel=0.51 * 10.0 ** (1 - digits)
    )


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
    page = build(small(calibrations=(adaptive(),)), tmp_path)
    checked(page)
    names = {file.name for file in tmp_path.iterdir()}
    assert {
        "figure-calibration-adaptive.csv",
        "figure-convergence-adaptive.csv",
        "parameters-adaptive.csv",
    } <= names
    assert "figure-polish-adaptive.csv" not in names
    summary = json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))
    assert summary["result"].startswith("71 model calls calibrated 14 parameters to an MSE of")
    assert "screened" not in summary["result"] + summary["figures"][0]["caption"]
    parameters = summary["tables"]["parameters-adaptive"][0]
    assert "calibrated" in parameters
    assert not {"screened", "polished"} & set(parameters)
    (row,) = summary["tables"]["calibrations"]
    assert (row["method"], row["total_calls"]) == ("adaptive", 71)
    assert not {"test_mae", "mse_screened", "n_polish"} & set(row)


def test_the_page_says_what_became_of_state_equations_and_what_is_left_open(tmp_path: Path) -> None:
    failed = "State equations of 3 states: not learnt, for they move too fast; the search did without"
    left_open = ("The data do not determine 1 of 14 parameters: cInt",)
    data = small(calibrations=(replace(adaptive(), state_equations=failed, left_open=left_open),))
    page = build(data, tmp_path).read_text(encoding="utf-8")
    assert f"<p>{failed}.</p>\n<p>{left_open[0]}.</p>" in page


def test_an_adaptive_calibration_stands_beside_the_papers(tmp_path: Path) -> None:
    data = small(calibrations=(calibration(64), adaptive()))
    assert data.headline is not None
    assert data.headline.is_adaptive
    build(data, tmp_path)
    names = {file.name for file in tmp_path.iterdir()}
    assert {"figure-polish-n0064.csv", "figure-convergence-adaptive.csv"} <= names
    first, second = calibrations_table(data).records()
    assert (first["method"], first["calls_paper"], first["mse_screened"]) == ("adaptive", 71, None)
    assert (second["method"], second["n_train"]) == ("paper", 64)


@pytest.mark.parametrize(
    ("low", "high", "digits"),
    [(0.2, 5.0, 3), (285.6, 285.7, 5), (1.0, 1.0, 3), (-1e-9, 1.0, 3), (1e5, 1.2e5, 3)],
)
def test_ends_of_an_interval_differ(low: float, high: float, digits: int) -> None:
    assert digits_between(low, high) == digits
