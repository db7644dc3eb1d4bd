"""The whole examination, in the order in which errors can occur; slow models get a short one."""

import time
from collections.abc import Generator, Iterator
from contextlib import closing
from dataclasses import dataclass, field, replace

import numpy as np

import studies.doctor.answers as answers
from simulation.arrays import FloatArray
from simulation.case import named_experiments, with_step
from simulation.errors import InputError
from simulation.forward_model import ForwardModel, WrappedModel
from simulation.pool.execution import ExecutionPolicy
from simulation.pool.pool_model import PoolModel
from simulation.store.stored_model import StoredModel
from simulation.trajectories import Trajectories
from studies.console import format_seconds
from studies.doctor.begin import look_at_begin
from studies.doctor.declared import look_at_data, look_at_declaration
from studies.doctor.finding import STOPPED, Diagnosis, Finding, finding, named
from studies.doctor.means import look_at_means, rows_for_means
from studies.doctor.names import look_at_names
from studies.physical_model import open_physical_model
from studies.stages.pipeline import Study

N_STEPS = 7
PIECE = 8
"""Simulations of each worker between two looks at the clock."""
LEAST_TIMES = 3.0
"""A time-out of fewer times the simulation of the estimates stops rows that are only somewhat harder."""


def examine(study: Study, *, is_thorough: bool = False) -> Diagnosis:
    """Examine the case of a study.

    Args:
        study: the case, and how many processes simulate at once.
        is_thorough: whether nothing is left out, however long it takes.
    """
    if not study.case.experiments:
        return _examine(study, is_thorough=is_thorough)
    findings, longest_s = list[Finding](), 0.0
    for name, case in named_experiments(study.case):
        found = _examine(replace(study, case=case), is_thorough=is_thorough)
        findings += (replace(one, what=f"{name}: {one.what}") for one in found.findings)
        longest_s = max(longest_s, found.simulation_s)
    return Diagnosis(tuple(findings), longest_s)


def _examine(study: Study, *, is_thorough: bool) -> Diagnosis:
    """Examine a single experiment."""
    case = study.case
    examination = _Examination(study, is_thorough=is_thorough)
    findings = [*look_at_declaration(case), *look_at_data(case), *look_at_begin(case), *look_at_names(case)]
    with (
        study.console.progress("examinations", N_STEPS) as advance,
        closing(examination.simulated()) as simulated,
    ):
        for step, found in enumerate(simulated, start=1):
            findings += found
            advance(min(step, N_STEPS), N_STEPS)
    return Diagnosis(tuple(findings), examination.budget.simulation_s)


class _Examination:
    """What is simulated and judged, and how long that may take."""

    def __init__(self, study: Study, *, is_thorough: bool) -> None:
        self._study, self._case, policy = study, study.case, study.case.policy
        self._base = study.case.parameter_space.expected
        n_workers = min(study.n_jobs, policy.max_workers or study.n_jobs)
        self._covering: Trajectories | None = None
        self.budget = TimeBudget(n_workers, is_thorough, policy.timeout_s)

    def simulated(self) -> Generator[list[Finding]]:
        """Simulate, and judge what comes; ends early where the estimates fail."""
        case, base, budget = self._case, self._base, self.budget
        policy, warn = self._policy(FIRST_S), self._study.console.warn
        with PoolModel(case.make_model, 1, policy=policy, on_warning=warn) as alone:
            try:
                nominal, budget.opening_s = _timed(alone, base)
                budget.simulation_s = budget.opening_s
            except InputError as error:
                reason = " ".join(str(error).split()).removeprefix(f"{case.fmu.path}: ")
                yield [answers.cannot_open(reason)]
                return
            yield list(answers.look_at_estimates(case, nominal))
            if nominal.failed[0]:
                return
            again = []
            if budget.rows("a repetition", 3, at_once=False):
                # Without opening the FMU; and after a row that is not the estimates.
                answer, budget.simulation_s = _timed(alone, base)
                # Inside the box: at a corner a parameter may do nothing.
                after = alone.simulate(np.stack([answers.coverage_points(case)[0], base]))
                again = [answer, after.take([1])]
                if budget.rows("the same answer in any order", 1, at_once=False):
                    later = after.take([0])
                    with PoolModel(case.make_model, 1, policy=policy) as other:
                        yield [answers.look_at_order(later, other.simulate(later.theta))]
            yield from self._in_the_box(nominal)
            yield self._in_other_processes(nominal, again)
            yield self._means()
        yield list(self._costs())

    def _in_the_box(self, nominal: Trajectories) -> Iterator[list[Finding]]:
        """Move the parameters, and keep what is simulated."""
        case, budget = self._case, self.budget
        with open_physical_model(self._study, policy=self._policy(budget.usual_s)) as stored:
            model = _StoringModel(stored)
            model.store_finished(nominal)
            if n := budget.rows("influence of the parameters", 2 * len(self._base), 2):
                yield list(self._influence(model, nominal, n - n % 2))
            points, what = answers.corner_points(case), "corners of the box"
            if n := budget.rows(what, len(points), 2):
                yield [answers.look_at_corners(self._in_pieces(model, points[:n], what))]
            points, what = answers.coverage_points(case), "coverage of the measurement"
            if n := budget.rows(what, len(points), 8):
                self._covering = self._in_pieces(model, points[:n], what)
                yield [answers.look_at_coverage(case, self._covering)]

    def _in_pieces(self, model: ForwardModel, theta: FloatArray, what: str) -> Trajectories:
        """Simulate until the time is over, at least one piece: rows that hang must not eat up hours."""
        size, budget = PIECE * self.budget.n_workers, self.budget
        parts = [model.simulate(theta[:size])]
        for start in range(size, len(theta), size):
            if budget.is_over:
                budget.left_out.append(f"{what} ({start} of {len(theta)} simulations)")
                break
            parts.append(model.simulate(theta[start : start + size]))
        return Trajectories.concatenate(parts)

    def _influence(self, model: ForwardModel, nominal: Trajectories, n: int) -> Iterator[Finding]:
        """Move every parameter; where one does nothing, once more from another point."""
        case = self._case
        answer = model.simulate(answers.moved_points(case, self._base)[:n])
        most = share = answers.influence(case, nominal, answer)
        if not (share > answers.SAME).all():
            other = answers.coverage_points(case)[0]
            moved = model.simulate(np.vstack([other, answers.moved_points(case, other)[:n]]))
            if not moved.failed[0]:
                there = answers.influence(case, moved.take([0]), moved.take(np.arange(1, n + 1)))
                most = np.fmax(share, there)
        yield answers.look_at_influence(case, share, most)
        n_rows = answers.N_HALVINGS * int(answer.failed.sum())
        is_traced = n_rows > 0 and self.budget.rows("from where on bounds fail", n_rows, n_rows) > 0
        yield from answers.look_at_bounds(case, self._base, answer, model if is_traced else None)

    def _in_other_processes(self, nominal: Trajectories, again: list[Trajectories]) -> list[Finding]:
        """Ask the estimates in another process: as they are, at half the step, with other inputs."""
        case, budget, names = self._case, self.budget, self._case.scenario.input_names
        halved = with_step(case, case.communication_step_s / 2.0)
        model = answers.circumstances(case, halved, self._base)
        policy = self._policy(budget.usual_s, SLOWER * budget.opening_s)
        with PoolModel(model.open, min(budget.n_workers, 2 + len(names)), policy=policy) as other:
            n = budget.rows("another process, half the step, other inputs", 3 + len(names), 3)
            if not n:
                return []
            answer = other.simulate(np.arange(n - 1, dtype=np.float64)[:, None])
        asked = names[: n - 3]
        findings = [answers.look_at_repeats(nominal, again, answer.take([0]))] if again else []
        findings.append(answers.look_at_halving(case, halved, nominal, answer.take([1])))
        if asked:
            changed = answer.take(np.arange(2, 2 + len(asked)))
            findings.append(answers.look_at_inputs(asked, nominal, changed))
        return findings

    def _means(self) -> list[Finding]:
        """Look whether samples are means, once all else is known: that takes the most simulations."""
        case, budget, n = self._case, self.budget, rows_for_means(self._case)
        if self._covering is None or not n or not budget.rows("means or moments", n, n, at_once=False):
            return []
        with open_physical_model(self._study, policy=self._policy(budget.usual_s)) as stored:
            return list(look_at_means(case, _StoringModel(stored), self._covering))

    def _costs(self) -> Iterator[Finding]:
        """Say what a simulation takes, and name a time-out that is near to it."""
        command, simulation_s = self._study.command, self.budget.simulation_s
        timeout_s = self._case.policy.timeout_s
        each = f"{1000.0 * simulation_s:.3g} ms" if simulation_s < 1.0 else format_seconds(simulation_s)
        yield finding("cost", "ok", each=each, command=command)
        if timeout_s is not None and timeout_s < LEAST_TIMES * simulation_s:
            yield finding("timeout", limit=f"{timeout_s:g} s", each=each)
        yield from named("left-out", self.budget.left_out, "; ", each=each, command=command)

    def _policy(self, usual_s: float, more_s: float = 0.0) -> ExecutionPolicy:
        """Return the case's policy with the time-out of the budget and without an end when many fail."""
        timeout_s = self.budget.timeout(usual_s, more_s)
        return replace(self._case.policy, timeout_s=timeout_s, max_failed_share=1.0)


def _timed(model: ForwardModel, row: FloatArray) -> tuple[Trajectories, float]:
    started = time.perf_counter()
    answer = model.simulate(row[None])
    return answer, time.perf_counter() - started


class _StoringModel(WrappedModel):
    """A stored model that does not store rows that took too long, as others may wait longer for them."""

    def __init__(self, model: StoredModel) -> None:
        """Wrap a stored model.

        Args:
            model: The model to ask.
        """
        super().__init__(model)
        self._stored = model

    def simulate(self, theta: FloatArray) -> Trajectories:
        """Read the rows that are stored and simulate the others.

        Args:
            theta: Parameters, no row twice. Shape (n, p). [per parameter]
        """
        missing = self._stored.missing(theta)
        known, new = np.flatnonzero(~missing), np.flatnonzero(missing)
        parts = [self._stored.store.read(theta[known])] if len(known) else []
        if len(new):
            parts.append(self._stored.unstored.simulate(theta[new]))
            self.store_finished(parts[-1])
        return Trajectories.concatenate(parts).take(np.argsort(np.concatenate([known, new])))

    def store_finished(self, rows: Trajectories) -> None:
        """Store rows of any model that finished, unless they are stored."""
        finished = np.array([STOPPED not in reason for reason in rows.failures], dtype=np.bool_)
        self._stored.store.append(rows.take(finished & ~self._stored.store.find(rows.theta)))


EXAMINATION_S = 120.0
"""Simulating time of an examination that is not thorough. [s]"""
FIRST_S = 600.0
"""Longest that the first simulation may take where the case names no time-out. [s]"""
SLOWER = 20.0
"""A row may take so many times what the estimates take, and LEAST_S more: corners are harder for a solver."""
LEAST_S = 5.0


@dataclass
class TimeBudget:
    """Time of an examination, and what had to be left out to keep it.

    Args:
        n_workers: simulations at once.
        is_thorough: nothing is left out.
        timeout_s: time-out of the case, None for none. [s]
        simulation_s: time of one simulation, once it is known. [s]
        opening_s: time of the first one, with the start of its process and the opening of the FMU. [s]
        left_out: examinations cut short, with what was done instead.
    """

    n_workers: int
    is_thorough: bool
    timeout_s: float | None
    simulation_s: float = 0.0
    opening_s: float = 0.0
    left_out: list[str] = field(default_factory=list)
    _started: float = field(default_factory=time.perf_counter)

    @property
    def is_over(self) -> bool:
        """Whether no further simulation should start."""
        return not self.is_thorough and time.perf_counter() - self._started > EXAMINATION_S

    @property
    def usual_s(self) -> float:
        """Time-out of all simulations but the first, where the case names none. [s]."""
        return LEAST_S + SLOWER * self.simulation_s

    def timeout(self, usual_s: float, more_s: float) -> float | None:
        """Return a time-out: the case's, else the usual one, which a thorough examination does without. [s].

        Args:
            usual_s: the usual one. [s]
            more_s: time that is added to either. [s]
        """
        timeout_s = usual_s if self.timeout_s is None and not self.is_thorough else self.timeout_s
        return None if timeout_s is None else timeout_s + more_s

    def rows(self, what: str, wanted: int, least: int = 1, *, at_once: bool = True) -> int:
        """Return how many simulations an examination may have, and remember what it has to do without.

        Args:
            what: the examination, in words.
            wanted: simulations it asks for.
            least: fewer say nothing.
            at_once: whether all workers share them.
        """
        if self.is_thorough:
            return wanted
        left = EXAMINATION_S - (time.perf_counter() - self._started)
        rounds = int(left / self.simulation_s) if self.simulation_s > 0.0 else wanted
        affordable = max(0, rounds) * (self.n_workers if at_once else 1)
        if affordable >= wanted:
            return wanted
        given = affordable if affordable >= least else 0
        self.left_out.append(f"{what} ({given} of {wanted} simulations)" if given else what)
        return given
