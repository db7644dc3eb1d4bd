"""What a project holds at this moment, read from its records: studies with their trials, and stages."""

import math
import time
import tomllib
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from studies.paths import ProjectPaths
from studies.report.wording import difference_unit
from studies.stages.pipeline import read_json
from studies.tuning.claim import is_dead
from studies.tuning.trial_record import TrialRecord, best_record
from studies.tuning.trial_store import RunningTrial, StudyEntry, TrialStore, list_studies, open_trials


@dataclass(frozen=True)
class StudyLook:
    """A study as it stands.

    Args:
        entry: what is known of it without its trials.
        store: its records.
        records: its finished trials, ordered by index.
        running: the trials that somebody works on.
        lost: the trials whose owner has died; the next `studies tune` takes them up.
        has_twin: whether the project holds another study of the same label and size.
    """

    entry: StudyEntry
    store: TrialStore
    records: tuple[TrialRecord, ...]
    running: tuple[RunningTrial, ...]
    lost: tuple[RunningTrial, ...]
    has_twin: bool = False

    @property
    def name(self) -> str:
        """Its whole name, such as `office-quick/n0064/1a2b3c4d`."""
        return self.entry.name

    @property
    def label(self) -> str:
        """Label of case and profile."""
        return self.entry.label

    @property
    def n_train(self) -> int:
        """Training-set size."""
        return self.entry.n_train

    @property
    def n_planned(self) -> int:
        """Trials that it shall have."""
        return max(self.entry.n_planned, len(self.records))

    @property
    def unit(self) -> str:
        """Unit of its errors."""
        return difference_unit(self.entry.output_unit)

    @property
    def short_name(self) -> str:
        """Its label and size, for example `office-quick/n0064`; of twins it means the latest."""
        return self.name.rsplit("/", 1)[0]

    @property
    def called(self) -> str:
        """What it is called on a command line: its label and size, its whole name where it has a twin."""
        return self.name if self.has_twin else self.short_name

    @property
    def digest(self) -> str:
        """First digits of the digest of all that decides its trials."""
        return self.name.rsplit("/", 1)[1]

    @cached_property
    def best(self) -> TrialRecord | None:
        """Its completed trial of least validation error."""
        return best_record(self.records)

    @property
    def default(self) -> TrialRecord | None:
        """Its completed trial of the default configuration, which is always the first."""
        first = self.records[0] if self.records else None
        return first if first and first.index == 0 and first.state == "complete" else None

    def count(self, state: str) -> int:
        """Return the trials that ended so."""
        return sum(record.state == state for record in self.records)

    @property
    def began_s(self) -> float:
        """Begin of its latest trial. [s since 1970, UTC]."""
        return max((record.started_s for record in self.records), default=0.0)


@dataclass(frozen=True)
class FixedParameter:
    """A parameter that a calibration of the most relevant ones held fixed.

    Attributes:
        value: What it was held at. [unit]
        unit: Its unit, empty where nothing tells.
        why: Where the value comes from, in words.
    """

    value: float
    unit: str
    why: str


@dataclass(frozen=True)
class StageLook:
    """A finished stage.

    Args:
        label: label of the study.
        stage: its name, such as `simulate` or `calibrate-n0064`.
        manifest: what the stage left: inputs, summary, files, versions, host, wall time.
        file: where that lies.
    """

    label: str
    stage: str
    manifest: Mapping[str, Any]
    file: Path

    @property
    def name(self) -> str:
        """What it is called on a command line."""
        return f"{self.label}/{self.stage}"

    @property
    def summary(self) -> Mapping[str, Any]:
        """Its results."""
        found: Mapping[str, Any] = self.manifest["summary"]
        return found

    @property
    def is_calibration(self) -> bool:
        """Whether parameters were calibrated."""
        return self.stage.startswith("calibrate-")

    @property
    def result_file(self) -> Path:
        """Where all numbers of a calibration lie."""
        return self.file.with_name(f"calibration-{self.stage.removeprefix('calibrate-')}.json")

    @cached_property
    def recipe(self) -> Mapping[str, Any]:
        """What a calibration was made from, empty where that is lost."""
        recipe: Mapping[str, Any] = (read_json(self.result_file) or {}).get("recipe", {})
        return recipe

    @cached_property
    def case_file(self) -> Mapping[str, Any]:
        """What the case file of a calibration declared, empty where its recipe is lost."""
        try:
            return tomllib.loads(self.recipe["case"]["text"])
        except (KeyError, tomllib.TOMLDecodeError):
            return {}

    @cached_property
    def units(self) -> dict[str, str]:
        """Units of a calibration's parameters by name; empty where nothing tells."""
        return {one["name"]: one.get("unit", "1") for one in self.case_file.get("parameters", ())}

    @cached_property
    def fixed(self) -> dict[str, FixedParameter]:
        """The parameters that a calibration held fixed, by name; empty where it calibrated all."""
        told = self.summary.get("restriction")
        if told is None:
            return {}
        return {
            name: FixedParameter(value, self.units.get(name, ""), told["why"][name])
            for name, value in told["fixed"].items()
        }

    @property
    def mse(self) -> float:
        """Final error of a calibration, infinite where it has none. [first output's unit squared]."""
        value = self.summary.get("mse_polished", self.summary.get("mse"))
        return math.inf if value is None else float(value)

    @property
    def n_calls(self) -> int:
        """Model calls of a calibration in the paper's count."""
        return int(self.summary["ledger"]["total_paper"])

    @property
    def n_known(self) -> int:
        """Stored simulations that a calibration began with, which are none of its calls."""
        return int(self.summary.get("n_known", 0))

    @property
    def has_paper_count(self) -> bool:
        """Whether the paper counts otherwise: it leaves validation and test sets out."""
        return self.n_calls != int(self.summary["ledger"]["total_honest"])


@dataclass(frozen=True)
class Project:
    """All studies and stages of a project.

    Args:
        paths: where everything lies.
        studies: the studies, by label and size.
        stages: the finished stages, by label.
    """

    paths: ProjectPaths
    studies: tuple[StudyLook, ...]
    stages: tuple[StageLook, ...]

    @property
    def calibrations(self) -> tuple[StageLook, ...]:
        """The finished calibrations."""
        return tuple(stage for stage in self.stages if stage.is_calibration)

    @property
    def labels(self) -> tuple[str, ...]:
        """All labels, in order."""
        labels = [study.label for study in self.studies] + [stage.label for stage in self.stages]
        return tuple(sorted(set(labels)))

    def case_of(self, label: str) -> str:
        """Return the name of the case behind a label, empty where nothing tells."""
        names = [study.entry.case_name for study in self.studies if study.label == label]
        return next(iter(names), "") or str(self._case_file(label).get("name", ""))

    def unit_of(self, label: str) -> str:
        """Return the unit of a label's errors, empty where nothing tells."""
        units = [study.unit for study in self.studies if study.label == label]
        if units:
            return units[0]
        outputs = self._case_file(label).get("outputs", ())
        return difference_unit(outputs[0]["unit"]) if outputs else ""

    def _case_file(self, label: str) -> Mapping[str, Any]:
        """Return what the case file behind a label's calibrations declared, empty where nothing tells."""
        files = (stage.case_file for stage in self.calibrations if stage.label == label)
        return next((file for file in files if file), {})


def look_at(paths: ProjectPaths) -> Project:
    """Read what there is.

    Raises:
        InputError: the storage cannot be reached.
    """
    studies = []
    entries = list_studies(paths)
    n_alike = Counter((entry.label, entry.n_train) for entry in entries)
    for entry in entries:
        store = open_trials(paths, entry.name)
        # First what runs: a trial that ends between the two looks is counted once, as finished.
        running, records = store.running(), store.records()
        finished = {record.index for record in records}
        begun = [trial for trial in running if trial.index not in finished]
        lost = tuple(trial for trial in begun if is_dead(trial.owner, time.time() - trial.heard_s))
        alive = tuple(trial for trial in begun if trial not in lost)
        studies.append(
            StudyLook(
                entry, store, tuple(records), alive, lost, has_twin=n_alike[entry.label, entry.n_train] > 1
            )
        )
    return Project(paths, tuple(studies), _stages(paths))


def _stages(paths: ProjectPaths) -> tuple[StageLook, ...]:
    found = []
    for file in sorted((paths.mlruns / "results").glob("*/*.json")):
        manifest = read_json(file)
        if manifest is not None and manifest.get("stage") == file.stem and "summary" in manifest:
            found.append(StageLook(file.parent.name, file.stem, manifest, file))
    return tuple(found)
