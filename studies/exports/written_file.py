"""The file that `studies best --write` leaves: its formats, its name, and that nothing is overwritten."""

import errno
import json
import os
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from simulation.errors import InputError
from simulation.foreign_text import quoted
from simulation.whole_file import whole_file
from studies.exports.calibrated_values import (
    CalibratedValues,
    as_csv,
    as_fmu,
    as_json,
    as_modelica,
    as_ssv,
    calibrated_values,
    values_of,
)
from studies.own_surrogate import OwnSurrogate
from studies.paths import ProjectPaths, folder_name
from studies.project import FinishedCalibration, Project, best_by_label, changed_files
from studies.results.provenance import case_of, read_provenance
from studies.results.trials import TrialView
from studies.tracking.runs import load_surrogate, run_store
from studies.words.wording import listed

OF_VALUES: dict[str, Callable[[CalibratedValues], bytes]] = {
    "ssv": as_ssv,
    "modelica": as_modelica,
    "csv": as_csv,
    "json": as_json,
    "fmu": as_fmu,
}
"""What a file of calibrated values holds, by its format."""
FORMATS = (*OF_VALUES, "onnx")
ENDINGS = {"modelica": ".mo"}
"""Endings of files that are not called as the format."""


def write_best(
    project: Project, words: Sequence[str], n_train: int | None, experiment: str | None
) -> tuple[Path, str]:
    """Write the best calibration, or the best surrogate, to a new file.

    Args:
        project: What the project holds of a case.
        words: The format and, if it is said, the file; otherwise the case names it, in the working folder.
        n_train: Training-set size of the surrogate; None for all.
        experiment: Which experiment's values; None where the case has none.

    Returns:
        The file, and what was changed since its content was made, in one line; "" for nothing.

    Raises:
        InputError: The format is unknown, the file exists, or there is nothing that can be written.
    """
    kind, *files = words
    if kind not in FORMATS or len(files) > 1:
        raise InputError(
            f"--write {quoted(' '.join(words))}: give one of {', '.join(FORMATS)}, then at most one file"
        )
    # Before the work, which may take seconds.
    if files:
        _refuse_existing(Path(files[0]))
    if kind == "onnx":
        name, content, stale = as_onnx(project, n_train)
    else:
        found = calibrated_values(project, experiment)
        name, content, stale = f"{found.case.name}-calibrated", OF_VALUES[kind](found), found.stale
    file = Path(files[0] if files else f"{folder_name(name)}{ENDINGS.get(kind, f'.{kind}')}")
    _write_new(file, content)
    return file, stale


def write_values(
    paths: ProjectPaths, finished: FinishedCalibration, file: Path, experiment: str | None
) -> Path:
    """Write the values of a calibration to a new file, in the format of its ending.

    Args:
        paths: Its project.
        finished: The calibration.
        file: The file.
        experiment: Which experiment's values; None where the case has none.

    Raises:
        InputError: The file exists, or its ending is that of no format.
    """
    formats = {ENDINGS.get(kind, f".{kind}"): write for kind, write in OF_VALUES.items()}
    if file.suffix not in formats:
        raise InputError(f"{file}: the ending says the format; give one of {', '.join(formats)}")
    _refuse_existing(file)
    _write_new(file, formats[file.suffix](values_of(paths, finished, experiment)))
    return file


def _write_new(file: Path, content: bytes) -> None:
    _refuse_existing(file)
    try:
        with whole_file(file) as stream:
            stream.write(content)
    except OSError as error:
        if error.errno == errno.ENOSPC:  # a fault of the machine
            raise
        raise InputError(f"{file}: cannot be written ({error.strerror}); name another file") from None


def _refuse_existing(file: Path) -> None:
    if os.path.lexists(file):
        raise InputError(f"{file} exists; name another file after the format, or remove it")


def decoders_of(best: TrialView) -> set[str]:
    """Return the decoders of a trial's surrogate, or of all parts of a mean."""
    return {one.decoder for one in best.parts} or {best.settings.decoder}


def as_onnx(project: Project, n_train: int | None) -> tuple[str, bytes, str]:
    """Return the name and the graph of the surrogate of least validation error, and what was changed since.

    Args:
        project: What the project holds of a case.
        n_train: Its training-set size; None for all.

    Raises:
        InputError: There is none, there are several cases, the case or the weights are not as they were, or
            a package is missing.
    """
    found = [one for of_label in best_by_label(project).values() for one in of_label]
    tuned = [one for one in found if n_train in (None, one.spec.n_train)]
    cases = sorted({one.spec.case_name for one in tuned})
    if not tuned and found:
        there = ", ".join(str(one) for one in sorted({one.spec.n_train for one in found}))
        raise InputError(f"nothing was tuned with n_train = {n_train}, there are {there}; correct --n-train")
    if len(cases) != 1:
        remedy = f"name one of: {', '.join(cases)}" if cases else "type studies tune first"
        raise InputError(f"--write onnx needs one case with a surrogate; {remedy}")
    complete = [one.best for one in tuned if one.best is not None and one.best.value is not None]
    # Its states are solved by compiled loops, which no ONNX operator is.
    writable = [best for best in complete if {"layers"} == decoders_of(best)]
    if not writable:
        raise InputError(
            "a state-space decoder has no ONNX form, nor has a mean with one; "
            f"type: studies tune {cases[0]} --surrogate refined"
        )
    best = min(writable, key=lambda one: one.value or 0.0)
    spec = best.spec
    runs = run_store(project.paths)
    with tempfile.TemporaryDirectory(prefix="studies-onnx-") as scratch:
        record = runs.record(best.run_id, Path(scratch))
    made = read_provenance(record, f"MLflow's run {best.run_id}")
    case = case_of(project.paths, made, exactly=False)
    surrogate = load_surrogate(runs, best.run_id)
    assert not isinstance(surrogate, OwnSurrogate), "it decodes by layers"
    try:
        from pelsvae.onnx_file import onnx_bytes

        graph = onnx_bytes(
            surrogate,
            metadata={
                "case": case.name,
                "case_digest": case.digest,
                "study": spec.name,
                "trial": str(best.number),
                "model": best.model,
                "validation_mae": repr(best.value),
                "parameters": json.dumps([[one.name, one.unit] for one in case.parameter_space.parameters]),
                "outputs": json.dumps([[one.name, one.unit] for one in case.outputs]),
                "time_s": json.dumps(case.measurement.time.tolist()),
            },
        )
    except ModuleNotFoundError as error:
        raise InputError(f"ONNX needs {error.name}: pip install 'pelsvae-studies[onnx]'") from None
    changed = changed_files(project.paths, record)
    stale = f"made before {listed(changed)} changed; to make it anew: {made.command}" * bool(changed)
    return spec.model_name, graph, stale
