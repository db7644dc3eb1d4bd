"""What one study's report holds, part by part, before any picture is drawn."""

from __future__ import annotations

from dataclasses import replace

from studies.report import captions
from studies.report.data import ReportData
from studies.report.figures_calibration import calibration_figure, calls_figure
from studies.report.figures_model import coverage_figure, sensitivity_figure
from studies.report.figures_tuning import mae_over_n_figure
from studies.report.figures_uncertainty import band_figure, interval_figure
from studies.report.page import Picture, Section
from studies.report.records import CalibrationRecord
from studies.report.tables import sensitivity_table, tuning_table, validation_table
from studies.report.tables_of_calibrations import calibrations_table, intervals_table, parameters_table
from studies.report.uncertainty import UncertaintyRecord, sentences
from studies.report.validation import validation_caption
from studies.report.wording import count, difference_unit, quantity


def sections_of(data: ReportData) -> list[Section]:
    """Decide what a report shows; what the data does not hold is left out.

    Args:
        data: The results.

    Returns:
        The parts of the page in their order.
    """
    headline = data.headline
    others = tuple(_calibration(data, c) for c in data.by_size if c is not headline)
    tuned, sobol = tuning_table(data), sensitivity_table(data)
    whole = (calibrations_table(data),) if data.calibrations else ()
    return [
        Section("tuned", "Tuned surrogates", tables=(tuned,) if tuned else (), is_leading=True),
        *(
            replace(_calibration(data, c), anchor="calibration", heading="Calibration")
            for c in (headline,)
            if c
        ),
        *(_uncertainty(data, record) for record in data.uncertainties),
        Section("sizes", "All calibrations", (), whole, others),
        Section("surrogate", "All trials", _surrogate_pictures(data)),
        Section("model", "The model and its parameters", _model_pictures(data), (sobol,) if sobol else ()),
    ]


def _calibration(data: ReportData, c: CalibrationRecord) -> Section:
    """Return a calibration as a part that can be folded."""
    mse_unit = data.measurement.mse_unit
    validation = data.validation_of(c)
    pictures = [
        Picture(
            f"calibration-{c.name}",
            f"Measured{'' if c.is_adaptive else ', screened'} and {c.final} ({c.shown_name})",
            captions.calibration_caption(data.measurement, c),
            calibration_figure(data.measurement, c),
        ),
        Picture(
            f"{'convergence' if c.is_adaptive else 'polish'}-{c.name}",
            f"MSE over model calls ({c.shown_name})",
            f"The search ended because {c.stop_reason}." if c.stop_reason else "",
            calls_figure(c, data.references, mse_unit=mse_unit),
        ),
    ]
    tables = [parameters_table(data.parameters, c)]
    if validation is not None:
        pictures.append(
            Picture(
                f"validation-{c.name}",
                f"The part that was not calibrated ({c.shown_name})",
                validation_caption(validation),
                calibration_figure(validation.measurement, validation.shown_as(c)),
            )
        )
        tables.append(validation_table(c, validation))
    said = tuple(f"{line}." for line in (*filter(None, [c.state_equations]), *c.left_open))
    heading = (
        f"{c.shown_name}: final MSE {quantity(c.mse_polished, mse_unit)} in {count(c.calls_paper, 'call')}"
    )
    return Section(
        c.name,
        heading,
        tuple(pictures),
        tuple(tables),
        paragraphs=said,
    )


def _uncertainty(data: ReportData, record: UncertaintyRecord) -> Section:
    name = record.calibration
    pictures = [
        Picture(
            f"bands-{name}",
            f"Equally good parameter sets over the measurement ({name})",
            "Dark: the simulations of equally good parameter sets. Light: measured values to be expected.",
            band_figure(data.measurement, record),
        ),
        Picture(
            f"intervals-{name}",
            f"What is known of each parameter ({name})",
            "Density and interval of the posterior, the linearised interval, and the calibrated value."
            if record.is_trusted
            else "The linearised interval and the calibrated value; too few calls to say more.",
            interval_figure(data.parameters, record),
        ),
    ]
    return Section(
        f"uncertainty-{name}",
        f"How sure the {name} calibration is",
        tuple(pictures),
        (intervals_table(data.parameters, record),),
        paragraphs=sentences(record, data.measurement.units),
    )


def _surrogate_pictures(data: ReportData) -> tuple[Picture, ...]:
    unit, trials = difference_unit(data.measurement.units[0]), data.trials
    pictures = []
    if trials is not None and trials.state:
        pictures.append(
            Picture(
                "mae-over-n",
                "Error of every trial over the number of training simulations",
                "The curves of each training are in MLflow: studies ui.",
                mae_over_n_figure(trials, unit=unit),
            )
        )

    return tuple(pictures)


def _model_pictures(data: ReportData) -> tuple[Picture, ...]:
    pictures = []
    coverage, sensitivity = data.coverage, data.sensitivity
    if coverage is not None:
        pictures.append(
            Picture(
                "coverage",
                f"The {coverage.name} set and the measurement",
                captions.coverage_caption(data.measurement, coverage),
                coverage_figure(data.measurement, coverage),
            )
        )
    if sensitivity is not None:
        pictures.append(
            Picture(
                "sensitivity",
                "Sobol indices over time",
                f"From {count(sensitivity.n_calls, 'simulation')} of the FMU. What the first orders "
                "miss to 1 are interactions. The six largest are shown.",
                sensitivity_figure(sensitivity),
            )
        )
    return tuple(pictures)
