"""The examination of a case as a stage: done once per case, unless asked for."""

from studies.doctor import Diagnosis, examine
from studies.doctor.budget import EXAMINATION_S
from studies.results.outcome import Outcome
from studies.stages.finished import stored
from studies.stages.knowledge import declared_inputs
from studies.stages.pipeline import Stage
from studies.task import Task


def check_stage(
    task: Task, *, again: bool = False, is_thorough: bool = False, limit_s: float = EXAMINATION_S
) -> Outcome[Diagnosis]:
    """Examine the case unless it was found sound before, or again.

    Args:
        task: the task.
        again: examine it though it was found sound.
        is_thorough: whether nothing is left out.
        limit_s: simulating time of an examination that is not thorough. [s]
    """
    inputs = {
        "case": task.case.digest,
        "measurement": task.case.measurement.digest,
        **declared_inputs(task.case),
    }
    stage = Stage(task, "check", f"examining {task.label}", inputs, Diagnosis)
    return stage.once(
        lambda: examine(task, is_thorough=is_thorough, limit_s=limit_s),
        again=again,
        is_kept=lambda found: found.is_sound,
    )


def found_of_the_step(task: Task) -> str | None:
    """Return what the last examination of this case found of its communication step.

    Returns:
        "" where it found nothing wrong, None where the case was not examined.
    """
    before = stored(task, "check", Diagnosis)
    if before is None:
        return None
    for one in before.findings:
        if one.key in ("half-step", "half-step-fails") and one.level == "warn":
            return f"{one.what} {one.found}: {one.remedy}"
    return ""
