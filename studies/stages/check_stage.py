"""The examination of a case as a stage: done once per case, unless asked for."""

from studies.doctor import Diagnosis, examine
from studies.stages.finished import stored
from studies.stages.knowledge import declared_inputs
from studies.stages.pipeline import Outcome, Stage, Study


def check_stage(study: Study, *, again: bool = False, is_thorough: bool = False) -> Outcome[Diagnosis]:
    """Examine the case unless it was found sound before, or again."""
    inputs = {
        "case": study.case.digest,
        "measurement": study.case.measurement.digest,
        **declared_inputs(study.case),
    }
    stage = Stage(study, "check", f"examining {study.label}", inputs, Diagnosis)
    return stage.once(
        lambda: examine(study, is_thorough=is_thorough), again=again, is_kept=lambda found: found.is_sound
    )


def found_of_the_step(study: Study) -> str | None:
    """Return what the last examination of this case found of its communication step.

    Returns:
        "" where it found nothing wrong, None where the case was not examined.
    """
    before = stored(study, "check", Diagnosis)
    if before is None:
        return None
    for one in before.findings:
        if "half the communication step" in one.what and one.level == "warn":
            return f"{one.what} {one.found}: {one.remedy}"
    return ""
