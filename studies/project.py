"""What a project holds, and what `studies best` and `studies status` show of it."""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase
from functools import cached_property
from typing import Any

from simulation.errors import InputError
from studies.blocks import Block, Column, Table, number
from studies.paths import ProjectPaths
from studies.reporting.sentences import mean_sentences
from studies.reporting.tables import tuning_table
from studies.reporting.tables_objective import best_blocks_of, objectives_table
from studies.results.declaration import ALIAS
from studies.results.objective import TunedObjective
from studies.results.outcome import Outcome, read_outcome
from studies.results.saved import plain
from studies.results.stage_results import Calibration, TunedSize
from studies.results.trials import TunedStudy
from studies.tracking.sent_runs import sent_runs
from studies.tuning.objective_results import read_objectives
from studies.tuning.study_results import joined_studies, latest_studies, read_studies
from studies.words.console import format_seconds
from studies.words.wording import (
    MISSING,
    count,
    listed,
    quantity,
    setting,
    shown_unit,
    significant,
    square_of,
)

FIRST_WORDS = "type: studies run (the office, some minutes), or studies new for a case of your own"


@dataclass(frozen=True)
class FinishedCalibration:
    """A finished calibration of a project.

    Args:
        label: label of its study.
        outcome: what it came to.
        changed_since: files that it was made from and that hold something else now.
    """

    label: str
    outcome: Outcome[Calibration]
    changed_since: Sequence[str]

    @classmethod
    def of(cls, paths: ProjectPaths, label: str, outcome: Outcome[Calibration]) -> "FinishedCalibration":
        """Return it with the files that hold something else now."""
        return cls(label, outcome, changed_files(paths, outcome.provenance))

    @property
    def found(self) -> Calibration:
        """Its result."""
        return self.outcome.result

    @property
    def name(self) -> str:
        """What it is called on a command line."""
        return f"{self.label}/{self.outcome.name}"

    @property
    def mse_text(self) -> str:
        """Its error with the unit; "failed" where the last simulation failed."""
        if not math.isfinite(self.found.mse):
            return "failed"
        return quantity(self.found.mse, square_of(self.found.output_unit), 4)

    def to_dict(self) -> dict[str, Any]:
        """Return what programs read."""
        about = {"label": self.label, "name": self.name, "finished": self.outcome.finished}
        return {**about, "changed_since": list(self.changed_since), **plain(self.found)}


def changed_files(paths: ProjectPaths, provenance: Mapping[str, Any]) -> list[str]:
    """Return the names of the files of a record that hold something else now.

    Of a file that is not there, as after an import of results, nothing is known.

    Args:
        paths: the project.
        provenance: what made a result, as it was recorded.
    """
    from studies.results.provenance import file_digest

    files, changed = provenance.get("files"), []
    places = files if isinstance(files, dict) else {}
    # Data of a case whose folder the project has are never those of an embedded case.
    is_own = any(paths.has_case_folder(place) for place in places)
    for place, sha256 in places.items():
        with suppress(OSError):
            file = paths.located(place)
            if file is None or (is_own and not file.is_relative_to(paths.root)):
                continue
            changed += [file.name] if file_digest(file) != sha256 else []
    return list(dict.fromkeys(changed))


@dataclass(frozen=True)
class Project:
    """The studies and calibrations of a project.

    Args:
        paths: where everything lies.
        studies: its Optuna studies.
        calibrations: its finished calibrations.
        objectives: studies of its user's objectives.
    """

    paths: ProjectPaths
    studies: Sequence[TunedStudy]
    calibrations: Sequence[FinishedCalibration]
    objectives: Sequence[TunedObjective] = ()

    @cached_property
    def sizes(self) -> list[TunedSize]:
        """What each size was tuned to; studies of other data stand apart."""
        found = joined_studies(self.studies)
        found.sort(key=lambda one: (one.spec.label, one.spec.n_train, one.spec.is_baseline, one.number))
        return [one.summary(self.studies) for one in found]


def read_project(paths: ProjectPaths, which: str | None = None) -> Project:
    """Read what a project holds.

    Args:
        paths: the project.
        which: a case, a label or a pattern of labels; None for everything.

    Raises:
        InputError: nothing is called so.
    """
    files = sorted((paths.mlruns / "results").glob("*/calibrate-*.json"))
    outcomes = [(file.parent.name, read_outcome(file.parent, file.stem, Calibration)) for file in files]
    calibrations = [FinishedCalibration.of(paths, label, one) for label, one in outcomes if one is not None]
    studies, objectives = read_studies(paths), read_objectives(paths)
    if which is None:
        return Project(paths, studies, calibrations, objectives)
    cases = {one.spec.label: one.spec.case_name for one in studies}
    cases |= {one.label: one.found.case for one in calibrations}
    cases |= {one.spec.label: "" for one in objectives}
    labels = {label for label, case in cases.items() if fnmatchcase(label, which) or case == which}
    if not labels:
        raise InputError(f"nothing is called {which!r}; labels: {', '.join(sorted(cases)) or 'none'}")
    studies = [one for one in studies if one.spec.label in labels]
    objectives = [one for one in objectives if one.spec.label in labels]
    return Project(paths, studies, [one for one in calibrations if one.label in labels], objectives)


def best_blocks(project: Project) -> list[Block]:
    """Return what a person sees."""
    blocks: list[Block] = []
    for label, found in best_by_label(project).items():
        table = tuning_table([one.summary(project.studies) for one in found])
        blocks += [label, *([table] if table else [])]
        blocks += mean_sentences([one.summary(project.studies) for one in found])
        blocks += [*_how_to_load(project, found), ""]
    for objective in latest_objectives(project):
        blocks += best_blocks_of(objective, project.paths.optuna_url)
    for calibration in best_calibrations(project):
        blocks += _calibration(calibration)
    return blocks or [f"No completed trial and no calibration yet; {FIRST_WORDS}"]


def best_document(project: Project) -> dict[str, Any]:
    """Return what a program reads: where Optuna and MLflow keep everything, and the best of each size."""
    best = [one for found in best_by_label(project).values() for one in found]
    stores = [_store_of(project, one) for one in best]
    sizes = [asdict(one.summary(project.studies)) for one in best]
    # Where all of them are, if they are in one place.
    one_place = stores[0].uri if len({one.uri for one in stores}) == 1 else project.paths.tracking_uri
    return {
        "command": "best",
        "optuna_storage": project.paths.optuna_url,
        "mlflow_tracking_uri": one_place,
        "sizes": [
            {**size, "run_id": store.run_id, "model_uri": store.model_uri, "tracking_uri": store.uri}
            for size, store in zip(sizes, stores, strict=True)
        ],
        "calibrations": [one.to_dict() for one in best_calibrations(project)],
        "objectives": [one.to_dict() for one in latest_objectives(project)],
    }


def latest_objectives(project: Project) -> list[TunedObjective]:
    """Return the latest study of each objective's name that has a best trial."""
    return [*{one.spec.label: one for one in project.objectives if one.best}.values()]


def best_by_label(project: Project) -> dict[str, list[TunedStudy]]:
    """Return what each size with a best trial was tuned with last; the label used last comes first."""
    tuned = [one for one in project.studies if not one.spec.is_baseline and one.best is not None]
    found = {}
    for label in dict.fromkeys(one.spec.label for one in sorted(tuned, key=lambda one: -one.number)):
        latest = latest_studies([one for one in tuned if one.spec.label == label])
        found[label] = [latest[key] for key in sorted(latest)]
    return found


def _how_to_load(project: Project, found: Sequence[TunedStudy]) -> list[Block]:
    best_study = min(found, key=lambda study: study.best.value or math.inf if study.best else math.inf)
    spec = best_study.spec if best_study.best is None else best_study.best.spec
    storage, store = project.paths.optuna_url, _store_of(project, best_study)
    lines = [
        "In Python:",
        f'  optuna.load_study(study_name="{spec.name}", storage="{storage}")',
    ]
    if store.model_uri is not None:
        lines += [
            f'  mlflow.set_tracking_uri("{store.uri}")',
            f'  mlflow.pyfunc.load_model("{store.model_uri}").predict(theta)',
        ]
    return [*lines]


@dataclass(frozen=True)
class _Store:
    """Where the run and the model of a study's best trial are: on the server, or in the project alone."""

    uri: str
    run_id: str
    model_uri: str | None


def _store_of(project: Project, study: TunedStudy) -> _Store:
    paths, spec, best = project.paths, study.spec, study.best
    run_id, sent = "" if best is None else best.run_id, sent_runs(paths)
    model = {} if sent is None else sent.models.get(spec.model_name, {})
    if sent is None or model.get("run") != run_id or not sent.id_of(run_id):
        return _Store(paths.tracking_uri, run_id, study.model_uri)
    which = f"/{model['version']}" if "version" in model else f"@{ALIAS}"  # none was noted before
    return _Store(sent.uri, sent.id_of(run_id), f"models:/{model['name']}{which}")


def best_calibrations(project: Project) -> list[FinishedCalibration]:
    """Return each case's calibration of least error on its latest data.

    One whose files are as they were comes before all others, whatever the clock said when these were made:
    a clock may be wrong, a digest is not. The cases follow in the same order.
    """
    by_case: dict[str, list[FinishedCalibration]] = {}
    good = [one for one in project.calibrations if math.isfinite(one.found.mse)]
    good.sort(key=lambda one: one.outcome.finished, reverse=True)
    for one in sorted(good, key=lambda one: bool(one.changed_since)):
        same = by_case.setdefault(one.found.case, [])
        if not same or _data(one) == _data(same[0]):
            same.append(one)
    return [min(same, key=lambda one: (bool(one.changed_since), one.found.mse)) for same in by_case.values()]


def _data(one: FinishedCalibration) -> list[object]:
    return [one.outcome.inputs.get(name) for name in ("case", "measurement")]


def _calibration(one: FinishedCalibration) -> list[Block]:
    found = one.found
    how = count(found.n_calls_paper, "model call")
    how += " in the paper's count" if found.n_calls_paper != found.n_calls else ""
    how += f", begun with {count(found.n_warm_start, 'stored simulation')}" if found.n_warm_start else ""
    rows = [[k, shown_unit(found.units.get(k, "")), f"{value:.6g}"] for k, value in found.theta.items()]
    columns = [Column("parameter"), Column("unit"), Column("calibrated", True)]
    return [
        f"{found.case}: best calibration: {found.error_name} {one.mse_text}, {how}",
        *([f"made before {listed(one.changed_since)} changed"] if one.changed_since else []),
        Table(one.name, columns, rows),
    ]


def status_blocks(project: Project) -> list[Block]:
    """Return what a person sees."""
    blocks: list[Block] = []
    tuned = [one for one in project.sizes if not one.is_baseline]
    if tuned:
        blocks.append(_studies(tuned))
    if project.objectives:
        blocks.append(objectives_table(project.objectives))
    if project.calibrations:
        blocks.append(_calibrations(project.calibrations))
    return blocks or [f"Nothing in {project.paths.root} yet; {FIRST_WORDS}"]


def status_document(project: Project) -> dict[str, Any]:
    """Return what a program reads."""
    return {
        "command": "status",
        "studies": [asdict(one) for one in project.sizes],
        "calibrations": [one.to_dict() for one in project.calibrations],
        "objectives": [one.to_dict() for one in project.objectives],
    }


def _studies(tuned: Sequence[TunedSize]) -> Table:
    names = list(dict.fromkeys(name for one in tuned for name in one.params))
    units = {one.unit for one in tuned}
    alike = [(one.label, one.n_train) for one in tuned]
    columns = [
        Column("study"),
        Column("model", spare=6),
        number("trials"),
        *([number("carried over", spare=4)] if any(one.n_carried for one in tuned) else []),
        number("pruned", spare=5),
        number("failed", spare=8),
    ]
    columns += [number("running", spare=7), *(number(name, spare=2) for name in names)]
    columns += [number("MAE"), number("P90"), number("PCA+GP", spare=3)]
    columns += [number("trials/h", spare=9), number("to go", spare=4)]
    rows = [
        [
            one.study if alike.count((one.label, one.n_train)) > 1 else one.study.rsplit("/", 1)[0],
            one.short_model or MISSING,
            f"{one.n_trials}/{one.n_all}",
            *([one.n_carried] if any(each.n_carried for each in tuned) else []),
            one.n_pruned,
            one.n_failed,
            one.n_running,
            *(setting(one.params.get(name)) for name in names),
            *(MISSING if error is None else significant(error) for error in (one.mae, one.p90)),
            significant(one.baseline[f"{one.judged_by}/mae"]) if one.baseline else MISSING,
            MISSING if one.trials_per_h is None else f"{one.trials_per_h:.0f}",
            MISSING if one.to_go_s is None else format_seconds(one.to_go_s) if one.to_go_s else "done",
        ]
        for one in tuned
    ]
    unit = f", in {units.pop()}" if len(units) == 1 else ""
    title = f"Studies (errors of the best trial on the test set{unit})"
    return Table(title, columns, rows)


def _calibrations(calibrations: Sequence[FinishedCalibration]) -> Table:
    """Return a line per calibration."""
    names = {one.found.error_name for one in calibrations}
    final = f"final {names.pop()}" if len(names) == 1 else "final error"
    columns = [Column("calibration"), number(final), number("calls (paper)")]
    columns += [number("calls (all)", spare=2), Column("how it ended", spare=3), number("finished", spare=1)]
    is_any_changed = any(one.changed_since for one in calibrations)
    columns += [Column("changed since")] * is_any_changed
    rows = []
    for one in calibrations:
        found, calls = one.found, str(one.found.n_calls_paper)
        rows.append(
            [
                one.name,
                one.mse_text,
                f"{calls} + {found.n_warm_start} stored" if found.n_warm_start else calls,
                found.n_calls,
                found.stop_reason,
                one.outcome.finished[:16].replace("T", " "),
                *([", ".join(one.changed_since)] if is_any_changed else []),
            ]
        )
    return Table("", columns, rows)
