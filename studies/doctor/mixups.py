"""Columns that were taken for one another, and signs: whether another order or sign fits far better."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from simulation.arrays import FloatArray
from simulation.case import Case
from simulation.case_reading import read_experiments
from simulation.fmi.fmu import FmuSettings
from simulation.fmi.variable import REAL_KINDS
from simulation.measurement import MeasuredOutput, Measurement
from simulation.samples import Samples
from simulation.trajectories import Trajectories
from simulation.units import in_si
from studies.doctor.finding import Finding, named

FAR_BETTER = 0.25
"""Another order or sign has to leave at most this share of the squared error: half of the difference."""
UNEXPLAINED = 0.5
"""And, apart from its mean, this share of the measurement's variance: a poor fit speaks for nothing."""
GOOD_FIT = 0.1
"""A fit that leaves no more of the variance could not become far better."""
_FACTORS = {
    factor**sign: f"{word} {factor:.12g}"
    for factor in (1000.0, 3600.0, 3.6e6)
    for sign, word in ((1, "times"), (-1, "divided by"))
}
"""Between W, kW, J, Wh and kWh, in words."""
NEAR, FARTHER = 4.0, 0.01
"""Another scale also counts where simulations come within two deviations of it, and were ten times as far."""
N_POINTS = 32
"""Points that each other order or sign of inputs is tried at."""
N_FIRST = 4
"""Points after which those are left that are nowhere better."""
MOST_TRIED = 24
"""Other orders and signs of inputs that are tried."""


@dataclass(frozen=True, eq=False)
class Mixup:
    """Another order or sign of what a case reads.

    Args:
        said: what is another, in words.
        settings: the model with these inputs.
    """

    said: str
    settings: FmuSettings


@dataclass(frozen=True, eq=False)
class Fit:
    """How rows fit, for each measured output.

    Args:
        squares: mean square differences. Shape (n, k). [uncertainties squared]
        shapes: the same without each row's mean difference. Shape (n, k). [uncertainties squared]
    """

    squares: FloatArray
    shapes: FloatArray

    @classmethod
    def of(cls, measurement: Measurement, y: FloatArray) -> "Fit":
        """Compare rows with a measurement, one column for each measured output. y of shape (n, t, k)."""
        found = [
            (measurement.differences(y, k) / measurement.outputs[k].uncertainty) for k in measurement.measured
        ]
        with np.errstate(over="ignore"):  # of a simulation that diverges
            return cls(
                np.column_stack([np.mean(one**2, axis=1) for one in found]),
                np.column_stack([np.var(one, axis=1) for one in found]),
            )

    def of_rows(self, kind: str, columns: list[int]) -> FloatArray:
        """Return how each row fits in some outputs. Shape (n,). [uncertainties squared]."""
        values: FloatArray = getattr(self, kind)[:, columns].sum(axis=1)
        return values


def deviations(measurement: Measurement) -> FloatArray:
    """Return how far measured values deviate from their mean. Shape (k,). [uncertainties squared]."""
    outputs = [measurement.outputs[k] for k in measurement.measured]
    return np.array([float(np.var(one.samples.values)) / one.uncertainty**2 for one in outputs])


def fits_well(case: Case, known: Trajectories) -> bool:
    """Say whether some simulation fits so well that no other order or sign could fit far better."""
    fit, usual = Fit.of(case.measurement, known.y), deviations(case.measurement)
    return bool(fit.squares.sum(axis=1).min() <= GOOD_FIT * usual.sum())


def input_mixups(case: Case) -> list[Mixup]:
    """Return the models with two inputs of one unit swapped, and with one of another sign."""
    read = {one.name: one.file for one in read_experiments(case.path)}[case.experiment]
    units = {table.name: table.unit for table in read.inputs}
    scenario, variables = case.settings.scenario, case.fmu.variables
    names = scenario.input_names
    real = [k for k, name in enumerate(names) if variables[name].kind in REAL_KINDS]

    def with_columns(change: dict[int, tuple[int, float]]) -> FmuSettings:
        series = dict[str, Any]()
        for key, values in zip(("inputs", "inputs_at_edges"), scenario.driving, strict=False):
            other = values.copy()
            for column, (source, sign) in change.items():
                other[:, column] = sign * values[:, source]
            series[key] = other
        return replace(case.settings, scenario=replace(scenario, **series))

    found = []
    for k in real:
        values, unit = scenario.inputs[:, k], units[names[k]]
        # A temperature has no other sign, and what lies between 0 and 1 is a switch or a share.
        if _is_temperature(unit) or (values.min() >= 0.0 and values.max() <= 1.0):
            continue
        low = variables[names[k]].minimum
        if low is None or low <= -values.max():
            found.append(Mixup(f"the sign of {names[k]} changed", with_columns({k: (k, -1.0)})))
    for i, j in combinations(real, 2):
        one, other = variables[names[i]], variables[names[j]]
        is_alike = units[one.name] == units[other.name] and one.unit == other.unit
        if is_alike and not np.array_equal(scenario.inputs[:, i], scenario.inputs[:, j]):
            said = f"the columns of {one.name} and {other.name} swapped"
            found.append(Mixup(said, with_columns({i: (j, 1.0), j: (i, 1.0)})))
    return found[:MOST_TRIED]


Better = tuple[float, str]
"""What another order or sign leaves of the difference, and what it is, in words."""


def better_outputs(case: Case, known: Trajectories) -> list[Better]:
    """Return which measured columns fit far better in another order or with another sign.

    Args:
        case: The case.
        known: Good simulations all over the box.
    """
    measurement = case.measurement
    usual, plain = deviations(measurement), Fit.of(measurement, known.y)
    found = [
        (_left(columns, plain, Fit.of(other, known.y), usual), said)
        for said, columns, other in _output_mixups(measurement)
    ]
    return [one for one in found if one[0] < 1.0]


def look_at_scales(case: Case, known: Trajectories) -> Iterator[Finding]:
    """Name usual factors and offsets between units, without which no simulation comes near a measurement.

    Args:
        case: The case.
        known: Good simulations all over the box.
    """
    lines = []
    for k in case.measurement.measured:
        one = case.measurement.outputs[k]
        simulated = case.measurement.differences(known.y, k) + one.samples.values
        # Each reading's least difference, as a share of the variance that it would have itself.
        usual = float(np.var(one.samples.values))
        if one.limits is not None or one.samples.since_s is not None or not usual > 0.0:
            continue

        def left(
            factor: float, offset: float, k: int = k, s: FloatArray = simulated, v: float = usual
        ) -> float:
            values = factor * case.measurement.outputs[k].samples.values + offset
            return float(np.mean((s - values) ** 2, axis=1).min()) / (factor**2 * v)

        readings = [(factor, 0.0, said) for factor, said in _FACTORS.items()]
        if _is_temperature(one.unit):
            readings = [(1.0, offset, f"{offset:+g}") for offset in (-273.15, 273.15)]
        share, said = min((left(factor, offset), said) for factor, offset, said in readings)
        plain = left(1.0, 0.0)
        is_explained = share <= min(UNEXPLAINED, FAR_BETTER * plain)
        if plain > 1.0 and (is_explained or share <= min(NEAR, FARTHER * plain)):
            lines.append(f"{one.name}: simulations reach the measured values {said}, and not as they are")
    yield from named("scale", lines, "; ")


def points_to_try(case: Case, known: Trajectories) -> FloatArray:
    """Return points for other inputs: those that fit best now, and others from all over. Shape (m, p)."""
    fit = Fit.of(case.measurement, known.y)
    every = list(range(fit.squares.shape[1]))
    best = [int(np.argmin(fit.of_rows(kind, every))) for kind in ("squares", "shapes")]
    spread = np.linspace(0, known.n - 1, N_POINTS).round().astype(int).tolist()
    return known.theta[list(dict.fromkeys([0, *best, *spread]))[:N_POINTS]]


def may_fit(case: Case, known: Trajectories, points: FloatArray, tried: Trajectories) -> bool:
    """Say whether other inputs are better at any of the first points.

    Args:
        case: The case.
        known: Good simulations with the inputs as they are.
        points: The first points. Shape (m, p). [per parameter]
        tried: The answers there.
    """
    at = {row.tobytes(): k for k, row in enumerate(known.theta)}
    plain = Fit.of(case.measurement, known.y[[at[row.tobytes()] for row in points]])
    other = Fit.of(case.measurement, tried.y)
    every = list(range(plain.squares.shape[1]))
    pairs = [(other.of_rows(kind, every), plain.of_rows(kind, every)) for kind in ("squares", "shapes")]
    return any(bool((there < here).any()) for there, here in pairs)


def better_inputs(case: Case, known: Trajectories, tried: list[tuple[Mixup, Trajectories]]) -> list[Better]:
    """Return which inputs fit far better in another order or with another sign.

    Args:
        case: The case.
        known: Good simulations with the inputs as they are.
        tried: Simulations with others.
    """
    usual, plain = deviations(case.measurement), Fit.of(case.measurement, known.y)
    found = [
        (_left(list(range(len(usual))), plain, Fit.of(case.measurement, good), usual), mixup.said)
        for mixup, answer in tried
        if len(good := answer.y[~answer.failed])
    ]
    return [one for one in found if one[0] < 1.0]


def look_at_mixups(better: list[Better]) -> Iterator[Finding]:
    """Name other orders and signs that fit far better, the best first."""
    lines = [
        f"{said}: the best simulation is off by {left:.2g} times as much" for left, said in sorted(better)
    ]
    yield from named("mixups", lines, "; ")


def _output_mixups(measurement: Measurement) -> Iterator[tuple[str, list[int], Measurement]]:
    """Yield the words for another measurement, the places of its measured outputs that differ, and it."""
    outputs, measured = measurement.outputs, measurement.measured

    def with_samples(change: dict[int, Samples]) -> Measurement:
        return replace(
            measurement,
            outputs=tuple(
                replace(one, samples=change[k]) if k in change else one for k, one in enumerate(outputs)
            ),
        )

    def is_plain(one: MeasuredOutput) -> bool:
        return one.limits is None

    for (a, i), (b, j) in combinations(list(enumerate(measured)), 2):
        one, other = outputs[i], outputs[j]
        if one.unit == other.unit and is_plain(one) and is_plain(other):
            words = f"the columns of {one.name} and {other.name} swapped"
            yield words, [a, b], with_samples({i: other.samples, j: one.samples})
    for a, i in enumerate(measured):
        if is_plain(outputs[i]) and not _is_temperature(outputs[i].unit):
            samples = outputs[i].samples
            turned = replace(samples, values=-samples.values)
            yield f"the sign of {outputs[i].name} changed", [a], with_samples({i: turned})


def _left(columns: list[int], plain: Fit, other: Fit, usual: FloatArray) -> float:
    """Return what another order or sign leaves of the difference; 1 where it does not fit far better.

    Both the differences and their shape have to be smaller, and one of them far smaller.
    """
    shares = []
    for kind in ("squares", "shapes"):
        here, there = plain.of_rows(kind, columns).min(), other.of_rows(kind, columns).min()
        shares.append(float(there / here) if here > 0.0 else 1.0)
    is_explained = other.of_rows("shapes", columns).min() <= UNEXPLAINED * usual[columns].sum()
    is_better = max(shares) < 1.0 and min(shares) <= FAR_BETTER and is_explained
    return math.sqrt(min(shares)) if is_better else 1.0


def _is_temperature(unit: str) -> bool:
    found = in_si(unit)
    return found is not None and found.exponents == (("K", 1),)
