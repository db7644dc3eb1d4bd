"""A study as its entry tells of it: enough to show it in Optuna and MLflow, not to train with."""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any, cast

from simulation.case_file import CaseFile
from simulation.errors import InputError
from simulation.parameters import Parameter, ParameterSpace
from studies.paths import ProjectPaths
from studies.profile import TuningBudget, Variant, profile_from
from studies.search_ranges import SearchRanges
from studies.tuning.champion import read_champion
from studies.tuning.study_spec import StudySpec
from studies.tuning.trial_record import TrialRecord
from studies.tuning.trial_store import StudyEntry

NOWHERE = Path("not-kept.npz")


@dataclass(frozen=True)
class RecordedStudy(StudySpec):
    """A study of which the entry is known and the data sets need not be there.

    Args:
        digits: the end of its name, which its digest begins with.
    """

    digits: str = ""

    @cached_property
    def digest(self) -> str:
        """The digits of the digest that are known."""
        return self.digits


def recorded_study(
    paths: ProjectPaths, entry: StudyEntry, records: Sequence[TrialRecord] = ()
) -> RecordedStudy:
    """Return a study as its entry, its recipe and its trials tell of it.

    Args:
        paths: the project.
        entry: what is known of the study.
        records: its trials, which tell what was searched where there is no recipe.
    """
    recipe, digests = entry.recipe, entry.digests
    budget = _budget(entry, records)
    sets = {name: paths.root / how["file"] for name, how in recipe.get("datasets", {}).items()}
    shared = {
        name: value
        for name in ("max_epochs", "patience", "device")
        if (value := getattr(budget, name)) is not None
    }
    space, outputs = _physics(recipe, paths.champion(entry.label, entry.n_train))
    return RecordedStudy(
        label=entry.label,
        n_train=entry.n_train,
        case_name=entry.case_name,
        case_digest=digests.get("case", ""),
        fmu_sha256=digests.get("fmu", ""),
        parameter_space=space,
        output_names=outputs,
        output_unit=entry.output_unit,
        output_scales=(1.0,) * len(outputs),
        train_file=sets.get("train", NOWHERE),
        validation_file=sets.get("validation", NOWHERE),
        test_file=sets.get("test", NOWHERE),
        train_digest=digests.get("train", ""),
        validation_digest=digests.get("validation", ""),
        test_digest=digests.get("test", ""),
        variant=entry.variant,
        overrides=shared,
        search=budget.ranges,
        seed=entry.seed,
        n_parallel=entry.n_parallel,
        pruner=budget.pruner,
        objectives=budget.objectives,
        note=entry.note,
        recipe=recipe,
        digits=entry.name.rpartition("/")[2],
    )


def _budget(entry: StudyEntry, records: Sequence[TrialRecord]) -> TuningBudget:
    """Return the budget a study was asked for with, put together from its trials where it was not kept."""
    try:
        return profile_from(entry.recipe["profile"], entry.name).tuning
    except (KeyError, InputError):  # no recipe, or one of another version
        variant = cast(Variant, entry.variant)
        return TuningBudget(n_trials=max(1, entry.n_planned), variant=variant, search=_searched(records))


def _searched(records: Sequence[TrialRecord]) -> SearchRanges:
    """Return the narrowest ranges in which all trials lie."""
    spans: dict[str, tuple[float, float]] = {}
    for record in records:
        for name, value in record.params.items():
            plain = 2.0**value if name.startswith("log2_") else float(value)
            low, high = spans.get(name.removeprefix("log2_"), (plain, plain))
            spans[name.removeprefix("log2_")] = (min(low, plain), max(high, plain))
    known = {field.name for field in fields(SearchRanges)}
    whole = {
        name: (round(low), round(high)) if name.startswith("n_") else (low, high)
        for name, (low, high) in spans.items()
        if name in known
    }
    return SearchRanges(**cast(dict[str, Any], whole))


def _physics(recipe: Mapping[str, Any], champion: Path) -> tuple[ParameterSpace, tuple[str, ...]]:
    """Return parameters and outputs as the recipe's case file or else the champion tells them."""
    try:
        case = CaseFile.model_validate(tomllib.loads(recipe["case"]["text"]))
        parameters = [Parameter(one.name, one.lower, one.upper, scale=one.scale) for one in case.parameters]
        return ParameterSpace(tuple(parameters)), tuple(one.name for one in case.outputs)
    except (KeyError, ValueError):
        pass
    try:
        told = read_champion(champion)
    except InputError:
        return ParameterSpace((Parameter("unknown", 0.0, 1.0),)), ()
    boxes = zip(told.parameter_names, told.lower, told.upper, strict=True)
    return ParameterSpace(tuple(Parameter(*box) for box in boxes)), told.output_names
