"""What one study's report holds, part by part."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

from studies.blocks import Table
from studies.report.data import ReportData, best_of
from studies.report.drawing import Figure
from studies.report.figures_calibration import calibration_figure, calls_figure, validation_figure
from studies.report.figures_model import coverage_caption, coverage_figure, sensitivity_figure
from studies.report.figures_tuning import mae_over_n_figure
from studies.report.figures_uncertainty import band_figure, interval_figure
from studies.report.sentences import calibration_sentences, uncertainty_sentences
from studies.report.tables import (
    calibrations_table,
    intervals_table,
    parameters_table,
    sensitivity_table,
    tuning_table,
    validation_table,
)
from studies.report.wording import count, difference_unit, quantity, square_of
from studies.stages.pipeline import Outcome
from studies.stages.stage_results import Calibration, Uncertainty


@dataclass(frozen=True)
class Picture:
    """A picture and its caption."""

    figure: Figure
    caption: str = ""


@dataclass(frozen=True)
class Section:
    """A part of the page; the reader opens folded ones, and one without content is left out."""

    anchor: str
    heading: str
    pictures: tuple[Picture, ...] = ()
    tables: tuple[Table, ...] = ()
    folded: tuple["Section", ...] = ()
    paragraphs: tuple[str, ...] = ()

    @property
    def has_content(self) -> bool:
        """Whether there is something to show."""
        return bool(self.pictures or self.tables or self.folded or self.paragraphs)


def sections_of(data: ReportData) -> list[Section]:
    """Return the parts of the page in their order; what the data does not hold is left out."""
    best, case, sobol = best_of(data.calibrations), data.case, data.sensitivity
    tuned = tuning_table(data.tuned)
    others = tuple(_calibration(data, one) for one in data.calibrations if one is not best)
    whole = (calibrations_table(case, data.calibrations),) if data.calibrations else ()
    sections = [Section("tuned", "Tuned surrogates", tables=(tuned,) if tuned else ())]
    if best is not None:
        sections.append(replace(_calibration(data, best), anchor="calibration", heading="Calibration"))
    sections += [_uncertainty(data, one) for one in data.uncertainties]
    indices = () if sobol is None else (sensitivity_table(sobol),)
    return [
        *sections,
        Section("sizes", "All calibrations", (), whole, others),
        Section("surrogate", "All trials", tuple(_trials(data))),
        Section("model", "The model and its parameters", tuple(_model(data)), indices),
    ]


def _calibration(data: ReportData, outcome: Outcome[Calibration]) -> Section:
    """Return a calibration as a part that can be folded."""
    case, found = data.case, outcome.result
    pictures = [
        Picture(calibration_figure(case, found)),
        Picture(calls_figure(case, found), f"The search ended because {found.stop_reason}."),
    ]
    tables = [parameters_table(case, found)]
    if (validated := validation_figure(case, found)) is not None:
        pictures.append(Picture(validated))
    if (table := validation_table(case, found)) is not None:
        tables.append(table)
    mse, calls = quantity(found.mse, square_of(case.outputs[0].unit)), count(found.n_calls_paper, "call")
    said = tuple(f"{one.rstrip('.')}." for one in calibration_sentences(case, found))
    heading = f"{found.shown_name}: final {found.error_name} {mse} in {calls}"
    return Section(outcome.name, heading, tuple(pictures), tuple(tables), paragraphs=said)


def _uncertainty(data: ReportData, found: Uncertainty) -> Section:
    name, case = found.calibration, data.case
    intervals = "The linearised interval and the calibrated value; too few calls to say more."
    if found.sample.is_trusted:
        intervals = "Density and interval of the posterior, linearised interval, and calibrated value."
    bands = "Dark: the simulations of equally good parameter sets. Light: measured values to be expected."
    return Section(
        f"uncertainty-{name}",
        f"How sure the {name} calibration is",
        (
            Picture(band_figure(case, found), bands),
            Picture(interval_figure(case.parameter_space, found), intervals),
        ),
        (intervals_table(case.parameter_space, found),),
        paragraphs=tuple(uncertainty_sentences(found, difference_unit(case.outputs[0].unit))),
    )


def _trials(data: ReportData) -> Iterator[Picture]:
    if data.trials is not None and data.trials.state:
        figure = mae_over_n_figure(data.trials, unit=difference_unit(data.case.outputs[0].unit))
        yield Picture(figure, "The curves of each training are in MLflow: studies ui.")


def _model(data: ReportData) -> Iterator[Picture]:
    if (y := data.coverage) is not None:
        yield Picture(coverage_figure(data.case, y), coverage_caption(data.case, y))
    if (sensitivity := data.sensitivity) is not None:
        caption = (
            f"From {count(sensitivity.n_calls, 'simulation')} of the FMU; the six largest are shown. "
            "What the first orders miss to 1 are interactions."
        )
        yield Picture(sensitivity_figure(sensitivity), caption)
