"""Every picture is drawn whatever the data lacks, and its values are in its CSV file."""

import csv
import io
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from measurement_for_tests import with_each, with_samples
from PIL import Image
from records_for_tests import (
    calibration,
    case,
    coverage,
    parameter_box,
    sensitivity,
    trials,
    uncertainty,
)

from simulation.case import Case
from simulation.samples import Samples
from studies.reporting.drawing import Axis, Figure, Panel, Series, with_gaps, write_picture
from studies.reporting.figures_calibration import (
    band_figure,
    calibration_figure,
    calls_figure,
    interval_figure,
    validation_figure,
)
from studies.reporting.figures_model import (
    coverage_figure,
    mae_over_n_figure,
    sensitivity_figure,
)
from studies.results.stage_results import Calibration, Validated, ValidatedPoint

FIGURES: dict[str, Callable[[], Figure]] = {
    "calibration": lambda: calibration_figure(case(), calibration()),
    "calls": lambda: calls_figure(case(), calibration()),
    "coverage": lambda: coverage_figure(case(), coverage()),
    "sensitivity": lambda: sensitivity_figure(sensitivity()),
    "trials": lambda: mae_over_n_figure(trials(), unit="K"),
    "bands": lambda: band_figure(case(), uncertainty()),
    "intervals": lambda: interval_figure(parameter_box(), uncertainty()),
}


def ink(figure: Figure, path: Path) -> float:
    """Return the fraction of pixels of a drawn figure that are not background."""
    with Image.open(write_picture(figure, path)) as picture:
        pixels = np.asarray(picture.convert("L"))
    return float(np.mean(pixels < 250))


def values(figure: Figure, series: str, column: str = "y") -> list[float]:
    """Return what a figure's file has of a series; NaN where a cell is empty."""
    rows = csv.DictReader(io.StringIO(figure.to_csv()))
    return [float(row[column] or "nan") for row in rows if row["series"] == series]


@pytest.mark.parametrize("name", FIGURES)
def test_picture_is_not_blank_and_has_the_same_bytes_each_time(name: str, tmp_path: Path) -> None:
    path = tmp_path / "new folder" / f"{name}.png"
    assert ink(FIGURES[name](), path) > 0.02
    assert [file.name for file in path.parent.iterdir()] == [path.name]
    content = path.read_bytes()
    assert content.startswith(b"\x89PNG\r\n\x1a\n")
    assert write_picture(FIGURES[name](), path).read_bytes() == content
    assert "<path" in write_picture(FIGURES[name](), path.with_suffix(".svg")).read_text(encoding="utf-8")


def test_a_figure_has_its_values_as_csv() -> None:
    c, m = calibration(), case().measurement
    figure = calibration_figure(case(), c)
    assert values(figure, "polished") == pytest.approx(c.y[:, 0], rel=1e-6)
    assert values(figure, "measured", "x") == pytest.approx(m.time / 86400.0, rel=1e-6)
    residual = m.differences(c.y[None], 0)[0]
    assert values(figure, "residual") == pytest.approx(residual, rel=1e-6)


def test_the_validation_period_has_a_picture_of_its_own() -> None:
    c = calibration()
    point = ValidatedPoint(None, 0.25, "", {})
    validated = Validated((10.0, 12.0), {"polished": point})
    later = replace(c, validation=validated, validation_y=c.y, validation_y_screened=c.y)
    figure = validation_figure(replace(case(), validation=case()), later)
    assert figure is not None
    assert figure.title == "The part that was not calibrated: MSE 0.250 K²"
    assert values(figure, "polished") == pytest.approx(c.y[:, 0], rel=1e-6)
    assert validation_figure(case(), c) is None


def without_improvement() -> Calibration:
    c = calibration()
    assert c.screening is not None
    assert c.y_screened is not None
    mse = c.screening.mse
    return replace(
        c, theta=c.screening.theta, y=c.y_screened, mse=mse, history_mse=np.full_like(c.history_mse, mse)
    )


def without_polish() -> Calibration:
    c = without_improvement()
    ledger = c.ledger | {"n_polish": 0, "total_paper": 65}
    return replace(c, ledger=ledger, history_calls=np.array([65]), history_mse=np.array([c.mse]))


def failed_check() -> Calibration:
    c = calibration()
    history, nothing = c.history_mse.copy(), np.full_like(c.y, np.nan)
    history[:16] = np.inf
    assert c.screening is not None
    return replace(c, screening=replace(c.screening, mse=np.inf), y_screened=nothing, history_mse=history)


def failed_throughout() -> Calibration:
    c = failed_check()
    nothing = np.full_like(c.y, np.nan)
    return replace(c, mse=np.inf, y=nothing, history_mse=np.full_like(c.history_mse, np.inf))


def empty_history() -> Calibration:
    return replace(calibration(), history_calls=np.empty(0, dtype=np.int64), history_mse=np.empty(0))


CASES = [without_improvement, without_polish, failed_check, failed_throughout, empty_history]


@pytest.mark.parametrize("make", CASES)
def test_calibrations_that_went_badly_are_drawn(make: Callable[[], Calibration], tmp_path: Path) -> None:
    c = make()
    assert ink(calibration_figure(case(), c), tmp_path / "c.png") > 0.01
    assert ink(calls_figure(case(), c), tmp_path / "p.png") > 0.01
    assert ink(calls_figure(replace(case(), references=()), c), tmp_path / "p.png") > 0.01


def test_the_history_begins_where_the_polish_does() -> None:
    c = calibration()
    assert values(calls_figure(case(), c), "0.00642 K² polished", "x")[0] == c.history_calls[0]


def test_undeclared_uncertainty_draws_no_band() -> None:
    known = case()
    unknown = replace(known, measurement=with_each(known.measurement, uncertainty=np.nan))
    assert values(calibration_figure(known, calibration()), "sensor ±0.5 K", "high") == [0.5]
    assert "sensor" not in calibration_figure(unknown, calibration()).to_csv()


def test_no_line_spans_a_gap(tmp_path: Path) -> None:
    uneven, c, y = with_gap(case(2)), calibration(n_outputs=2), coverage(8, n_outputs=2)
    assert ink(calibration_figure(uneven, c), tmp_path / "c.png") > 0.02
    assert np.isnan(values(coverage_figure(uneven, y), "measured")).any()
    _, broken = with_gaps(np.array([0.0, 1.0, 2.0, 6.0, 7.0]), np.arange(5.0))
    assert np.isnan(broken).tolist() == [False, False, False, True, False, False]
    assert " % of the measured values lie between" in coverage_figure(uneven, y).caption


def test_a_line_breaks_at_a_gap_and_is_not_drawn_to_zero(tmp_path: Path) -> None:
    time, values = with_gaps(np.array([0.0, 1.0, 2.0, 6.0, 7.0]), np.array([3.0, 4.0, 3.0, 5.0, 4.0]))
    line = Series("line", "#226699", time, values)
    other = Series("points", "#000000", time, values, mark="point")
    panels = [Panel(one.name, Axis("x"), Axis("y"), [one]) for one in (line, other)]
    picture = write_picture(Figure("gap", tuple(panels)), tmp_path / "gap.svg").read_text(encoding="utf-8")
    (path,) = re.findall(r'aria-roledescription="line mark" d="([^"]*)"', picture)
    assert [part.count("L") for part in path.split("M")[1:]] == [2, 1]


def with_gap(whole: Case) -> Case:
    """The first output at odd moments with two days missing, the second half as often."""
    first, second = (one.samples for one in whole.outputs)
    kept = np.flatnonzero((first.time < 3 * 86400) | (first.time > 5 * 86400))[1:-1]
    samples = (
        Samples(first.time[kept] + 411.0, first.values[kept]),
        Samples(second.time[::2], second.values[::2]),
    )
    return replace(whole, measurement=with_samples(whole.measurement, samples))


@pytest.mark.parametrize(("p", "n_undefined"), [(14, 480), (14, 0), (2, 1), (1, 0), (7, 0)])
def test_sensitivity_with_undefined_steps_or_few_parameters(p: int, n_undefined: int, tmp_path: Path) -> None:
    figure = sensitivity_figure(sensitivity(p, n_undefined=n_undefined))
    assert len(figure.panels[0].series) == min(p, 6)
    assert ink(figure, tmp_path / "s.png") > 0.01


def test_names_from_files_are_drawn_as_they_are(tmp_path: Path) -> None:
    names = (
        "$\\frac{",
        "a_b^c",
        "温度",
        "datum['y']",
        "x" * 60,
        '"]); throw 1 //',
        "<b>",
        *parameter_box().names[7:],
    )
    strange = replace(sensitivity(), names=names, output_names=("$T_{.[]",))
    figure = sensitivity_figure(strange)
    assert len(values(figure, "datum['y']")) == 2 * 480
    assert ink(figure, tmp_path / "s.png") > 0.02
    assert write_picture(figure, tmp_path / "s.png", footnote="$\\bad{ 温 " * 60).stat().st_size > 10_000
