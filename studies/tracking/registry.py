"""The best surrogate per training-set size: a logged model of its trial's run, in MLflow's registry."""

import tempfile
import warnings
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import pelsvae
from simulation.errors import InputError
from simulation.foreign_text import without_pictures
from studies.report.wording import difference_unit
from studies.tracking.runs import RunStore
from studies.tuning.declaration import ALIAS, Declaration

if TYPE_CHECKING:
    from pelsvae.surrogate import Surrogate
    from studies.tuning.study_results import TrialView

SURROGATE = "surrogate"
"""Artifact of a trial's run: the weights, of trials that were the best of their study when they ended."""


def load_surrogate(runs: RunStore, run_id: str) -> "Surrogate":
    """Load the surrogate of a trial from its run.

    Raises:
        InputError: the run has no weights, or they are damaged or out of reach.
    """
    from pelsvae import surrogate_files

    with tempfile.TemporaryDirectory(prefix="studies-surrogate-") as scratch:
        folder = runs.fetch(run_id, SURROGATE, Path(scratch))
        try:
            return surrogate_files.load_surrogate(folder, device="cpu")
        except (ValueError, FileNotFoundError) as error:
            raise InputError(f"the surrogate of MLflow's run {run_id} cannot be loaded: {error}") from None


def register_best(runs: RunStore, spec: Declaration, best: "TrialView") -> None:
    """Give the best trial's surrogate the alias "champion"; it is registered where it is not yet.

    Raises:
        InputError: the trial's weights are gone or out of this machine's reach.
    """
    client, name = runs.client, spec.model_name
    known = client.search_model_versions(f"name = '{name}' and run_id = '{best.run_id}'")
    number = known[0].version if known else _register(runs, spec, best)
    if not known or ALIAS not in known[0].aliases:
        client.set_registered_model_alias(name, ALIAS, str(number))


def _register(runs: RunStore, spec: Declaration, best: "TrialView") -> int:
    """Log the surrogate as a model of the trial's run, register it, and return its version.

    Not in one call: with a name, `Model.log` prints what it has registered.
    """
    import numpy as np
    import pandas as pd

    with warnings.catch_warnings(), tempfile.TemporaryDirectory(prefix="studies-model-") as scratch:
        warnings.simplefilter("ignore")  # MLflow's own deprecations, at its import and below
        import mlflow.pyfunc
        from mlflow.models import Model, ModelSignature
        from mlflow.types import ColSpec, Schema, TensorSpec

        middle = [0.5 * (low + high) for low, high in zip(spec.lower, spec.upper, strict=True)]
        inputs: list[ColSpec | TensorSpec] = [ColSpec("double", name) for name in spec.parameter_names]
        outputs = Schema([TensorSpec(np.dtype(np.float64), (-1, -1, len(spec.output_names)))])
        mlflow.set_experiment(experiment_id=runs.experiment(spec.label))
        logged = Model.log(
            None,
            mlflow.pyfunc,
            run_id=best.run_id,
            name=spec.model_name,
            model_type="PELS-VAE" if spec.surrogate != "pca-gp" else "PCA + GP",
            tags={"study": spec.name, "trial": best.number},
            loader_module="pelsvae.pyfunc",
            code_paths=[str(Path(pelsvae.__file__).parent)],
            data_path=str(runs.fetch(best.run_id, SURROGATE, Path(scratch))),
            pip_requirements=[f"{one}=={version(one).split('+')[0]}" for one in ("numpy", "pandas", "torch")],
            signature=ModelSignature(Schema(inputs), outputs),
            input_example=pd.DataFrame([dict(zip(spec.parameter_names, middle, strict=True))]),
        )
    unit, client = difference_unit(spec.output_unit), runs.client
    errors = ", ".join(f"{key} {value:.4g} {unit}" for key, value in best.metrics.items())
    said = ". ".join(part for part in (f"Trial {best.number} of {spec.name}", errors, spec.note) if part)
    if not client.search_registered_models(f"name = '{spec.model_name}'"):
        client.create_registered_model(spec.model_name)
    made = client.create_model_version(
        spec.model_name,
        source=f"models:/{logged.model_id}",
        run_id=best.run_id,
        model_id=logged.model_id,
        description=without_pictures(said),
    )
    return int(made.version)
