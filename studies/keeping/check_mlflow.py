"""Does MLflow tell the same as the records, and are its files where it says."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

from simulation.errors import InputError
from studies.keeping.finding import StoreFinding, listed, ok
from studies.keeping.ghosts import is_worked_on
from studies.keeping.mlflow_repairs import (
    end_runs,
    follow_move,
    register_again,
    take_alias_away,
    write_everything,
    write_files_again,
    write_missing_stages,
    write_study,
)
from studies.keeping.mlflow_tables import (
    MlflowContent,
    RunRow,
    VersionRow,
    local_folder,
    moved_places,
    read_mlflow,
)
from studies.keeping.stage_views import stage_manifests, stage_metrics, stage_name
from studies.keeping.stores import KeptStudy, Stores
from studies.report.wording import count
from studies.tuning.champion import CHAMPION_FILE, read_champion
from studies.tuning.trial_record import TrialRecord, trial_name

STORE = "MLflow"
_STATUS = {"complete": "FINISHED", "pruned": "KILLED", "failed": "FAILED"}
NOTHING = "[0, null]"
"""What the tag `told` says of a study without a trial."""
_REMEDY = "--repair writes what is missing from the records"


def check_mlflow(stores: Stores) -> Iterator[StoreFinding]:
    """Compare every run with its record, and look for every file."""
    paths = stores.paths
    if paths.storage is None and not paths.tracking_database.is_file():
        if stores.studies:
            repair = partial(write_everything, stores)
            yield StoreFinding(STORE, "bad", "mlruns/mlflow.db", "there is none", _REMEDY, repair)
        return
    try:
        content = read_mlflow(paths)
    except InputError as error:
        remedy = "move it away, then studies doctor --repair writes it from the records"
        yield StoreFinding(STORE, "bad", paths.show(paths.tracking_database), str(error), remedy)
        return
    comparison = _Comparison(stores, content)
    found = list(comparison.findings())
    yield from found
    if not any(finding.level == "bad" for finding in found):
        n_trials = len(content.of_role("trial"))
        what = f"{count(len(content.active), 'run')}, {count(n_trials, 'trial')} as the records say"
        yield ok(STORE, "all experiments", what)


@dataclass(frozen=True)
class _Comparison:
    """What MLflow holds, beside the records."""

    stores: Stores
    content: MlflowContent

    def findings(self) -> Iterator[StoreFinding]:
        moved = moved_places(self.stores.paths, self.content)
        if moved:
            yield StoreFinding(
                STORE,
                "bad",
                ", ".join(sorted(moved)),
                "MLflow looks for files there, the project has moved since",
                "--repair tells it where they lie now",
                partial(follow_move, self.stores, moved),
            )
        yield from self._ghosts()
        for study in self.stores.studies:
            yield from self._study(study)
        yield from self._orphans()
        yield from self._stages()
        if not moved:
            yield from self._files()
        yield from self._registry(is_moved=bool(moved))

    @cached_property
    def by_trial(self) -> dict[str, list[RunRow]]:
        found: dict[str, list[RunRow]] = {}
        for run in self.content.of_role("trial"):
            found.setdefault(run.tags.get("trial_key", ""), []).append(run)
        return found

    @cached_property
    def by_study(self) -> dict[str, list[RunRow]]:
        found: dict[str, list[RunRow]] = {}
        for run in self.content.of_role("study"):
            found.setdefault(run.tags.get("study_key", ""), []).append(run)
        return found

    def _ghosts(self) -> Iterator[StoreFinding]:
        busy = {study.name for study in self.stores.studies if study.is_busy}
        ghosts = [
            run
            for run in self.content.active
            if run.status == "RUNNING" and run.role and not is_worked_on(run, busy)
        ]
        if ghosts:
            yield StoreFinding(
                STORE,
                "bad",
                listed([f"{run.label}: {run.name}" for run in ghosts]),
                "running, though nobody works on it any more",
                "--repair ends them; what they tell is completed from the records",
                partial(end_runs, self.stores, [run.run_id for run in ghosts]),
            )

    def _study(self, study: KeptStudy) -> Iterator[StoreFinding]:
        if not study.records:
            return
        wrong = list(self._differences(study))
        bad = [run.run_id for runs in self._wrong_runs(study) for run in runs]
        if wrong and study.is_busy:
            yield StoreFinding(STORE, "note", study.name, f"{wrong[0]}; it is being tuned at the moment")
        elif wrong:
            repair = partial(write_study, self.stores, study, bad)
            yield StoreFinding(STORE, "bad", study.name, "; ".join(wrong), _REMEDY, repair)

    def _differences(self, study: KeptStudy) -> Iterator[str]:
        runs = self.by_study.get(study.name, [])
        if not runs:
            yield "it has no run"
        if len(runs) > 1:
            yield f"it has {len(runs)} runs"
        missing = [record.index for record in study.records if record.key not in self.by_trial]
        if runs and missing:
            yield _named(missing, "is missing", "are missing")
        twice = [record.index for record in study.records if len(self.by_trial.get(record.key, [])) > 1]
        if twice:
            yield _named(twice, "is there twice", "are there twice")
        other = [record.index for record in study.records if self._differs(record)]
        if other:
            yield _named(other, "tells another end or error", "tell other ends or errors")
        if lost := self._recordless(study):
            names = listed(sorted({run.tags["trial_key"].rpartition("/")[2] for run in lost}))
            yield f"{names} {'has' if len(lost) == 1 else 'have'} no record"

    def _differs(self, record: TrialRecord) -> bool:
        runs = self.by_trial.get(record.key, [])
        return bool(runs) and not _agrees(runs[0], record)

    def _wrong_runs(self, study: KeptStudy) -> Iterator[Sequence[RunRow]]:
        yield self.by_study.get(study.name, [])[1:]
        for record in study.records:
            runs = self.by_trial.get(record.key, [])
            yield [run for run in runs if run.status != "RUNNING" and not _agrees(run, record)]
            yield [run for run in runs if _agrees(run, record)][1:]
        yield self._recordless(study)

    def _recordless(self, study: KeptStudy) -> list[RunRow]:
        """Return the runs of trials that the study has no record of."""
        known = {record.key for record in study.records}
        ours = [run for run in self.content.of_role("trial") if run.tags.get("study_key") == study.name]
        return [run for run in ours if run.tags.get("trial_key") not in known]

    def _orphans(self) -> Iterator[StoreFinding]:
        known = set(self.stores.by_name)
        orphans = [run for run in self.content.active if _study_of(run) and _study_of(run) not in known]
        studies = sorted({_study_of(run) for run in orphans})
        if studies:
            runs = count(len(orphans), "run")
            found = f"{runs} of studies without records" if len(studies) > 1 else f"{runs}, and no records"
            remedy = "studies gc lists and removes them; or bring the records back"
            yield StoreFinding(STORE, "note", listed(studies), found, remedy)

    def _stages(self) -> Iterator[StoreFinding]:
        told: dict[str, list[RunRow]] = {}
        for run in self.content.active:
            told.setdefault(run.tags.get("stage_key", ""), []).append(run)
        paths = self.stores.paths
        for label in sorted(folder.name for folder in (paths.mlruns / "results").glob("*")):
            manifests = stage_manifests(paths, label)
            missing = [
                file
                for file, manifest in manifests
                # Done again while MLflow was away, a stage may have come to other numbers.
                if not any(
                    stage_metrics(manifest).items() <= run.numbers.items()
                    for run in told.get(manifest["digest"], [])
                )
            ]
            if not missing:
                continue
            stages = [stage_name(paths, file).partition("/")[2] for file in missing]
            what = f"{listed(stages)} {'has no run' if len(stages) == 1 else 'have no runs'} of these results"
            repair = partial(write_missing_stages, self.stores, label)
            yield StoreFinding(STORE, "bad", label, what, _REMEDY, repair)

    def _files(self) -> Iterator[StoreFinding]:
        lost: dict[str, list[RunRow]] = {}
        for run in self.content.active:
            # Told of no trial, a study has nothing to draw yet.
            is_told = run.role in ("study", "overview") and run.tags.get("told", NOTHING) != NOTHING
            if (is_told or run.tags.get("whole") == "yes") and run.folder is not None and not _has_files(run):
                lost.setdefault(run.label, []).append(run)
        for label, runs in lost.items():
            yield StoreFinding(
                STORE,
                "bad",
                f"{label}: {listed([run.name for run in runs])}",
                "figures or numbers are gone",
                "--repair writes those of studies and calibrations again; studies report draws the report",
                partial(write_files_again, self.stores, label, [run.run_id for run in runs]),
            )

    def _registry(self, *, is_moved: bool) -> Iterator[StoreFinding]:
        paths = self.stores.paths
        alive = {run.run_id for run in self.content.active}
        for model, alias in self.content.dangling:
            found = f"the alias {alias} points at a version that is gone"
            repair = partial(take_alias_away, self.stores, model, alias)
            yield StoreFinding(STORE, "bad", model, found, _REMEDY, repair)
        for version in self.content.versions:
            if not version.aliases:
                continue
            what = f"{'/'.join(version.aliases)} (version {version.version})"
            folder = local_folder(version.source)
            gone = version.run_id not in alive
            empty = folder is not None and not is_moved and not any(folder.rglob("MLmodel"))
            if gone or empty:
                found = f"{what}: {'its run was deleted' if gone else 'its files are gone'}"
                repair = partial(register_again, self.stores, version.model, version.version)
                remedy = "--repair registers the champion again"
                yield StoreFinding(STORE, "bad", version.model, found, remedy, repair)
        by_model = {one.model: one for one in self.content.versions if "champion" in one.aliases}
        for file in sorted((paths.mlruns / "champions").glob(f"*/*/{CHAMPION_FILE}")):
            yield from self._registered(file.parent.parent.name, file.parent.name, by_model)

    def _registered(self, label: str, size: str, by_model: dict[str, VersionRow]) -> Iterator[StoreFinding]:
        folder = self.stores.paths.champions(label) / size
        try:
            told = read_champion(folder)
        except InputError:
            return
        study = self.stores.by_name.get(told.study)
        version = by_model.get(f"{label}-{size}")
        identity = f"{told.study}-{told.index}-{told.files_sha256['weights.npz'][:16]}"
        if study is None or study.is_busy or (version is not None and version.identity == identity):
            return
        found = "the champion is not registered" if version is None else "the registry has another champion"
        repair = partial(write_study, self.stores, study, [])
        yield StoreFinding(STORE, "bad", f"{label}-{size}", found, "--repair registers it", repair)


def _agrees(run: RunRow, record: TrialRecord) -> bool:
    value = record.metrics.get("val/mae")
    if value is not None and not math.isfinite(value):
        value = None
    same = run.value == value or (
        run.value is not None and value is not None and math.isclose(run.value, value, rel_tol=1e-12)
    )
    return run.status == _STATUS[record.state] and (same or value is None)


def _study_of(run: RunRow) -> str:
    return run.tags.get("study_key", "") if run.role in ("study", "trial") else ""


def _has_files(run: RunRow) -> bool:
    folder = run.folder
    if folder is None or not folder.is_dir():
        return False
    if run.role == "study" and run.status == "FINISHED":
        return any((folder / "figures").glob("*.png"))
    return any(file.is_file() for file in folder.rglob("*"))


def _named(indices: Sequence[int], one: str, several: str) -> str:
    names = listed([trial_name(index) for index in indices])
    return f"{names} {one if len(indices) == 1 else several}"
