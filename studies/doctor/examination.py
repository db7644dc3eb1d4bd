"""The whole examination, in the order in which things can go wrong; slow models get a short one."""

import time
from collections.abc import Callable, Generator, Iterator
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass, replace

import numpy as np

from simulation.arrays import FloatArray
from simulation.case import Case
from simulation.errors import InputError
from simulation.forward_model import ForwardModel
from simulation.pool.execution import ExecutionPolicy
from simulation.pool.pool_model import PoolModel
from simulation.trajectories import Trajectories
from studies.circumstances import RestartModel
from studies.console import Console, format_seconds
from studies.doctor.answers import (
    N_CORNERS,
    N_COVERAGE,
    SAME,
    Estimates,
    cannot_open,
    corner_points,
    coverage_points,
    influence,
    look_at_corners,
    look_at_coverage,
    look_at_estimates,
    look_at_influence,
    look_at_inputs,
    moved_points,
)
from studies.doctor.cost import planned_simulations, tell_cost, tell_timeout
from studies.doctor.declared import base_point, look_at_data, look_at_declaration
from studies.doctor.finding import Diagnosis, Finding
from studies.doctor.keeping import KeepingModel
from studies.doctor.patience import Patience
from studies.doctor.region import N_HALVINGS, look_at_bounds
from studies.doctor.repeats import (
    MEMORY_S,
    N_MEMORY,
    look_at_memory,
    look_at_order,
    look_at_repeats,
    look_at_restart,
    memory_in_use,
)
from studies.doctor.variants import circumstances, look_at_halving
from studies.profile import Profile

N_STEPS = 8
PIECE = 8
"""Simulations of each worker between two looks at the clock."""
OpenModel = Callable[[ExecutionPolicy], AbstractContextManager[KeepingModel]]
"""Opens the case's model for batches, with all workers; what it is asked is stored."""


@dataclass(frozen=True)
class Surgery:
    """What the doctor has at hand.

    Attributes:
        case: the case.
        halved: the same case at half the communication step.
        profile: the budget whose cost is said.
        open_model: opens the model for batches.
        n_workers: processes that simulate at once.
        command: what was typed, to ask for a thorough examination.
        console: shows how far the examination is.
    """

    case: Case
    halved: Case
    profile: Profile
    open_model: OpenModel
    n_workers: int
    command: str
    console: Console


def examine(surgery: Surgery, *, is_thorough: bool = False) -> Diagnosis:
    """Examine a case.

    Args:
        surgery: the case, and what it is examined with.
        is_thorough: whether nothing is left out, however long it takes.
    """
    case = surgery.case
    patience = Patience(surgery.n_workers, is_thorough, case.policy.timeout_s)
    findings = [*look_at_declaration(case), *look_at_data(case)]
    with (
        surgery.console.progress("examinations", N_STEPS) as advance,
        closing(_simulated(surgery, patience)) as simulated,
    ):
        for step, found in enumerate(simulated, start=1):
            findings += found
            advance(min(step, N_STEPS), N_STEPS)
    planned = planned_simulations(case, surgery.profile)
    return Diagnosis(tuple(findings), patience.simulation_s, planned)


def _simulated(surgery: Surgery, patience: Patience) -> Generator[list[Finding]]:
    """Simulate, and judge what comes; ends early where the estimates fail."""
    case, base = surgery.case, base_point(surgery.case.parameter_space)
    policy, warn = _policy(case, patience.first_timeout_s), surgery.console.warn
    with PoolModel(case.make_model, 1, policy=policy, on_warning=warn) as alone:
        try:
            nominal, patience.opening_s = _timed(alone, base)
            patience.simulation_s = patience.opening_s
        except InputError as error:
            yield [cannot_open(_in_short(error, case))]
            return
        yield list(look_at_estimates(case, nominal))
        if nominal.failed[0]:
            return
        estimates = Estimates(base, nominal)
        again = []
        if patience.rows("a repetition", 3, at_once=False):
            # Without opening the FMU; and after a row that is not the estimates.
            answer, patience.simulation_s = _timed(alone, base)
            # Inside the box: at a corner a parameter may do nothing.
            after = alone.simulate(np.stack([coverage_points(case, 1)[0], base]))
            again = [answer, after.take([1])]
            if patience.rows("starting the FMU over", 4, at_once=False):
                yield _restart(case, patience, after.take([0]), base)
        yield from _in_the_box(surgery, patience, estimates)
        yield _elsewhere(surgery, patience, estimates, again)
        yield [*_memory(surgery, patience, alone, base)]
    yield [*_costs(surgery, patience)]


def _restart(case: Case, patience: Patience, later: Trajectories, other: FloatArray) -> list[Finding]:
    """Ask a row as the first of a process that was answered after others in another."""
    model = RestartModel(case.settings, later.theta[0], other)
    policy = _policy(case, patience.with_opening(patience.first_timeout_s))
    with PoolModel(model.open, 1, policy=policy) as alone:
        answer = alone.simulate(np.zeros((1, 1)))
    first = replace(later, y=answer.y[:, :, :-1], failures=answer.failures)
    found = look_at_restart(answer)
    return [look_at_order(later, first), *([] if found is None else [found])]


def _in_the_box(surgery: Surgery, patience: Patience, estimates: Estimates) -> Iterator[list[Finding]]:
    """Move the parameters, and keep what is simulated."""
    case, p = surgery.case, surgery.case.parameter_space.n_parameters
    with surgery.open_model(_policy(case, patience.row_timeout_s)) as model:
        model.keep(estimates.nominal)
        if n := patience.rows("influence of the parameters", 2 * p, 2):
            yield _influence(case, model, estimates, n - n % 2, patience)
        what = "corners of the box"
        if n := patience.rows(what, len(corner_points(case, N_CORNERS)), 2):
            answer = _in_pieces(model, corner_points(case, n), what, patience)
            yield [look_at_corners(case.parameter_space, answer)]
        what = "coverage of the measurement"
        if n := patience.rows(what, N_COVERAGE, 8):
            yield [look_at_coverage(case, _in_pieces(model, coverage_points(case, n), what, patience))]


def _in_pieces(model: ForwardModel, theta: FloatArray, what: str, patience: Patience) -> Trajectories:
    """Simulate until patience ends, at least one piece: rows that hang must not eat up hours."""
    size = PIECE * patience.n_workers
    parts = [model.simulate(theta[:size])]
    for start in range(size, len(theta), size):
        if patience.is_over:
            patience.left_out.append(f"{what} ({start} of {len(theta)} simulations)")
            break
        parts.append(model.simulate(theta[start : start + size]))
    return Trajectories.concatenate(parts)


def _influence(
    case: Case, model: ForwardModel, estimates: Estimates, n: int, patience: Patience
) -> list[Finding]:
    """Move every parameter; where a bound fails, find out from where on."""
    answer = model.simulate(moved_points(case, estimates.theta)[:n])
    found = [_moves(case, model, influence(case, estimates, answer))]
    n_rows = N_HALVINGS * int(answer.failed.sum())
    is_told = n_rows > 0 and patience.rows("from where on bounds fail", n_rows, n_rows) > 0
    bounds = look_at_bounds(case, estimates.theta, answer, model if is_told else None)
    return found if bounds is None else [*found, bounds]


def _moves(case: Case, model: ForwardModel, share: FloatArray) -> Finding:
    """Judge what every parameter moves; where one does nothing, ask once more from another point."""
    n = 2 * len(share)
    if (share > SAME).all():
        return look_at_influence(case, share, None)
    other = coverage_points(case, 1)[0]
    answer = model.simulate(np.vstack([other, moved_points(case, other)[:n]]))
    if answer.failed[0]:
        return look_at_influence(case, share, None)
    moved = influence(case, Estimates(other, answer.take([0])), answer.take(np.arange(1, n + 1)))
    return look_at_influence(case, share, moved)


def _elsewhere(
    surgery: Surgery, patience: Patience, estimates: Estimates, again: list[Trajectories]
) -> list[Finding]:
    """Ask the estimates in another process: as they are, at half the step, with other inputs."""
    case, names = surgery.case, surgery.case.scenario.input_names
    model = circumstances(case, surgery.halved, estimates.theta)
    policy = _policy(case, patience.with_opening(patience.row_timeout_s))
    with PoolModel(model.open, min(surgery.n_workers, 2 + len(names)), policy=policy) as elsewhere:
        n = patience.rows("another process, half the step, other inputs", 3 + len(names), 3)
        if not n:
            return []
        answer = elsewhere.simulate(np.arange(n - 1, dtype=np.float64)[:, None])
    findings = [look_at_repeats(estimates.nominal, again, answer.take([0]))] if again else []
    findings.append(look_at_halving(case, surgery.halved, estimates, answer.take([1])))
    if n > 3:
        asked = names[: n - 3]
        findings.append(look_at_inputs(asked, estimates, answer.take(np.arange(2, 2 + len(asked)))))
    return findings


def _memory(surgery: Surgery, patience: Patience, model: ForwardModel, base: FloatArray) -> Iterator[Finding]:
    n = min(N_MEMORY, int(MEMORY_S / patience.simulation_s)) if patience.simulation_s > 0.0 else N_MEMORY
    if n < 20:
        return
    # The first rows fill caches; what comes after them should not.
    model.simulate(np.tile(base, (n // 4, 1)))
    before, started = memory_in_use(), time.perf_counter()
    model.simulate(np.tile(base, (n, 1)))
    # Of many rows, handing over one has no weight.
    patience.simulation_s = (time.perf_counter() - started) / n
    total = sum(planned_simulations(surgery.case, surgery.profile).values())
    yield look_at_memory(memory_in_use() - before, n, total)


def _costs(surgery: Surgery, patience: Patience) -> Iterator[Finding]:
    case = surgery.case
    yield tell_timeout(case, patience.simulation_s)
    yield tell_cost(case, surgery.profile, patience.simulation_s, surgery.n_workers)
    if patience.left_out:
        yield Finding(
            "left out",
            "warn",
            f"a simulation takes {format_seconds(patience.simulation_s)}: {'; '.join(patience.left_out)}",
            f"to have everything examined: {surgery.command} --thorough",
        )


def _policy(case: Case, timeout_s: float | None) -> ExecutionPolicy:
    """Return the case's patience, with the doctor's time-out and without an end when many fail."""
    return replace(case.policy, timeout_s=timeout_s, max_failed_share=1.0)


def _timed(model: ForwardModel, row: FloatArray) -> tuple[Trajectories, float]:
    started = time.perf_counter()
    answer = model.simulate(row[None])
    return answer, time.perf_counter() - started


def _in_short(error: InputError, case: Case) -> str:
    return " ".join(str(error).split()).removeprefix(f"{case.fmu.path}: ")
