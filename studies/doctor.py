"""The doctor: is a case sound, what will it cost, and what to do about what is wrong."""

import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from simulation.arrays import FloatArray
from simulation.case import Case
from simulation.design import uniform_design
from simulation.forward_model import ForwardModel
from simulation.trajectories import Trajectories
from studies.console import Column, Console, format_seconds
from studies.profile import Profile
from studies.report.wording import count

Level = Literal["ok", "warn", "fail"]
N_CORNERS, N_COVERAGE = 32, 64
DOCTOR_SEED = 12_345
SAME = 1e-9
"""Two answers of one model to one question differ by no more than this. [output's unit]"""
STEP_SHARE = 0.2
"""Halving the communication step may change the output by this share of the sensor's uncertainty."""
UNSEEN_SHARE = 0.01
"""A parameter that moves the output by less than this share of the uncertainty cannot be identified."""
COVERED_SHARE = 0.9
"""Part of the measurement that should lie within the simulated envelope."""


@dataclass(frozen=True)
class Finding:
    """One thing the doctor looked at.

    Args:
        what: what was examined.
        level: ok, warn (the study can go on) or fail (it cannot).
        found: what was found, with numbers.
        remedy: what to do; empty when all is well.
    """

    what: str
    level: Level
    found: str
    remedy: str = ""


@dataclass(frozen=True)
class Diagnosis:
    """All findings about a case.

    Args:
        findings: one per examination.
        simulation_s: time of one simulation. [s]
        planned_simulations: simulations the profile asks for, by purpose.
    """

    findings: tuple[Finding, ...]
    simulation_s: float
    planned_simulations: dict[str, int]

    @property
    def is_sound(self) -> bool:
        """Whether nothing failed."""
        return all(finding.level != "fail" for finding in self.findings)

    def to_dict(self) -> dict[str, Any]:
        """Return the diagnosis as JSON values."""
        return {
            "sound": self.is_sound,
            **asdict(self),
            "findings": [asdict(found) for found in self.findings],
        }


def examine(case: Case, profile: Profile, *, halved: Case, console: Console) -> Diagnosis:
    """Examine a case.

    Args:
        case: the case.
        profile: the budget whose cost is told.
        halved: the same case at half the communication step.
        console: shows how far the examination is.
    """
    findings = [_declaration(case), _data(case)]
    base = _base_point(case)
    with console.progress("examinations", 7) as advance, case.open_model() as model:
        model.simulate(base[None])
        started = time.perf_counter()
        nominal = model.simulate(base[None])
        simulation_s = time.perf_counter() - started
        findings.append(_nominal(case, nominal))
        advance(1, 7)
        if nominal.failed[0]:
            planned = _planned(case, profile)
            return Diagnosis(tuple(findings), simulation_s, planned)
        findings.append(_corners(case, model))
        advance(2, 7)
        findings.append(_coverage(case, model))
        advance(3, 7)
        findings.extend(_influence(case, model, base, nominal))
        advance(4, 7)
        again = model.simulate(base[None])
        advance(5, 7)
    with case.open_model() as fresh:
        findings.append(_reuse(nominal, again, fresh.simulate(base[None])))
    findings.append(_halving(case, halved, base, nominal))
    planned = _planned(case, profile)
    findings.append(_cost(profile, simulation_s, planned))
    return Diagnosis(tuple(findings), simulation_s, planned)


def show_diagnosis(console: Console, label: str, diagnosis: Diagnosis) -> None:
    """Print the findings as a table, and what they come to."""
    console.table(
        f"{label}: what the doctor found",
        [Column("examined"), Column("result"), Column("found"), Column("what to do")],
        [[found.what, found.level, found.found, found.remedy] for found in diagnosis.findings],
    )
    levels = [finding.level for finding in diagnosis.findings]
    words = f"{levels.count('fail')} failed, {levels.count('warn')} to look at, {levels.count('ok')} good"
    console.result(f"{label}: {words}")


def _base_point(case: Case) -> FloatArray:
    """Return the estimates, the middle of the bounds where there is none. Shape (p,)."""
    space = case.parameter_space
    middle = space.from_unit(np.full(space.n_parameters, 0.5))
    estimates = [parameter.estimate for parameter in space.parameters]
    return np.array([m if e is None else e for e, m in zip(estimates, middle, strict=True)])


def _declaration(case: Case) -> Finding:
    n_inputs = len(case.scenario.input_names)
    return Finding(
        "names, units, bounds",
        "ok",
        f"{case.parameter_space.n_parameters} parameters, {n_inputs} inputs and "
        f"{count(len(case.outputs), 'output')} are in {case.fmu_path.name}, units agree",
    )


def _data(case: Case) -> Finding:
    measurement = case.measurement
    begin, end = case.window_d
    return Finding(
        "data",
        "ok",
        f"days {begin:g} to {end:g} are covered: {len(measurement.time)} measured values per output, "
        f"inputs every {case.communication_step_s:g} s",
    )


def _nominal(case: Case, nominal: Trajectories) -> Finding:
    if nominal.failed[0]:
        return Finding(
            "estimates",
            "fail",
            f"cannot be simulated: {nominal.failures[0]}",
            "correct the estimates or the FMU; try the FMU in another tool",
        )
    mse = float(np.mean((nominal.y[0] - case.measurement.y) ** 2))
    unit = case.outputs[0].unit
    low, high = float(nominal.y.min()), float(nominal.y.max())
    return Finding("estimates", "ok", f"MSE {mse:.4g}, output from {low:.2f} to {high:.2f} {unit}")


def _corners(case: Case, model: ForwardModel) -> Finding:
    space = case.parameter_space
    sides = np.random.default_rng(DOCTOR_SEED).integers(0, 2, (N_CORNERS, space.n_parameters))
    sides[0], sides[1] = 0, 1
    answer = model.simulate(space.from_unit(sides.astype(np.float64)))
    n_failed = int(answer.failed.sum())
    if not n_failed:
        return Finding("corners of the box", "ok", f"{N_CORNERS} corners were simulated")
    reason = next(reason for reason in answer.failures if reason)
    return Finding(
        "corners of the box",
        "fail" if n_failed == N_CORNERS else "warn",
        f"{n_failed} of {N_CORNERS} corners failed, the first one: {reason}",
        "narrow the bounds where the model breaks; failed rows are left out of training",
    )


def _coverage(case: Case, model: ForwardModel) -> Finding:
    answer = model.simulate(uniform_design(case.parameter_space, N_COVERAGE, DOCTOR_SEED))
    good = answer.y[~answer.failed]
    if len(good) < 2:
        return Finding(
            "box", "fail", f"{int(answer.failed.sum())} of {N_COVERAGE} failed", "narrow the bounds"
        )
    measured = case.measurement.y
    inside = float(np.mean((measured >= good.min(axis=0)) & (measured <= good.max(axis=0))))
    failed = f", {int(answer.failed.sum())} of {N_COVERAGE} failed" if answer.failed.any() else ""
    return Finding(
        "box covers the measurement",
        "ok" if inside >= COVERED_SHARE else "warn",
        f"{inside:.0%} of the measured values lie between {N_COVERAGE} simulations{failed}",
        "" if inside >= COVERED_SHARE else "widen the bounds, or check the unit of the measurement",
    )


def _influence(case: Case, model: ForwardModel, base: FloatArray, nominal: Trajectories) -> Iterator[Finding]:
    """Move each parameter to both of its bounds, one at a time."""
    space = case.parameter_space
    p = space.n_parameters
    theta = np.tile(base, (2 * p, 1))
    theta[np.arange(p), np.arange(p)] = space.lower
    theta[p + np.arange(p), np.arange(p)] = space.upper
    moved = np.nan_to_num(np.abs(model.simulate(theta).y - nominal.y[0]))
    share = (moved.max(axis=1) / case.measurement.uncertainty).max(axis=1).reshape(2, p).max(axis=0)
    dead = [space.names[i] for i in np.flatnonzero(moved.reshape(2, p, -1).max(axis=(0, 2)) <= SAME)]
    if dead:
        yield Finding(
            "every parameter moves an output",
            "fail",
            f"no effect: {', '.join(dead)}",
            "name the variable that the equations use, or leave the parameter out",
        )
        return
    weak = [space.names[i] for i in np.flatnonzero(share < UNSEEN_SHARE)]
    least = int(np.argmin(share))
    yield Finding(
        "every parameter moves an output",
        "warn" if weak else "ok",
        f"the weakest, {space.names[least]}, by {share[least]:.2g} times the sensor's uncertainty",
        f"{', '.join(weak)} cannot be identified; leave out or fix" if weak else "",
    )


def _reuse(first: Trajectories, again: Trajectories, fresh: Trajectories) -> Finding:
    difference = max(float(np.max(np.abs(other.y - first.y))) for other in (again, fresh))
    if not difference <= SAME:
        return Finding(
            "reset equals fresh",
            "fail",
            f"the same parameters give outputs {difference:.3g} apart after other simulations",
            "the FMU keeps a state over fmi2Reset; have its exporter corrected",
        )
    exact = "bit for bit" if difference == 0.0 else f"within {difference:.1g}"
    return Finding("reset equals fresh", "ok", f"the same answer {exact}, reused or fresh")


def _halving(case: Case, halved: Case, base: FloatArray, nominal: Trajectories) -> Finding:
    with halved.open_model() as model:
        fine = model.simulate(base[None])
    what = f"half the communication step ({halved.communication_step_s:g} s)"
    if fine.failed[0]:
        return Finding(what, "warn", f"failed: {fine.failures[0]}", "check the FMU's smallest step")
    change = np.abs(fine.y[0] - nominal.y[0]).max(axis=0)
    share, most = float(np.max(change / case.measurement.uncertainty)), float(change.max())
    good = share <= STEP_SHARE
    return Finding(
        what,
        "ok" if good else "warn",
        f"changes the output by {most:.3g} at most, {share:.2g} times the sensor's uncertainty",
        "" if good else "lower communication_step_s in the case file, or choose another interpolation",
    )


def _planned(case: Case, profile: Profile) -> dict[str, int]:
    p, n = case.parameter_space.n_parameters, len(profile.data.n_train)
    return {
        "training": max(profile.data.n_train),
        "validation": profile.data.n_validation,
        "test": profile.data.n_test,
        "sensitivity": profile.sensitivity.n_base * (p + 2),
        "calibration at most": n * (profile.polish.max_calls + 1),
    }


def _cost(profile: Profile, simulation_s: float, planned: dict[str, int]) -> Finding:
    total = sum(planned.values())
    trainings = len(profile.data.n_train) * profile.tuning.n_trials
    return Finding(
        f"cost of profile {profile.name}",
        "ok",
        f"{1000 * simulation_s:.3g} ms per simulation; at most {total} simulations, "
        f"{format_seconds(total * simulation_s)} on one core; {trainings} trainings",
    )
