"""What drives a case's model, as a network needs to know it: potentials, sources, switches, by their units.

An input in the output's unit, as an outdoor temperature, is a potential. Others are sources, as the sun. An
input without unit that takes two values may also switch conductances, as a fan does.
"""

import numpy as np

from pelsvae.linear_network.drive import Drive
from simulation.case import Case
from simulation.units import Unit, in_si

# Solving costs time in proportion: ten weeks of ten-minute steps.
MOST_STEPS = 10_000
# Powers of a second and a kelvin of which a specific heat, J/(kg.K), has none.
TIME = {"s": 1, "K": -2}


def network_of_stores(case: Case) -> Drive | None:
    """Return what drives a case's model, None where it cannot be a network of stores that is fitted in time.

    Args:
        case: The case.
    """
    drive = drive_of(case)
    # Rows of several experiments are several trajectories, each with inputs of its own.
    if case.experiments or drive is None or len(drive.pattern) > MOST_STEPS or not drive.is_alike.all():
        return None
    unit = in_si(case.outputs[0].unit)
    return drive if case.scenario.inputs.shape[1] and unit is not None and unit.exponents else None


def drive_of(case: Case) -> Drive | None:
    """Return what drives a case's model; None where its experiments differ in inputs, outputs or step.

    Args:
        case: The case, with experiments or without.
    """
    members = case.members or ((None, case),)
    first = members[0][1]
    steps = [float(np.diff(one.scenario.time_communication[:2])[0]) for _, one in members]
    models = [[output.name for output in one.outputs] for _, one in members]
    inputs_alike = len({one.scenario.input_names for _, one in members}) == 1
    if max(steps) > min(steps) or not inputs_alike or any(set(names) != set(models[0]) for names in models):
        return None
    names = models[0]
    unit = in_si(first.outputs[0].unit)
    lengths = [len(one.scenario.inputs) for _, one in members]
    n_steps = sum(lengths)
    columns = np.empty((len(members), len(names)), dtype=np.int64)
    for place, (experiment, one) in enumerate(members):
        where = range(len(names)) if experiment is None else experiment.outputs
        for column, output in zip(where, one.outputs, strict=True):
            columns[place, names.index(output.name)] = column
    potentials, sources, switches, powers = [], [], [], []
    inputs = np.concatenate([one.scenario.inputs for _, one in members])
    for name, values in zip(first.scenario.input_names, inputs.T, strict=True):
        declared = first.said_units.get(name) or first.fmu.variables[name].unit
        of_input = in_si(declared, first.fmu.units) if declared else None
        if unit is not None and unit.exponents and of_input and of_input.exponents == unit.exponents:
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
    is_start = np.array(
        [unit is not None and one is not None and one.exponents == unit.exponents for one in parameters]
    )
    ratios = [
        float(one.factor / unit.factor) if one is not None and unit is not None else 0.0 for one in parameters
    ]
    known = np.array([np.nan if one is None else powers_of_time(one) for one in parameters])
    is_thermal = (
        unit is not None
        and unit.exponents == (("K", 1),)
        and bool(np.isfinite(known).all() and np.isfinite(powers).all())
    )
    of_outputs = [in_si(output.unit) for output in first.outputs]
    return Drive(
        potentials=np.array(potentials).reshape(-1, n_steps).T.copy(),
        sources=np.array(sources).reshape(-1, n_steps).T.copy(),
        pattern=pattern.reshape(-1).astype(np.int64),
        patterns=patterns,
        step=steps[0] / (2.0 * first.output_step_s),
        bounds=np.cumsum([0, *lengths]).astype(np.int64),
        every=np.array([one.scenario.output_every for _, one in members], dtype=np.int64),
        n_before=np.array([one.scenario.n_warmup for _, one in members], dtype=np.int64),
        columns=columns,
        # Without units the first output alone is a state.
        is_alike=np.array(
            [place == 0 or (one is not None and one == unit) for place, one in enumerate(of_outputs)]
        ),
        is_start=is_start,
        start_ratio=np.where(is_start, ratios, 0.0),
        time_powers=known if is_thermal else np.empty(0),
        source_powers=np.array(powers, dtype=np.float64),
    )


def powers_of_time(unit: Unit | None) -> float:
    """Return powers of time in a unit of heat, twice those of temperature subtracted; 0 for no unit.

    Constants of a model are lengths, masses and specific heats mostly, which have none: a conductance in W/K
    has -1, a capacity in J/K has 0, and formulas keep the sum.
    """
    return float(sum(TIME.get(base, 0) * power for base, power in (unit.exponents if unit else ())))
