"""Tune the surrogates of several training-set sizes side by side, in worker processes."""

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import optuna
from optuna.storages import RDBStorage
from optuna.trial import FrozenTrial

from studies.paths import ProjectPaths
from studies.profile import Confirmation
from studies.results.declaration import Declaration
from studies.results.saved import plain
from studies.results.trials import TunedStudy, joined
from studies.tracking.runs import RunStore
from studies.tracking.sending import begin_sending
from studies.tracking.study_run import close_study, promote, without_deleted
from studies.tuning import attempts
from studies.tuning.carried import carried_trials
from studies.tuning.confirmations import to_confirm
from studies.tuning.means import best_mean
from studies.tuning.side_by_side import Group, Part, opened_run, work_on
from studies.tuning.storage import storage_of, study_locked
from studies.tuning.study_results import joined_studies, latest_studies, read_studies
from studies.words.wording import setting, significant

_LOG = logging.getLogger(__name__)
OnTrials = Callable[[Declaration, Sequence[FrozenTrial]], None]
OnLine = Callable[[str], None]


@dataclass(frozen=True)
class _Part(Part):
    """A study of surrogates on its way."""

    spec: Declaration
    provenance: Mapping[str, Any] | None
    smaller: int | None = None

    @property
    def found(self) -> TunedStudy:
        """All studies whose errors compare with this one's."""
        every = read_studies(self.paths, label=self.spec.label, n_train=self.spec.n_train)
        return joined([one for one in every if one.spec.has_equal_data(self.spec)])

    @property
    def is_tuned(self) -> bool:
        """Whether its trials are chosen among others."""
        return not (self.spec.is_baseline or self.spec.is_confirmation)

    def begin_last(self, smaller: TunedStudy) -> None:
        """Let the last trial begin, with the best settings of the next smaller size."""
        # Without further seeds: these begin at the same time.
        best = next((one.settings for one in smaller.usable if not one.spec.is_confirmation), None)
        with study_locked(self.storage, self.paths, self.spec.name):
            attempts.begin_last(self.study, self.spec, best)

    def close(self, on_warning: OnLine, on_news: OnLine) -> TunedStudy:
        """Register the best surrogate of all studies of equal data, and end the run of this one.

        One command at a time does so: another one finds mean and version, and makes no second ones.
        """
        which = f"{self.spec.project}/{self.spec.label}/{self.spec.size} closes"
        with study_locked(self.storage, self.paths, which, file=".closing.lock"):
            return self._close(on_warning, on_news)

    def _close(self, on_warning: OnLine, on_news: OnLine) -> TunedStudy:
        every = read_studies(self.paths, label=self.spec.label, n_train=self.spec.n_train)
        (found,) = joined_studies(one for one in every if one.spec.has_equal_data(self.spec))
        if self.spec.is_confirmation:  # its trials count with those that they confirm
            close_study(self.runs, found, self.spec, self.run_id)
            return found
        found, fault = without_deleted(self.runs, found)
        if fault:
            on_warning(fault)
        if not self.spec.is_baseline:
            beside = [one for one in every if one.spec.is_baseline and one.spec.data == self.spec.data]
            baseline = joined(beside).best if beside else None
            record = self.provenance or {}
            mean = best_mean(self.runs, self.paths, found, baseline, record, parent=self.run_id)
            found = replace(found, mean=mean)
        close_study(self.runs, found, self.spec, self.run_id)
        version, why = promote(self.runs, found)
        if why:
            on_news(why)
        if found.best is not None and version is not None:
            found = replace(found, versions={**found.versions, found.best.run_id: version})
        names = {self.spec.name, *(trial.spec.name for trial in found.trials)}
        for name in names:
            study = optuna.load_study(study_name=name, storage=self.storage)
            noted = {
                attempts.GONE: sorted(found.gone),
                attempts.VERSIONS: dict(found.versions),
                attempts.MEAN: None if found.mean is None else plain(found.mean),
                attempts.CLOSED: found.n_ended_of(name),
            }
            for key, value in noted.items():
                if study.user_attrs.get(key) != value:
                    study.set_user_attr(key, value)
        return replace(found, n_closed=sum(found.n_ended_of(name) for name in names))

    def confirmations(self, confirm: Confirmation) -> "list[_Part]":
        """Enqueue what is to be trained with further seeds, and return the studies of that."""
        found = self.found
        wanted, parts = to_confirm(found, confirm), dict[str, _Part]()
        for one, n_missing in wanted:
            spec = one.spec.confirmation
            if spec.name not in parts:
                parts[spec.name] = _opened(
                    spec, 0, None, self.storage, self.paths, self.runs, self.provenance
                )
            for _ in range(n_missing):
                marks = {attempts.PROPOSED_BY: attempts.CONFIRMATION}
                parts[spec.name].study.enqueue_trial(dict(one.params), user_attrs=marks)
        return [*parts.values()]


def _opened(
    spec: Declaration,
    n_planned: int,
    smaller: int | None,
    storage: RDBStorage,
    paths: ProjectPaths,
    runs: RunStore,
    provenance: Mapping[str, Any] | None,
) -> _Part:
    """Open a study, which is made where it is not there yet, and its run."""
    carried, has_smaller = carried_trials(storage, spec), smaller is not None
    with study_locked(storage, paths, spec.name):
        study = attempts.make_study(
            storage, spec, n_trials=n_planned, carried=carried, has_smaller=has_smaller
        )
    run_id = opened_run(study, runs, spec, n_planned, provenance)
    part = _Part(spec, study, run_id, storage, paths, runs, provenance, smaller)
    part.give_back()
    return part


@dataclass
class _Size(Group[_Part]):
    """The studies of one training-set size."""

    results: dict[str, TunedStudy] = field(default_factory=dict)
    is_confirmed: bool = False

    def confirm(self, confirm: Confirmation | None) -> None:
        """Add the studies that confirm what the trials came to, once."""
        if confirm is not None and not self.is_confirmed:
            self.parts += [
                one for part in self.parts if not part.spec.is_baseline for one in part.confirmations(confirm)
            ]
        self.is_confirmed = True

    def begin_last(self, sizes: "Mapping[int, _Size]") -> None:
        """Let the last trial begin where trials of the next smaller size have ended; it tries their best."""
        for part in self.parts:
            if part.smaller is None or not part.is_held:
                continue
            below = sizes[part.smaller]
            if not below.workers and not below.is_held and not any(one.is_unfinished for one in below.parts):
                part.begin_last(next(one for one in below.parts if one.is_tuned).found)


def _carried_words(n_train: int, n_carried: int, n_planned: int) -> str:
    words = f"n_train {n_train}: carried over from before the search space was edited: {n_carried} of "
    words += f"{n_planned} trials, which count and are not trained again"
    is_full = n_carried >= n_planned
    return words + (f"; --trials {n_carried + n_planned} trains {n_planned} more" if is_full else "")


BEST_OF_SIZES = "Best per n_train"
"""Begins our line in the note of an experiment."""


def tune(
    specs: Sequence[Declaration],
    *,
    paths: ProjectPaths,
    n_trials: int,
    n_jobs: int,
    n_parallel: int = 1,
    until_s: float | None = None,
    confirm: Confirmation | None = None,
    provenance: Mapping[str, Any] | None = None,
    on_trials: OnTrials = lambda spec, trials: None,
    on_warning: OnLine = _LOG.warning,
    on_news: OnLine = _LOG.info,
) -> list[TunedStudy]:
    """Bring every study to `n_trials` trials and register its best surrogate.

    Studies run side by side, the largest training set first. Trials that were enqueued or added through
    Optuna count; those that run in other commands are not waited for. With `n_parallel` 1 the trials depend
    neither on `n_jobs` nor on interruptions; a killed worker's trial is run again.

    Args:
        specs: the studies.
        paths: the project.
        n_trials: trials per study in total; a baseline has one.
        n_jobs: worker processes.
        n_parallel: workers of one study.
        until_s: no trial begins after this moment of `time.monotonic`. [s]
        confirm: what is trained with further seeds when the trials of a size have ended.
        provenance: what makes the data sets again, kept with every trial.
        on_trials: called with the trials of a study that is worked on, about twice a second.
        on_warning: called with one line that a user should see.
        on_news: called with one line: why another surrogate is the best of a size now, or how many trials
            were carried over.

    Returns:
        The studies as they stand, each with those of equal data, in the order given.

    Raises:
        InputError: a study cannot be run as declared, or the storage cannot be used.
        StageError: a worker failed for a reason that is not a trial's.
        KeyboardInterrupt: after the workers were stopped and their trials given back.
    """
    with storage_of(paths) as storage:
        runs = RunStore(paths)
        begin_sending(paths)
        sizes: dict[int, _Size] = {}
        for spec in specs:
            planned = 1 if spec.is_baseline else n_trials
            others = [] if spec.is_baseline else [one.n_train for one in specs if not one.is_baseline]
            smaller = max((n for n in others if n < spec.n_train), default=None)
            part = _opened(spec, planned, smaller, storage, paths, runs, provenance)
            if n_carried := sum(attempts.CARRIED in one.user_attrs for one in part.trials):
                on_news(_carried_words(spec.n_train, n_carried, planned))
            sizes.setdefault(spec.n_train, _Size([])).parts.append(part)

        def prepare(size: _Size) -> None:
            size.begin_last(sizes)
            if not (size.workers or size.is_held or size.is_waiting(n_parallel)):
                size.confirm(confirm)

        def show(size: _Size) -> None:
            for part in size.parts:
                on_trials(part.spec, part.trials)

        def close(size: _Size) -> None:
            size.results = {part.spec.name: part.close(on_warning, on_news) for part in size.parts}

        work_on(
            # Begun last, the longest trainings would run alone at the end.
            [sizes[n] for n in sorted(sizes, reverse=True)],
            n_jobs=n_jobs,
            n_parallel=n_parallel,
            until_s=until_s,
            on_free=prepare,
            on_poll=show,
            on_over=close,
        )
        runs.describe(specs[0].label, BEST_OF_SIZES, _best_of_sizes(paths, specs[0]), specs[0].note)
        return [sizes[spec.n_train].results[spec.name] for spec in specs]


def _best_of_sizes(paths: ProjectPaths, spec: Declaration) -> str:
    """Name the best model of each size in one line: MLflow's page shows one until its note is unfolded.

    All sizes of the label are named, those of other commands too.
    """
    latest = latest_studies(read_studies(paths, label=spec.label), spec.digests["case"])
    sizes = [one.summary() for (_, is_baseline), one in sorted(latest.items()) if not is_baseline]
    found = [one for one in sizes if one.trial is not None]
    if not found:
        return ""
    names = list(dict.fromkeys(name for one in found for name in one.params))
    each = [
        f"{one.n_train}: {f'{one.short_model}, ' if one.parts else ''}"
        f"{' / '.join(setting(one.params.get(name)) for name in names)} → "
        f"{significant(one.mae)}, {significant(one.p90)}"
        for one in found
    ]
    judged = "cross-validated" if found[0].folds else "test"
    return f" ({' / '.join(names)} → {judged} MAE, P90 {found[0].unit}): {' · '.join(each)}"


def closed_studies(
    specs: Sequence[Declaration], paths: ProjectPaths, n_trials: int, confirm: Confirmation | None = None
) -> list[TunedStudy] | None:
    """Return the studies where all of them are finished and registered, None where work is left."""
    known = joined_studies(read_studies(paths, label=specs[0].label))
    found = [one for spec in specs for one in known if one.spec.has_equal_data(spec)]
    if len(found) != len(specs):
        return None
    are_ended = all(one.is_closed for one in found)
    if confirm is not None:
        networks = [one for one in found if not one.spec.is_baseline]
        are_ended &= not any(n_missing for one in networks for _, n_missing in to_confirm(one, confirm))
    alone = [one.of(spec.name) for one, spec in zip(found, specs, strict=True)]
    are_enough = all(one.n_ended >= (1 if one.spec.is_baseline else n_trials) for one in alone)
    return found if are_ended and are_enough else None
