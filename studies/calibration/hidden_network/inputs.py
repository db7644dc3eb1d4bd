"""What drives a network whose states no output shows: potentials, sources and switches, by their units.

An input in the output's unit, as an outdoor temperature, is a potential. Others are sources, as the sun. An
input without unit that takes two values may also switch conductances, as a fan does.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.case import Case
from simulation.units import Unit, in_si

# Solving costs time in proportion: ten weeks of ten-minute steps.
MOST_STEPS = 10_000
# Powers of a second and a kelvin of which a specific heat, J/(kg.K), has none.
TIME = {"s": 1, "K": -2}


@dataclass(frozen=True, eq=False)
class NetworkInputs:
    """What is known of a network beside its outputs.

    Attributes:
        potentials: Inputs in the outputs' unit over the m communication steps. Shape (m, a). [first output's
            unit]
        sources: Other inputs, divided by their standard deviations. Shape (m, b). [1]
        pattern: Which pattern of the switches holds in each step. Shape (m,).
        patterns: Which switches are on in each pattern. Shape (r, w).
        step: Communication step in units of two output steps. [1]
        every: Communication steps from one output to the next.
        n_before: First outputs that are simulated and not reported.
        is_start: Parameters in the outputs' unit: they may be states at the start. Shape (p,).
        start_scale: Half ranges of these in the first output's unit, 0 for others. Shape (p,).
        time_powers: Powers of time in the units of the parameters, empty where units are not known: see
            `powers_of_time`. Shape (p,).
        source_powers: The same of the sources. Shape (b,).
    """

    potentials: FloatArray
    sources: FloatArray
    pattern: IntArray
    patterns: FloatArray
    step: float
    every: int
    n_before: int
    is_start: BoolArray
    start_scale: FloatArray
    time_powers: FloatArray
    source_powers: FloatArray

    @classmethod
    def of(cls, case: Case) -> Self | None:
        """Return what drives a case's model, None where it cannot be such a network.

        Args:
            case: The case.
        """
        scenario = case.scenario
        outputs = [in_si(output.unit) for output in case.outputs]
        unit = outputs[0]
        n_steps, n_inputs = scenario.inputs.shape
        is_alike = unit is not None and unit.exponents and all(unit == other for other in outputs)
        # Rows of several experiments are several trajectories, each with inputs of its own.
        if case.experiments or not is_alike or not n_inputs or n_steps > MOST_STEPS:
            return None
        assert unit is not None, "checked above"
        potentials, sources, switches, powers = [], [], [], []
        for name, values in zip(scenario.input_names, scenario.inputs.T, strict=True):
            declared = case.said_units.get(name) or case.fmu.variables[name].unit
            of_input = in_si(declared, case.fmu.units) if declared else None
            if of_input is not None and of_input.exponents == unit.exponents:
                in_si_units = values * float(of_input.factor) + float(of_input.offset)
                potentials.append((in_si_units - float(unit.offset)) / float(unit.factor))
                continue
            levels, size = np.unique(values), float(values.std())
            is_switch = levels.size == 2 and (of_input is None or not of_input.exponents)
            if is_switch:
                switches.append(values == levels[1])
            elif size > 0.0:
                sources.append(values / size)
                powers.append(np.nan if of_input is None and declared else powers_of_time(of_input))
        on = np.array(switches, dtype=np.float64).reshape(-1, n_steps).T
        patterns, pattern = np.unique(on, axis=0, return_inverse=True)
        parameters = [in_si(one.unit) for one in case.parameter_space.parameters]
        is_start = np.array([one is not None and one.exponents == unit.exponents for one in parameters])
        half = 0.5 * (case.parameter_space.upper - case.parameter_space.lower)
        ratios = [float(one.factor / unit.factor) if one is not None else 0.0 for one in parameters]
        known = np.array([np.nan if one is None else powers_of_time(one) for one in parameters])
        is_thermal = unit.exponents == (("K", 1),) and np.isfinite(known).all() and np.isfinite(powers).all()
        edges = scenario.time_communication
        return cls(
            np.array(potentials).reshape(-1, n_steps).T.copy(),
            np.array(sources).reshape(-1, n_steps).T.copy(),
            pattern.reshape(-1).astype(np.int64),
            patterns,
            float(edges[1] - edges[0]) / (2.0 * case.output_step_s),
            scenario.output_every,
            scenario.n_warmup,
            is_start,
            np.where(is_start, half * np.array(ratios), 0.0),
            known if is_thermal else np.empty(0),
            np.array(powers, dtype=np.float64),
        )


def powers_of_time(unit: Unit | None) -> float:
    """Return powers of time in a unit of heat, twice those of temperature subtracted; 0 for no unit.

    Constants of a model are lengths, masses and specific heats mostly, which have none: a conductance in W/K
    has -1, a capacity in J/K has 0, and formulas keep the sum.
    """
    return float(sum(TIME.get(base, 0) * power for base, power in (unit.exponents if unit else ())))
