"""The stage that compares model structures on one measurement."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from simulation.arrays import FloatArray, digest_of
from simulation.case import Case
from simulation.errors import InputError
from simulation.measurement import MeasuredOutput
from studies.calibration.descent import Residuals, jacobians
from studies.calibration.differences import difference_rows
from studies.calibration.problem import CalibrationProblem
from studies.calibration.uncertainty.assess import STEP
from studies.calibration.uncertainty.density import Posterior
from studies.calibration.uncertainty.emulated import emulated_residuals
from studies.calibration.uncertainty.identifiability import judged_slopes
from studies.calibration.uncertainty.noise import NoiseKind, noise_of
from studies.calibration.uncertainty.rows import informative_rows, joined
from studies.calibration.uncertainty.structures import (
    blocks_of,
    evidence,
    exceeded,
    left_out_losses,
    whiteness,
)
from studies.results.choice import Choice, Structure
from studies.results.outcome import Outcome
from studies.results.stage_results import Calibration
from studies.stages.judged_model import judged_model
from studies.stages.knowledge import case_inputs, sensor_inputs
from studies.stages.pipeline import Stage
from studies.stages.stage_runs import log_choice
from studies.stages.warm_start import WarmStart
from studies.task import Task
from studies.words.wording import count, listed, percent

SURE, SURE_TOGETHER = 0.95, 0.75
"""Probability from which the data choose a structure, and where it also has the least BIC: three to one."""

CONTRADICTED = 2.1
"""Standard errors by which another structure predicts blocks better: 90 % of Student's t with 4 freedoms."""

WHITE = 0.01
"""Least probability of residuals that may be white."""

N_STARTS = 4
"""Rows from which calibrations without a block begin, the calibrated one among them."""


@dataclass(frozen=True, eq=False)
class _Judged:
    """What is known of a structure once its model is closed."""

    problem: CalibrationProblem
    residuals: Residuals
    starts: FloatArray
    y: FloatArray
    mse: float
    n_simulated: int
    by_equations: bool


def check_same_measurement(cases: Sequence[Case]) -> None:
    """Refuse cases that are not compared with the same samples.

    Raises:
        InputError: Two are not; the first difference is named.
    """
    names = [case.name for case in cases]
    if len(cases) < 2 or len(set(names)) < len(names):
        raise InputError(f"choose compares cases of different names, two or more; given: {', '.join(names)}")
    for other in cases[1:]:
        pair = f"{names[0]} and {other.name}"
        if len(cases[0].outputs) != len(other.outputs):
            raise InputError(
                f"{pair} have {len(cases[0].outputs)} and {len(other.outputs)} outputs; {_REMEDY}"
            )
        for mine, its in zip(cases[0].outputs, other.outputs, strict=True):
            both = [
                vars(one) | {"samples": digest_of(repr(one.samples.interval), *_arrays(one))}
                for one in (mine, its)
            ]
            if differing := [key for key in _COMPARED if repr(both[0][key]) != repr(both[1][key])]:
                raise InputError(f"{pair}: outputs[{mine.name}] and outputs[{its.name}] have other "
                                 f"{differing[0]}; {_REMEDY}")  # fmt: skip


def _arrays(output: MeasuredOutput) -> list[FloatArray]:
    samples = output.samples
    return [one for one in (samples.time, samples.values, samples.deviations) if one is not None]


_COMPARED = ("samples", "unit", "uncertainty", "weight", "loss", "correlation_s", "error_lasts_s", "limits")
_REMEDY = "structures are compared on one measurement, so give all the same window, data and outputs"


def choose_stage(
    tasks: Sequence[Task],
    calibrations: Sequence[Outcome[Calibration]],
    *,
    noise: NoiseKind,
    again: bool = False,
) -> Outcome[Choice]:
    """Compare calibrated structures.

    Args:
        tasks: A study of each; results lie with the first.
        calibrations: Their calibrations.
        noise: Model of the noise.
        again: Do it though it is finished.
    """
    inputs = {
        "structures": [
            {
                **case_inputs(task.case),
                **sensor_inputs(task.case),
                "label": task.label,
                "theta": one.result.theta,
                "state_equations": one.result.believes_equations,
            }
            for task, one in zip(tasks, calibrations, strict=True)
        ],
        "case": tasks[0].case.digest,
        "noise": noise,
        "seed": tasks[0].profile.seed,
    }
    name = "-".join(["choose", *(task.case.name for task in tasks[1:])])[:120]
    what = f"{count(len(tasks), 'structure')} by evidence, information criteria and left-out blocks"
    stage = Stage(tasks[0], name, what, inputs, Choice)
    starts = [
        WarmStart(stage.file.with_name(f"{name}-{task.case.name}-rows.npz"), stage.digest, informative_rows)
        for task in tasks
    ]

    def choose() -> Choice:
        judged = [_judged(*each, noise) for each in zip(tasks, calibrations, starts, strict=True)]
        return _compared(tasks, calibrations, judged, noise)

    return stage.once(choose, again=again, files=[one.file for one in starts], log=log_choice)


def _judged(task: Task, calibration: Outcome[Calibration], start: WarmStart, noise: NoiseKind) -> _Judged:
    with judged_model(task, calibration, start, noise) as model:
        problem, known, emulator = model.problem, model.known, model.emulator
        u = np.clip(problem.space.to_unit(calibration.result.point), 0.0, 1.0)
        if emulator is None:
            # Slopes at the optimum are what everything depends on.
            known = joined([known, problem.evaluate(difference_rows(u, STEP))])
        best = np.argsort(known.mse, kind="stable")[: N_STARTS - 1]
        return _Judged(
            problem,
            emulated_residuals(problem, known, emulator),
            np.concatenate([u[None], known.u[best]]),
            model.best_y,
            float(problem.measurement.mse(model.best_y[None])[0]),
            model.physical.n_simulated,
            emulator is not None,
        )


def _compared(
    tasks: Sequence[Task],
    calibrations: Sequence[Outcome[Calibration]],
    judged: Sequence[_Judged],
    kind: NoiseKind,
) -> Choice:
    """Judge all structures with the noise of the one of least error."""
    best = int(np.argmin([one.mse for one in judged]))
    of_best = judged[best].problem
    noise = noise_of(kind, of_best.measurement, judged[best].y, of_best.space.n_parameters)
    seed, console, n = tasks[0].profile.seed, tasks[0].console, len(tasks)
    evidences, losses = [], []
    with console.bars() as bars:
        for done, one in enumerate(judged):
            bars("structures", done, n)
            posterior = Posterior(noise, one.problem.prior)
            evidences.append(evidence(one.residuals, posterior, one.starts[0], seed=seed))
            blocks = blocks_of(one.problem.measurement)
            losses.append(left_out_losses(one.residuals, posterior, one.starts, blocks))
        bars("structures", n, n)
    logs = np.array([one.log for one in evidences])
    weights = np.exp(logs - logs.max())
    probabilities = (weights / weights.sum()).tolist()
    deviances = [one.mse / noise.unit for one in judged]
    names = [set(one.problem.space.names) for one in judged]
    structures = []
    for i, (task, one) in enumerate(zip(tasks, judged, strict=True)):
        at, p = one.starts[:1], one.problem.space.n_parameters
        larger = min((j for j in range(n) if names[i] < names[j]), key=lambda j: len(names[j]), default=None)
        slopes = jacobians(one.residuals, at, one.residuals(at))[0]
        local = judged_slopes(one.problem.space.names, slopes, noise.raised, prior=one.problem.prior)
        structure = Structure(
            case=task.case.name, label=task.label, n_parameters=p, determined=local.determined, mse=one.mse,
            aic=deviances[i] + 2.0 * p, bic=deviances[i] + p * float(np.log(noise.n_independent)),
            log_evidence=evidences[i].log, log_evidence_error=evidences[i].error,
            probability=probabilities[i],
            left_out_mse=float(np.mean(losses[i])), left_out=tuple(losses[i].tolist()),
            white=whiteness(one.problem.measurement, one.y),
            larger="" if larger is None else tasks[larger].case.name,
            ratio_p=None if larger is None
            else exceeded(deviances[i] - deviances[larger], len(names[larger]) - p),
            n_calls=calibrations[i].result.n_calls, n_judged=one.n_simulated, by_equations=one.by_equations,
        )  # fmt: skip
        structures.append(structure)
    chosen, reason = decided(structures)
    probable = max(structures, key=lambda one: one.probability)
    what = "experiment" if judged[0].problem.layout else "part"
    blocks_named = count(len(losses[0]), what) + ("" if judged[0].problem.layout else " of the time")
    name, is_white = tasks[best].case.name, probable.white >= WHITE
    return Choice(tuple(structures), chosen, reason, noise, name, blocks_named, is_explained=is_white)


def decided(structures: Sequence[Structure]) -> tuple[str, str]:
    """Return the case that the data choose, "" where they do not decide, and why in words.

    The evidence decides, unless another structure predicts left-out blocks clearly better: evidence depends
    on the bounds, predictions do not.

    Args:
        structures: What speaks for each, two or more.
    """
    ranked = sorted(structures, key=lambda one: -one.probability)
    best = ranked[0]
    by_bic = min(structures, key=lambda one: one.bic)
    if best.probability < (SURE_TOGETHER if by_bic is best else SURE):
        alike = [one for one in ranked if one.probability > 1.0 - SURE]
        each = listed(f"{one.case} ({percent(one.probability)})" for one in alike)
        return "", f"the evidence leaves {each}, and BIC is least for {by_bic.case}"
    for one in ranked[1:]:
        gains = np.array(best.left_out) - np.array(one.left_out)
        error = float(gains.std(ddof=1)) / np.sqrt(len(gains)) if len(gains) > 1 else np.inf
        if gains.mean() > CONTRADICTED * error:
            return "", (
                f"the evidence is for {best.case} ({percent(best.probability)}), "
                f"but {one.case} predicts what was left out better"
            )
    least = "the least" if by_bic is best else f"not the least, which {by_bic.case} has"
    return best.case, f"its probability among these is {percent(best.probability)}, its BIC is {least}"
