"""What a person may call a study, a trial, a calibration or anything else that a project holds."""

import re
from fnmatch import fnmatchcase
from pathlib import Path

from simulation.errors import InputError
from studies.looking.mlflow_runs import find_runs
from studies.looking.project import Project, StageLook, StudyLook
from studies.looking.things import (
    DigestThing,
    LabelThing,
    Thing,
    TrialThing,
    all_digests,
    all_things,
    row_sets,
)
from studies.looking.wording import hint
from studies.stages.pipeline import read_json
from studies.tuning.trial_record import trial_name

N_NAMED = 6
"""Names that a message lists at most."""


def chosen_labels(project: Project, which: str | None) -> tuple[str, ...]:
    """Return the labels that a case, a label or a pattern means; all where nothing is named.

    Raises:
        InputError: there is none.
    """
    if which is None or not project.labels:
        return project.labels
    found = tuple(
        label for label in project.labels if fnmatchcase(label, which) or project.case_of(label) == which
    )
    if not found:  # the begin of labels; a case may share it with others, as office and office-recorded
        found = tuple(label for label in project.labels if label.startswith(f"{which}-"))
    if not found:
        known = ", ".join(project.labels)
        cases = [case for case in map(project.case_of, project.labels) if case]
        raise InputError(
            f"nothing is called {which!r}; {hint(which, (*cases, *project.labels))}labels: {known}"
        )
    return found


def find_thing(project: Project, text: str) -> Thing:
    """Return what a name, a place, a digest or an MLflow run means.

    Whole names come first, then their ends (`n0064/t003` where one label has it), then first digits of
    digests and of MLflow's run ids.

    Raises:
        InputError: nothing is called so, or several things are.
    """
    things = all_things(project)
    said = _in_full(_without_place(project, text))
    if said in things:
        return things[said]
    ends = {id(thing): name for name, thing in things.items() if name.endswith(f"/{said}")}
    if len(ends) == 1:
        return things[next(iter(ends.values()))]
    if len(ends) > 1:
        raise InputError(f"{text!r} may be {_listed(sorted(ends.values()))}; give the whole name")
    found = _by_digest(project, things, text) if re.fullmatch(r"[0-9a-f]{4,}", text) else None
    if found is not None:
        return found
    if not things:
        raise InputError(f"nothing is called {text!r}: this project has no results yet; type: studies run")
    study = things.get(said.rpartition("/")[0])
    if isinstance(study, StudyLook) and study.records and said.rpartition("/")[2].startswith("t"):
        first, last = trial_name(study.records[0].index), trial_name(study.records[-1].index)
        raise InputError(f"nothing is called {text!r}; {study.called} has the trials {first} to {last}")
    known = "studies status shows what there is"
    raise InputError(f"nothing is called {text!r}; {hint(said, things)}{known}")


def kind_of(thing: Thing) -> str:
    """Return what a thing is, in a word or two."""
    if isinstance(thing, StageLook):
        return "calibration" if thing.is_calibration else "stage"
    if isinstance(thing, StudyLook):
        return "study"
    if isinstance(thing, TrialThing):
        return "trial"
    if isinstance(thing, LabelThing):
        return "label"
    return "digest" if isinstance(thing, DigestThing) else "row set"


def _without_place(project: Project, text: str) -> str:
    """Return the name that a file or folder of the project stands for."""
    parts = Path(text.removeprefix(f"{project.paths.root}/")).parts
    if len(parts) == 4 and parts[:2] == ("mlruns", "champions"):
        champion = read_json(project.paths.root / Path(*parts) / "champion.json") or {}
        if "study" in champion and "index" in champion:
            return f"{champion['study']}/{trial_name(champion['index'])}"
    if len(parts) >= 4 and parts[:2] == ("mlruns", "trials"):
        rest = [part for part in parts[4:] if part not in ("trial.json", "history.npz", "surrogate")]
        return "/".join([parts[2], *parts[3].split("-", 1), *rest])
    if len(parts) >= 4 and parts[:2] == ("mlruns", "results"):
        stage = Path(parts[3]).stem.replace("calibration-", "calibrate-")
        return "/".join([parts[2], stage, *parts[4:]])
    if parts[:1] == ("data",) and text.endswith(".npz"):
        return Path(text).stem
    return text.rstrip("/")


def _in_full(text: str) -> str:
    """Pad the numbers of sizes and trials: n64/t3 is n0064/t003."""
    padded = re.sub(r"(?<![^/])n(\d{1,3})(?=/|$)", lambda found: f"n{int(found[1]):04d}", text)
    return re.sub(r"(?<![^/])t(\d{1,2})$", lambda found: f"t{int(found[1]):03d}", padded)


def _by_digest(project: Project, things: dict[str, Thing], text: str) -> Thing | None:
    sets = row_sets(project)
    known = all_digests(project, sets)
    matching = sorted(digest for digest in known if digest.startswith(text))
    if len(matching) > 1:
        listed = _listed([f"{digest[:12]} ({known[digest][0][0]})" for digest in matching])
        raise InputError(f"several digests begin with {text}: {listed}; give more digits")
    if matching:
        uses = known[matching[0]]
        what, user = uses[0]
        if what in ("study", "stage", "row set") and user in things:
            return things[user]
        return DigestThing(matching[0], what, tuple(dict.fromkeys(user for _, user in uses)))
    runs = find_runs(project.paths, run_id=text)
    if len(runs) > 1:
        raise InputError(
            f"several MLflow runs begin with {text}: {_listed([r.run_id for r in runs])}; give more digits"
        )
    for run in runs:
        for key in run.keys:
            if key in things:
                return things[key]
            staged = [s for s in project.stages if s.manifest.get("digest") == key]
            if staged:
                return staged[0]
        raise InputError(f"MLflow's run {run.run_id} ({run.name}) has no record in this project any more")
    return None


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - N_NAMED} more" if len(names) > N_NAMED else ""
    return ", ".join(names[:N_NAMED]) + more
