"""What one study's report holds: which pictures and tables there are, before any of them is drawn."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from studies.report import captions
from studies.report.data import ReportData
from studies.report.figures_calibration import calibration_figure, polish_figure
from studies.report.figures_convergence import convergence_figure
from studies.report.figures_data import MarkedPoint, coverage_figure, coverage_pairs_figure
from studies.report.figures_overview import overview_figure
from studies.report.figures_sensitivity import sensitivity_figure
from studies.report.figures_tuning import learning_curves_figure, mae_over_n_figure
from studies.report.figures_uncertainty import band_figure, interval_figure, pairs_figure, shown_pairs
from studies.report.records import CalibrationRecord
from studies.report.records_tuning import LearningCurves
from studies.report.tables import Table, sensitivity_table, tuning_table, validation_table
from studies.report.tables_of_calibrations import calibrations_table, parameters_table
from studies.report.uncertainty import UncertaintyRecord
from studies.report.uncertainty_told import (
    band_caption,
    interval_caption,
    intervals_table,
    pairs_caption,
)
from studies.report.validation import validation_caption
from studies.report.wording import difference_unit


@dataclass(frozen=True)
class Picture:
    """A picture still to be drawn."""

    name: str
    heading: str
    caption: str
    draw: Callable[[Path], Path]

    @property
    def file(self) -> str:
        """Name of the PNG."""
        return f"{self.name}.png"


@dataclass(frozen=True)
class Contents:
    """Everything that one study's report holds, by the part of the page it belongs to."""

    calibration: tuple[Picture, ...]
    overview: tuple[Picture, ...]
    others: tuple[tuple[CalibrationRecord, tuple[Picture, ...]], ...]
    uncertainty: tuple[tuple[UncertaintyRecord, tuple[Picture, ...]], ...]
    surrogate: tuple[Picture, ...]
    model: tuple[Picture, ...]
    tables: dict[str, Table]

    @property
    def pictures(self) -> tuple[Picture, ...]:
        """All pictures in the order of the page."""
        others = tuple(picture for _, pictures in self.others for picture in pictures)
        uncertainty = tuple(picture for _, pictures in self.uncertainty for picture in pictures)
        return self.calibration + uncertainty + self.overview + self.surrogate + self.model + others


def contents_of(data: ReportData) -> Contents:
    """Decide what a report shows; what the data does not hold is left out."""
    headline = data.headline
    foot = f"{data.label} · {data.note}" if data.note else data.label
    unit = difference_unit(data.measurement.units[0])
    mse_unit = captions.mse_unit(data.measurement)
    others = tuple(c for c in data.by_size if c is not headline)
    tables = {
        t.name: t
        for t in (
            calibrations_table(data) if data.calibrations else None,
            *(parameters_table(data.parameters, c) for c in data.by_size),
            *(validation_table(c, v) for c in data.by_size for v in (data.validation_of(c),) if v),
            *(intervals_table(data.parameters, record) for record in data.uncertainties),
            tuning_table(data),
            sensitivity_table(data),
        )
        if t is not None
    }
    overview: tuple[Picture, ...] = ()
    if any(not c.is_adaptive for c in data.calibrations):
        overview = (
            Picture(
                "overview",
                "Errors and calls of all calibrations",
                captions.overview_caption(data.by_size, mse_unit),
                lambda path: overview_figure(
                    data.by_size, data.references, path, mse_unit=mse_unit, footnote=foot
                ),
            ),
        )
    return Contents(
        calibration=_pictures_of(data, headline, foot) if headline else (),
        overview=overview,
        others=tuple((c, _pictures_of(data, c, foot)) for c in others),
        uncertainty=tuple(
            (record, _uncertainty_pictures(data, record, foot)) for record in data.uncertainties
        ),
        surrogate=_surrogate_pictures(data, unit, foot),
        model=_model_pictures(data, foot),
        tables=tables,
    )


def _pictures_of(data: ReportData, c: CalibrationRecord, foot: str) -> tuple[Picture, ...]:
    mse_unit = captions.mse_unit(data.measurement)
    validation = data.validation_of(c)
    over_calls, caption_over_calls = polish_figure, captions.polish_caption
    if c.is_adaptive:
        over_calls, caption_over_calls = convergence_figure, captions.convergence_caption
    validated: tuple[Picture, ...] = ()
    if validation is not None:
        validated = (
            Picture(
                f"validation-{c.name}",
                f"The part that was not calibrated ({c.shown_name})",
                validation_caption(validation),
                lambda path: calibration_figure(
                    validation.measurement,
                    validation.shown_as(c),
                    path,
                    title=validation.sentence,
                    footnote=foot,
                ),
            ),
        )
    return (
        Picture(
            f"calibration-{c.name}",
            f"Measured{'' if c.is_adaptive else ', screened'} and {c.final} ({c.shown_name})",
            captions.calibration_caption(data.measurement, c),
            lambda path: calibration_figure(data.measurement, c, path, footnote=foot),
        ),
        Picture(
            f"{'convergence' if c.is_adaptive else 'polish'}-{c.name}",
            f"MSE over model calls ({c.shown_name})",
            caption_over_calls(c, mse_unit),
            lambda path: over_calls(c, data.references, path, mse_unit=mse_unit, footnote=foot),
        ),
        *validated,
    )


def _uncertainty_pictures(data: ReportData, record: UncertaintyRecord, foot: str) -> tuple[Picture, ...]:
    name, box = record.calibration, data.parameters.of(record.names)
    pictures = [
        Picture(
            f"bands-{name}",
            f"Equally good parameter sets over the measurement ({name})",
            band_caption(data.measurement, record),
            lambda path: band_figure(data.measurement, record, path, footnote=foot),
        ),
        Picture(
            f"intervals-{name}",
            f"What is known of each parameter ({name})",
            interval_caption(record),
            lambda path: interval_figure(box, record, path, footnote=foot),
        ),
    ]
    if shown_pairs(record):
        pictures.append(
            Picture(
                f"pairs-{name}",
                f"Parameters that compensate each other ({name})",
                pairs_caption(record),
                lambda path: pairs_figure(box, record, path, footnote=foot),
            )
        )
    return tuple(pictures)


def _surrogate_pictures(data: ReportData, unit: str, foot: str) -> tuple[Picture, ...]:
    pictures = []
    trials = data.trials
    if trials is not None and trials.state:
        pictures.append(
            Picture(
                "mae-over-n",
                "Error of every trial over the number of training simulations",
                captions.trials_caption(trials, unit),
                lambda path: mae_over_n_figure(trials, path, unit=unit, footnote=foot),
            )
        )

    def learning(curves: LearningCurves) -> Picture:
        return Picture(
            f"learning-n{curves.n_train:04d}",
            f"Learning curves of the best surrogate (n = {curves.n_train})",
            captions.learning_caption(curves, unit),
            lambda path: learning_curves_figure(curves, path, unit=unit, footnote=foot),
        )

    return (*pictures, *(learning(c) for c in sorted(data.learning_curves, key=lambda c: c.n_train)))


def _model_pictures(data: ReportData, foot: str) -> tuple[Picture, ...]:
    pictures = []
    coverage, sensitivity, headline = data.coverage, data.sensitivity, data.headline
    if coverage is not None:
        marked = (
            [MarkedPoint(f"{headline.final} ({headline.shown_name})", headline.theta_polished)]
            if headline
            else []
        )
        pictures += [
            Picture(
                "coverage",
                f"The {coverage.name} set and the measurement",
                captions.coverage_caption(data.measurement, coverage),
                lambda path: coverage_figure(data.measurement, coverage, path, footnote=foot),
            ),
            Picture(
                "coverage-pairs",
                f"The {coverage.name} set, every pair of parameters",
                captions.pairs_caption(data.parameters, coverage),
                lambda path: coverage_pairs_figure(
                    data.parameters, coverage, path, marked=marked, footnote=foot
                ),
            ),
        ]
    if sensitivity is not None:
        pictures.append(
            Picture(
                "sensitivity",
                "Sobol indices over time",
                captions.sensitivity_caption(sensitivity),
                lambda path: sensitivity_figure(sensitivity, path, footnote=foot),
            )
        )
    return tuple(pictures)
