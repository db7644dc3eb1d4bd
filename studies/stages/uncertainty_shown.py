"""The uncertainty of a calibration on the terminal."""

from studies.console import Column
from studies.physical_model import warn_failed
from studies.report.uncertainty import HOW_KNOWN, sentences, uncertainty_record
from studies.report.wording import MISSING, count, percent
from studies.stages.pipeline import Outcome, Study
from studies.stages.results import read_arrays
from studies.stages.uncertainty_results import posterior_files


def show_uncertainty(study: Study, outcome: Outcome) -> None:
    """Print intervals, and what the data determine and what not."""
    found = outcome.summary
    record = uncertainty_record(found, read_arrays(posterior_files(study, found["calibration"]).arrays))
    share = percent(found["level"])
    others = f" ({count(record.n_fixed, 'parameter')} fixed)" if record.n_fixed else ""
    rows = []
    parameters = {one.name: one for one in study.case.parameter_space.parameters}
    told = zip(found["parameters"].items(), record.digits, record.interval.T, record.known, strict=True)
    for (name, one), digits, (low, high), known in told:
        parameter = parameters[name]
        rows.append(
            [
                parameter.name,
                parameter.unit,
                f"{one['calibrated']:.{digits}g}",
                f"{low:.{digits}g} to {high:.{digits}g}" if record.is_trusted else MISSING,
                f"{one['linear'][0]:.{digits}g} to {one['linear'][1]:.{digits}g}",
                f"{parameter.lower:.4g} to {parameter.upper:.4g}",
                HOW_KNOWN[known],
            ]
        )
    study.console.table(
        f"{study.label}: {share} intervals of the {found['calibration']} calibration{others}",
        [
            Column("parameter"),
            Column("unit", spare=2),
            Column("calibrated", True),
            Column(f"{share} interval", True),
            Column("linearised", True, spare=3),
            Column("bounds", True, spare=1),
            Column("by the data"),
        ],
        rows,
    )
    warn_failed(study, found)
    for sentence in sentences(record, tuple(output.unit for output in study.case.outputs)):
        study.console.result(sentence)
    if study.case.note:
        study.console.result(f"Note: {study.case.note}")
    study.console.result(f"Pictures: studies report {study.command}")
