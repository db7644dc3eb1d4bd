"""Champions in MLflow's model registry: plain files behind a loader of ours, found by an alias."""

import logging
import shutil
import tempfile
import warnings
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from studies.paths import size_name
from studies.report.wording import difference_unit
from studies.tuning.champion import CHAMPION_FILE, ChampionInfo, read_champion
from studies.tuning.study_spec import StudySpec

if TYPE_CHECKING:
    from mlflow import MlflowClient
    from mlflow.entities.model_registry import ModelVersion

ALIAS = "champion"
PREVIOUS = "previous"
_IDENTITY = "champion_sha256"
_ROOT = Path(__file__).resolve().parents[2]


def model_name(label: str, n_train: int) -> str:
    """Return the registered model's name."""
    return f"{label}-{size_name(n_train)}"


def register_champion(
    client: "MlflowClient", *, spec: StudySpec, folder: Path, run_id: str, wake: Callable[[], None]
) -> None:
    """Register the champion in a folder and point the alias to it, unless it is the one already there.

    Args:
        client: MLflow's client.
        spec: the study.
        folder: the champion's folder.
        run_id: run that keeps the model's files.
        wake: makes that run accept files.
    """
    info = read_champion(folder)
    identity = "-".join((info.study, str(info.index), info.files_sha256["weights.npz"][:16]))
    name = model_name(spec.label, spec.n_train)
    present = _version_by_alias(client, name)
    if present is not None and present.tags.get(_IDENTITY) == identity:
        return
    if not client.search_registered_models(f"name = '{name}'"):
        client.create_registered_model(
            name, description=f"Best surrogate of {spec.label}, n_train {spec.n_train}."
        )
    versions = client.search_model_versions(f"name = '{name}'")
    known = [version for version in versions if version.tags.get(_IDENTITY) == identity]
    version = known[0] if known else _create_version(client, spec, info, folder, identity, run_id, wake)
    if present is not None:
        client.set_registered_model_alias(name, PREVIOUS, present.version)
    client.set_registered_model_alias(name, ALIAS, version.version)


def _create_version(
    client: "MlflowClient",
    spec: StudySpec,
    info: ChampionInfo,
    folder: Path,
    identity: str,
    run_id: str,
    wake: Callable[[], None],
) -> "ModelVersion":
    wake()
    place = f"champion/t{info.index:03d}"
    with tempfile.TemporaryDirectory() as scratch:
        model = Path(scratch) / "model"
        _save_model(info, folder, model, Path(scratch) / "code", run_id=run_id, place=place)
        client.log_artifacts(run_id, str(model), place)
    return client.create_model_version(
        model_name(spec.label, spec.n_train),
        source=f"{client.get_run(run_id).info.artifact_uri}/{place}",
        run_id=run_id,
        tags={
            _IDENTITY: identity,
            "trial_run_id": info.run_id,
            "study_key": info.study,
            "trial": str(info.index),
            "case_sha256": info.digests["case"],
            **{metric.replace("/", "_"): f"{value:.6g}" for metric, value in info.metrics.items()},
        },
        description=_description(info, spec.search.names),
    )


def fetch_champion(
    client: "MlflowClient", *, label: str, n_train: int, artifacts: Path, folder: Path
) -> bool:
    """Copy the registered champion's files into an empty folder.

    Args:
        client: MLflow's client.
        label: label of the study.
        n_train: training-set size.
        artifacts: this project's root of all artifacts; MLflow itself only remembers where it once was.
        folder: where to put the files.

    Returns:
        Whether there is a registered champion whose files are still there.
    """
    from mlflow.artifacts import download_artifacts
    from mlflow.exceptions import MlflowException

    present = _version_by_alias(client, model_name(label, n_train))
    if present is None:
        return False
    registered = present.source or ""
    moved = artifacts / label / registered.rpartition(f"/{label}/")[2]
    source = str(moved) if moved.is_dir() else registered
    try:
        with tempfile.TemporaryDirectory() as scratch:
            copied = Path(download_artifacts(artifact_uri=source, dst_path=scratch))
            for record in copied.rglob(CHAMPION_FILE):
                shutil.copytree(record.parent, folder, dirs_exist_ok=True)
                return True
    except (MlflowException, OSError):
        logging.getLogger(__name__).warning("the files of %s are not at %s", present.name, present.source)
    return False


def _version_by_alias(client: "MlflowClient", name: str) -> "ModelVersion | None":
    from mlflow.exceptions import MlflowException

    try:
        return client.get_model_version_by_alias(name, ALIAS)
    except MlflowException:
        return None


def _save_model(
    info: ChampionInfo, folder: Path, model: Path, code: Path, *, run_id: str, place: str
) -> None:
    """Write an MLflow model: the champion's files, the code that reads them, and what they are called."""
    import numpy as np
    import pandas as pd

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # MLflow's own deprecations, at its import and below
        import mlflow.pyfunc
        from mlflow.models import Model, ModelSignature
        from mlflow.types import ColSpec, Schema, TensorSpec

    shutil.copytree(_ROOT / "pelsvae", code / "pelsvae", ignore=shutil.ignore_patterns("__pycache__"))
    (code / "studies").mkdir()
    for file in ("__init__.py", "pyfunc_loader.py"):
        shutil.copy(_ROOT / "studies" / file, code / "studies" / file)
    columns: list[ColSpec | TensorSpec] = [ColSpec("double", name) for name in info.parameter_names]
    middle = pd.DataFrame([dict(zip(info.parameter_names, _middle(info), strict=True))])
    outputs = Schema([TensorSpec(np.dtype(np.float64), (-1, -1, len(info.output_names)))])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        mlflow.pyfunc.save_model(
            model,
            loader_module="studies.pyfunc_loader",
            data_path=str(folder),
            mlflow_model=Model(artifact_path=place, run_id=run_id),
            code_paths=[str(code / "pelsvae"), str(code / "studies")],
            pip_requirements=[
                f"{package}=={_public_version(package)}" for package in ("numpy", "pandas", "torch")
            ],
            signature=ModelSignature(Schema(columns), outputs),
            input_example=middle,
            metadata={"label": info.label, "study": info.study, "output_unit": info.output_unit},
        )


def _middle(info: ChampionInfo) -> list[float]:
    return [0.5 * (low + high) for low, high in zip(info.lower, info.upper, strict=True)]


def _public_version(package: str) -> str:
    return version(package).split("+")[0]  # "2.13.0+cpu" is not to be had from every index


def _description(info: ChampionInfo, searched: Sequence[str]) -> str:
    unit = difference_unit(info.output_unit)
    errors = ", ".join(f"{name} {value:.4g} {unit}" for name, value in info.metrics.items())
    settings = ", ".join(f"{name} {info.config[name]:g}" for name in searched)
    return ". ".join(
        part for part in (f"Trial {info.index} of {info.study}", settings, errors, info.note) if part
    )
