"""MLflow's runs of a project: made, written to while the work goes on, found again, and ended.

The best surrogate per training-set size is a logged model of its trial's run, in MLflow's registry. The only
module that speaks to MLflow's client.
"""

import math
import re
import tempfile
import time
import warnings
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import pelsvae
from simulation.errors import InputError
from simulation.file_lock import FileLock
from simulation.foreign_text import without_pictures
from simulation.record_file import read_json, with_checksum
from simulation.write_gate import check_written
from studies.paths import ProjectPaths, folder_name, opening
from studies.results.declaration import ALIAS, UNEXPLAINED, Declaration
from studies.results.provenance import FILE
from studies.search_space import is_own
from studies.tracking.foreign_store import SCHEME, check_store
from studies.tracking.origin import origin_tags
from studies.tracking.quiet_mlflow import (
    LocalArtifactRepository,
    connect,
    entities,
    get_artifact_repository,
    make_database,
    mlflow,
    storing_files,
)
from studies.tracking.sending import begin_sending
from studies.tracking.shared_names import PROJECT, own_experiment
from studies.tracking.study_tags import NOTE, TRACKING, with_line
from studies.words.wording import difference_unit, setting

if TYPE_CHECKING:
    from pelsvae.mean_surrogate import MeanSurrogate
    from pelsvae.surrogate import Surrogate
    from studies.own_surrogate import OwnSurrogate
    from studies.results.trials import TrialView
    from studies.task import Task


Run: TypeAlias = entities.Run
RunStatus = Literal["FINISHED", "FAILED", "KILLED", "RUNNING"]
CURVE, VALIDATION_MAE = "curve/", "validation_mae"
_REFUSED = re.compile(r"[^/\w.\- :]")


class RunStore:
    """The runs of one project.

    Args:
        paths: the project.

    Raises:
        InputError: MLflow cannot use the store, or it names places outside the project.
        MachineError: the store does not answer, or its disk is full.
    """

    def __init__(self, paths: ProjectPaths) -> None:
        self.paths = paths
        check_written(paths.artifacts)
        self._artifacts = paths.artifacts.resolve()
        self._artifacts.mkdir(parents=True, exist_ok=True)
        with opening(paths, "MLflow", paths.tracking_database):
            if paths.storage is None:
                if paths.tracking_database.is_file():
                    check_store(paths.tracking_database)
                else:
                    make_database(paths.tracking_database)
            self.client = connect(paths.tracking_uri)
        self._origin = origin_tags()
        self._experiments: dict[str, str] = {}
        self._identity = paths.identity
        self._marks = {PROJECT: self._identity} if self._identity else {}
        self._marks |= {TRACKING: paths.server.uri} if paths.server is not None else {}

    def experiment(self, label: str) -> str:
        """Return the id of a label's experiment, a new one where there is none."""
        if label not in self._experiments:
            # On a server there is no file that artifacts could lie beside: they lie in this project's folder.
            folder = folder_name(label)
            lies_beside = self.paths.storage is None
            location = f"{SCHEME}:/{folder}" if lies_beside else (self._artifacts / folder).as_uri()
            with FileLock(self.paths.mlruns / ".mlflow.lock"):
                self._experiments[label] = own_experiment(self.client, label, self._identity, location)
        return self._experiments[label]

    def describe(self, label: str, lead: str, line: str, usual: str) -> None:
        """Bring our line in the text at the head of a label's page up to date, see `with_line`."""
        experiment = self.client.get_experiment(self.experiment(label))
        note = with_line(experiment.tags.get(NOTE, ""), lead, line, usual)
        self.client.set_experiment_tag(experiment.experiment_id, NOTE, note)

    def find(self, label: str, tags: Mapping[str, str], *, status: RunStatus | None = None) -> list[Run]:
        """Return the runs of an experiment that have all of some tags, the earliest first."""
        wanted = [f"tags.`{name}` = '{value}'" for name, value in tags.items()]
        wanted += [f"attributes.status = '{status}'"] if status else []
        where, order = [self.experiment(label)], ["attributes.start_time ASC"]
        query = " and ".join(wanted)
        found: list[Run] = []
        page: str | None = ""
        while page is not None:
            part = self.client.search_runs(where, query, order_by=order, page_token=page or None)
            # Another project may have runs in an experiment that has no owner.
            found += [one for one in part if one.data.tags.get(PROJECT, self._identity) == self._identity]
            page = part.token or None
        return found

    def begin(self, label: str, name: str, tags: Mapping[str, Any], *, start_s: float | None = None) -> str:
        """Make a run, and return its id."""
        start = None if start_s is None else round(1000.0 * start_s)
        said = {
            **self._origin,
            **self._marks,
            "label": label,
            **{key: str(value) for key, value in tags.items()},
        }
        said |= {NOTE: without_pictures(said[NOTE])} if NOTE in said else {}
        run = self.client.create_run(self.experiment(label), start_time=start, run_name=name, tags=said)
        return str(run.info.run_id)

    def open_again(self, run_id: str) -> None:
        """Open a run that has ended; from now on it is also sent to the server that the project has."""
        self.client.update_run(run_id, status="RUNNING")
        self.log(run_id, tags=self._marks)

    def is_there(self, run_id: str) -> bool:
        """Whether a run exists and was not deleted, as its owner may in MLflow."""
        try:
            return bool(self.client.get_run(run_id).info.lifecycle_stage == "active")
        except mlflow.MlflowException as error:
            if error.error_code != "RESOURCE_DOES_NOT_EXIST":
                raise
            return False

    def has(self, run_id: str, name: str) -> bool:
        """Whether a run has an artifact of a name."""
        return any(one.path == name for one in self.client.list_artifacts(run_id))

    def champion(self, name: str) -> "entities.model_registry.ModelVersion | None":
        """Return the version of a model that has the alias, None where there is none."""
        try:
            return self.client.get_model_version_by_alias(name, ALIAS)
        except mlflow.MlflowException as error:
            if error.error_code not in ("RESOURCE_DOES_NOT_EXIST", "INVALID_PARAMETER_VALUE"):
                raise
            return None

    def log(
        self,
        run_id: str,
        *,
        params: Mapping[str, Any] | None = None,
        metrics: Mapping[str, float] | None = None,
        tags: Mapping[str, Any] | None = None,
    ) -> None:
        """Write settings, results and tags of a run; a metric that is no finite number is left out."""
        now = round(1000.0 * time.time())
        finite = {name: float(value) for name, value in (metrics or {}).items() if math.isfinite(value)}
        results = [entities.Metric(name, value, now, 0) for name, value in finite.items()]
        settings = [entities.Param(name, str(value)[:6000]) for name, value in (params or {}).items()]
        marks = [entities.RunTag(name, str(value)) for name, value in (tags or {}).items()]
        self.client.log_batch(run_id, metrics=results, params=settings, tags=marks)

    def log_files(self, run_id: str, files: Iterable[Path], folder: str | None = None) -> None:
        """Copy files among a run's artifacts.

        Raises:
            MachineError: the store of artifacts refuses.
        """
        with storing_files(run_id):
            for file in files:
                self.client.log_artifact(run_id, str(file), folder)

    def log_record(self, run_id: str, record: Mapping[str, Any]) -> None:
        """Write what makes a run's result again among its artifacts.

        Raises:
            MachineError: the store of artifacts refuses.
        """
        with storing_files(run_id):
            self.client.log_dict(run_id, with_checksum(record), FILE)

    def fetch(self, run_id: str, name: str, folder: Path) -> Path:
        """Return where an artifact of a run lies, which is a copy in a folder if it is not on this disk.

        Raises:
            InputError: the run has none of that name, or it is out of this machine's reach.
        """
        try:
            place = self.client.get_run(run_id).info.artifact_uri
            files = get_artifact_repository(place, tracking_uri=self.paths.tracking_uri)
            if isinstance(files, LocalArtifactRepository):
                here = Path(files.artifact_dir) / name
                here.stat()
                return here
            return Path(files.download_artifacts(name, str(folder)))
        except (mlflow.MlflowException, OSError) as error:
            line = next(iter(str(error).splitlines()), "")
            raise InputError(f"MLflow's run {run_id} has no {name} that can be read here ({line})") from None

    def record(self, run_id: str, folder: Path) -> dict[str, Any]:
        """Return what makes a run's result again, as JSON values; see `fetch`.

        Raises:
            InputError: the run has none that can be read here, or it is damaged.
        """
        remedy = f"restore it from a copy, or take another run than {run_id}"
        return read_json(self.fetch(run_id, FILE, folder), remedy) or {}

    def end(self, run_id: str, status: RunStatus, *, end_s: float | None = None) -> None:
        """End a run."""
        self.client.set_terminated(run_id, status, None if end_s is None else round(1000.0 * end_s))


_opened = lru_cache(maxsize=4)(RunStore)


def run_store(paths: ProjectPaths) -> RunStore:
    """Return the runs of a project; opening them costs MLflow's import, so it is done once per process.

    A command that asks for it sends them to the project's server from now on.
    """
    store = _opened(paths)
    begin_sending(paths)
    return store


def log_stage(
    task: "Task",
    kind: str,
    name: str,
    *,
    key: str,
    wall_s: float,
    note: str = "",
    params: Mapping[str, Any] | None = None,
    metrics: Mapping[str, float | None] | None = None,
    curves: Mapping[str, Iterable[tuple[int, float]]] | None = None,
    tags: Mapping[str, Any] | None = None,
    figures: Sequence[Path] = (),
    artifacts: Sequence[Path] = (),
    record: Mapping[str, Any] | None = None,
) -> str:
    """Write a stage that has just ended as a run of its own, unless it is there with the same numbers.

    A run that a killed command left unfinished is ended as KILLED.

    Args:
        task: the task; its label is MLflow's experiment.
        kind: what it is, for example "calibration" or "sensitivity".
        name: name a user reads, for example "n0064 calibration".
        key: digest of the stage's inputs; a stage logged before with the same key and metrics is not logged
            again.
        wall_s: its duration. [s]
        note: Markdown, shown on the run's page; "" for that of the case.
        params: settings.
        metrics: results, one number each; what is no finite number is left out.
        curves: results over steps: pairs of step and value, for example the best MSE over model calls.
        tags: what to search for beside the case.
        figures: image files.
        artifacts: other files.
        record: what makes it again, kept as `provenance.json`; nothing where nothing does.

    Returns:
        The id of its run.
    """
    runs, now_s, case = run_store(task.paths), time.time(), task.case
    numbers = {metric_name(k): v for k, v in (metrics or {}).items() if v is not None and math.isfinite(v)}
    for run in runs.find(task.label, {"stage_key": key, "role": kind}):
        if run.info.status == "FINISHED" and all(run.data.metrics.get(k) == v for k, v in numbers.items()):
            return str(run.info.run_id)
        if run.info.status == "RUNNING":
            runs.end(run.info.run_id, "KILLED")
    about = {"role": kind, "stage_key": key, "case": case.name, "case_sha256": case.digest}
    about |= {NOTE: note or case.note, **(tags or {})}
    run_id = runs.begin(task.label, name, about, start_s=now_s - wall_s)
    runs.log(run_id, params=params, metrics=numbers)
    points = [
        entities.Metric(metric_name(curve), value, round(1000.0 * now_s), step)
        for curve, along in (curves or {}).items()
        for step, value in along
    ]
    runs.client.log_batch(run_id, points)
    runs.log_files(run_id, figures, "figures")
    runs.log_files(run_id, artifacts)
    if record:
        runs.log_record(run_id, record)
    runs.end(run_id, "FINISHED", end_s=now_s)
    return run_id


def metric_name(name: str) -> str:
    """Return a metric's name without the signs that MLflow refuses: `wall[1].R` becomes `wall_1_.R`."""
    return _REFUSED.sub("_", name)


SURROGATE = "surrogate"
"""Artifact of a trial's run: the weights, of trials that were among the best when they ended."""


def load_surrogate(runs: RunStore, run_id: str) -> "Surrogate | MeanSurrogate | OwnSurrogate":
    """Load the surrogate of a trial, or a mean of several, from its run.

    Raises:
        InputError: the run has no weights, or they are damaged or out of reach.
    """
    from pelsvae import surrogate_files
    from studies.own_surrogate import holds_own, load_own

    with tempfile.TemporaryDirectory(prefix="studies-surrogate-") as scratch:
        folder = runs.fetch(run_id, SURROGATE, Path(scratch))
        try:
            if holds_own(folder):
                return load_own(folder)
            return surrogate_files.load_surrogate(folder, device="cpu")
        except (ValueError, FileNotFoundError) as error:
            raise InputError(f"the surrogate of MLflow's run {run_id} cannot be loaded: {error}") from None


def register_best(runs: RunStore, best: "TrialView") -> int:
    """Give the best trial's surrogate the alias "champion"; it is registered where it is not yet.

    Returns:
        Its version.

    Raises:
        InputError: the trial's weights are gone or out of this machine's reach.
    """
    client, spec, name = runs.client, best.spec, best.spec.model_name
    known = client.search_model_versions(f"name = '{name}' and run_id = '{best.run_id}'")
    number = known[0].version if known else _register(runs, spec, best)
    if not known or ALIAS not in known[0].aliases:
        client.set_registered_model_alias(name, ALIAS, str(number))
    return int(number)


def _register(runs: RunStore, spec: Declaration, best: "TrialView") -> int:
    """Log the surrogate as a model of the trial's run, register it, and return its version.

    MLflow's function for this knows the store and the experiment of the process alone.
    """
    import numpy as np
    import pandas as pd

    from studies.own_surrogate import holds_own

    unit, client = difference_unit(spec.output_unit), runs.client
    usual = "PCA + GP" if spec.surrogate == "pca-gp" else "PELS-VAE"
    kind = "mean" if best.parts else spec.surrogate if is_own(spec.surrogate) else usual
    about = {"study": spec.name, "trial": str(best.number), "model": best.model}
    with warnings.catch_warnings(), tempfile.TemporaryDirectory(prefix="studies-model-") as scratch:
        warnings.simplefilter("ignore")  # MLflow's own deprecations, at its import and below
        from mlflow.models import Model, ModelSignature
        from mlflow.pyfunc import save_model
        from mlflow.types import ColSpec, Schema, TensorSpec
        from mlflow.types.schema import AnyType

        middle = [0.5 * (low + high) for low, high in zip(spec.lower, spec.upper, strict=True)]
        # As "double" MLflow refuses whole numbers, before the surrogate could take them.
        inputs: list[ColSpec | TensorSpec] = [ColSpec(AnyType(), name) for name in spec.parameter_names]
        outputs = Schema([TensorSpec(np.dtype(np.float64), (-1, -1, len(spec.output_names)))])
        weights = runs.fetch(best.run_id, SURROGATE, Path(scratch))
        # The network of states is solved by numba.
        kinds = "".join(file.read_text(encoding="utf-8") for file in sorted(weights.rglob("*.json")))
        packages = ("numpy", "pandas", "torch", *(["numba"] if '"state-space"' in kinds else []))
        needed = [f"{one}=={version(one).split('+')[0]}" for one in packages]
        params, experiment = client.get_run(best.run_id).data.params, runs.experiment(spec.label)
        made = client.create_logged_model(experiment, spec.model_name, best.run_id, about, params, kind)
        place, folder = made.artifact_location, Path(scratch) / "model"
        model = Model(place, best.run_id, model_uuid=made.model_id, model_id=made.model_id)
        save_model(
            folder,
            mlflow_model=model,
            loader_module="studies.own_surrogate" if holds_own(weights) else "pelsvae.pyfunc",
            code_paths=[str(Path(pelsvae.__file__).parent)],
            data_path=str(weights),
            pip_requirements=needed,
            signature=ModelSignature(Schema(inputs), outputs),
            input_example=pd.DataFrame([dict(zip(spec.parameter_names, middle, strict=True))]),
        )
        with storing_files(best.run_id):
            client.log_model_artifacts(made.model_id, str(folder))
    client.finalize_logged_model(made.model_id, "READY")
    client.log_outputs(best.run_id, [entities.LoggedModelOutput(made.model_id, step=0)])
    errors = ", ".join(
        f"{key} {value:.4g} {'' if key.endswith(UNEXPLAINED) else unit}".strip()
        for key, value in best.metrics.items()
    )
    which = f"{best.model[:1].upper()}{best.model[1:]} of {spec.name}"
    chosen = ", ".join(f"{name} {setting(value)}" for name, value in best.params.items())
    said = ". ".join(filter(None, (which, errors, chosen, spec.note)))
    if not client.search_registered_models(f"name = '{spec.model_name}'"):
        client.create_registered_model(spec.model_name)
    # By place: to follow the model's id, MLflow looks into the store of the process.
    registered = client.create_model_version(
        spec.model_name,
        source=place,
        run_id=best.run_id,
        tags={name: str(value) for name, value in {**best.params, **best.metrics}.items()},
        description=without_pictures(said),
    )
    return int(registered.version)
