"""The examination of a case as a stage: done once per case, unless asked for."""

from studies.doctor import Diagnosis, Finding, examine
from studies.report.wording import count
from studies.stages.knowledge import declared_inputs
from studies.stages.pipeline import Outcome, Stage, Study, Summary, read_json


def check_stage(study: Study, *, again: bool = False, is_thorough: bool = False) -> tuple[Outcome, Diagnosis]:
    """Examine the case unless it was found sound before, or again."""
    inputs = {
        "case": study.case.digest,
        "measurement": study.case.measurement.digest,
        **declared_inputs(study.case),
    }

    stage = Stage(study, "check", f"examining {study.label}", inputs)
    outcome = stage.finished(lambda summary: count(len(summary["findings"]), "finding"), again=again)
    if outcome is None:
        with stage.work() as work:
            found = examine(study, is_thorough=is_thorough)
            outcome = work.keep(found.to_dict(), is_finished=found.is_sound)
    return outcome, _diagnosis(outcome.summary)


def found_of_the_step(study: Study) -> str | None:
    """Return what the last examination of this case found of its communication step.

    Returns:
        "" where it found nothing wrong, None where nobody has examined the case.
    """
    manifest = read_json(study.results / "check.json")
    if manifest is None or manifest["inputs"]["case"] != study.case.digest:
        return None
    for one in _diagnosis(manifest["summary"]).findings:
        if one.what.startswith("half the communication step") and one.level == "warn":
            return f"{one.what} {one.found}: {one.remedy}"
    return ""


def _diagnosis(summary: Summary) -> Diagnosis:
    return Diagnosis(
        tuple(Finding(**found) for found in summary["findings"]),
        float(summary["simulation_s"]),
    )
