"""The best surrogate per training-set size: a logged model of its trial's run, in MLflow's registry."""

import tempfile
import time
import warnings
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import pelsvae
from simulation.errors import InputError
from studies.paths import ProjectPaths, size_name
from studies.report.wording import difference_unit
from studies.tracking.quiet_mlflow import Metric
from studies.tracking.runs import RunStore
from studies.tuning.declaration import Declaration

if TYPE_CHECKING:
    from mlflow.entities.model_registry import ModelVersion

    from pelsvae.surrogate import Surrogate
    from studies.tuning.results import TrialView

ALIAS = "champion"
SURROGATE = "surrogate"
_TRIAL_RUN = "trial_run_id"


def model_name(label: str, n_train: int) -> str:
    """Return the registered model's name."""
    return f"{label}-{size_name(n_train)}"


def model_uri(label: str, n_train: int) -> str:
    """Return the address by which MLflow loads the best surrogate of a size."""
    return f"models:/{model_name(label, n_train)}@{ALIAS}"


def load_surrogate(
    runs: RunStore, run_id: str, *, device: Literal["auto", "cpu", "cuda"] = "cpu"
) -> "Surrogate":
    """Load the surrogate of a trial from its run.

    Raises:
        InputError: the run has no weights, or they are damaged or out of reach.
    """
    from pelsvae.surrogate import Surrogate

    with tempfile.TemporaryDirectory(prefix="studies-surrogate-") as scratch:
        folder = runs.fetch(run_id, SURROGATE, Path(scratch))
        try:
            return Surrogate.load(folder, device=device)
        except (ValueError, FileNotFoundError) as error:
            raise InputError(f"the surrogate of MLflow's run {run_id} cannot be loaded: {error}") from None


def register_best(runs: RunStore, spec: Declaration, best: "TrialView", paths: ProjectPaths) -> None:
    """Register the best trial's surrogate under the alias "champion", unless it is there already.

    Raises:
        InputError: the trial's weights are gone or out of this machine's reach.
    """
    client, name = runs.client, model_name(spec.label, spec.n_train)
    present = _champion(runs, name)
    if present is not None and present.tags.get(_TRIAL_RUN) == best.run_id:
        return
    if not client.search_registered_models(f"name = '{name}'"):
        client.create_registered_model(
            name, description=f"Best surrogate of {spec.label}, n_train {spec.n_train}."
        )
    known = [
        one
        for one in client.search_model_versions(f"name = '{name}'")
        if one.tags.get(_TRIAL_RUN) == best.run_id
    ]
    registered = known[0] if known else _logged(runs, spec, best, name)
    client.set_registered_model_alias(name, ALIAS, registered.version)


def _logged(runs: RunStore, spec: Declaration, best: "TrialView", name: str) -> "ModelVersion":
    """Log the surrogate as a model of the trial's run, and register it."""
    from mlflow.entities import LoggedModelOutput

    client = runs.client
    settings = {key: str(value) for key, value in {"n_train": spec.n_train, **best.params}.items()}
    model = client.create_logged_model(
        runs.experiment(spec.label),
        name=name,
        source_run_id=best.run_id,
        params=settings,
        tags={"study": spec.name, "trial": str(best.number)},
        model_type="PELS-VAE" if spec.surrogate != "pca-gp" else "PCA + GP",
    )
    with tempfile.TemporaryDirectory(prefix="studies-model-") as scratch:
        weights = runs.fetch(best.run_id, SURROGATE, Path(scratch))
        folder = Path(scratch) / "model"
        _save_pyfunc(spec, weights, folder, model.model_id, best.run_id)
        client.log_model_artifacts(model.model_id, str(folder))
    client.finalize_logged_model(model.model_id, "READY")
    # Once more with the model's id: MLflow's page of models shows a model's errors beside its settings.
    now = round(1000.0 * time.time())
    metrics = [Metric(key, value, now, 0, model_id=model.model_id) for key, value in best.metrics.items()]
    client.log_batch(best.run_id, metrics=metrics)
    client.log_outputs(best.run_id, [LoggedModelOutput(model.model_id, step=best.n_epochs)])
    unit = difference_unit(spec.output_unit)
    errors = ", ".join(f"{key} {value:.4g} {unit}" for key, value in best.metrics.items())
    return client.create_model_version(
        name,
        source=f"models:/{model.model_id}",
        run_id=best.run_id,
        model_id=model.model_id,
        tags={_TRIAL_RUN: best.run_id, "study": spec.name, "trial": str(best.number)},
        description=". ".join(
            part for part in (f"Trial {best.number} of {spec.name}", errors, spec.note) if part
        ),
    )


def _save_pyfunc(spec: Declaration, weights: Path, folder: Path, model_id: str, run_id: str) -> None:
    """Write an MLflow model: the weights, the loader and what the columns are called."""
    import numpy as np
    import pandas as pd

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # MLflow's own deprecations, at its import and below
        import mlflow.pyfunc
        from mlflow.models import Model, ModelSignature
        from mlflow.types import ColSpec, Schema, TensorSpec

        middle = [0.5 * (low + high) for low, high in zip(spec.lower, spec.upper, strict=True)]
        inputs: list[ColSpec | TensorSpec] = [ColSpec("double", name) for name in spec.parameter_names]
        outputs = Schema([TensorSpec(np.dtype(np.float64), (-1, -1, len(spec.output_names)))])
        mlflow.pyfunc.save_model(
            folder,
            loader_module="pelsvae.pyfunc",
            code_paths=[str(Path(pelsvae.__file__).parent)],
            data_path=str(weights),
            mlflow_model=Model(model_id=model_id, run_id=run_id),
            pip_requirements=[f"{one}=={version(one).split('+')[0]}" for one in ("numpy", "pandas", "torch")],
            signature=ModelSignature(Schema(inputs), outputs),
            input_example=pd.DataFrame([dict(zip(spec.parameter_names, middle, strict=True))]),
            metadata={"label": spec.label, "study": spec.name, "output_unit": spec.output_unit},
        )


def _champion(runs: RunStore, name: str) -> "ModelVersion | None":
    from mlflow.exceptions import MlflowException

    try:
        return runs.client.get_model_version_by_alias(name, ALIAS)
    except MlflowException:
        return None
