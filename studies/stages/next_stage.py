"""The stage that ranks experiments by what they would show of the parameters."""

import csv
import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.case import Case
from simulation.parameters import ParameterSpace
from simulation.time_unit import DAY_S
from simulation.whole_file import whole_file
from studies.calibration.descent import Residuals, jacobians
from studies.calibration.differences import difference_rows, difference_slopes
from studies.calibration.state_equations.coefficient import Points, values
from studies.calibration.state_equations.equations import StateEquations
from studies.calibration.state_equations.states import StateSignals, why_unwatched
from studies.calibration.uncertainty.assess import STEP
from studies.calibration.uncertainty.emulated import emulated_residuals
from studies.calibration.uncertainty.identifiability import BOX_PRECISION, DETERMINED
from studies.calibration.uncertainty.information import (
    Criterion,
    covariance,
    half_widths,
    information,
    merit,
)
from studies.calibration.uncertainty.rows import informative_rows, joined
from studies.physical_model import open_physical_model
from studies.results.outcome import Outcome
from studies.results.planned import Candidate, Planned
from studies.results.stage_results import Calibration
from studies.stages.candidates import Offer
from studies.stages.finished import stored_uncertainties
from studies.stages.judged_model import JudgedModel, judged_model
from studies.stages.knowledge import case_inputs, sensor_inputs
from studies.stages.pipeline import Stage
from studies.stages.stage_runs import log_planned
from studies.stages.warm_start import WarmStart
from studies.task import Task
from studies.words.wording import count

MOST_POINTS = 8
"""Parameter sets of the posterior over which half widths are averaged, the calibrated one among them."""


def next_stage(
    task: Task,
    calibration: Outcome[Calibration],
    present: Offer,
    offered: Sequence[Offer],
    *,
    criterion: Criterion,
    again: bool = False,
) -> Outcome[Planned]:
    """Rank experiments that might be made.

    Args:
        task: The study.
        calibration: The calibration that they are planned around.
        present: The present experiment, the first one of several.
        offered: The candidates.
        criterion: What ranks them.
        again: Do it though it is finished.
    """
    known = {one.result.calibration: one for one in stored_uncertainties(task)}.get(calibration.name)
    inputs = {
        **case_inputs(task.case),
        **sensor_inputs(task.case),
        "theta": calibration.result.theta,
        "criterion": criterion,
        "uncertainty": None if known is None else known.digest,
        "candidates": [[one.name, one.block, one.case.digest, one.case.model_digest] for one in offered],
        "uncertainties": [one.case.measurement.uncertainty.tolist() for one in offered],
    }
    what = f"{count(len(offered), 'candidate')} for the next experiment"
    stage = Stage(task, f"next-{calibration.name}", what, inputs, Planned)
    start = WarmStart(stage.file.with_name(f"{stage.name}-rows.npz"), stage.digest, informative_rows)
    block = stage.file.with_suffix(".toml")
    sample = np.empty((0, task.case.parameter_space.n_parameters))
    if known is not None and known.result.sample.is_trusted:
        sample = known.result.sample_theta[: MOST_POINTS - 1]
    return stage.once(
        lambda: _planned(task, calibration, present, offered, criterion, sample, start, block),
        again=again,
        files=[start.file],
        log=log_planned,
    )


def _planned(
    task: Task,
    calibration: Outcome[Calibration],
    present: Offer,
    offered: Sequence[Offer],
    criterion: Criterion,
    sample: FloatArray,
    start: WarmStart,
    block: Path,
) -> Planned:
    space, p = task.case.parameter_space, task.case.parameter_space.n_parameters
    points = space.to_unit(np.concatenate([calibration.result.point[None], sample]))
    points = np.clip(points, 0.0, 1.0)
    with judged_model(task, calibration, start, "correlated") as model:
        problem, known, n_calls = model.problem, model.known, 0
        if model.emulator is None:
            # Slopes of a process are those of the best point alone.
            points, n_calls = points[:1], 2 * p + 1
            known = joined([known, problem.evaluate(difference_rows(points[0], STEP))])
        residuals = emulated_residuals(problem, known, model.emulator)
    raised = model.noise.raised
    slopes = jacobians(residuals, points, residuals(points)) / raised
    now = [one.T @ one for one in slopes]
    spread_now = [covariance(one, problem.prior) for one in now]
    width_now = np.mean([half_widths(one) for one in spread_now], axis=0)
    found = list[tuple[Candidate, Offer, FloatArray | None]]()
    with task.console.bars() as bars:
        for done, offer in enumerate(offered):
            bars("candidates", done, len(offered))
            its = _slopes(task, model, present, offer, space, points)
            n_calls += its.n_calls
            is_own = offer.is_own | (its.only_start if offer.begins_anew else False)
            after = [
                covariance(known_now + information(one / raised, is_own), problem.prior)
                for known_now, one in zip(now[: len(its.slopes)], its.slopes, strict=True)
            ]
            width = np.mean([half_widths(one) for one in after], axis=0)
            before = np.mean([half_widths(one) for one in spread_now[: len(after)]], axis=0)
            limit = half_widths(np.eye(p) / BOX_PRECISION) * DETERMINED * np.sqrt(BOX_PRECISION)
            news = (width < limit) & ~(before < limit)
            candidate = Candidate(
                name=offer.name, what=offer.what, days=offer.days,
                half_widths=dict(zip(space.names, width.tolist(), strict=True)),
                shrinks_to=float(width.mean() / before.mean()),
                merit=float(np.mean([merit(one, criterion) for one in after])),
                determines=tuple(name for name, one in zip(space.names, news, strict=True) if one),
                own=tuple(name for name, one in zip(space.names, is_own, strict=True) if one),
                n_calls=its.n_calls, by_equations=its.solved is not None, excluded=its.excluded,
            )  # fmt: skip
            found.append((candidate, offer, its.solved))
        bars("candidates", len(offered), len(offered))
    found.sort(key=lambda one: (bool(one[0].excluded), one[0].merit))
    (best, offer, solved), error, file = found[0], None, ""
    if not best.excluded:
        if solved is not None:
            error, n_calls = _error(task, offer, space.from_unit(points[:1]), solved), n_calls + 1
        file = _write(task, best, offer, block)
    now_named = dict(zip(space.names, width_now.tolist(), strict=True))
    place = "" if best.excluded else task.paths.recorded(block)
    every = tuple(one for one, *_ in found)
    return Planned(calibration.name, criterion, len(points), now_named, every, place, file, n_calls, error)


class _Slopes(NamedTuple):
    """What a candidate's samples do as parameters move, one over the sensor's share of the first one's.

    Attributes:
        slopes: At each point. Shape (k, m, p). [first output's unit per range]
        only_start: Parameters that act on the start alone, as far as equations say. Shape (p,).
        excluded: Why the candidate is not to be made.
        n_calls: Simulations that they took, none where equations gave them.
        solved: The outputs at the first point by equations, None where they gave no slopes. Shape (t, k).
    """

    slopes: FloatArray
    only_start: BoolArray
    excluded: str
    n_calls: int
    solved: FloatArray | None = None


def _slopes(
    task: Task, model: JudgedModel, present: Offer, offer: Offer, space: ParameterSpace, points: FloatArray
) -> _Slopes:
    p, scaled = space.n_parameters, _scaled(task.case, offer.case)
    equations = _equations_there(model, present, offer.case)
    if equations is not None:
        solved = _solved(equations, offer, space)
        y = solved(points[:1])[0]
        slopes = jacobians(lambda u: scaled(solved(u)), points, scaled(solved(points)))
        if np.isfinite(slopes).all():
            only_start = np.zeros(p, dtype=np.bool_)
            only_start[offer.columns] = _acts_on_start_alone(equations, offer.case.parameter_space)
            return _Slopes(slopes, only_start, _beyond_limits(offer.case, y), 0, y)
    q = offer.columns
    rows = difference_rows(points[0], STEP)[np.concatenate([[0], 1 + q, 1 + p + q])]
    with open_physical_model(task, case=offer.case) as physical:
        answer = physical.simulate(np.ascontiguousarray(space.from_unit(rows)[:, q]))
    slopes = np.zeros((1, scaled(answer.y[:1]).shape[1], p))
    if answer.failed[0]:
        why = f"a simulation failed: {answer.failures[0]}"
        return _Slopes(slopes, np.zeros(p, dtype=np.bool_), why, len(rows))
    slopes[0][:, q] = difference_slopes(rows[:, q], scaled(answer.y)).T
    return _Slopes(slopes, np.zeros(p, dtype=np.bool_), _beyond_limits(offer.case, answer.y[0]), len(rows))


def _scaled(whole: Case, case: Case) -> Residuals:
    """Return what makes a candidate's outputs (n, t, k) residuals (n, m), sampled as often as at present."""
    first, step = float(whole.measurement.uncertainty[0]), case.output_step_s
    parts = [
        (k, max(round(float(np.median(np.diff(one.samples.time))) / step), 1), first / one.uncertainty)
        for k, one in enumerate(case.outputs)
        if one.is_measured and len(one.samples.time) > 1
    ]

    def scaled(y: FloatArray) -> FloatArray:
        return np.concatenate([share * y[:, ::every, k] for k, every, share in parts], axis=1)

    return scaled


def _equations_there(model: JudgedModel, present: Offer, case: Case) -> StateEquations | None:
    """Return the equations of the present experiment as a candidate follows them; None where not known."""
    if model.ode is None or model.emulator is None or why_unwatched(case):
        return None
    equations, own = model.ode.experiments[0].equations, present.case
    if equations is None or equations.signals.n_hidden or not own.differs_in_values(case):
        return None
    mine, there = equations.signals, StateSignals.of(case)
    changed = [(own.fixed[name], value) for name, value in case.fixed.items() if own.fixed[name] != value]
    if changed:
        if not all(
            isinstance(one, float | int) and not isinstance(one, bool) for pair in changed for one in pair
        ):
            return None
        pairs = [(float(here), float(then)) for here, then in changed]
        follower = equations.in_experiment(there, pairs)
        return None if follower is None or follower[1] else follower[0]
    # What an input does is unknown where it rests, unless it rests there, too.
    rests = (mine.driven == mine.driven[0]).all(axis=0)
    if (rests & (there.driven != mine.driven[0]).any(axis=0)).any():
        return None
    course = {key: getattr(there, key) for key in ("driven", "seen", "step_s", "every", "n_before")}
    return equations.with_signals(replace(mine, **course))


def _solved(equations: StateEquations, offer: Offer, space: ParameterSpace) -> Residuals:
    """Return what gives a candidate's outputs at points (n, p) of all parameters. Shape (n, t, k)."""
    own = offer.case.parameter_space

    def solved(u: FloatArray) -> FloatArray:
        theta = space.from_unit(np.clip(u, 0.0, 1.0))[:, offer.columns]
        return equations.outputs(Points.of(own, own.to_unit(np.ascontiguousarray(theta))))

    return solved


def _acts_on_start_alone(equations: StateEquations, space: ParameterSpace) -> BoolArray:
    """Return which of the parameters act on first states alone. Shape (q,)."""
    q = space.n_parameters
    points = Points.of(space, np.concatenate([np.full((1, q), 0.5), 0.5 + 0.17 * np.eye(q)]))
    tables = (*equations.by_term, equations.limits)
    course = np.concatenate([values(table, points) for table in tables if table], axis=1)
    start = values(equations.start, points)
    moves = [(one[1:] != one[0]).any(axis=1) for one in (course, start)]
    return np.asarray(moves[1] & ~moves[0])


def _beyond_limits(case: Case, y: FloatArray) -> str:
    """Say which output a candidate leads beyond its limits, "" for none; y (t, k)."""
    for k, one in enumerate(case.outputs):
        if one.limits is not None and np.any(one.limits.excess(y[:, k]) != 0.0):
            return f"{one.name} leaves its limits"
    return ""


def _error(task: Task, offer: Offer, theta: FloatArray, solved: FloatArray) -> float | None:
    """Return how far equations and one simulation of a candidate differ, over the sensor's uncertainty.

    Args:
        task: The study.
        offer: The candidate.
        theta: All parameters. Shape (1, p). [per parameter]
        solved: What the equations give there. Shape (t, k). [per output]
    """
    with open_physical_model(task, case=offer.case) as physical:
        answer = physical.simulate(np.ascontiguousarray(theta[:, offer.columns]))
    if answer.failed[0]:
        return None
    return float(np.abs((solved - answer.y[0]) / offer.case.measurement.uncertainty).max())


def _write(task: Task, best: Candidate, offer: Offer, block: Path) -> str:
    """Write the tables of the best candidate, and return the place of the inputs that it needs."""
    lines = [f"# The next experiment of {task.label}, for its case file: {best.what}."]
    needs_table = not offer.block.startswith("#")
    if needs_table and not task.case.experiments:
        begin, end = task.case.window_d
        start = task.case.scenario.time_communication[0] / DAY_S
        lines += [
            "# The present recording becomes an experiment, too.",
            "[[experiments]]",
            'name = "recorded"',
        ]
        lines += [f"time = {{ window_d = [{begin:.10g}, {end:.10g}], start_d = {start:.10g} }}", ""]
    lines += [f"# {name}: add per_experiment = true to its [[parameters]]." for name in best.own]
    lines += ["[[experiments]]", f'name = "{best.name}"'] if needs_table else []
    lines += [offer.block]
    place = ""
    if offer.course is not None:
        file = block.with_name(f"{best.name}.csv")
        rows = ([f"{time:.10g}", f"{value:.10g}"] for time, value in offer.course[1].tolist())
        table = io.StringIO()
        csv.writer(table, lineterminator="\n").writerows([("time_s", offer.course[0]), *rows])
        with whole_file(file) as stream:
            stream.write(table.getvalue().encode())
        place = task.paths.recorded(file)
        lines.append(f"# Copy {file.name} to the folder of the recordings.")
    with whole_file(block) as stream:
        stream.write(("\n".join(lines) + "\n").encode())
    return place
