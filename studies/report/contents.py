"""What one study's report holds, part by part, before any picture is drawn."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from studies.report.captions import calibration_caption, coverage_caption
from studies.report.data import ReportData
from studies.report.figures_calibration import calibration_figure, calls_figure
from studies.report.figures_model import coverage_figure, sensitivity_figure
from studies.report.figures_tuning import mae_over_n_figure
from studies.report.figures_uncertainty import band_figure, interval_figure
from studies.report.page import Picture, Section
from studies.report.records import CalibrationRecord
from studies.report.tables import sensitivity_table, tuning_table, validation_table
from studies.report.tables_of_calibrations import calibrations_table, intervals_table, parameters_table
from studies.report.uncertainty_record import UncertaintyRecord, sentences
from studies.report.validation import validation_caption
from studies.report.wording import count, difference_unit, quantity


def sections_of(data: ReportData) -> list[Section]:
    """Decide what a report shows; what the data does not hold is left out.

    Args:
        data: The results.

    Returns:
        The parts of the page in their order.
    """
    headline, tuned, sobol = data.headline, tuning_table(data.tuned), sensitivity_table(data)
    others = tuple(_calibration(data, c) for c in data.by_size if c is not headline)
    whole = (calibrations_table(data),) if data.calibrations else ()
    sections = [Section("tuned", "Tuned surrogates", tables=(tuned,) if tuned else (), is_leading=True)]
    if headline is not None:
        sections.append(replace(_calibration(data, headline), anchor="calibration", heading="Calibration"))
    return [
        *sections,
        *(_uncertainty(data, record) for record in data.uncertainties),
        Section("sizes", "All calibrations", (), whole, others),
        Section("surrogate", "All trials", tuple(_trials(data))),
        Section("model", "The model and its parameters", tuple(_model(data)), (sobol,) if sobol else ()),
    ]


def _calibration(data: ReportData, c: CalibrationRecord) -> Section:
    """Return a calibration as a part that can be folded."""
    mse_unit, validation = data.measurement.mse_unit, data.validation_of(c)
    pictures = [
        Picture(
            f"calibration-{c.name}",
            calibration_caption(data.measurement, c),
            calibration_figure(data.measurement, c),
        ),
        Picture(
            f"{'convergence' if c.is_adaptive else 'polish'}-{c.name}",
            f"The search ended because {c.stop_reason}." if c.stop_reason else "",
            calls_figure(c, data.references, mse_unit=mse_unit),
        ),
    ]
    tables = [parameters_table(data.parameters, c)]
    if validation is not None:
        figure = calibration_figure(validation.measurement, validation.shown_as(c))
        figure = replace(figure, title=f"The part that was not calibrated: {figure.title}")
        pictures.append(Picture(f"validation-{c.name}", validation_caption(validation), figure))
        tables.append(validation_table(c, validation))
    mse, calls = quantity(c.mse_polished, mse_unit), count(c.calls_paper, "call")
    said = tuple(f"{line}." for line in (c.state_equations, *c.left_open) if line)
    heading = f"{c.shown_name}: final MSE {mse} in {calls}"
    return Section(c.name, heading, tuple(pictures), tuple(tables), paragraphs=said)


def _uncertainty(data: ReportData, record: UncertaintyRecord) -> Section:
    name = record.calibration
    pictures = (
        Picture(
            f"bands-{name}",
            "Dark: the simulations of equally good parameter sets. Light: measured values to be expected.",
            band_figure(data.measurement, record),
        ),
        Picture(
            f"intervals-{name}",
            "Density and interval of the posterior, the linearised interval, and the calibrated value."
            if record.is_trusted
            else "The linearised interval and the calibrated value; too few calls to say more.",
            interval_figure(data.parameters, record),
        ),
    )
    table, said = intervals_table(data.parameters, record), sentences(record, data.measurement.units)
    heading = f"How sure the {name} calibration is"
    return Section(f"uncertainty-{name}", heading, pictures, (table,), paragraphs=said)


def _trials(data: ReportData) -> Iterator[Picture]:
    if data.trials is not None and data.trials.state:
        figure = mae_over_n_figure(data.trials, unit=difference_unit(data.measurement.units[0]))
        yield Picture("mae-over-n", "The curves of each training are in MLflow: studies ui.", figure)


def _model(data: ReportData) -> Iterator[Picture]:
    if (coverage := data.coverage) is not None:
        caption = coverage_caption(data.measurement, coverage)
        yield Picture("coverage", caption, coverage_figure(data.measurement, coverage))
    if (sensitivity := data.sensitivity) is not None:
        caption = (
            f"From {count(sensitivity.n_calls, 'simulation')} of the FMU; the six largest are shown. "
            "What the first orders miss to 1 are interactions."
        )
        yield Picture("sensitivity", caption, sensitivity_figure(sensitivity))
