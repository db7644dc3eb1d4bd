"""The page: one HTML file that opens anywhere, with its pictures and the library that draws them."""

import base64
import gzip
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from hashlib import sha256
from importlib.resources import files
from pathlib import Path
from typing import Any

from markupsafe import Markup

from simulation.arrays import FloatArray
from simulation.case import Case
from simulation.whole_file import whole_file
from studies.blocks import Table
from studies.calibration.sobol import SobolIndices
from studies.reporting.drawing import Figure, drawn
from studies.reporting.figures_calibration import (
    band_figure,
    calibration_figure,
    calls_figure,
    interval_figure,
    profile_figure,
    validation_figure,
)
from studies.reporting.figures_model import (
    TrialsRecord,
    coverage_figure,
    mae_over_n_figure,
    sensitivity_figure,
)
from studies.reporting.figures_tuning import learning_figure, slices_figure
from studies.reporting.sentences import (
    calibration_sentences,
    choice_sentences,
    headline,
    mean_sentences,
    profile_sentences,
    uncertainty_sentences,
)
from studies.reporting.tables import (
    Calibrations,
    best_of,
    calibrations_table,
    importances_table,
    intervals_table,
    parameters_table,
    profiles_table,
    sensitivity_table,
    structures_table,
    tuning_table,
    validation_table,
)
from studies.results.choice import Choice
from studies.results.outcome import Outcome
from studies.results.profiled import Profiles
from studies.results.stage_results import Calibration, TunedSize, Uncertainty
from studies.results.trials import TunedStudy
from studies.templates import environment
from studies.words.wording import count, difference_unit, quantity, square_of


@dataclass(frozen=True)
class ReportData:
    """Everything a report shows.

    Attributes:
        label: The study's label, e.g. "office-quick".
        case: What was calibrated, against what.
        calibrations: One per training-set size, the adaptive one first.
        coverage: Trajectories of the training set, NaN in failed rows; None without. Shape (n, t, k).
            [per output]
        sensitivity: Sobol indices, if they were asked for.
        tuned: The best surrogate of each training-set size.
        trials: Every trial of the studies.
        studies: The study of each training-set size, in its order.
        importances: Part of each hyperparameter in what decides the error, by training-set size and name. [1]
        uncertainties: How sure the calibrations are, as far as that was asked.
        profiles: Profile likelihoods of the calibrations, likewise.
        choices: Comparisons of this structure with others.
        commands: What made the results.
    """

    label: str
    case: Case
    calibrations: Calibrations = ()
    coverage: FloatArray | None = None
    sensitivity: SobolIndices | None = None
    tuned: tuple[TunedSize, ...] = ()
    trials: TrialsRecord | None = None
    studies: tuple[TunedStudy, ...] = ()
    importances: Mapping[int, Mapping[str, float]] = field(default_factory=dict)
    uncertainties: tuple[Uncertainty, ...] = ()
    profiles: tuple[Profiles, ...] = ()
    choices: tuple[Choice, ...] = ()
    commands: tuple[str, ...] = ()


def write_page(data: ReportData, file: Path) -> None:
    """Write a report as one page, in one step.

    Args:
        data: What to show.
        file: Where to; its folder is made.
    """
    templates = environment("reporting", escapes=True)
    templates.filters["packed"] = _packed
    program = _library() + files("studies.reporting").joinpath("charts.js").read_text(encoding="utf-8")
    digest = base64.b64encode(sha256(program.encode()).digest()).decode("ascii")
    best = best_of(data.calibrations)
    lead = "Nothing has been calibrated yet." if best is None else f"{headline(data.case, best)}."
    text = templates.get_template("page.html").render(
        data=data, lead=lead, sections=sections_of(data), program=Markup(program), digest=digest
    )
    with whole_file(file) as stream:
        stream.write(text.encode())


def _packed(specification: Mapping[str, Any]) -> str:
    """Return JSON compressed, in base64: a sixth of the text, which counts where recordings are long."""
    content = json.dumps(specification, allow_nan=False).encode()
    return base64.b64encode(gzip.compress(content, mtime=0)).decode("ascii")


@cache
def _library() -> str:
    """Return the programs that draw, about 0.9 MB; putting them together takes two seconds."""
    return drawn("library")


@dataclass(frozen=True)
class Section:
    """A part of the page; the reader opens folded ones, and one without content is left out."""

    anchor: str
    heading: str
    pictures: tuple[Figure, ...] = ()
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
    tuned, unit = tuning_table(data.tuned), difference_unit(case.outputs[0].unit)
    others = tuple(_calibration(data, one) for one in data.calibrations if one is not best)
    whole = (calibrations_table(case, data.calibrations),) if data.calibrations else ()
    means = tuple(f"{one}." for one in mean_sentences(data.tuned))
    sections = [Section("tuned", "Tuned surrogates", (), (tuned,) if tuned else (), paragraphs=means)]
    if best is not None:
        sections.append(replace(_calibration(data, best), anchor="calibration", heading="Calibration"))
    sections += [_uncertainty(data, one) for one in data.uncertainties]
    sections += [
        Section(f"choice-{n}", "Model structures", (), (structures_table(one, unit),),
                paragraphs=tuple(choice_sentences(one, unit)))
        for n, one in enumerate(data.choices)
    ]  # fmt: skip
    pca_gp = {one.n_train: _errors(one.baseline) for one in data.tuned if one.baseline}
    beside = {"PCA + GP": pca_gp} if pca_gp else {}
    trials = () if data.trials is None else (mae_over_n_figure(data.trials, unit=unit, beside=beside),)
    trials += tuple(filter(None, (slices_figure(data.studies), learning_figure(data.studies))))
    importances = (importances_table(data.importances),) if any(data.importances.values()) else ()
    model = () if data.coverage is None else (coverage_figure(case, data.coverage),)
    model += () if sobol is None else (sensitivity_figure(sobol),)
    indices = () if sobol is None else (sensitivity_table(sobol),)
    return [
        *sections,
        Section("sizes", "All calibrations", (), whole, others),
        Section("surrogate", "All trials", trials, importances),
        Section("model", "The model and its parameters", model, indices),
    ]


def _errors(metrics: Mapping[str, float]) -> tuple[float, float]:
    """Return MAE and 90th percentile on the test set. [output's unit]."""
    return metrics.get("test/mae", math.nan), metrics.get("test/p90", math.nan)


def _calibration(data: ReportData, outcome: Outcome[Calibration]) -> Section:
    """Return a calibration as a part that can be folded."""
    case, found = data.case, outcome.result
    pictures = calibration_figure(case, found), calls_figure(case, found), validation_figure(case, found)
    tables = parameters_table(case, found), validation_table(case, found)
    mse, calls = quantity(found.mse, square_of(case.outputs[0].unit)), count(found.n_calls_paper, "call")
    said = tuple(f"{one.rstrip('.')}." for one in calibration_sentences(case, found))
    heading = f"{found.shown_name}: final {found.error_name} {mse} in {calls}"
    shown, tabulated = tuple(filter(None, pictures)), tuple(filter(None, tables))
    return Section(outcome.name, heading, shown, tabulated, paragraphs=said)


def _uncertainty(data: ReportData, found: Uncertainty) -> Section:
    name, case = found.calibration, data.case
    profiled = [one for one in data.profiles if one.calibration == name]
    space, said = case.parameter_space, uncertainty_sentences(found, difference_unit(case.outputs[0].unit))
    return Section(
        f"uncertainty-{name}",
        f"How sure the {name} calibration is",
        (band_figure(case, found), interval_figure(space, found), *map(profile_figure, profiled)),
        (intervals_table(space, found), *(profiles_table(space, one, found) for one in profiled)),
        paragraphs=(*said, *(line for one in profiled for line in profile_sentences(one))),
    )
