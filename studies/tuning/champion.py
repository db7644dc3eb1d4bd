"""The best surrogate of a study as a folder that can be copied anywhere, checked whenever it is read."""

import hashlib
import json
import shutil
import tempfile
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from simulation.errors import InputError
from studies.paths import ProjectPaths, size_name
from studies.tracking.origin import versions
from studies.tuning.study_spec import StudySpec
from studies.tuning.trial_record import SURROGATE_FOLDER, TrialRecord, replace_folder, trial_name, write_json
from studies.tuning.trial_store import named_lock, open_trials

if TYPE_CHECKING:
    from pelsvae.surrogate import Surrogate

CHAMPION_FILE = "champion.json"
WEIGHTS_FILE = "weights.npz"
DESCRIPTION_FILE = "surrogate.json"
SCHEMA = 1


@dataclass(frozen=True)
class ChampionInfo:
    """Where a surrogate comes from and how good it is.

    Args:
        schema: version of this record.
        label: label of the study.
        case_name: name of the case.
        n_train: training-set size.
        study: name of the Optuna study.
        index: trial of that study.
        run_id: MLflow run of the trial, empty without one.
        created: time of writing, UTC, ISO 8601.
        params: searched hyperparameters.
        config: all settings of the surrogate.
        seed: seed of its training.
        n_epochs: epochs trained.
        wall_s: training time. [s]
        metrics: errors by name (`val/mae`, `val/p90`, `test/mae`, `test/p90`). [output's unit]
        output_unit: unit of the errors.
        output_names: outputs predicted.
        parameter_names: parameters, in the surrogate's order.
        lower: lower bounds of the box it was trained in. Length p.
        upper: upper bounds of the box it was trained in. Length p.
        scales: "linear" or "log" per parameter. Length p.
        digests: sha256 of case, FMU and data sets.
        files_sha256: sha256 of the other files in the folder.
        versions: versions of what made it.
        note: shown wherever the numbers are shown.
    """

    schema: int
    label: str
    case_name: str
    n_train: int
    study: str
    index: int
    run_id: str
    created: str
    params: dict[str, float | int]
    config: dict[str, Any]
    seed: int
    n_epochs: int
    wall_s: float
    metrics: dict[str, float]
    output_unit: str
    output_names: tuple[str, ...]
    parameter_names: tuple[str, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    scales: tuple[str, ...]
    digests: dict[str, str]
    files_sha256: dict[str, str]
    versions: dict[str, str]
    note: str

    def to_dict(self) -> dict[str, Any]:
        """Return the record as JSON values."""
        return asdict(self)


def champion_lock(paths: ProjectPaths, label: str, n_train: int) -> AbstractContextManager[Any]:
    """Return the lock under which the champion of a size is replaced; taking it waits."""
    return named_lock(paths, f"champion/{label}/{size_name(n_train)}")


def crown(paths: ProjectPaths, spec: StudySpec, best: TrialRecord, run_id: str = "") -> bool:
    """Make a study's best surrogate the champion of its size.

    Args:
        paths: the project.
        spec: the study.
        best: its best trial.
        run_id: MLflow run of that trial.

    Returns:
        Whether its weights are there.
    """
    with (
        champion_lock(paths, spec.label, spec.n_train),
        tempfile.TemporaryDirectory(prefix="studies-champion-") as scratch,
    ):
        surrogate = Path(scratch) / trial_name(best.index) / SURROGATE_FOLDER
        surrogate.mkdir(parents=True)
        if not open_trials(paths, spec).fetch_surrogate(best.index, surrogate):
            return False
        folder = paths.champion(spec.label, spec.n_train)
        write_champion(spec, best, study_folder=Path(scratch), folder=folder, run_id=run_id)
    return True


def write_champion(
    spec: StudySpec, record: TrialRecord, *, study_folder: Path, folder: Path, run_id: str = ""
) -> bool:
    """Make a trial's surrogate the champion.

    Args:
        spec: the study.
        record: its best trial, whose weights are still there.
        study_folder: folder of the study's trials.
        folder: the champion's folder; empty for a moment while it is replaced, never half filled.
        run_id: MLflow run of the trial.

    Returns:
        Whether the champion changed.
    """
    source = study_folder / trial_name(record.index) / SURROGATE_FOLDER
    digests = {name: _sha256(source / name) for name in (WEIGHTS_FILE, DESCRIPTION_FILE)}
    try:
        present = read_champion(folder)
    except InputError:
        present = None
    if present and (present.study, present.index, present.files_sha256) == (spec.name, record.index, digests):
        return False
    info = ChampionInfo(
        schema=SCHEMA,
        label=spec.label,
        case_name=spec.case_name,
        n_train=spec.n_train,
        study=spec.name,
        index=record.index,
        run_id=run_id,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        params=record.params,
        config=record.config,
        seed=record.seed,
        n_epochs=record.n_epochs,
        wall_s=record.wall_s,
        metrics=record.metrics,
        output_unit=spec.output_unit,
        output_names=spec.output_names,
        parameter_names=spec.parameter_space.names,
        lower=tuple(spec.parameter_space.lower.tolist()),
        upper=tuple(spec.parameter_space.upper.tolist()),
        scales=tuple(parameter.scale for parameter in spec.parameter_space.parameters),
        digests=record.digests,
        files_sha256=digests,
        versions=versions(),
        note=spec.note,
    )
    scratch = folder.with_name(f".{folder.name}-new")
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.parent.mkdir(parents=True, exist_ok=True)
    shutil.copytree(source, scratch)
    write_json(scratch / CHAMPION_FILE, info.to_dict())
    replace_folder(scratch, folder)
    return True


def read_champion(folder: Path, *, case_digest: str | None = None) -> ChampionInfo:
    """Read a champion's record and check its files against it.

    Args:
        folder: the champion's folder.
        case_digest: digest of the case it is wanted for.

    Raises:
        InputError: there is none, it is damaged, or it was trained for other physics.
    """
    file = folder / CHAMPION_FILE
    if not file.is_file():
        raise InputError(f"there is no champion in {folder}; train one with `studies tune`")
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        if content.get("schema") != SCHEMA:
            raise InputError(
                f"{file} has schema {content.get('schema')}, this version reads {SCHEMA}; tune again"
            )
        info = ChampionInfo(**{f.name: _as_declared(content[f.name]) for f in fields(ChampionInfo)})
    except (ValueError, KeyError, AttributeError, UnicodeDecodeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{file} is damaged ({error}); remove {folder} and run `studies tune`") from None
    for name, expected in info.files_sha256.items():
        if not (folder / name).is_file():
            raise InputError(f"{folder} has no {name}; remove the folder and run `studies tune`")
        if _sha256(folder / name) != expected:
            raise InputError(
                f"{folder / name} is damaged (sha256 differs); remove the folder and run `studies tune`"
            )
    if case_digest is not None and info.digests.get("case") != case_digest:
        raise InputError(
            f"{folder} was trained for other physics (case {info.digests.get('case', '?')[:12]}, "
            f"now {case_digest[:12]}); run `studies tune` again"
        )
    return info


def load_champion(
    folder: Path, *, case_digest: str | None = None, device: Literal["auto", "cpu", "cuda"] = "auto"
) -> tuple["Surrogate", ChampionInfo]:
    """Read the best surrogate from its folder alone.

    Args:
        folder: the champion's folder, wherever it lies.
        case_digest: digest of the case it is wanted for.
        device: where the network is put.

    Raises:
        InputError: there is none, it is damaged, or it was trained for other physics.
    """
    from pelsvae.surrogate import Surrogate

    info = read_champion(folder, case_digest=case_digest)
    try:
        return Surrogate.load(folder, device=device), info
    except (ValueError, FileNotFoundError) as error:
        raise InputError(f"the champion in {folder} cannot be loaded: {error}") from None


def restore_champion(paths: ProjectPaths, label: str, n_train: int, fetch: Callable[[Path], bool]) -> bool:
    """Bring back a missing champion folder from a copy kept elsewhere, such as the model registry.

    Args:
        paths: the project.
        label: label of the study.
        n_train: training-set size.
        fetch: copies the files into a given empty folder; returns whether there was a copy.

    Returns:
        Whether the folder was restored.

    Raises:
        InputError: the copy is damaged.
    """
    folder = paths.champion(label, n_train)
    scratch = folder.with_name(f".{folder.name}-new")
    with champion_lock(paths, label, n_train):
        shutil.rmtree(scratch, ignore_errors=True)
        scratch.mkdir(parents=True)
        try:
            if not fetch(scratch):
                return False
            read_champion(scratch)
            replace_folder(scratch, folder)
            return True
        finally:
            shutil.rmtree(scratch, ignore_errors=True)


def _as_declared(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def _sha256(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()
