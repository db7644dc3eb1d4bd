"""The doctor as a stage: examined once per case and profile, unless asked for."""

from pathlib import Path

from simulation.case import load_case
from studies.doctor import Diagnosis, Finding, examine
from studies.pipeline import Outcome, Study, Summary, run_stage


def diagnose(study: Study) -> Diagnosis:
    """Examine the study's case now."""
    case = study.case
    halved = load_case(case.path, case.window_d, communication_step_s=case.communication_step_s / 2.0)
    return examine(case, study.profile, halved=halved, console=study.console)


def check_stage(study: Study) -> tuple[Outcome, Diagnosis]:
    """Examine the case unless it was found sound before."""
    inputs = {
        "case": study.case.digest,
        "measurement": study.case.measurement.digest,
        "estimates": [parameter.estimate for parameter in study.case.parameter_space.parameters],
        "profile": study.profile.to_dict(),
    }

    def work() -> tuple[Summary, list[Path]]:
        return diagnose(study).to_dict(), []

    outcome = run_stage(
        study,
        "check",
        what=f"examining {study.label}",
        inputs=inputs,
        work=work,
        reuse_note=lambda summary: f"{len(summary['findings'])} findings",
        keep=lambda summary: bool(summary["sound"]),
    )
    return outcome, _diagnosis(outcome.summary)


def _diagnosis(summary: Summary) -> Diagnosis:
    return Diagnosis(
        tuple(Finding(**found) for found in summary["findings"]),
        float(summary["simulation_s"]),
        dict(summary["planned_simulations"]),
    )
