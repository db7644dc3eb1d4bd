"""The best surrogate of a case as an ONNX graph that names its parameters, outputs and units."""

import json
import tempfile
from pathlib import Path

from simulation.errors import InputError
from studies.best_models import best_by_label
from studies.exports.calibrated_values import case_of
from studies.project import Project
from studies.provenance import FILE, read_provenance
from studies.stages.pipeline import read_json
from studies.stages.saved import plain
from studies.tracking.registry import load_surrogate
from studies.tracking.stage_run import run_store


def as_onnx(project: Project, n_train: int | None) -> tuple[str, bytes]:
    """Return the name and the graph of the surrogate with the least validation error.

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
    spec, best = min(
        ((one.spec, one.best) for one in tuned if one.best is not None and one.best.value is not None),
        key=lambda pair: pair[1].value or 0.0,
    )
    runs = run_store(project.paths)
    with tempfile.TemporaryDirectory(prefix="studies-onnx-") as scratch:
        record = read_json(runs.fetch(best.run_id, FILE, Path(scratch))) or {}
    made = read_provenance(record, f"MLflow's run {best.run_id}")
    case = case_of(project.paths, plain(made))
    surrogate = load_surrogate(runs, best.run_id)
    try:
        from pelsvae.onnx_file import onnx_bytes

        graph = onnx_bytes(
            surrogate,
            metadata={
                "case": case.name,
                "case_digest": case.digest,
                "study": spec.name,
                "trial": str(best.number),
                "validation_mae": repr(best.value),
                "parameters": json.dumps([[one.name, one.unit] for one in case.parameter_space.parameters]),
                "outputs": json.dumps([[one.name, one.unit] for one in case.outputs]),
                "time_s": json.dumps(case.measurement.time.tolist()),
            },
        )
    except ModuleNotFoundError as error:
        raise InputError(f"ONNX needs {error.name}: pip install 'pelsvae-studies[onnx]'") from None
    return spec.model_name, graph
