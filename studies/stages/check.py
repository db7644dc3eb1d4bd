"""The doctor as a stage: examined once per case and profile, unless asked for."""

from collections.abc import Iterator
from contextlib import contextmanager

from simulation.case import load_case
from simulation.pool.execution import ExecutionPolicy
from studies.doctor import Diagnosis, Finding, examine
from studies.doctor.examination import Surgery
from studies.doctor.keeping import KeepingModel
from studies.doctor.variants import HALVING
from studies.physical_model import open_physical_model
from studies.report.wording import count
from studies.stages.knowledge import declared_inputs
from studies.stages.pipeline import Outcome, Stage, Study, Summary, read_json


def diagnose(study: Study, *, is_thorough: bool = False) -> Diagnosis:
    """Examine the study's case now."""
    case = study.case

    @contextmanager
    def open_model(policy: ExecutionPolicy) -> Iterator[KeepingModel]:
        with open_physical_model(study, policy=policy) as model:
            yield KeepingModel(model)

    surgery = Surgery(
        case=case,
        halved=load_case(case.path, case.window_d, communication_step_s=case.communication_step_s / 2.0),
        profile=study.profile,
        open_model=open_model,
        n_workers=min(study.n_jobs, case.policy.max_workers or study.n_jobs),
        command=f"studies check {study.command}",
        console=study.console,
    )
    return examine(surgery, is_thorough=is_thorough)


def check_stage(study: Study, *, again: bool = False, is_thorough: bool = False) -> tuple[Outcome, Diagnosis]:
    """Examine the case unless it was found sound before, or again."""
    inputs = {
        "case": study.case.digest,
        "measurement": study.case.measurement.digest,
        **declared_inputs(study.case),
        "profile": study.profile.to_dict(),
    }

    stage = Stage(study, "check", f"examining {study.label}", inputs)
    outcome = stage.finished(lambda summary: count(len(summary["findings"]), "finding"), again=again)
    if outcome is None:
        with stage.work() as work:
            found = diagnose(study, is_thorough=is_thorough)
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
        if one.what.startswith(HALVING) and one.level == "warn":
            return f"{one.what} {one.found}: {one.remedy}"
    return ""


def _diagnosis(summary: Summary) -> Diagnosis:
    return Diagnosis(
        tuple(Finding(**found) for found in summary["findings"]),
        float(summary["simulation_s"]),
        dict(summary["planned_simulations"]),
    )
