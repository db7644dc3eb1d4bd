"""The doctor as a stage: examined once per case and profile, unless asked for."""

from pathlib import Path

from studies.doctor import Diagnosis, Finding, examine
from studies.report.wording import count
from studies.stages.knowledge import declared_inputs
from studies.stages.pipeline import Outcome, Study, Summary, read_json, run_stage


def check_stage(study: Study, *, again: bool = False, is_thorough: bool = False) -> tuple[Outcome, Diagnosis]:
    """Examine the case unless it was found sound before, or again."""
    inputs = {
        "case": study.case.digest,
        "measurement": study.case.measurement.digest,
        **declared_inputs(study.case),
        "profile": study.profile.to_dict(),
    }

    def work() -> tuple[Summary, list[Path]]:
        return examine(study, is_thorough=is_thorough).to_dict(), []

    outcome = run_stage(
        study,
        "check",
        what=f"examining {study.label}",
        inputs=inputs,
        work=work,
        reuse_note=lambda summary: count(len(summary["findings"]), "finding"),
        keep=lambda summary: bool(summary["sound"]),
        again=again,
    )
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
        dict(summary["planned_simulations"]),
    )
