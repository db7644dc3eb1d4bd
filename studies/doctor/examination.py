"""The whole examination, in the order in which errors can occur; slow models get a short one."""

from collections.abc import Generator, Iterator
from contextlib import closing
from dataclasses import replace
from time import monotonic
from typing import cast

import numpy as np

import studies.doctor.answers as answers
import studies.doctor.effects as effects
import studies.doctor.mixups as mixups
from simulation.arrays import FloatArray
from simulation.case import named_experiments, with_step
from simulation.errors import InputError
from simulation.pool.pool_model import PoolModel
from simulation.pool.worker_process import NewProcess
from simulation.trajectories import Trajectories
from studies.circumstances import RowsInCircumstances
from studies.doctor.asking import Asked, TimedModel
from studies.doctor.begin import look_at_begin
from studies.doctor.budget import EXAMINATION_S, SLOWER, TimeBudget
from studies.doctor.declared import look_at_data, look_at_declaration, look_at_number_of_values
from studies.doctor.finding import Diagnosis, Finding, finding, named
from studies.doctor.means import look_at_means, rows_for_means
from studies.doctor.names import look_at_names
from studies.physical_model import checked_file, give_up_reuse, never_reused_file, open_physical_model
from studies.results.saved import write_arrays
from studies.simulation_time import Timed, note_time
from studies.task import Task
from studies.words.console import format_seconds

N_STEPS = 8
N_ORDERED, LEAST_ORDERED, QUICK_S = 8, 2, 0.5
"""Simulations that are repeated in the reverse order where one takes less than QUICK_S [s], and else."""
LEAST_TIMES = 3.0
"""A time-out of fewer times the simulation of the estimates stops rows that are only somewhat harder."""
N_TRIES = 8
"""Points of the box beside its middle, one of which stands for estimates where there are none."""


def examine(task: Task, *, is_thorough: bool = False, limit_s: float = EXAMINATION_S) -> Diagnosis:
    """Examine the case of a study.

    Args:
        task: the case, and how many processes simulate at once.
        is_thorough: whether nothing is left out, however long it takes.
        limit_s: simulating time of an examination that is not thorough; the first simulation may take
            longer. [s]
    """
    case, until = task.case, monotonic() + limit_s
    if not case.experiments:
        one = _Examination(task, is_thorough=is_thorough, limit_s=limit_s)
        findings = (*one.findings(), *one.of_effects())
        note_time(task.paths, case, one.timed)
        return Diagnosis(findings, one.budget.simulation_s)
    found, longest_s, parts = list[Finding](), 0.0, dict[str, effects.Effects | None]()
    timed = list[Timed]()
    members = list(named_experiments(case))
    for n_before, (name, member) in enumerate(members):
        # What one experiment leaves of its share the others have.
        share_s = max(0.0, until - monotonic()) / (len(members) - n_before)
        part, is_first = replace(task, case=member), n_before == 0
        one = _Examination(part, is_thorough=is_thorough, limit_s=share_s, is_first=is_first)
        found += (replace(line, what=f"{name}: {line.what}") for line in one.findings())
        longest_s = max(longest_s, one.budget.simulation_s)
        timed.append(one.timed)
        parts[name] = one.effects
    found.append(look_at_number_of_values(case))
    whole = effects.over_experiments(case, [parts[one.name] for one, _ in case.members])
    found += filter(None, [effects.look_at_effects(whole)])
    # One experiment may have had no time for a simulation.
    if all(one.simulation_s for one in timed):
        note_time(task.paths, case, Timed(*(sum(each) for each in zip(*timed, strict=True))))
    return Diagnosis(tuple(found), longest_s)


class _Examination:
    """What is simulated and judged of a single experiment, and how long that may take.

    Attributes:
        budget: Its time.
        timed: What a simulation takes in a process that is open, and the opening of one; 0 if unknown.
        effects: What parameters do; None where nothing could be simulated.
    """

    def __init__(self, task: Task, *, is_thorough: bool, limit_s: float, is_first: bool = True) -> None:
        self._study, self._case, policy = task, task.case, task.case.policy
        self._base = task.case.parameter_space.expected
        n_workers = min(task.n_jobs, policy.max_workers or task.n_jobs)
        self.budget = TimeBudget(n_workers, is_thorough, policy.timeout_s, limit_s=limit_s)
        self.timed = Timed(0.0)
        self.effects: effects.Effects | None = None
        self._is_random = False
        self._is_first = is_first

    def findings(self) -> list[Finding]:
        """Examine all but what parameters do, which is judged over all experiments."""
        case = self._case
        found = [*look_at_declaration(case), *look_at_data(case), *look_at_begin(case), *look_at_names(case)]
        with (
            self._study.console.progress("examinations", N_STEPS) as advance,
            closing(self._simulated()) as simulated,
        ):
            for step, more in enumerate(simulated, start=1):
                found += more
                advance(min(step, N_STEPS), N_STEPS)
        return found

    def of_effects(self) -> Iterator[Finding]:
        """Say whether every parameter moves an output."""
        if self.effects is not None and (line := effects.look_at_effects(self.effects)):
            yield line

    def _simulated(self) -> Generator[list[Finding]]:
        """Simulate, and judge what comes; ends early where the estimates fail."""
        case, budget = self._case, self.budget
        policy, warn = budget.first_policy(case.policy), self._study.console.warn
        if budget.is_over and not self._is_first:
            budget.left_out.append("all that needs a simulation")
            yield list(self._left_out())
            return
        with PoolModel(case.make_model, 1, policy=policy, on_warning=warn) as alone:
            try:
                began = monotonic()
                nominal = alone.simulate(self._base[None])
                budget.simulation_s = budget.opening_s = monotonic() - began
                self.timed = Timed(budget.simulation_s)
                budget.begin()
            except InputError as error:
                reason = " ".join(str(error).split()).removeprefix(f"{case.fmu.path}: ")
                yield [answers.cannot_open(reason)]
                return
            timed, n_points = TimedModel(alone, budget), 0
            if not effects.has_estimates(case):
                if nominal.failed[0]:
                    yield [answers.middle_fails(case, nominal)]
                nominal, n_points = self._best_point(timed, nominal)
            yield list(answers.look_at_estimates(case, nominal, n_points))
            if nominal.failed[0]:
                return
            if budget.rows("a repetition", 1, at_once=False):
                # Without opening the FMU.
                began = monotonic()
                answer = timed.ask(self._base[None], "a repetition", NewProcess.WHEN_NEEDED)
                if answer.is_whole:
                    budget.simulation_s = monotonic() - began
                yield self._in_any_order(timed)
                self.timed = Timed(alone.simulation_s or budget.simulation_s, alone.opening_s)
            yield from self._in_the_box(nominal, is_first=n_points == 0)
            yield self._in_other_processes(nominal)
        yield list(self._costs())

    def _in_any_order(self, timed: TimedModel) -> list[Finding]:
        """Simulate points in one process, and in another one in the reverse order."""
        what, budget = "the same answer in any order", self.budget
        n = N_ORDERED if budget.simulation_s < QUICK_S else LEAST_ORDERED
        if not budget.rows(what, 2 * n, 2 * n, at_once=False):
            return []
        # Inside the box: at a corner a parameter may do nothing.
        points = np.vstack([self._base, answers.coverage_points(self._case)[: n - 1]])
        orders = points, points[::-1]
        asked = [timed.ask(one, what, NewProcess.AT_FIRST) for one in orders]
        if not all(one.is_whole for one in asked):
            return []
        there, back = asked[0].answer, asked[1].answer.take(np.arange(n)[::-1])
        if (others := np.flatnonzero(answers.differ(there, back))).size:
            twice = timed.ask(points[others[[0, 0]]], what, NewProcess.EACH_ROW)
            if twice.is_whole and answers.differ(*(twice.answer.take([row]) for row in (0, 1)))[0]:
                # Nothing shows what it remembers.
                self._is_random = True
                return [answers.look_at_repeats(*(twice.answer.take([row]) for row in (0, 1)))]
            if not never_reused_file(self._study.paths, self._case).is_file():
                give_up_reuse(self._study)
        return [answers.look_at_order(there, back)]

    def _best_point(self, timed: TimedModel, middle: Trajectories) -> tuple[Trajectories, int]:
        """Begin at the best of some points, where the case has no estimates.

        Returns:
            Its answer, and the number of points.
        """
        case, what = self._case, "points beside the middle"
        n = self.budget.rows(what, N_TRIES, at_once=False)
        tried = timed.ask(answers.coverage_points(case)[:n], what).answer if n else middle.take([])
        points = Trajectories.concatenate([middle, tried])
        mse = np.where(points.failed, np.inf, case.measurement.mse(points.y))
        best = int(np.argmin(mse))
        self._base = points.theta[best]
        return points.take([best]), points.n

    def _in_the_box(self, nominal: Trajectories, *, is_first: bool) -> Iterator[list[Finding]]:
        """Move the parameters, and keep what is simulated."""
        case, budget = self._case, self.budget
        with open_physical_model(self._study, policy=budget.policy(case.policy)) as stored:
            # A single experiment's model is a pool.
            timed = TimedModel(cast("PoolModel", stored.unstored), budget, stored.store)
            timed.add(nominal, is_first=is_first)
            try:
                yield from self._answered(timed, nominal)
            finally:
                write_arrays(checked_file(self._study.paths, case), {"theta": timed.known.theta})

    def _answered(self, timed: TimedModel, nominal: Trajectories) -> Iterator[list[Finding]]:
        """Judge what the box answers."""
        case, budget = self._case, self.budget
        moved = self._moved(timed, nominal)
        points, what = answers.corner_points(case), "corners of the box"
        if n := budget.rows(what, len(points), 2):
            yield list(answers.look_at_corners(timed.ask(points[:n], what).answer))
        points, what = answers.coverage_points(case), "coverage of the measurement"
        if n := budget.rows(what, len(points), 8):
            found = timed.ask(points[:n], what)
            yield list(answers.look_at_coverage(case, found, timed.known))
        if moved is not None:
            self._from_other_points(timed)
            yield self._at_bounds(timed, moved)
        yield self._mixed_up(timed.known)
        yield self._means(timed)

    def _moved(self, timed: TimedModel, nominal: Trajectories) -> Asked | None:
        """Move every parameter from the estimates; None where there is no time for that."""
        case, what = self._case, "influence of the parameters"
        points = effects.moved_points(case, self._base)
        n = self.budget.rows(what, len(points), 2)
        if not n:
            return None
        found = timed.ask(points[: n - n % 2], what)
        found = replace(found, n=len(points))
        self.effects = effects.Effects.of(case, nominal, found.whole(points))
        return found

    def _from_other_points(self, timed: TimedModel) -> None:
        """Move parameters that seem to do nothing from other points: the middle of a wide box says little."""
        for other in effects.other_points(self._case, timed.known).theta:
            found = self.effects
            if found is None or not len(idle := found.seem_idle):
                return
            points = effects.moved_points(self._case, other, idle)
            what = "influence from other points"
            if not self.budget.rows(what, len(points), len(points)):
                return
            answer = timed.ask(points, what)
            base = timed.ask(other[None], what).one(0)
            if base is not None:
                there = effects.influence(self._case, base, answer.whole(points))
                self.effects = found.also(idle, there)

    def _at_bounds(self, timed: TimedModel, moved: Asked) -> list[Finding]:
        """Say from where on bounds fail."""
        answer, budget = moved.answer, self.budget
        n_rows = answers.N_HALVINGS * int(answer.failed.sum())
        is_traced = n_rows > 0 and budget.rows("from where on bounds fail", n_rows, n_rows) > 0
        found = answers.look_at_bounds(
            self._case, self._base, answer, moved.rows, timed if is_traced else None
        )
        return list(found)

    def _mixed_up(self, known: Trajectories) -> list[Finding]:
        """Try other orders and signs of columns, where nothing fits well."""
        case = self._case
        # Few simulations may all be poor by chance.
        if known.n < mixups.N_POINTS or mixups.fits_well(case, known):
            return []
        better = mixups.better_outputs(case, known)
        better += self._better_inputs(known)
        return [*mixups.look_at_mixups(better), *mixups.look_at_scales(case, known)]

    def _means(self, timed: TimedModel) -> list[Finding]:
        """Look whether samples are means, once all else is known: that takes the most simulations."""
        n, what = rows_for_means(self._case), "means or moments"
        if not n or not self.budget.rows(what, n, n, at_once=False):
            return []

        # Hundreds of rows, and it is known whether one changes the next.
        is_forgotten = not never_reused_file(self._study.paths, self._case).is_file()
        new_process = NewProcess.WHEN_NEEDED if is_forgotten else None

        def simulate(theta: FloatArray) -> Trajectories:
            return timed.ask(theta, what, new_process).whole(theta)

        return list(look_at_means(self._case, simulate, timed.known))

    def _better_inputs(self, known: Trajectories) -> list[mixups.Better]:
        case, budget = self._case, self.budget
        others, points = mixups.input_mixups(case), mixups.points_to_try(case, known)
        if not others:
            return []
        model = RowsInCircumstances(tuple(one.settings for one in others), points)
        policy = budget.policy(case.policy, SLOWER * budget.opening_s)
        n_first, what = min(mixups.N_FIRST, len(points)), "other orders and signs of columns"
        if not budget.rows(what, len(others) * n_first, len(others) * n_first):
            return []
        with PoolModel(model.open, budget.n_workers, policy=policy) as pool:
            timed, tried = TimedModel(pool, budget), list[tuple[mixups.Mixup, Trajectories]]()
            for number, other in enumerate(others):
                rows = np.column_stack([np.full(len(points), number), np.arange(len(points))]).astype(float)
                answer = timed.ask(rows[:n_first], what).answer
                good = answer.take(~answer.failed)
                if not mixups.may_fit(case, known, points[good.theta[:, 1].astype(int)], good):
                    continue
                if budget.rows(what, len(rows) - n_first, 1):
                    answer = Trajectories.concatenate([answer, timed.ask(rows[n_first:], what).answer])
                tried.append((other, answer))
        return mixups.better_inputs(case, known, tried)

    def _in_other_processes(self, nominal: Trajectories) -> list[Finding]:
        """Ask the estimates in another process: as they are, at half the step, with other inputs."""
        case, budget, names = self._case, self.budget, self._case.scenario.input_names
        halved, what = (
            with_step(case, case.communication_step_s / 2.0),
            "another process, half the step, other inputs",
        )
        model = answers.circumstances(case, halved, self._base)
        policy = budget.policy(case.policy, SLOWER * budget.opening_s)
        with PoolModel(model.open, min(budget.n_workers, 2 + len(names)), policy=policy) as other:
            n = budget.rows(what, 3 + len(names), 3)
            if not n:
                return []
            asked = TimedModel(other, budget).ask(np.arange(n - 1, dtype=np.float64)[:, None], what)
        fresh, half = asked.one(0), asked.one(1)
        findings = []
        if fresh is not None and not self._is_random:
            findings.append(answers.look_at_repeats(nominal, fresh))
        if half is not None:
            findings.append(answers.look_at_halving(case, halved, nominal, half))
        if (changed := asked.answer.take(asked.rows > 1)).n:
            findings.append(
                answers.look_at_inputs([names[row - 2] for row in asked.rows if row > 1], nominal, changed)
            )
        return findings

    def _costs(self) -> Iterator[Finding]:
        """Say what a simulation takes, and name a time-out that is near to it."""
        timeout_s = self._case.policy.timeout_s
        yield finding("cost", "ok", each=self._each, command=self._study.command)
        if timeout_s is not None and timeout_s < LEAST_TIMES * self.budget.simulation_s:
            yield finding("timeout", limit=f"{timeout_s:g} s", each=self._each)
        yield from self._left_out()

    def _left_out(self) -> Iterator[Finding]:
        """Say what the time was not enough for."""
        limit, command = format_seconds(self.budget.limit_s), self._study.command
        left_out = list(dict.fromkeys(self.budget.left_out))
        yield from named("left-out", left_out, "; ", each=self._each, command=command, limit=limit)

    @property
    def _each(self) -> str:
        """What a simulation takes, in words."""
        simulation_s = self.budget.simulation_s
        return f"{1000.0 * simulation_s:.3g} ms" if simulation_s < 1.0 else format_seconds(simulation_s)
