"""What can be named beside studies and stages: labels, trials, row sets, and digests with their users."""

from dataclasses import dataclass
from pathlib import Path

from studies.looking.project import Project, StageLook, StudyLook
from studies.tuning.trial_record import TrialRecord, trial_name


@dataclass(frozen=True)
class LabelThing:
    """All studies and stages of a label.

    Args:
        name: the label.
        studies: its studies.
        stages: its finished stages.
    """

    name: str
    studies: tuple[StudyLook, ...]
    stages: tuple[StageLook, ...]


@dataclass(frozen=True)
class TrialThing:
    """A finished trial.

    Args:
        study: its study.
        record: what is known of it.
    """

    study: StudyLook
    record: TrialRecord

    @property
    def name(self) -> str:
        """What it is called on a command line."""
        return f"{self.study.called}/{trial_name(self.record.index)}"


@dataclass(frozen=True)
class RowSetThing:
    """A set of stored simulations.

    Args:
        name: its file's stem.
        file: its file.
        users: stages that made or used it, by name.
        digest: sha256 of its content, empty where no stage tells.
    """

    name: str
    file: Path
    users: tuple[str, ...]
    digest: str


@dataclass(frozen=True)
class DigestThing:
    """A digest and everything that names it.

    Args:
        name: the whole digest.
        what: what it is the digest of.
        users: names of what has it.
    """

    name: str
    what: str
    users: tuple[str, ...]


Thing = LabelThing | StudyLook | TrialThing | StageLook | RowSetThing | DigestThing


def all_things(project: Project) -> dict[str, Thing]:
    """Return everything that has a name of its own, by every whole name it has, the latest of equals."""
    things: dict[str, Thing] = {}
    for label in project.labels:
        things[label] = LabelThing(
            label,
            tuple(study for study in project.studies if study.label == label),
            tuple(stage for stage in project.stages if stage.label == label),
        )
    for study in sorted(project.studies, key=lambda one: one.began_s):
        things |= dict.fromkeys((study.short_name, study.name), study)
        for record in study.records:
            thing = TrialThing(study, record)
            short = f"{study.short_name}/{trial_name(record.index)}"
            things |= dict.fromkeys((short, record.key), thing)
    for stage in project.stages:
        things[stage.name] = stage
        if stage.is_calibration:
            things[f"{stage.label}/{stage.stage.replace('calibrate-', 'calibration-')}"] = stage
    for row_set in row_sets(project):
        things[row_set.name] = row_set
    return things


def row_sets(project: Project) -> list[RowSetThing]:
    """Return the row sets that lie in the project."""
    users: dict[str, list[StageLook]] = {}
    for stage in project.stages:
        if stage.stage == "simulate":
            for place in stage.summary["files"].values():
                users.setdefault(place, []).append(stage)
    found = []
    for file in sorted(project.paths.data.glob("*/generated/sets/*.npz")):
        stages = users.get(project.paths.relative(file), [])
        digests = [
            digest
            for stage in stages
            for role, digest in stage.summary["digests"].items()
            if stage.summary["files"][role] == project.paths.relative(file)
        ]
        names = tuple(stage.name for stage in stages)
        found.append(RowSetThing(file.stem, file, names, digests[0] if digests else ""))
    return found


def all_digests(project: Project, sets: list[RowSetThing]) -> dict[str, list[tuple[str, str]]]:
    """Return every digest that records name, with what it is of and who names it."""
    found: dict[str, list[tuple[str, str]]] = {}

    def note(digest: object, what: str, user: str) -> None:
        if isinstance(digest, str) and digest:
            found.setdefault(digest, []).append((what, user))

    for study in project.studies:
        note(study.digest, "study", study.name)
        for role, digest in study.entry.digests.items():
            note(digest, role if role in ("case", "fmu") else f"{role} set", study.called)
    for stage in project.stages:
        note(stage.manifest.get("digest"), "stage", stage.name)
        note(stage.summary.get("case_sha256"), "case", stage.name)
        note(stage.summary.get("measurement_sha256"), "measurement", stage.name)
        for file, digest in (stage.summary.get("surrogate") or {}).get("sha256", {}).items():
            note(digest, f"{file} of a surrogate", stage.name)
    for row_set in sets:
        note(row_set.digest, "row set", row_set.name)
    return found
