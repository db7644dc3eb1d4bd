"""`studies show`: which card tells of which thing, where it comes from, and what to type next."""

from collections.abc import Sequence
from typing import Any

from simulation.errors import InputError
from studies.console import Block, Facts
from studies.lineage import Lineage, Step, lineage_of
from studies.looking.card import label_blocks, study_blocks, study_values, trial_blocks, trial_values
from studies.looking.card_stage import digest_blocks, row_set_blocks, stage_blocks, stage_values
from studies.looking.project import Project, StageLook, StudyLook
from studies.looking.things import LabelThing, RowSetThing, Thing, TrialThing
from studies.tuning.trial_record import trial_name


def thing_blocks(project: Project, thing: Thing) -> list[Block]:
    """Return what a person sees of a thing."""
    if isinstance(thing, TrialThing):
        return trial_blocks(project, thing)
    if isinstance(thing, StudyLook):
        return study_blocks(project, thing)
    if isinstance(thing, StageLook):
        return stage_blocks(project, thing)
    if isinstance(thing, LabelThing):
        return label_blocks(project, thing)
    return row_set_blocks(project, thing) if isinstance(thing, RowSetThing) else digest_blocks(thing)


def thing_values(project: Project, thing: Thing) -> dict[str, Any]:
    """Return what a program reads of a thing."""
    if isinstance(thing, TrialThing):
        return trial_values(thing)
    if isinstance(thing, StudyLook):
        return study_values(thing)
    if isinstance(thing, StageLook):
        return stage_values(thing)
    if isinstance(thing, LabelThing):
        return {
            "studies": [study_values(study) for study in thing.studies],
            "stages": [stage_values(stage) for stage in thing.stages],
        }
    if isinstance(thing, RowSetThing):
        file = project.paths.show(thing.file)
        return {"file": file, "digest": thing.digest or None, "users": list(thing.users)}
    return {"what": thing.what, "users": list(thing.users)}


def lineage_blocks(project: Project, thing: Thing) -> list[Block]:
    """Return what a thing was made from and what was made of it, nothing where no record tells."""
    found = _lineage(project, thing)
    if found is None:
        return []
    return [Facts("", [("made from", _tree(found.made_from)), ("made of it", _tree(found.made_of_it))])]


def lineage_values(project: Project, thing: Thing) -> dict[str, Any] | None:
    """Return what a program reads of that."""
    found = _lineage(project, thing)
    return None if found is None else found.to_dict()


def _lineage(project: Project, thing: Thing) -> Lineage | None:
    name = thing.name
    if isinstance(thing, TrialThing):
        name = thing.record.key
    elif isinstance(thing, RowSetThing):
        name = project.paths.relative(thing.file)
    try:
        return lineage_of(project.paths, name)
    except InputError:
        return None


def _tree(steps: Sequence[Step]) -> str:
    """Return a line per step, deeper ones further in; what is as it was made needs no word."""
    lines = []
    for step in steps:
        kind = "" if step.kind in step.name else f"{step.kind} "
        state = "" if step.state == "unchanged" else f", {step.state} since"
        lines.append(f"{'  ' * (step.depth - 1)}{kind}{step.name} ({step.digest[:8]}{state})")
    return "\n".join(lines)


def next_line(thing: Thing) -> str:
    """Say what to type next."""
    if isinstance(thing, TrialThing):
        return f"next: studies reproduce {thing.name}"
    if isinstance(thing, StudyLook):
        best = f"studies show {thing.called}/{trial_name(thing.best.index)}" if thing.best else ""
        return f"next: {best or 'studies status --live'}"
    if isinstance(thing, StageLook):
        may_repeat = thing.is_calibration or thing.stage == "sensitivity"
        return f"next: studies reproduce {thing.name}" if may_repeat else f"next: studies show {thing.label}"
    return f"next: studies best {thing.name}" if isinstance(thing, LabelThing) else "next: studies status"
