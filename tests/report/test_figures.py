"""Every picture is a PNG with something on it, the same bytes each time, whatever the data lacks."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib import image
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from records_for_tests import (
    calibration,
    coverage,
    measured,
    parameter_box,
    report_data,
    sensitivity,
    trials,
)

from simulation.case import KnownError
from simulation.measurement import Samples
from simulation.time_unit import period_text
from studies.report import CalibrationRecord, MeasuredSeries, captions
from studies.report.drawing import decimal_log, drawing, line_with_gaps, time_axis
from studies.report.figures_calibration import (
    calibration_figure,
    calls_figure,
    residual_reach,
)
from studies.report.figures_data import coverage_figure
from studies.report.figures_sensitivity import sensitivity_figure
from studies.report.figures_tuning import mae_over_n_figure
from studies.report.findings import enclosed_fraction

REFERENCES = (KnownError("best known", 0.0103, is_target=False), KnownError("target", 0.0121, is_target=True))

DRAW: dict[str, Callable[[Path], Path]] = {
    "calibration": lambda p: calibration_figure(measured(), calibration(), p),
    "calls": lambda p: calls_figure(calibration(), REFERENCES, p, mse_unit="K²"),
    "coverage": lambda p: coverage_figure(measured(), coverage(), p),
    "sensitivity": lambda p: sensitivity_figure(sensitivity(), p),
    "trials": lambda p: mae_over_n_figure(trials(), p, unit="K"),
}


def ink(path: Path) -> float:
    """Return the fraction of pixels that are not background."""
    assert path.read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    pixels = np.asarray(image.imread(path))[..., :3]
    return float(np.mean((pixels < 0.98).any(axis=-1)))


@pytest.mark.parametrize("name", DRAW)
def test_picture_is_not_blank_and_has_the_same_bytes_each_time(name: str, tmp_path: Path) -> None:
    path = tmp_path / "new folder" / f"{name}.png"
    assert DRAW[name](path) == path
    assert ink(path) > 0.02
    assert [file.name for file in path.parent.iterdir()] == [path.name]
    content = path.read_bytes()
    assert DRAW[name](path).read_bytes() == content
    assert b"Software" not in content


def test_picture_is_as_wide_as_promised(tmp_path: Path) -> None:
    assert image.imread(DRAW["calls"](tmp_path / "p.png")).shape[1] == 1200


def test_settings_of_the_user_change_nothing(tmp_path: Path) -> None:
    import matplotlib as mpl

    plain = DRAW["calls"](tmp_path / "plain.png").read_bytes()
    with mpl.rc_context({"lines.linewidth": 9.0, "font.size": 30.0, "savefig.facecolor": "red"}):
        assert DRAW["calls"](tmp_path / "changed.png").read_bytes() == plain
        assert mpl.rcParams["lines.linewidth"] == 9.0


def test_importing_the_room_loads_neither_matplotlib_nor_its_global_state() -> None:
    code = (
        "import sys, studies.report; assert 'matplotlib' not in sys.modules;"
        "import studies.report.builder; assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)


def test_a_failed_drawing_leaves_no_file(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="half way"), drawing(tmp_path / "x.png", title="", height_in=2.0):
        raise RuntimeError("half way")
    assert not list(tmp_path.iterdir())


def without_improvement() -> CalibrationRecord:
    c = calibration()
    return replace(
        c, theta_polished=c.theta_screened, y_polished=c.y_screened, mse_polished=c.mse_screened,
        history_mse=np.full_like(c.history_mse, c.mse_screened),
    )  # fmt: skip


def without_polish() -> CalibrationRecord:
    c = without_improvement()
    return replace(c, n_polish=0, history_calls=np.array([65]), history_mse=np.array([c.mse_screened]))


def failed_check() -> CalibrationRecord:
    c = calibration()
    history = c.history_mse.copy()
    history[:16] = np.inf
    return replace(c, mse_screened=np.inf, y_screened=np.full_like(c.y_screened, np.nan), history_mse=history)


def failed_throughout() -> CalibrationRecord:
    c, nothing = failed_check(), np.full_like(calibration().y_polished, np.nan)
    return replace(
        c, mse_polished=np.inf, y_polished=nothing, history_mse=np.full_like(c.history_mse, np.inf)
    )


def empty_history() -> CalibrationRecord:
    return replace(calibration(), history_calls=np.empty(0, dtype=np.int64), history_mse=np.empty(0))


CASES = [without_improvement, without_polish, failed_check, failed_throughout, empty_history]


@pytest.mark.parametrize("make", CASES)
def test_calibrations_that_went_badly_are_drawn(
    make: Callable[[], CalibrationRecord], tmp_path: Path
) -> None:
    c = make()
    assert ink(calibration_figure(measured(), c, tmp_path / "c.png")) > 0.02
    assert ink(calls_figure(c, REFERENCES, tmp_path / "p.png", mse_unit="K²")) > 0.02
    assert ink(calls_figure(c, (), tmp_path / "p.png", mse_unit="")) > 0.02


def test_a_large_training_set_does_not_squeeze_the_polish(tmp_path: Path) -> None:
    large = calls_figure(calibration(4096, n_polish=65), (), tmp_path / "p.png", mse_unit="K²")
    assert ink(large) > 0.05


def test_the_screened_point_stands_where_the_polish_begins(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    figures: list[Figure] = []
    save = FigureCanvasAgg.print_png

    def watched(canvas: FigureCanvasAgg, *arguments: Any, **more: Any) -> None:
        figures.append(canvas.figure)
        save(canvas, *arguments, **more)

    monkeypatch.setattr(FigureCanvasAgg, "print_png", watched)
    c = calibration()
    calls_figure(c, (), tmp_path / "p.png", mse_unit="K²")
    lines = figures[0].axes[0].get_lines()
    (diamond,) = [line for line in lines if line.get_marker() == "D"]
    (steps,) = [line for line in lines if line.get_drawstyle() == "steps-post"]
    assert np.asarray(diamond.get_xdata())[0] == np.asarray(steps.get_xdata())[0] == c.history_calls[0]


def test_a_residual_is_no_line_within_a_wide_band() -> None:
    assert residual_reach(0.4, 0.5) == 1.25 * 0.5
    assert residual_reach(2.0, 0.5) == 1.12 * 2.0
    # A hundredth of the band: the axis is the residual's.
    assert residual_reach(0.005, 0.5) == 1.12 * 0.005
    assert residual_reach(0.0, 0.5) == 1.25 * 0.5
    assert residual_reach(0.0, np.nan) == 1.0


def test_several_outputs_get_panels_of_their_own(tmp_path: Path) -> None:
    n_pixels = {}
    for k in (1, 2):
        paths = (
            calibration_figure(measured(k), calibration(n_outputs=k), tmp_path / "c.png"),
            coverage_figure(measured(k), coverage(8, n_outputs=k), tmp_path / "f.png"),
            sensitivity_figure(sensitivity(6, n_outputs=k), tmp_path / "s.png"),
        )
        n_pixels[k] = [image.imread(path).shape[0] for path in paths]
    assert all(two > 1.4 * one for one, two in zip(n_pixels[1], n_pixels[2], strict=True))


def test_undeclared_uncertainty_draws_no_band(tmp_path: Path) -> None:
    known = measured()
    unknown = replace(known, measurement=replace(known.measurement, uncertainty=np.array([np.nan])))
    with_band = calibration_figure(measured(), calibration(), tmp_path / "a.png").read_bytes()
    assert calibration_figure(unknown, calibration(), tmp_path / "b.png").read_bytes() != with_band


def test_uneven_samples_are_dots_and_no_line_spans_a_gap(tmp_path: Path) -> None:
    whole, c = measured(2), calibration(n_outputs=2)
    uneven = with_gap(whole)
    pictures = [
        calibration_figure(series, c, tmp_path / "c.png").read_bytes() for series in (whole, uneven)
    ] + [
        coverage_figure(series, coverage(8, n_outputs=2), tmp_path / "f.png").read_bytes()
        for series in (whole, uneven)
    ]
    assert len(set(pictures)) == 4
    figure = Figure()
    axes = figure.subplots()
    line_with_gaps(axes, np.array([0.0, 1.0, 2.0, 6.0, 7.0]), np.arange(5.0), color="k")
    (line,) = axes.get_lines()
    assert np.isnan(np.asarray(line.get_ydata())).tolist() == [False, False, False, True, False, False]
    assert "of the values of TWall lie within" in captions.calibration_caption(uneven, c)
    assert 0.0 <= enclosed_fraction(uneven, coverage(8, n_outputs=2)) <= 1.0


def with_gap(series: MeasuredSeries) -> MeasuredSeries:
    """The first output at odd moments with two days missing, the second half as often."""
    first, second = series.samples
    kept = np.flatnonzero((first.time < 3 * 86400) | (first.time > 5 * 86400))[1:-1]
    samples = (
        Samples(first.time[kept] + 411.0, first.values[kept]),
        Samples(second.time[::2], second.values[::2]),
    )
    return replace(series, measurement=replace(series.measurement, samples=samples))


def test_failed_rows_are_left_out_of_the_bundle(tmp_path: Path) -> None:
    some = coverage(16)
    some.y[3] = np.nan
    assert ink(coverage_figure(measured(), some, tmp_path / "c.png")) > 0.02
    some.y[:] = np.nan
    assert ink(coverage_figure(measured(), some, tmp_path / "c.png")) > 0.005


@pytest.mark.parametrize(("p", "n_undefined"), [(14, 480), (14, 0), (2, 1), (1, 0), (7, 0)])
def test_sensitivity_with_undefined_steps_or_few_parameters(p: int, n_undefined: int, tmp_path: Path) -> None:
    assert ink(sensitivity_figure(sensitivity(p, n_undefined=n_undefined), tmp_path / "s.png")) > 0.01


def test_trials_that_all_failed_or_one_size_alone_are_drawn(tmp_path: Path) -> None:
    one = trials((64,), 3)
    assert ink(mae_over_n_figure(one, tmp_path / "t.png", unit="K")) > 0.01
    nothing = np.full(len(one.state), np.nan)
    failed = replace(
        one, state=("failed",) * len(one.state), validation_mae=nothing, test_mae=nothing, test_p90=nothing,
        is_best=np.zeros(len(one.state), dtype=bool),
    )  # fmt: skip
    assert ink(mae_over_n_figure(failed, tmp_path / "t.png", unit="K")) > 0.005
    assert ink(mae_over_n_figure(trials(()), tmp_path / "t.png", unit="K")) > 0.005


def test_names_from_files_are_drawn_as_they_are(tmp_path: Path) -> None:
    names = ("$\\frac{", "a_b^c", "温度", "☃", "x" * 60, "%s {0}", "<b>", *parameter_box().names[7:])
    strange = replace(sensitivity(), names=names, output_names=("$T_{",))
    assert ink(sensitivity_figure(strange, tmp_path / "s.png", footnote="$\\bad{ 温 " * 60)) > 0.02


def test_two_cases_at_once_do_not_share_a_picture(tmp_path: Path) -> None:
    data = report_data()
    a = calibration_figure(data.measurement, data.calibrations[0], tmp_path / "a.png").read_bytes()
    b = calibration_figure(data.measurement, data.calibrations[1], tmp_path / "b.png").read_bytes()
    assert a != b


def test_a_late_period_has_the_unit_in_which_it_is_told() -> None:
    axes = Figure().add_subplot()
    hour_s = 3600.0
    unit = time_axis(axes, np.array([4.0, 5.0, 5.5]) * hour_s)
    assert unit.symbol in period_text((4.0 / 24.0, 5.5 / 24.0))
    assert axes.get_xlabel() == "time [h]"
    assert axes.get_xlim() == (4.0, 5.5)


@pytest.mark.parametrize(
    ("lower", "upper", "named"),
    [
        (0.001, 9.0, {"0.01", "0.1", "1"}),
        (0.006, 0.2, {"0.01", "0.02", "0.05", "0.1"}),
        (0.0101, 0.0129, {"0.012"}),
    ],
)
def test_a_logarithmic_axis_names_round_numbers(lower: float, upper: float, named: set[str]) -> None:
    axes = Figure().add_subplot()
    decimal_log(axes)
    axes.set_ylim(lower, upper)
    assert named <= {label.get_text() for label in axes.get_yticklabels()}
